//! The production tracers against the f64 reference.

use crate::common::{
    Gaussian, PatternedSurfaces, Random, add_random_triangles, add_triangle, hangs_on_rounding_in, splats,
};
use glam::{DQuat, DVec3, Vec3};
use rayon::prelude::*;
use splatprobe::bvh::Bvh;
use splatprobe::job::{Order, ShDirection};
use splatprobe::scene::splats::ALPHA_MIN;
use splatprobe::scene::{Scene, Splats};
use splatprobe::trace::{
    BeamTracer, Face, Footprint, Level, Radiance, Ray, RayTracer, ReferenceTracer, Tile, TileTracer, TraceSettings,
};

use super::{Row, worse};

/// What the numbers are.
pub const WHAT: &str = "Production tracers against the f64 reference, without a cut-off: the largest difference of any texel's colour sums, \
transmittance, or mean distance (relative to the scene's size), in both orders of blending, with and without a \
footprint, on whole small faces and within a large one. Rays on which the model itself jumps within rounding are left out: a response \
at the threshold of 1/255, two at the same distance, one that is strongest at the probe itself. Rods are thinner \
than f32 can place a ray; the beam cannot resolve discs thinner than about 1e-13 of their distance, which no row \
shows.";

/// A scene and where it is seen from.
struct Case {
    name: String,
    scene: Scene,
    origins: Vec<DVec3>,
    /// Texels along a face.
    size: u32,
    /// What colours and distances are measured by.
    colour: f32,
    metres: f32,
    tolerance: f64,
    /// How large the scene is to what is left out as a jump of the model; nothing is left out without.
    excused: Option<f64>,
}

impl Case {
    /// Gaussians of ordinary colours, seen from the origin.
    fn new(name: impl Into<String>, splats: Splats, tolerance: f64) -> Self {
        let scene = Scene { splats, ..Scene::default() };
        let (name, origins) = (name.into(), vec![DVec3::ZERO]);
        Self { name, scene, origins, size: 12, colour: 1.0, metres: 1.0, tolerance, excused: Some(1.0) }
    }

    /// A scene some `metres` large.
    fn of_metres(self, metres: f64) -> Self {
        Self { metres: metres as f32, excused: Some(metres), ..self }
    }

    fn from(self, origins: impl IntoIterator<Item = DVec3>) -> Self {
        Self { origins: origins.into_iter().collect(), ..self }
    }

    /// The largest differences of the ray tracer and of the beam tracer at each level.
    fn row(mut self) -> Row {
        let bvh = Bvh::build(&mut self.scene);
        let names = ["ray".to_owned()]
            .into_iter()
            .chain(Level::available().into_iter().map(|level| format!("beam, {}", level.name())));
        let mut worst: Vec<(String, f64)> = names.map(|name| (name, 0.0)).collect();
        for origin in &self.origins {
            for way in [whole, whole_widened, piece] {
                for (worst, found) in worst.iter_mut().zip(self.differences(&bvh, *origin, way)) {
                    worst.1 = worse(worst.1, found);
                }
            }
        }
        Row { case: self.name, worst, tolerance: self.tolerance }
    }

