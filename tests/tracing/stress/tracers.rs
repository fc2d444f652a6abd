//! Scenes that break renderers: the tracers stay finite, agree with the reference, and finish.

use crate::common::{Gaussian, NoSurfaces, PatternedSurfaces, Random, add_triangle, begins_at_the_probe, splats};
use glam::{DQuat, DVec3, Vec3};
use splatprobe::bvh::Bvh;
use splatprobe::scene::Scene;
use splatprobe::trace::{
    BeamTracer, Face, Radiance, Ray, RayTracer, ReferenceTracer, Surfaces, Tile, TileTracer, TraceSettings,
};

/// Traces all six faces of `size` texels with both production tracers and the reference; returns the largest difference
/// of the splat and surface sums and the transmittance. Rays that begin at a Gaussian's strongest response are left out:
/// whether it lies ahead is a matter of rounding.
fn worst(scene: &Scene, bvh: &Bvh, surfaces: &dyn Surfaces, origin: DVec3, size: u32) -> f32 {
    let settings = TraceSettings { t_cutoff: 0.0, ..TraceSettings::default() };
    let truth = ReferenceTracer { scene, surfaces, settings };
    let ray = RayTracer { scene, bvh, surfaces, settings };
    let beam = BeamTracer::new(scene, bvh, surfaces, settings);
    let mut worst = 0.0f32;
    for face in Face::ALL {
        let tile = Tile { face, face_size: size, x: 0, y: 0, width: size, height: size };
        let trace = |tracer: &dyn TileTracer| {
            let mut texels = vec![Radiance::default(); tile.len()];
            tracer.trace_tile(origin, &tile, &mut texels);
            texels
        };
        let expected = trace(&truth);
        for seen in [trace(&ray), trace(&beam)] {
            for ((a, b), direction) in seen.iter().zip(&expected).zip(tile.directions()) {
                assert!(a.splat_sum.is_finite() && a.surface_sum.is_finite() && a.transmittance.is_finite());
                let sums = (a.splat_sum - b.splat_sum).abs().max((a.surface_sum - b.surface_sum).abs());
                let difference = sums.max_element().max((a.transmittance - b.transmittance).abs());
                if difference <= worst || begins_at_the_probe(scene, &Ray { origin, direction }) {
                    continue;
                }
                worst = difference;
            }
        }
    }
    worst
}

fn build(gaussians: impl IntoIterator<Item = Gaussian>) -> (Scene, Bvh) {
    let mut scene = Scene { splats: splats(gaussians), ..Scene::default() };
    let bvh = Bvh::build(&mut scene);
    (scene, bvh)
}

fn gaussian(mean: DVec3, standard_deviations: DVec3, opacity: f64) -> Gaussian {
    Gaussian { mean, rotation: DQuat::IDENTITY, standard_deviations, opacity, colour: Vec3::new(0.9, 0.5, 0.2) }
}

#[test]
fn a_probe_inside_a_gaussian_and_on_its_mean_agrees_with_the_reference() {
    let (scene, bvh) = build([
        gaussian(DVec3::ZERO, DVec3::new(2.0, 1.0, 0.5), 0.9),
        gaussian(DVec3::new(0.1, 0.0, 0.0), DVec3::new(0.5, 0.5, 1e-4), 0.7),
    ]);
    for origin in [DVec3::ZERO, DVec3::new(0.1, 0.0, 0.0), DVec3::new(0.3, 0.1, 0.2), DVec3::new(0.1, 1e-9, 0.0)] {
        let worst = worst(&scene, &bvh, &NoSurfaces, origin, 12);
        assert!(worst < 1e-5, "{origin}: {worst:e}");
    }
}

#[test]
fn one_gaussian_covering_the_scene_agrees_with_the_reference() {
    let (scene, bvh) = build([
        gaussian(DVec3::new(0.0, 0.0, -1.0), DVec3::splat(1e4), 0.5),
        gaussian(DVec3::new(0.0, 0.0, -3.0), DVec3::splat(0.3), 0.8),
    ]);
    assert!(worst(&scene, &bvh, &NoSurfaces, DVec3::ZERO, 12) < 1e-5);
}

