//! `--mesh-shadows`: Gaussians near meshes are darkened by the ambient light that the meshes keep from them.
//!
//! A capture was lit without the meshes. What changes is taken to be ambient light, the same from all sides: of the
//! directions from which it reaches a Gaussian through the other Gaussians, the share that the meshes hide, weighted by the
//! cosine to the Gaussian's thinnest axis. Without meshes nothing changes, and neither does what no mesh hides.
//
// Shadows of a captured lamp or window are not found this way, nor is light that a mesh sends back: the first needs the
// capture's lighting taken apart, the second a path-traced bake of the splats' own reflectance, which a capture has not.

use glam::DVec3;
use rayon::prelude::*;

use super::footing::coverage;
use super::sampling::fibonacci;
use super::with_scratch;
use crate::bvh::Bvh;
use crate::job::Order;
use crate::scene::bounds::Bounds;
use crate::scene::colour::{linear_to_srgb, srgb_to_linear};
use crate::scene::sh::{self, C0};
use crate::scene::{Scene, SplatEncoding};
use crate::trace::{EverySurface, Ray, RayTracer, TraceSettings};

/// Directions from which ambient light is looked for. A square panel's share is then within 2 % of its form factor.
const DIRECTIONS: usize = 128;

/// How far a part's shadow reaches beyond its box, in lengths of the box's diagonal. A ball's shadow is below 2 % there.
const REACH: f64 = 1.5;

/// Darkens the Gaussians of `scene`, whose tree is `bvh`.
pub fn darken(scene: &mut Scene, bvh: &Bvh, trace: TraceSettings) {
    let parts: Vec<(Bounds, f64)> =
        scene.meshes.part_bounds().into_iter().flatten().map(|b| (b, REACH * b.extent().length())).collect();
    let tracer = RayTracer {
        scene,
        bvh,
        surfaces: &EverySurface,
        // The limit of a ray is a distance along it.
        settings: TraceSettings { order: Order::RayHitDistance, ..trace },
    };
    let directions: Vec<DVec3> = (0..DIRECTIONS).map(|i| fibonacci(i, DIRECTIONS)).collect();
    let shares: Vec<(usize, f32)> = (0..scene.splats.len())
        .into_par_iter()
        .filter_map(|i| {
            let mean = scene.splats.means[i].as_dvec3();
            let distance =
                |(bounds, reach): &(Bounds, f64)| (mean - mean.clamp(bounds.min, bounds.max)).length() - reach;
            // How far the shadows that may reach it come from.
            let reach = parts.iter().filter(|part| distance(part) <= 0.0).map(|part| part.1).reduce(f64::max)?;
            let share = visible_share(&tracer, i, &directions, reach);
            (share < 1.0).then_some((i, share))
        })
        .collect();
    for (i, share) in shares {
        let decoded = scene.encoding == SplatEncoding::SrgbDisplay && !scene.splats.is_linear(i);
        dim(&mut scene.splats.sh, sh::coefficient_count(scene.splats.sh_degree), i, share, decoded);
    }
}

/// Share of the ambient light at Gaussian `i` that meshes within `reach` metres let pass.
fn visible_share(tracer: &RayTracer, i: usize, directions: &[DVec3], reach: f64) -> f32 {
    let splats = &tracer.scene.splats;
    let origin = splats.means[i].as_dvec3();
    // Rows of M are unit axes over standard deviations: the longest belongs to the thinnest axis.
    let rows = splats.unit_from_world[i].transpose();
    let row = |k: usize| rows.col(k).as_dvec3();
    let thinnest = (0..3).map(row).max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
    let normal = thinnest.unwrap_or(DVec3::Y).normalize();
    let (mut without, mut with) = (0.0, 0.0);
    with_scratch(|scratch| {
        for &direction in directions {
            let ray = Ray { origin, direction };
            let mut past_meshes = 1.0;
            let past_splats = tracer.transmittance(&ray, reach, scratch, &mut |hit| {
                past_meshes *= 1.0 - coverage(&tracer.scene.meshes, &ray, hit);
                0.0
            });
            let light = past_splats * direction.dot(normal).abs() as f32;
            without += light;
            with += light * past_meshes;
        }
    });
    if without > 0.0 { with / without } else { 1.0 }
}

/// Dims the colour of Gaussian `i` to a share of its light: the whole expansion by one factor per channel, that of its mean
/// colour where the colour is `decoded` from a display's encoding.
fn dim(coefficients: &mut [f32], count: usize, i: usize, share: f32, decoded: bool) {
    for channel in coefficients[3 * count * i..3 * count * (i + 1)].chunks_exact_mut(count) {
        let mean = 0.5 + C0 as f32 * channel[0];
        let factor = if decoded && mean > 0.0 { linear_to_srgb(share * srgb_to_linear(mean)) / mean } else { share };
        channel.iter_mut().for_each(|coefficient| *coefficient *= factor);
        channel[0] = (mean * factor - 0.5) / C0 as f32;
    }
}
