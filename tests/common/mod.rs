//! Small scenes with known properties, shared by the integration tests.
#![allow(dead_code)] // each test binary uses its part

pub mod gltf;

use glam::{DQuat, DVec3, Vec2, Vec3};
use splatprobe::scene::Material;
use splatprobe::scene::mesh::VertexAttributes;
use splatprobe::scene::splats::ALPHA_MIN;
use splatprobe::scene::{LinearRgb, Scene, Splats, sh};
use splatprobe::trace::{Footprint, Fragment, Ray, SurfaceHit, Surfaces, gaussian};

/// A counter-based generator (splitmix64): the same numbers on every machine.
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [low, high).
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn below(&mut self, end: usize) -> usize {
        (self.bits() % end as u64) as usize
    }

    pub fn direction(&mut self) -> DVec3 {
        loop {
            let p = DVec3::new(self.uniform(-1.0, 1.0), self.uniform(-1.0, 1.0), self.uniform(-1.0, 1.0));
            if (1e-3..1.0).contains(&p.length()) {
                return p.normalize();
            }
        }
    }

    pub fn rotation(&mut self) -> DQuat {
        DQuat::from_axis_angle(self.direction(), self.uniform(0.0, std::f64::consts::TAU))
    }
}

/// One Gaussian to be added to a scene.
pub struct Gaussian {
    pub mean: DVec3,
    pub rotation: DQuat,
    pub standard_deviations: DVec3,
    pub opacity: f64,
    pub colour: Vec3,
}

/// Gaussians without view dependence.
pub fn splats(gaussians: impl IntoIterator<Item = Gaussian>) -> Splats {
    let mut splats = Splats::default();
    for g in gaussians {
        splats.means.push(g.mean.as_vec3());
        splats.unit_from_world.push(Splats::unit_from_world(g.rotation, g.standard_deviations));
        splats.opacities.push(g.opacity as f32);
        let mut dc = [0.0; 25];
        sh::basis(0, Vec3::Z, &mut dc);
        splats.sh.extend((g.colour - 0.5).to_array().map(|c| c / dc[0]));
    }
    splats
}

/// A cloud around the origin, standard deviations log-uniform in `sizes`, colours with bands up to `degree`.
pub fn cloud(count: usize, sizes: [f64; 2], degree: u8, seed: u64) -> Splats {
    let mut random = Random(seed);
    let mut splats = Splats { sh_degree: degree, ..Splats::default() };
    for _ in 0..count {
        let mut size = || random.uniform(sizes[0].ln(), sizes[1].ln()).exp();
        let standard_deviations = DVec3::new(size(), size(), size());
        let distance = random.uniform(0.3, 5.0);
        splats.means.push((random.direction() * distance).as_vec3());
        splats.unit_from_world.push(Splats::unit_from_world(random.rotation(), standard_deviations));
        splats.opacities.push(random.uniform(0.01, 1.0) as f32);
        splats.sh.extend((0..3 * sh::coefficient_count(degree)).map(|_| random.uniform(-0.8, 0.8) as f32));
    }
    splats
}

/// Adds a single triangle.
pub fn add_triangle(scene: &mut Scene, corners: [Vec3; 3]) {
    let meshes = &mut scene.meshes;
    let first = meshes.positions.len() as u32;
    meshes.positions.extend(corners);
    meshes.attributes.extend([VertexAttributes::default(); 3]);
    meshes.triangles.push([first, first + 1, first + 2]);
    if meshes.materials.is_empty() {
        meshes.materials.push(Material::default());
    }
    meshes.triangle_materials.push(0);
}

/// Randomly placed triangles around the origin.
pub fn add_random_triangles(scene: &mut Scene, count: usize, seed: u64) {
    let mut random = Random(seed);
    for _ in 0..count {
        let centre = random.direction() * random.uniform(0.5, 5.0);
        add_triangle(scene, [(); 3].map(|()| (centre + random.direction() * 0.6).as_vec3()));
    }
}

/// Surfaces whose look depends only on where they are: a third opaque, a third masked, a third blended, so that order
/// cannot depend on how a tree has sorted them.
pub struct PatternedSurfaces<'a>(pub &'a Scene);

impl PatternedSurfaces<'_> {
    fn kind(&self, triangle: u32) -> u32 {
        self.0.meshes.corners(triangle as usize)[0].x.to_bits() % 3
    }
}

impl Surfaces for PatternedSurfaces<'_> {
    fn is_opaque(&self, triangle: u32) -> bool {
        self.kind(triangle) == 0
    }

    fn is_double_sided(&self, _: u32) -> bool {
        true
    }

    fn fragment(&self, _: &Ray, hit: &SurfaceHit) -> Fragment {
        let Vec2 { x, y } = hit.barycentric;
        let alpha = match self.kind(hit.triangle) {
            0 => 1.0,
            1 => f32::from(((x * 8.0) as u32 + (y * 8.0) as u32).is_multiple_of(2)),
            _ => 0.2 + 0.6 * x,
        };
        Fragment { alpha, radiance: LinearRgb(Vec3::new(x, y, 0.5) * 2.0) }
    }
}

/// No surfaces at all.
pub struct NoSurfaces;

impl Surfaces for NoSurfaces {
    fn is_opaque(&self, _: u32) -> bool {
        false
    }

    fn is_double_sided(&self, _: u32) -> bool {
        false
    }

    fn fragment(&self, _: &Ray, _: &SurfaceHit) -> Fragment {
        unreachable!("the scene has no triangles")
    }
}

/// Whether the value along the ray hangs on a rounding of f32: some Gaussian's response is 1/255 to within 2e-5 or is
/// strongest within a micrometre of the ray's origin (it counts in front and not behind), or two that contribute have their strongest response at the same
/// distance to within 1e-6.
pub fn hangs_on_rounding(scene: &Scene, ray: &Ray) -> bool {
    hangs_on_rounding_under(Footprint::default(), scene, ray)
}

/// [`hangs_on_rounding`], of Gaussians that `footprint` has widened.
pub fn hangs_on_rounding_under(footprint: Footprint, scene: &Scene, ray: &Ray) -> bool {
    hangs_on_rounding_in(1.0, footprint, scene, ray)
}

/// [`hangs_on_rounding_under`], in a scene some `metres` large.
pub fn hangs_on_rounding_in(metres: f64, footprint: Footprint, scene: &Scene, ray: &Ray) -> bool {
    let responses = responses(footprint, scene, ray);
    let mut distances: Vec<f64> = responses.iter().filter(|r| r.contributes(0.0)).map(|r| r.distance).collect();
    distances.sort_by(f64::total_cmp);
    responses.iter().any(|r| (r.alpha / ALPHA_MIN - 1.0).abs() < 2e-5)
        || distances.windows(2).any(|pair| pair[1] / pair[0] - 1.0 < 1e-6)
        || responses.iter().any(|r| r.alpha >= ALPHA_MIN && r.distance.abs() < 1e-6 * metres)
}

fn responses(footprint: Footprint, scene: &Scene, ray: &Ray) -> Vec<gaussian::Response> {
    let splats = &scene.splats;
    let response = |i: usize| {
        let mean = splats.means[i].as_dvec3() - ray.origin;
        let (m, opacity) =
            footprint.widened(&splats.unit_from_world[i].as_dmat3(), f64::from(splats.opacities[i]), mean);
        gaussian::response(&m, opacity, mean, ray.direction)
    };
    (0..splats.len()).map(response).collect()
}