#[test]
fn gaussians_around_the_planes_between_faces_agree_with_the_reference() {
    let mut random = Random(4);
    let (scene, bvh) = build((0..400).map(|_| {
        // On the planes x = +-z and y = +-z, and right beside the probe.
        let reach = random.uniform(0.01, 3.0);
        let sign = |random: &mut Random| if random.below(2) == 0 { 1.0 } else { -1.0 };
        let mean = DVec3::new(reach * sign(&mut random), reach * sign(&mut random), reach * sign(&mut random));
        let size = random.uniform(0.01, 1.5) * reach;
        Gaussian { rotation: random.rotation(), ..gaussian(mean, DVec3::new(size, size * 0.3, size * 0.01), 0.6) }
    }));
    assert!(worst(&scene, &bvh, &NoSurfaces, DVec3::ZERO, 20) < 2e-3);
}

#[test]
fn a_hundred_thousand_gaussians_along_one_ray_neither_stall_nor_disagree() {
    let behind_one_another =
        (0..100_000).map(|i| gaussian(DVec3::new(0.0, 0.0, -1.0 - f64::from(i) * 1e-5), DVec3::splat(0.05), 0.02));
    let (scene, bvh) = build(behind_one_another);
    assert!(worst(&scene, &bvh, &NoSurfaces, DVec3::ZERO, 4) < 1e-4);
}

#[test]
fn all_gaussians_at_one_point_agree_with_the_reference() {
    let (scene, bvh) = build((0..3000).map(|i| Gaussian {
        colour: Vec3::splat((i % 7) as f32 / 7.0),
        ..gaussian(DVec3::new(0.2, 0.1, -2.0), DVec3::splat(0.2), 0.05)
    }));
    // Equal keys in another order: every colour difference shows, weighted by the product of two opacities.
    assert!(worst(&scene, &bvh, &NoSurfaces, DVec3::ZERO, 8) < 1e-4);
}

#[test]
fn a_wall_of_fully_transparent_gaussians_is_not_there() {
    let wall = (0..20_000).map(|i| {
        gaussian(
            DVec3::new(f64::from(i % 141) * 0.05 - 3.5, f64::from(i / 141) * 0.05 - 3.5, -2.0),
            DVec3::splat(0.1),
            0.0,
        )
    });
    let (scene, bvh) = build(wall);
    assert_eq!(worst(&scene, &bvh, &NoSurfaces, DVec3::ZERO, 8), 0.0);
    let tile = Tile { face: Face::NegZ, face_size: 8, x: 0, y: 0, width: 8, height: 8 };
    let mut texels = vec![Radiance::default(); 64];
    let settings = TraceSettings::default();
    BeamTracer::new(&scene, &bvh, &NoSurfaces, settings).trace_tile(DVec3::ZERO, &tile, &mut texels);
    assert!(texels.iter().all(|texel| texel.transmittance == 1.0));
}

#[test]
fn a_probe_on_a_triangles_plane_agrees_with_the_reference() {
    let mut scene = Scene::default();
    add_triangle(&mut scene, [Vec3::new(-1.0, 0.0, -1.0), Vec3::new(1.0, 0.0, -1.0), Vec3::new(0.0, 0.0, -3.0)]);
    add_triangle(&mut scene, [Vec3::new(-1.0, -1.0, -1.0), Vec3::new(1.0, -1.0, -1.0), Vec3::new(0.0, 2.0, -1.0)]);
    scene.splats = splats([gaussian(DVec3::new(0.0, 0.0, -0.5), DVec3::splat(0.2), 0.5)]);
    let bvh = Bvh::build(&mut scene);
    let surfaces = PatternedSurfaces(&scene);
    for origin in [DVec3::ZERO, DVec3::new(0.0, 0.0, -1.0)] {
        let worst = worst(&scene, &bvh, &surfaces, origin, 17);
        assert!(worst < 1e-5, "{origin}: {worst:e}");
    }
}

#[test]
fn a_scene_ten_million_metres_from_zero_agrees_with_the_reference() {
    let far = DVec3::new(1e7, -3e6, 2e6);
    let mut random = Random(8);
    let local: Vec<Gaussian> = (0..500)
        .map(|_| gaussian(random.direction() * random.uniform(1.0, 4.0), DVec3::splat(random.uniform(0.01, 0.3)), 0.7))
        .collect();
    let mut scene = Scene { origin: far, splats: splats(local), ..Scene::default() };
    let bvh = Bvh::build(&mut scene);
    // Probes are given in the world; what the tracers see is the offset from the scene's origin.
    let probe = (far + DVec3::new(0.5, 0.25, 0.125)) - scene.origin;
    assert!(worst(&scene, &bvh, &NoSurfaces, probe, 16) < 1e-4);
}
