//! Surfaces lit by a cubemap of their surroundings, against closed forms and against path tracing.

use std::sync::atomic::AtomicBool;

use crate::common::Random;
use crate::scenes::{add_panel, add_room, add_sphere, directional, glass, lambert, metal, nearest_hit, ray};
use glam::{DVec3, Vec3};
use splatprobe::Error;
use splatprobe::bvh::Bvh;
use splatprobe::scene::{EnvironmentMap, LinearRgb, Material, Scene};
use splatprobe::shade::{LocallyLitSurfaces, PathSettings, PathSurfaces};
use splatprobe::trace::{Ray, RayTracer, Surfaces, TraceSettings};

fn trace() -> TraceSettings {
    TraceSettings { t_cutoff: 0.0, ..TraceSettings::default() }
}

/// What a ray sees under `--surface probe`.
fn seen(scene: &mut Scene, rays: &[Ray]) -> Vec<Vec3> {
    let bvh = Bvh::build(scene);
    let surfaces = LocallyLitSurfaces::new(scene, &bvh, trace(), &AtomicBool::new(false)).unwrap();
    radiance(scene, &bvh, &surfaces, rays)
}

/// The same under `--surface path`.
fn seen_by_paths(scene: &mut Scene, max_paths: u32, rays: &[Ray]) -> Vec<Vec3> {
    let bvh = Bvh::build(scene);
    let settings = PathSettings { noise: 0.0, max_paths, ..PathSettings::default() };
    let surfaces = PathSurfaces::new(scene, &bvh, trace(), settings, &[]);
    radiance(scene, &bvh, &surfaces, rays)
}

fn radiance(scene: &Scene, bvh: &Bvh, surfaces: &dyn Surfaces, rays: &[Ray]) -> Vec<Vec3> {
    let tracer = RayTracer { scene, bvh, surfaces, settings: trace() };
    let hit = |ray: &Ray| nearest_hit(&tracer, ray).expect("the ray meets a surface");
    rays.iter().map(|ray| surfaces.fragment(ray, &hit(ray)).radiance.0).collect()
}

/// Rays from all around toward points of a sphere of radius 1 around the origin.
fn rays_at_the_sphere() -> Vec<Ray> {
    let mut random = Random(3);
    let mut direction = || loop {
        let v = DVec3::from_array([(); 3].map(|()| random.uniform(-1.0, 1.0)));
        if v.length_squared() < 1.0 && v.length_squared() > 0.01 {
            return v.normalize();
        }
    };
    (0..60).map(|_| ray(direction() * 3.0, direction() * 0.8)).collect()
}

/// Light that falls off smoothly from above, with a bright spot.
fn sky() -> EnvironmentMap {
    let texel = |x: u32, y: u32| {
        let (u, v) = ((f64::from(x) + 0.5) / 64.0, (f64::from(y) + 0.5) / 32.0);
        let spot = 20.0 * (-((u - 0.3).powi(2) + (v - 0.3).powi(2)) * 200.0).exp();
        Vec3::new(1.2 - v as f32, 0.8 - 0.5 * v as f32, 0.3 + 0.5 * u as f32) + Vec3::splat(spot as f32)
    };
    let texels = (0..32).flat_map(|y| (0..64).map(move |x| texel(x, y))).collect();
    EnvironmentMap::new(64, 32, texels).expect("a finite map")
}

#[test]
fn every_white_material_vanishes_in_a_white_surrounding() {
    let coated = {
        let mut coated = lambert(1.0);
        coated.clearcoat.factor = 1.0.into();
        coated.specular = 1.0.into();
        coated
    };
    let materials =
        [(lambert(1.0), 0.005), (metal(0.0), 1e-4), (metal(0.5), 0.015), (metal(1.0), 0.012), (coated, 0.01)];
    for (k, (material, tolerance)) in materials.into_iter().enumerate() {
        let mut scene = Scene { background: LinearRgb(Vec3::splat(0.7)), ..Scene::default() };
        add_sphere(&mut scene, material, Vec3::ZERO, 1.0);
        for light in seen(&mut scene, &rays_at_the_sphere()) {
            assert!((light / 0.7 - 1.0).abs().max_element() < tolerance, "material {k}: {light}");
        }
    }
}

