//! The surfaces of `--surface path`: lit by everything that their scene sends them, found by path tracing.
//!
//! A hit is the mean of paths that start there (Kajiya 1986). Paths go on through the tracer's own tree, so that Gaussians
//! and other surfaces light, hide and mirror each other as they look ([`walk`]). How many paths a hit takes depends on how
//! far they differ ([`PathSettings::noise`]). Their random numbers follow from the ray that asks, and from nothing else.

mod noise;
mod walk;

use glam::{DVec3, Vec3};

use self::noise::NoiseSums;
use self::walk::Walk;
use super::footing::{self, Footing, lit_fragment};
use super::lights::Lights;
use super::sampling::{Sampler, hash_all};
use super::with_scratch;
use crate::bvh::Bvh;
use crate::scene::Scene;
use crate::trace::{Fragment, Ray, RayTracer, SurfaceHit, Surfaces, TraceSettings};

pub use noise::SurfaceNoise;

/// How much work a hit is worth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathSettings {
    /// A hit takes paths until the standard error of its reflected light, estimated from their differences, is at most this
    /// share of it (where it is darker than 1/20 of paper white, of that). 0: always `max_paths`.
    pub noise: f32,
    /// Most paths of a hit.
    pub max_paths: u32,
    /// Most surfaces that a path meets after the first.
    pub max_bounces: u32,
}

impl Default for PathSettings {
    fn default() -> Self {
        Self { noise: 0.02, max_paths: 1024, max_bounces: 32 }
    }
}

/// Paths before the first look at how they differ. Fewer would now and then agree by chance and end a hit too early.
const FIRST_PATHS: u32 = 32;

/// Hits darker than this share of paper white need not be known to the same share of themselves.
const DARK: f32 = 0.05;

/// The surfaces of a scene, lit by it.
pub struct PathSurfaces<'a> {
    scene: &'a Scene,
    bvh: &'a Bvh,
    trace: TraceSettings,
    settings: PathSettings,
    lights: Lights<'a>,
    ray_angle: f32,
    noise: NoiseSums,
}

impl<'a> PathSurfaces<'a> {
    /// The surfaces of `scene`, whose tree is `bvh`. Secondary rays follow the same rules, `trace`, as those that ask.
    /// `origins` are the probes, in metres relative to the scene origin, whose noise [`Self::noise_of`] will know.
    pub fn new(
        scene: &'a Scene,
        bvh: &'a Bvh,
        trace: TraceSettings,
        settings: PathSettings,
        origins: &[DVec3],
    ) -> Self {
        let lights = Lights::new(&scene.meshes, &scene.lights);
        Self { scene, bvh, trace, settings, lights, ray_angle: 0.0, noise: NoiseSums::new(origins) }
    }

    /// The same for rays that widen by `ray_angle` radians: textures are averaged over that.
    pub fn for_rays_of(self, ray_angle: f64) -> Self {
        Self { ray_angle: ray_angle as f32, ..self }
    }

    /// How noisy the surfaces are that the probe at `origin` has asked for; `None` where it saw none that is lit.
    pub fn noise_of(&self, origin: DVec3) -> Option<SurfaceNoise> {
        self.noise.of(origin)
    }

    fn tracer(&self) -> RayTracer<'_> {
        RayTracer { scene: self.scene, bvh: self.bvh, surfaces: self, settings: self.trace }
    }

    /// The light that a lit surface sends back along `ray`, without what it emits.
    fn reflected(&self, ray: &Ray, footing: &Footing) -> Vec3 {
        let seed = hash_all(
            [ray.origin, ray.direction]
                .into_iter()
                .flat_map(|v| v.to_array())
                .flat_map(|x| [x.to_bits() as u32, (x.to_bits() >> 32) as u32]),
        );
        let walk = Walk {
            tracer: self.tracer(),
            lights: &self.lights,
            ray_angle: self.ray_angle,
            max_bounces: self.settings.max_bounces,
        };
        with_scratch(|scratch| {
            let (mut count, mut mean, mut spread) = (0u32, DVec3::ZERO, 0.0);
            let mut end = FIRST_PATHS.min(self.settings.max_paths.max(1));
            loop {
                while count < end {
                    let light = walk.path(ray, footing, &mut Sampler::new(seed, count), scratch).as_dvec3();
                    count += 1;
                    let from_mean = light - mean;
                    mean += from_mean / f64::from(count);
                    // Welford's running sum of squared differences, of all channels.
                    spread += from_mean.dot(light - mean) / 3.0;
                }
                let error = (spread / f64::from(count) / f64::from(count.max(2) - 1)).sqrt() as f32;
                let brightness = (mean.element_sum() / 3.0) as f32;
                let relative = error / brightness.max(DARK);
                if count >= self.settings.max_paths || relative <= self.settings.noise {
                    self.noise.add(ray.origin, count, relative);
                    return mean.as_vec3();
                }
                end = (count * 2).min(self.settings.max_paths);
            }
        })
    }
}

impl Surfaces for PathSurfaces<'_> {
    fn is_opaque(&self, triangle: u32) -> bool {
        footing::is_opaque(&self.scene.meshes, triangle)
    }

    fn is_double_sided(&self, triangle: u32) -> bool {
        footing::is_double_sided(&self.scene.meshes, triangle)
    }

    fn fragment(&self, ray: &Ray, hit: &SurfaceHit) -> Fragment {
        lit_fragment(&self.scene.meshes, ray, hit, self.ray_angle, |footing, _| self.reflected(ray, footing))
    }
}
