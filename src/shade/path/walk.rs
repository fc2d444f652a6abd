//! One path: from a surface toward the light.
//!
//! At every surface lights are sampled directly and the BSDF is sampled for the next ray, and where both could have found
//! the same light they share it by the power heuristic (Veach 1997, section 9.2). Gaussians are never sampled directly: what
//! a ray gathers of them is its radiance as the tracers define it, blended in their encoding and converted once. Surfaces
//! that cover part of a ray weigh what the ray gathers as they do for a probe's, and the path goes on from one of them,
//! drawn by weight.

use glam::{DVec3, Vec3};

use crate::scene::LinearRgb;
use crate::shade::bsdf::{Bsdf, Response};
use crate::shade::footing::{Footing, LIFT, coverage, visibility};
use crate::shade::lights::Lights;
use crate::shade::material::SurfacePoint;
use crate::shade::sampling::Sampler;
use crate::trace::ray::RayScratch;
use crate::trace::{Fragment, Ray, RayTracer, SurfaceHit};

/// Bounces that no path ends before by chance.
const SURE_BOUNCES: u32 = 3;

/// What all paths of a bake share.
pub(super) struct Walk<'a> {
    pub tracer: RayTracer<'a>,
    pub lights: &'a Lights<'a>,
    pub ray_angle: f32,
    pub max_bounces: u32,
}

/// What a ray meets.
struct Segment {
    /// What it gathers, without surfaces and background.
    radiance: Vec3,
    /// Share of the background that it sees.
    transmittance: f32,
    /// The surface that the path goes on from: its share of the light divided by the probability of drawing it.
    next: Option<(SurfaceHit, f32)>,
}