    fn differences(&self, bvh: &Bvh, origin: DVec3, way: fn(u32) -> (TraceSettings, Tile)) -> Vec<f64> {
        let (settings, tile) = way(self.size);
        let scene = &self.scene;
        let surfaces = &PatternedSurfaces(scene);
        let truth = ReferenceTracer { scene, surfaces, settings };
        let ray = RayTracer { scene, bvh, surfaces, settings };
        let beams: Vec<BeamTracer> = Level::available()
            .into_iter()
            .map(|level| BeamTracer { level, ..BeamTracer::new(scene, bvh, surfaces, settings) })
            .collect();
        let tracers: Vec<&dyn TileTracer> =
            std::iter::once(&ray as &dyn TileTracer).chain(beams.iter().map(|beam| beam as _)).collect();
        let mut worst = vec![0.0f64; tracers.len()];
        for face in Face::ALL {
            let tile = Tile { face, ..tile };
            let trace = |tracer: &dyn TileTracer| {
                let mut texels = vec![Radiance::default(); tile.len()];
                tracer.trace_tile(origin, &tile, &mut texels);
                texels
            };
            let expected = trace(&truth);
            for (worst, tracer) in worst.iter_mut().zip(&tracers) {
                for ((seen, expected), direction) in trace(*tracer).iter().zip(&expected).zip(tile.directions()) {
                    let difference = f64::from(self.difference(seen, expected));
                    let ray = Ray { origin, direction };
                    let jumps = |metres| hangs_on_rounding_in(metres, settings.footprint, scene, &ray);
                    // NaN is more than anything, and no excuse.
                    if difference.is_nan() || (difference > *worst && !self.excused.is_some_and(jumps)) {
                        *worst = difference;
                    }
                }
            }
        }
        worst
    }

    fn difference(&self, a: &Radiance, b: &Radiance) -> f32 {
        let sums = (a.splat_sum - b.splat_sum).abs().max((a.surface_sum - b.surface_sum).abs()).max_element();
        let distance = (a.distance_sum - b.distance_sum).abs() / (self.metres + b.distance_sum.abs());
        let all = [sums / self.colour, (a.transmittance - b.transmittance).abs(), distance];
        // `max` would lose a NaN.
        if all.iter().all(|difference| difference.is_finite()) { all.into_iter().fold(0.0, f32::max) } else { f32::NAN }
    }
}

/// Whole faces, as they are traced by default.
fn whole(size: u32) -> (TraceSettings, Tile) {
    let tile = Tile { face: Face::PosX, face_size: size, x: 0, y: 0, width: size, height: size };
    (TraceSettings { t_cutoff: 0.0, ..TraceSettings::default() }, tile)
}

/// The same in the other order, with colours by ray, of Gaussians as wide as a pixel.
fn whole_widened(size: u32) -> (TraceSettings, Tile) {
    let (settings, tile) = whole(size);
    let (order, sh_direction, footprint) = (Order::CameraDistance, ShDirection::Ray, Footprint::pixel(size, 0.3));
    (TraceSettings { order, sh_direction, footprint, ..settings }, tile)
}

/// A piece of a large face.
fn piece(size: u32) -> (TraceSettings, Tile) {
    let (settings, tile) = whole(size);
    (settings, Tile { face_size: 600, x: 290, y: 300, ..tile })
}

fn gaussian(mean: DVec3, standard_deviations: DVec3, opacity: f64) -> Gaussian {
    Gaussian { mean, rotation: DQuat::IDENTITY, standard_deviations, opacity, colour: Vec3::new(0.9, 0.5, 0.2) }
}

/// Gaussians all around the origin from 0.3 to 5 `scale`, with standard deviations that `size` gives in units of that.
fn around(scale: f64, seed: u64, size: impl Fn(&mut Random) -> DVec3) -> Vec<Gaussian> {
    let mut random = Random(seed);
    let one = |_| Gaussian {
        mean: random.direction() * random.uniform(0.3, 5.0) * scale,
        rotation: random.rotation(),
        standard_deviations: size(&mut random) * scale,
        opacity: random.uniform(0.01, 1.0),
        colour: Vec3::from([(); 3].map(|()| random.uniform(0.0, 1.0) as f32)),
    };
    (0..400).map(one).collect()
}

fn ordinary(random: &mut Random) -> DVec3 {
    DVec3::from([(); 3].map(|()| random.uniform(0.01_f64.ln(), 0.4_f64.ln()).exp()))
}

/// All cases, measured.
pub fn rows() -> Vec<Row> {
    let cases = [sizes(), shapes(), values(), crowds(), places()];
    cases.into_iter().flatten().collect::<Vec<_>>().into_par_iter().map(Case::row).collect()
}