#[test]
fn a_convex_part_under_a_sky_is_lit_as_by_path_tracing() {
    for (k, (material, tolerance)) in
        [(lambert(0.8), 0.03), (metal(0.3), 0.01), (metal(0.7), 0.025), (metal(1.0), 0.03)].into_iter().enumerate()
    {
        let mut scene = Scene { environment: Some(sky()), ..Scene::default() };
        add_sphere(&mut scene, material, Vec3::ZERO, 1.0);
        let rays = rays_at_the_sphere();
        let (probe, path) = (seen(&mut scene, &rays), seen_by_paths(&mut scene, 16_384, &rays));
        let squares = |values: &mut dyn Iterator<Item = Vec3>| values.map(|v| v.length_squared()).sum::<f32>();
        let differences = squares(&mut probe.iter().zip(&path).map(|(a, b)| *a - *b));
        let relative = (differences / squares(&mut path.iter().copied())).sqrt();
        assert!(relative < tolerance, "material {k}: relative RMSE {relative}");
    }
}

#[test]
fn a_punctual_light_gives_lamberts_cosine_and_its_shadow() {
    let mut scene = Scene::default();
    add_panel(&mut scene, lambert(0.5), Vec3::ZERO, Vec3::X * 8.0, Vec3::NEG_Z * 8.0);
    // Between the light, which comes from (0.6, 0.8, 0), and what lies beyond x = 0 on the floor.
    add_panel(&mut scene, lambert(0.0), Vec3::new(2.5, 2.0, 0.0), Vec3::X * 2.0, Vec3::Z * 2.0);
    scene.lights.push(directional(3.0));
    let at = |x: f64| ray(DVec3::new(x, 1.0, 0.0), DVec3::new(x, 0.0, 0.0));
    let light = seen(&mut scene, &[at(-2.0), at(1.0)]);
    let expected = 0.5 * std::f32::consts::FRAC_1_PI * 3.0 * 0.8;
    assert!((light[0] - expected).abs().max_element() < 1e-5, "{}", light[0]);
    assert_eq!(light[1], Vec3::ZERO);
}

#[test]
fn light_goes_from_part_to_part() {
    // A white sphere in a room that shines: it is lit by the room, not by what lies outside.
    let glowing = Material { emissive: LinearRgb(Vec3::new(0.2, 0.4, 0.8)), ..lambert(0.0) };
    let mut scene = Scene { background: LinearRgb(Vec3::splat(9.0)), ..Scene::default() };
    add_room(&mut scene, glowing, 6.0);
    add_sphere(&mut scene, lambert(1.0), Vec3::ZERO, 1.0);
    for light in seen(&mut scene, &[ray(DVec3::new(2.5, 0.3, 0.1), DVec3::new(0.9, 0.0, 0.0))]) {
        assert!((light - Vec3::new(0.2, 0.4, 0.8)).abs().max_element() < 2e-3, "{light}");
    }
}

#[test]
fn clear_glass_shows_what_is_behind_it() {
    let mut scene = Scene { environment: Some(sky()), ..Scene::default() };
    let mut pane = glass(0.0);
    pane.volume.thickness = 0.0.into();
    add_panel(&mut scene, Material { ior: 1.0, ..pane }, Vec3::ZERO, Vec3::X * 4.0, Vec3::Y * 4.0);
    let ray = ray(DVec3::new(0.2, 0.3, 2.0), DVec3::new(0.1, 0.1, 0.0));
    let behind = scene.background_along(ray.direction).0;
    let light = seen(&mut scene, &[ray])[0];
    // A texel of the cubemap is 1.4 degrees wide, one of the sky 5.6.
    assert!((light / behind - 1.0).abs().max_element() < 0.02, "{light} is not {behind}");
}

#[test]
fn a_request_to_stop_is_heard_while_the_cubemaps_are_baked() {
    let mut scene = Scene::default();
    add_sphere(&mut scene, lambert(0.5), Vec3::ZERO, 1.0);
    let bvh = Bvh::build(&mut scene);
    let result = LocallyLitSurfaces::new(&scene, &bvh, trace(), &AtomicBool::new(true));
    assert!(matches!(result, Err(Error::Cancelled)));
}
