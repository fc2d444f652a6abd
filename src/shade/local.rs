//! The surfaces of `--surface probe`: lit by small cubemaps that are baked where the surfaces are.
//!
//! Each part of the meshes has a cubemap, seen from the middle of the part and without it. A hit is lit by its part's
//! cubemap as if that were infinitely far away: the material's own BSDF is sampled at a fixed set of points, and each
//! sample looks up the mip whose texels have its solid angle (filtered importance sampling: Křivánek and Colbert 2008,
//! "Real-time Shading with Filtered Importance Sampling", section 4). All lobes of a material are lit by one rule, and
//! nothing is noisy. Punctual lights are added with their shadows.
//!
//! What is lost against path tracing is what changes over a part: shadows and light of near surfaces, and the part's own
//! reflections of itself.
//
// The split sum (one look-up per lobe, times a tabulated albedo) was the plan. It has no answer for sheen, anisotropy and
// rough refraction, stretches no reflection at grazing angles, and saves little: a hit asks 256 look-ups of a few cache
// lines each.

use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::footing::{self, Footing, lit_fragment, visibility};
use super::material::MaterialPoint;
use super::with_scratch;
use crate::bvh::Bvh;
use crate::filter::{Prefilter, RgbCubemap};
use crate::scene::{LinearRgb, Scene};
use crate::trace::{
    BeamTracer, Face, Fragment, Radiance, Ray, RayTracer, SurfaceHit, Surfaces, Tile, TileTracer, TraceSettings,
};
use crate::{Error, Result};

/// Points at which a hit's BSDF is sampled: a sphere under a sky with a bright spot is then within 3 % of its path-traced
/// image, root mean square (`tests/light/probe.rs`); with half as many within 5 %, with twice as many 1 %.
const POINTS: u32 = 256;

/// Solid angle that a sample looks up over its own; as in prefiltering, samples that overlap less err less.
const TEXEL_PER_SAMPLE: f32 = 0.5;

/// The points, the same for every hit. The first coordinate, which chooses the lobe, grows along them; the others go by the
/// powers of the plastic number's inverse, a sequence of which every run is spread evenly (Roberts 2018, R2), so that each
/// lobe has points of its own as good as if it were alone.
///
/// At 128 points, a rough metal errs by 5 %; with Owen-scrambled Sobol points by 6 to 12 %, and with a Fibonacci lattice whose
/// lobe goes by a third irrational, so that each lobe draws its points at random, by 8 to 10 %.
fn point(index: u32) -> Vec3 {
    const STEPS: [f64; 2] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_2];
    let [u, v] = STEPS.map(|step| (0.5 + f64::from(index) * step).fract() as f32);
    Vec3::new((index as f32 + 0.5) / POINTS as f32, u, v)
}

/// Times that light is passed on from part to part. In the first, parts see the others by what they emit.
const BOUNCES: u32 = 2;

/// Texels along an edge of the cubemaps' faces. Where there are many parts each gets a smaller one, by halves, so that no
/// more than about [`RAYS`] are traced.
pub const FACE_SIZE: u32 = Tile::EDGE;

const LEAST_FACE_SIZE: u32 = 8;

/// Rays that all cubemaps of one bounce may take.
const RAYS: u64 = 8 << 20;

/// The surfaces of a scene, each lit by the cubemap of its part.
pub struct LocallyLitSurfaces<'a> {
    scene: &'a Scene,
    bvh: &'a Bvh,
    trace: TraceSettings,
    ray_angle: f32,
    /// What lights each part.
    light: Vec<Prefilter>,
}

impl<'a> LocallyLitSurfaces<'a> {
    /// The surfaces of `scene`, whose tree is `bvh`; bakes the cubemaps that light them, by the rules of `trace`.
    ///
    /// Fails with [`Error::Request`] where a cubemap is not finite, and with [`Error::Cancelled`] when `cancel` is set.
    pub fn new(scene: &'a Scene, bvh: &'a Bvh, trace: TraceSettings, cancel: &AtomicBool) -> Result<Self> {
        // No ray meets a part all of whose triangles were left out.
        let middles: Vec<DVec3> =
            scene.meshes.part_bounds().into_iter().map(|bounds| bounds.map_or(DVec3::ZERO, |b| b.centre())).collect();
        let rays_of = |size: u32| middles.len() as u64 * 6 * u64::from(size).pow(2);
        let mut size = FACE_SIZE;
        while size > LEAST_FACE_SIZE && rays_of(size) > RAYS {
            size /= 2;
        }
        let mut surfaces = Self { scene, bvh, trace, ray_angle: 0.0, light: Vec::new() };
        for _ in 0..BOUNCES {
            let parts = middles.par_iter().enumerate();
            surfaces.light =
                parts.map(|(part, &middle)| surfaces.light_at(part, middle, size, cancel)).collect::<Result<_>>()?;
        }
        Ok(surfaces)
    }