/// From nothing to everything.
fn sizes() -> Vec<Case> {
    let mut cases = Vec::new();
    for scale in [1e-14, 1e-4, 1e-2, 1.0, 1e2, 1e4, 1e12] {
        let mut case =
            Case::new(format!("scene of {scale:e} m"), splats(around(scale, 1, ordinary)), 2e-5).of_metres(scale);
        if (1e-5..1e5).contains(&scale) {
            add_random_triangles(&mut case.scene, 40, 2);
            case.scene.meshes.positions.iter_mut().for_each(|corner| *corner *= scale as f32);
        }
        cases.push(case.from([DVec3::ZERO, DVec3::new(0.5, 0.25, -0.125) * scale]));
    }
    for distance in [1e3, 1e5, 1e7] {
        let far = DVec3::new(1.0, -0.3, 0.2) * distance;
        // As large as it must be for f32 to tell its Gaussians apart there.
        let scale = distance / 1e5;
        let mut moved = around(scale, 3, ordinary);
        moved.iter_mut().for_each(|gaussian| gaussian.mean += far);
        let name = format!("scene of {scale:e} m, {distance:e} m from its origin");
        cases.push(Case::new(name, splats(moved), 2e-5).of_metres(scale).from([far]));
    }
    let cover = [gaussian(DVec3::NEG_Z, DVec3::splat(1e4), 0.5), gaussian(DVec3::NEG_Z * 3.0, DVec3::splat(0.3), 0.8)];
    cases.push(Case::new("one Gaussian of 1e4 m around a scene", splats(cover), 1e-5));
    let cover = [gaussian(DVec3::NEG_Z, DVec3::splat(1e18), 0.5), gaussian(DVec3::NEG_Z * 3.0, DVec3::splat(0.3), 0.8)];
    cases.push(Case::new("one Gaussian of 1e18 m around a scene", splats(cover), 1e-5));
    cases
}

/// Long, flat and both.
fn shapes() -> Vec<Case> {
    let mut cases = Vec::new();
    for ratio in [1e2, 1e3, 1e4, 1e5] {
        for (name, thin) in [("rods", [false, true, true]), ("discs", [false, false, true])] {
            let size = |random: &mut Random| {
                DVec3::from(thin.map(|thin| random.uniform(0.2, 1.0) / if thin { ratio } else { 1.0 }))
            };
            // Thinner than f32 can place a ray: 2^-24 of the image is a thousandth of a rod of 1e-4 radians.
            let tolerance = if name == "rods" { 2e-3 } else { 1e-5 };
            cases.push(Case::new(format!("{name} of 1 to {ratio:e}"), splats(around(1.0, 5, size)), tolerance));
        }
    }
    for thickness in [1e-9, 1e-12] {
        let size = |random: &mut Random| DVec3::new(thickness, random.uniform(0.1, 1.0), random.uniform(0.1, 1.0));
        cases.push(Case::new(format!("discs {thickness:e} m thin"), splats(around(1.0, 6, size)), 1e-4));
    }
    let size = |random: &mut Random| DVec3::new(1e18, random.uniform(0.01, 0.1), random.uniform(0.01, 0.1));
    cases.push(Case::new("rods 1e18 m long", splats(around(1.0, 7, size)), 1e-4));
    let size = |random: &mut Random| DVec3::new(1e-15, random.uniform(1e14, 1e15), random.uniform(1e14, 1e15));
    cases.push(Case::new("discs of 1e-15 by 1e15 m", splats(around(1.0, 8, size)), 1e-3));
    cases
}