impl Walk<'_> {
    /// The light that one path brings to the eye at the start of `ray` from the surface at `first`, which `ray` has met.
    pub fn path(&self, ray: &Ray, first: &Footing, sampler: &mut Sampler, scratch: &mut RayScratch) -> Vec3 {
        let mut light = Vec3::ZERO;
        let mut throughput = Vec3::ONE;
        let mut channel = None;
        let mut reached;
        let mut footing = first;
        debug_assert!(ray.direction.is_normalized());
        for bounce in 0.. {
            let [u0, u1, u2, u3] = sampler.next_four();
            let mut parameters = footing.parameters;
            if parameters.dispersion > 0.0 && parameters.transmission > 0.0 && parameters.thickness > 0.0 {
                // A path is of one colour from the first dispersion on.
                let channel = *channel.get_or_insert_with(|| {
                    let channel = ((sampler.next_four()[0] * 3.0) as usize).min(2);
                    throughput *= 3.0 * Vec3::AXES[channel];
                    channel
                });
                parameters = parameters.dispersed(channel);
            }
            let bsdf = footing.bsdf(&parameters);
            if !bsdf.is_specular() {
                light += throughput * self.direct(footing, &bsdf, sampler, scratch);
            }
            let Some(sample) = bsdf.sample(Vec3::new(u0, u1, u2)) else { break };
            let direction = footing.world(sample.direction);
            if !footing.is_consistent(direction, sample.direction) {
                break;
            }
            throughput *= sample.weight;
            if bounce >= SURE_BOUNCES {
                // The lesser the light that can still arrive, the likelier the end (Arvo and Kirk 1990).
                let going_on = throughput.max_element().min(0.95);
                if u3 >= going_on {
                    break;
                }
                throughput /= going_on;
            }
            let ray = footing.leave(direction);
            let segment = self.segment(&ray, sampler.next_four()[0], scratch);
            light += throughput * segment.radiance;
            if segment.transmittance > 0.0 {
                let shared =
                    sample.density.map_or(1.0, |density| power_heuristic(density, self.background_density(direction)));
                let background = self.tracer.scene.background_along(direction).0;
                light += throughput * segment.transmittance * shared * background;
            }
            let Some((hit, share)) = segment.next.filter(|_| throughput != Vec3::ZERO) else { break };
            throughput *= share;
            let is_inside = (sample.direction.z > 0.0) != footing.front;
            if is_inside && parameters.thickness > 0.0 {
                throughput *= parameters.attenuation(hit.distance as f32);
            }
            let length = footing.length + hit.distance as f32;
            let point = SurfacePoint::new(&self.tracer.scene.meshes, &ray, &hit, self.ray_angle * length);
            if point.material.unlit {
                light += throughput * point.base_colour_and_coverage().0;
                break;
            }
            let material = point.evaluate();
            if material.emission != LinearRgb::default() {
                let shared = sample.density.map_or(1.0, |density| {
                    let cosine = direction.dot(material.geometric_normal.as_dvec3());
                    power_heuristic(density, self.lights.emitter_density(hit.triangle, hit.distance, cosine))
                });
                light += throughput * shared * material.emission.0;
            }
            if bounce >= self.max_bounces {
                break;
            }
            reached = Footing::new(&ray, &hit, &material, length);
            footing = &reached;
        }
        if light.is_finite() { light } else { Vec3::ZERO }
    }

    /// Light that reaches the surface straight from lights and leaves it toward the eye.
    fn direct(&self, footing: &Footing, bsdf: &Bsdf, sampler: &mut Sampler, scratch: &mut RayScratch) -> Vec3 {
        let mut light = Vec3::ZERO;
        if !self.lights.has_no_punctual() {
            let random = sampler.next_four()[0];
            if let Some(drawn) = self.lights.sample_punctual(footing.position.as_vec3(), random) {
                let direction = drawn.incident.to_light.as_dvec3().normalize();
                let irradiance = drawn.incident.irradiance.0 / drawn.probability;
                let response = footing.response(bsdf, direction).value;
                if response != Vec3::ZERO {
                    let distance = f64::from(drawn.incident.distance);
                    light +=
                        response * irradiance * visibility(&self.tracer, &footing.leave(direction), distance, scratch);
                }
            }
        }
        if !self.lights.has_no_emitters() {
            let [u0, u1, u2, _] = sampler.next_four();
            light += self.light_from_emitter(footing, bsdf, [u0, u1, u2], scratch).unwrap_or(Vec3::ZERO);
        }
        if self.tracer.scene.environment.is_some() {
            let [u0, u1, ..] = sampler.next_four();
            light += self.light_from_environment(footing, bsdf, [u0, u1], scratch).unwrap_or(Vec3::ZERO);
        }
        light
    }

    fn light_from_environment(
        &self,
        footing: &Footing,
        bsdf: &Bsdf,
        random: [f32; 2],
        scratch: &mut RayScratch,
    ) -> Option<Vec3> {
        let map = self.tracer.scene.environment.as_ref()?;
        let direction = map.sample(random)?;
        let Response { value: response, density: bsdf_density } = footing.response(bsdf, direction);
        let density = map.density(direction);
        if response == Vec3::ZERO || density <= 0.0 {
            return None;
        }
        let passed = visibility(&self.tracer, &footing.leave(direction), f64::INFINITY, scratch);
        Some(response * map.radiance(direction).0 * passed * power_heuristic(density, bsdf_density) / density)
    }

    /// Density with which the background is sampled; a colour is not, since the BSDF alone finds it as well.
    fn background_density(&self, direction: DVec3) -> f32 {
        self.tracer.scene.environment.as_ref().map_or(0.0, |map| map.density(direction))
    }

    fn light_from_emitter(
        &self,
        footing: &Footing,
        bsdf: &Bsdf,
        random: [f32; 3],
        scratch: &mut RayScratch,
    ) -> Option<Vec3> {
        let drawn = self.lights.sample_emitter(random)?;
        let offset = drawn.position - footing.position;
        let direction = offset.try_normalize()?;
        let Response { value: response, density: bsdf_density } = footing.response(bsdf, direction);
        if response == Vec3::ZERO {
            return None;
        }
        let ray = footing.leave(direction);
        let hit = self.tracer.hit(&ray, drawn.triangle, f64::INFINITY)?;
        let point = SurfacePoint::new(&self.tracer.scene.meshes, &ray, &hit, 0.0);
        let cosine = direction.dot(point.geometric_normal.as_dvec3());
        let density = self.lights.emitter_density(drawn.triangle, hit.distance, cosine);
        if density <= 0.0 {
            return None;
        }
        let (_, coverage) = point.base_colour_and_coverage();
        let radiance = coverage * point.emission().0;
        // Up to the emitter, without it.
        let passed = visibility(&self.tracer, &ray, hit.distance * (1.0 - LIFT), scratch);
        Some(response * radiance * passed * power_heuristic(density, bsdf_density) / density)
    }

    /// Follows a ray to its end. The surface that the path goes on from is drawn among those met with `random`, in [0, 1),
    /// by what each contributes (a reservoir of one, Chao 1982).
    fn segment(&self, ray: &Ray, mut random: f32, scratch: &mut RayScratch) -> Segment {
        let mut next = None;
        let mut total = 0.0;
        let gathered = self.tracer.trace_with(ray, scratch, &mut |hit, transmittance| {
            let alpha = if self.tracer.surfaces.is_opaque(hit.triangle) {
                1.0
            } else {
                coverage(&self.tracer.scene.meshes, ray, hit)
            };
            let weight = transmittance as f32 * alpha;
            if weight > 0.0 {
                total += weight;
                let probability = weight / total;
                if random < probability {
                    next = Some(*hit);
                    random /= probability;
                } else {
                    random = (random - probability) / (1.0 - probability);
                }
            }
            Fragment { alpha, radiance: LinearRgb::default() }
        });
        let scene = self.tracer.scene;
        Segment {
            radiance: gathered.to_linear(scene.encoding, LinearRgb::default()).0,
            transmittance: gathered.transmittance,
            next: next.map(|hit| (hit, total)),
        }
    }
}

/// The share of a sample of density `own` where `other` could have drawn it, too.
fn power_heuristic(own: f32, other: f32) -> f32 {
    // As a ratio, since squares of narrow lobes' densities overflow.
    let ratio = other / own;
    1.0 / (1.0 + ratio * ratio)
}
