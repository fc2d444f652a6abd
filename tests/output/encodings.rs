//! Display-referred and linear Gaussians in one scene: each kind's share is converted as it must be.

use crate::common::{Gaussian, NoSurfaces, splats};
use glam::{DQuat, DVec3, Vec3};
use splatprobe::bvh::Bvh;
use splatprobe::scene::colour::srgb_to_linear;
use splatprobe::scene::{LinearRgb, Scene, SplatEncoding};
use splatprobe::trace::ray::RayScratch;
use splatprobe::trace::{
    BeamTracer, Face, Level, Radiance, Ray, RayTracer, ReferenceTracer, Tile, TileTracer, TraceSettings,
};

#[test]
fn a_linear_gaussian_adds_to_linear_light_and_a_display_one_is_decoded_after_blending() {
    let colours = [Vec3::new(0.8, 0.5, 0.1), Vec3::new(3.0, 0.25, 0.7), Vec3::new(0.2, 0.9, 0.4)];
    let opacities = [0.5, 0.25, 0.75];
    let ball = |i: usize| Gaussian {
        mean: DVec3::new(0.0, 0.0, -1.0 - i as f64),
        rotation: DQuat::IDENTITY,
        standard_deviations: DVec3::splat(0.1),
        opacity: opacities[i],
        colour: colours[i],
    };
    let mut scene = Scene { splats: splats((0..3).map(ball)), ..Scene::default() };
    // The tree puts Gaussians in an order of its own: flags must move along.
    scene.splats.linear = vec![false, true, false];
    scene.background = LinearRgb(Vec3::splat(0.3));

    // Weights front to back: 1/2, 1/2 * 1/4, 1/2 * 3/4 * 3/4; the first and third are blended before they are decoded.
    let weights = [0.5f32, 0.125, 0.28125];
    let display = (colours[0] * weights[0] + colours[2] * weights[2]) / (weights[0] + weights[2]);
    let decoded = Vec3::from(display.to_array().map(srgb_to_linear)) * (weights[0] + weights[2]);
    let expected = decoded + colours[1] * weights[1] + Vec3::splat(0.3) * 0.09375;

    let bvh = Bvh::build(&mut scene);
    let ray = Ray { origin: DVec3::ZERO, direction: DVec3::NEG_Z };
    let settings = TraceSettings { t_cutoff: 0.0, ..TraceSettings::default() };
    let reference = ReferenceTracer { scene: &scene, surfaces: &NoSurfaces, settings }.trace(&ray);
    let tracer = RayTracer { scene: &scene, bvh: &bvh, surfaces: &NoSurfaces, settings };
    // The middle of three texels looks straight ahead.
    let tile = Tile { face: Face::NegZ, face_size: 3, x: 0, y: 0, width: 3, height: 3 };
    let beam = |level| {
        let mut texels = [Radiance::default(); 9];
        BeamTracer { level, ..BeamTracer::new(&scene, &bvh, &NoSurfaces, settings) }.trace_tile(
            DVec3::ZERO,
            &tile,
            &mut texels,
        );
        texels[4]
    };
    let singles = [reference, tracer.trace(&ray, &mut RayScratch::default())];
    for radiance in Level::available().into_iter().map(beam).chain(singles) {
        let found = radiance.to_linear(SplatEncoding::SrgbDisplay, scene.background).0;
        assert!((found - expected).abs().max_element() < 1e-6, "{found} is not {expected}");
    }
}