/// Opacities and colours at and beyond the ends of their ranges.
fn values() -> Vec<Case> {
    let mut cases = Vec::new();
    for opacity in [0.0, ALPHA_MIN, 0.99, 1.0] {
        let mut seen = splats(around(1.0, 9, ordinary));
        seen.opacities.fill(opacity as f32);
        cases.push(Case::new(
            format!("opacity {}", if opacity == ALPHA_MIN { "1/255".into() } else { format!("{opacity:e}") }),
            seen,
            1e-5,
        ));
    }
    for (size, degree) in [(1e-40, 4), (1.0, 4), (1e4, 3), (1e18, 4)] {
        let mut random = Random(10);
        let mut seen = splats(around(1.0, 11, ordinary));
        seen.sh_degree = degree;
        seen.sh = (0..seen.len() * seen.sh_stride()).map(|_| (random.uniform(-1.0, 1.0) * size) as f32).collect();
        // The sum of the bases of a direction is below 5.
        let case = Case::new(format!("SH of degree {degree}, coefficients to {size:e}"), seen, 1e-5);
        cases.push(Case { colour: (5.0 * size).max(1.0) as f32, ..case });
    }
    let mut tiny = around(1.0, 12, ordinary);
    tiny.iter_mut().for_each(|gaussian| gaussian.mean *= DVec3::new(1e-40, 1.0, 1.0));
    cases.push(Case::new("means with denormal x", splats(tiny), 1e-5).from([
        DVec3::ZERO,
        DVec3::X * 1e-40,
        DVec3::X * 1e-310,
    ]));
    cases
}

/// Many in one place.
fn crowds() -> Vec<Case> {
    let mut random = Random(13);
    let overlapping = (0..100_000).map(|_| Gaussian {
        rotation: random.rotation(),
        ..gaussian(
            DVec3::NEG_Z * 2.0 + random.direction(),
            DVec3::from([(); 3].map(|()| random.uniform(0.05, 0.5))),
            random.uniform(0.005, 0.02),
        )
    });
    let overlapping = Case { size: 3, ..Case::new("100 000 overlapping Gaussians", splats(overlapping), 1e-4) };
    let queue = (0..100_000).map(|i| gaussian(DVec3::NEG_Z * (1.0 + f64::from(i) * 1e-5), DVec3::splat(0.05), 0.02));
    let queue = Case { size: 4, ..Case::new("100 000 Gaussians along one ray", splats(queue), 1e-4) };
    let coincident = (0..3000).map(|i| Gaussian {
        colour: Vec3::splat((i % 7) as f32 / 7.0),
        ..gaussian(DVec3::new(0.2, 0.1, -2.0), DVec3::splat(0.2), 0.05)
    });
    // Faces of 32 texels are the smallest whose rays go in packets.
    let coincident =
        Case { size: 32, ..Case::new("3000 Gaussians that are the same but for colour", splats(coincident), 1e-4) };
    let mut random = Random(14);
    let mean = DVec3::new(0.2, 0.1, -2.0);
    let concentric = (0..1000).map(|_| gaussian(mean, DVec3::splat(random.uniform(-7.0, 3.0).exp()), 0.3));
    let concentric =
        Case { size: 32, ..Case::new("1000 concentric Gaussians of one colour", splats(concentric), 2e-5) };
    let concentric = concentric.from([DVec3::ZERO, mean * 0.9]);
    vec![
        overlapping,
        queue,
        // In another order every colour shows, weighted by the product of two opacities.
        Case { excused: None, ..coincident },
        Case { excused: None, ..concentric },
    ]
}