    /// The same for rays that widen by `ray_angle` radians: textures are averaged over that.
    pub fn for_rays_of(self, ray_angle: f64) -> Self {
        Self { ray_angle: ray_angle as f32, ..self }
    }

    /// The cubemap around the middle of `part`, without it, with the light that there is so far.
    fn light_at(&self, part: usize, middle: DVec3, size: u32, cancel: &AtomicBool) -> Result<Prefilter> {
        let without = Without { surfaces: self, part };
        let tracer = BeamTracer::new(self.scene, self.bvh, &without, self.trace);
        let mut texels = Vec::with_capacity(6 * (size * size) as usize);
        for face in Face::ALL {
            if cancel.load(Ordering::Relaxed) {
                return Err(Error::Cancelled);
            }
            let tile = Tile { face, face_size: size, x: 0, y: 0, width: size, height: size };
            let mut radiance = vec![Radiance::default(); tile.len()];
            tracer.trace_tile(middle, &tile, &mut radiance);
            texels.extend(radiance.iter().zip(tile.directions()).map(|(radiance, direction)| {
                radiance.to_linear(self.scene.encoding, self.scene.background_along(direction)).0
            }));
        }
        Ok(Prefilter::new(RgbCubemap::new(size, texels)?))
    }

    /// The light that a lit surface sends back, without what it emits.
    fn reflected(&self, part: usize, footing: &Footing, material: &MaterialPoint) -> Vec3 {
        let bsdf = footing.bsdf(&footing.parameters);
        let mut indirect = Vec3::ZERO;
        if let Some(light) = self.light.get(part) {
            for index in 0..POINTS {
                let Some(sample) = bsdf.sample(point(index)) else { continue };
                let direction = footing.world(sample.direction);
                if !footing.is_consistent(direction, sample.direction) {
                    continue;
                }
                let entered = (sample.direction.z < 0.0) == footing.front;
                let passed = if entered && footing.parameters.thickness > 0.0 {
                    footing.parameters.attenuation(footing.parameters.thickness)
                } else {
                    Vec3::ONE
                };
                let solid_angle = sample.density.map_or(0.0, |density| TEXEL_PER_SAMPLE / (POINTS as f32 * density));
                indirect += sample.weight * passed * light.mean_radiance(direction.as_vec3(), solid_angle);
            }
        }
        // The file's occlusion is of light from all around (glTF 2.0, section 3.9.3): what the part hides from itself.
        let mut reflected = indirect * material.occlusion / POINTS as f32;
        for light in &self.scene.lights {
            let Some(incident) = light.incident_at(footing.position.as_vec3()) else { continue };
            let direction = incident.to_light.as_dvec3().normalize();
            let response = footing.response(&bsdf, direction).value;
            if response != Vec3::ZERO {
                let ray = footing.leave(direction);
                let visible =
                    with_scratch(|scratch| visibility(&self.tracer(), &ray, incident.distance.into(), scratch));
                reflected += response * incident.irradiance.0 * visible;
            }
        }
        if reflected.is_finite() { reflected } else { Vec3::ZERO }
    }

    fn tracer(&self) -> RayTracer<'_> {
        RayTracer { scene: self.scene, bvh: self.bvh, surfaces: self, settings: self.trace }
    }
}

impl Surfaces for LocallyLitSurfaces<'_> {
    fn is_opaque(&self, triangle: u32) -> bool {
        footing::is_opaque(&self.scene.meshes, triangle)
    }

    fn is_double_sided(&self, triangle: u32) -> bool {
        footing::is_double_sided(&self.scene.meshes, triangle)
    }

    fn fragment(&self, ray: &Ray, hit: &SurfaceHit) -> Fragment {
        let part = self.scene.meshes.part_of(hit.triangle as usize);
        lit_fragment(&self.scene.meshes, ray, hit, self.ray_angle, |footing, material| {
            self.reflected(part, footing, material)
        })
    }
}

/// The surfaces of all parts but one, which rays pass as if it were not there.
struct Without<'a> {
    surfaces: &'a LocallyLitSurfaces<'a>,
    part: usize,
}

impl Without<'_> {
    fn is_there(&self, triangle: u32) -> bool {
        self.surfaces.scene.meshes.part_of(triangle as usize) != self.part
    }
}

impl Surfaces for Without<'_> {
    fn is_opaque(&self, triangle: u32) -> bool {
        self.is_there(triangle) && self.surfaces.is_opaque(triangle)
    }

    fn is_double_sided(&self, triangle: u32) -> bool {
        self.surfaces.is_double_sided(triangle)
    }

    fn fragment(&self, ray: &Ray, hit: &SurfaceHit) -> Fragment {
        if self.is_there(hit.triangle) {
            self.surfaces.fragment(ray, hit)
        } else {
            Fragment { alpha: 0.0, radiance: LinearRgb::default() }
        }
    }
}
