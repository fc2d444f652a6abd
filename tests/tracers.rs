//! The production tracers against the f64 reference.

mod common;

use common::{NoSurfaces, PatternedSurfaces, Random, add_random_triangles, cloud};
use glam::{DVec3, Vec3};
use splatprobe::bvh::Bvh;
use splatprobe::job::{Order, ShDirection};
use splatprobe::scene::{Scene, colour};
use splatprobe::trace::ray::RayScratch;
use splatprobe::trace::{Radiance, Ray, RayTracer, ReferenceTracer, Surfaces, TraceSettings};

/// Largest difference of two results over colour in display space, coverage, and mean distance relative to itself.
fn difference(a: &Radiance, b: &Radiance) -> f32 {
    let display = |r: &Radiance| {
        let linear = r.to_linear(Default::default(), Default::default()).0;
        Vec3::new(colour::linear_to_srgb(linear.x), colour::linear_to_srgb(linear.y), colour::linear_to_srgb(linear.z))
    };
    let distance = (a.distance_sum - b.distance_sum).abs() / (1.0 + b.distance_sum.abs());
    (display(a) - display(b)).abs().max_element().max((a.transmittance - b.transmittance).abs()).max(distance)
}

struct Comparison {
    rms: f64,
    max: f32,
}

fn compare(
    scene: &Scene,
    bvh: &Bvh,
    surfaces: &dyn Surfaces,
    settings: TraceSettings,
    origin: DVec3,
    rays: usize,
) -> Comparison {
    let fast = RayTracer { scene, bvh, surfaces, settings };
    let truth = ReferenceTracer { scene, surfaces, settings };
    let mut random = Random(99);
    let mut scratch = RayScratch::default();
    let (mut squares, mut max) = (0.0, 0.0f32);
    for _ in 0..rays {
        let ray = Ray { origin, direction: random.direction() };
        let d = difference(&fast.trace(&ray, &mut scratch), &truth.trace(&ray));
        squares += f64::from(d).powi(2);
        max = max.max(d);
    }
    Comparison { rms: (squares / rays as f64).sqrt(), max }
}

#[test]
fn ray_equals_reference_without_cut_off_in_every_order_and_colour_direction() {
    let mut scene = Scene { splats: cloud(4000, [0.01, 0.4], 3, 1), ..Scene::default() };
    add_random_triangles(&mut scene, 60, 2);
    let bvh = Bvh::build(&mut scene);
    let surfaces = PatternedSurfaces(&scene);
    for order in [Order::RayHitDistance, Order::CameraDistance] {
        for sh_direction in [ShDirection::Mean, ShDirection::Ray] {
            for origin in [DVec3::ZERO, DVec3::new(0.4, -0.3, 1.0), DVec3::new(40.0, 3.0, -7.0)] {
                let settings = TraceSettings { order, sh_direction, t_cutoff: 0.0, ..TraceSettings::default() };
                let seen = compare(&scene, &bvh, &surfaces, settings, origin, 400);
                assert!(seen.rms <= 2e-5 && seen.max <= 1e-3, "{settings:?} {origin}: {} {}", seen.rms, seen.max);
            }
        }
    }
}

#[test]
fn ray_with_a_cut_off_errs_by_no_more_than_the_cut_off() {
    let mut scene = Scene { splats: cloud(20_000, [0.01, 0.4], 0, 5), ..Scene::default() };
    for value in &mut scene.splats.sh {
        *value = value.clamp(-1.7, 1.7); // colours within [0, 1], for which the bound holds
    }
    let bvh = Bvh::build(&mut scene);
    for t_cutoff in [0.1, 0.01, 1e-3] {
        let settings = TraceSettings { t_cutoff, ..TraceSettings::default() };
        let fast = RayTracer { scene: &scene, bvh: &bvh, surfaces: &NoSurfaces, settings };
        let truth = ReferenceTracer { scene: &scene, surfaces: &NoSurfaces, settings };
        let mut random = Random(7);
        for _ in 0..300 {
            let ray = Ray { origin: DVec3::ZERO, direction: random.direction() };
            let (seen, full) = (fast.trace(&ray, &mut RayScratch::default()), truth.trace(&ray));
            assert!((seen.splat_sum - full.splat_sum).abs().max_element() <= t_cutoff + 1e-6);
            assert!((seen.transmittance - full.transmittance).abs() <= t_cutoff);
        }
    }
}