/// Probes where they should not stand.
fn places() -> Vec<Case> {
    let on_means = around(1.0, 15, ordinary);
    let means: Vec<DVec3> = on_means.iter().take(12).map(|gaussian| gaussian.mean.as_vec3().as_dvec3()).collect();
    let beside = means.iter().map(|mean| *mean + DVec3::new(0.0, 1e-9, 0.0));
    let at_means = Case::new("probes at and 1e-9 m beside means", splats(on_means), 1e-4)
        .from(means.iter().copied().chain(beside));

    let disc = |random: &mut Random| DVec3::new(random.uniform(0.1, 1.0), random.uniform(0.1, 1.0), 1e-4);
    let mut flat = around(1.0, 16, disc);
    flat.iter_mut().for_each(|gaussian| gaussian.rotation = DQuat::from_rotation_y(0.3));
    let on_planes = flat
        .iter()
        .take(12)
        .map(|g| g.mean.as_vec3().as_dvec3() + g.rotation * DVec3::new(0.4, -0.3, 0.0))
        .collect::<Vec<_>>();
    let on_planes = Case::new("probes on the planes of discs", splats(flat), 1e-4).from(on_planes);

    let mut triangles = Case::new(
        "probes on the planes of triangles",
        splats([gaussian(DVec3::NEG_Z * 0.5, DVec3::splat(0.2), 0.5)]),
        1e-5,
    );
    add_triangle(
        &mut triangles.scene,
        [Vec3::new(-1.0, 0.0, -1.0), Vec3::new(1.0, 0.0, -1.0), Vec3::new(0.0, 0.0, -3.0)],
    );
    add_triangle(
        &mut triangles.scene,
        [Vec3::new(-1.0, -1.0, -1.0), Vec3::new(1.0, -1.0, -1.0), Vec3::new(0.0, 2.0, -1.0)],
    );
    let triangles = Case { size: 17, ..triangles.from([DVec3::ZERO, DVec3::NEG_Z]) };

    let mut random = Random(17);
    let seams = (0..400).map(|_| {
        // On the planes x = +-z and y = +-z, and right beside the probe.
        let reach = random.uniform(0.01, 3.0);
        let mut side = || if random.below(2) == 0 { reach } else { -reach };
        let mean = DVec3::new(side(), side(), side());
        let size = random.uniform(0.01, 1.5) * reach;
        Gaussian { rotation: random.rotation(), ..gaussian(mean, DVec3::new(size, size * 0.3, size * 0.01), 0.6) }
    });
    let seams = Case { size: 20, ..Case::new("Gaussians on the planes between faces", splats(seams), 2e-5) };

    let mut random = Random(18);
    let grazing = (0..200).map(|i| {
        // The support ends at the probe, within a few roundings: its outline is a plane, a parabola seen from there.
        let size = DVec3::from([(); 3].map(|()| random.uniform(0.01, 2.0)));
        let (rotation, opacity) = (random.rotation(), random.uniform(0.02, 1.0));
        let radius = Splats::support_radius_squared(opacity as f32).sqrt() * (1.0 + f64::from(i % 5 - 2) * 1e-7);
        Gaussian { rotation, ..gaussian(rotation * (random.direction() * radius * size), size, opacity) }
    });
    let grazing = Case::new("supports that end at the probe", splats(grazing), 2e-5);
    // What is strongest at the probe is what this is about.
    let at_means = Case { excused: Some(0.0), ..at_means };
    vec![at_means, on_planes, triangles, seams, grazing]
}

#[test]
fn a_wall_of_fully_transparent_gaussians_is_not_there() {
    let at = |i: i32| DVec3::new(f64::from(i % 141) * 0.05 - 3.5, f64::from(i / 141) * 0.05 - 3.5, -2.0);
    let wall = splats((0..20_000).map(|i| gaussian(at(i), DVec3::splat(0.1), 0.0)));
    let mut scene = Scene { splats: wall, ..Scene::default() };
    let bvh = Bvh::build(&mut scene);
    let tile = Tile { face: Face::NegZ, face_size: 8, x: 0, y: 0, width: 8, height: 8 };
    let mut texels = vec![Radiance::default(); 64];
    let surfaces = PatternedSurfaces(&scene);
    BeamTracer::new(&scene, &bvh, &surfaces, TraceSettings::default()).trace_tile(DVec3::ZERO, &tile, &mut texels);
    assert!(texels.iter().all(|texel| texel.transmittance == 1.0));
}
