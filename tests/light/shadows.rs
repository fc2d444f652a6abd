//! Gaussians darkened by meshes, against form factors.

use crate::common::{Gaussian, splats};
use crate::scenes::{add_panel, lambert};
use glam::{DQuat, DVec3, Vec3};
use splatprobe::bvh::Bvh;
use splatprobe::scene::material::AlphaMode;
use splatprobe::scene::{Material, Scene, SplatEncoding, colour, sh};
use splatprobe::shade::shadows;
use splatprobe::trace::TraceSettings;

/// Flat Gaussians that face up, at some places of the plane y = 0, too small to hide each other.
fn ground(encoding: SplatEncoding, places: &[DVec3]) -> Scene {
    let gaussian = |mean: DVec3| Gaussian {
        mean,
        rotation: DQuat::IDENTITY,
        standard_deviations: DVec3::new(1e-3, 1e-5, 1e-3),
        opacity: 0.9,
        colour: Vec3::new(0.7, 0.4, 0.9),
    };
    Scene { splats: splats(places.iter().copied().map(gaussian)), encoding, ..Scene::default() }
}

/// Form factor from a facing point to a square whose middle is straight ahead, by its half edge over its distance
/// (Howell, "A Catalog of Radiation Heat Transfer Configuration Factors", B-4, four times).
fn form_factor(ratio: f64) -> f64 {
    let root = (1.0 + ratio * ratio).sqrt();
    4.0 * ratio / root * (ratio / root).atan() / std::f64::consts::PI
}

/// A square panel of edge 2, at height 1 over the origin.
fn add_roof(scene: &mut Scene, material: Material) {
    add_panel(scene, material, Vec3::Y, Vec3::X * 2.0, Vec3::Z * 2.0);
}

/// Linear mean colour of each Gaussian by its place along x, so that the tree's order is of no matter.
fn colours(scene: &Scene) -> Vec<Vec3> {
    let mut order: Vec<usize> = (0..scene.splats.len()).collect();
    order.sort_by(|&a, &b| scene.splats.means[a].x.total_cmp(&scene.splats.means[b].x));
    let displayed = |i: usize| sh::evaluate(scene.splats.sh_degree, scene.splats.sh_of(i), Vec3::Y);
    order.into_iter().map(|i| scene.encoding.decode(colour::DisplayRgb(displayed(i))).0).collect()
}

fn darkened(mut scene: Scene) -> (Vec<Vec3>, Vec<Vec3>) {
    let before = colours(&scene);
    let bvh = Bvh::build(&mut scene);
    shadows::darken(&mut scene, &bvh, TraceSettings::default());
    (before, colours(&scene))
}

#[test]
fn a_panel_overhead_takes_its_form_factor_of_the_light() {
    for encoding in [SplatEncoding::SrgbDisplay, SplatEncoding::LinScene] {
        let mut scene = ground(encoding, &[DVec3::ZERO]);
        add_roof(&mut scene, lambert(0.5));
        let (before, after) = darkened(scene);
        // Light comes from above and below; the panel hides its share of what comes from above.
        let expected = 1.0 - 0.5 * form_factor(1.0) as f32;
        let share = after[0] / before[0];
        assert!((share - expected).abs().max_element() < 0.01, "{encoding:?}: {share} is not {expected}");
    }
}

#[test]
fn half_transparent_panels_take_half() {
    let mut scene = ground(SplatEncoding::LinScene, &[DVec3::ZERO]);
    let glass = Material { alpha: AlphaMode::Blend, ..lambert(0.5) };
    add_roof(&mut scene, Material { base_colour: glass.base_colour.with_w(0.5), ..glass });
    let (before, after) = darkened(scene);
    let expected = 1.0 - 0.25 * form_factor(1.0) as f32;
    assert!((after[0] / before[0] - expected).abs().max_element() < 0.01);
}

#[test]
fn what_no_mesh_is_near_stays_as_it_is_bit_for_bit() {
    let mut scene = ground(SplatEncoding::SrgbDisplay, &[DVec3::ZERO, DVec3::X * 50.0]);
    add_roof(&mut scene, lambert(0.5));
    let (before, after) = darkened(scene);
    assert!(after[0].x < before[0].x);
    assert_eq!(after[1], before[1]);
    let (before, after) = darkened(ground(SplatEncoding::SrgbDisplay, &[DVec3::ZERO, DVec3::X]));
    assert_eq!(before, after);
}

#[test]
fn light_that_splats_keep_away_is_not_taken_twice() {
    // A roof of splats as wide as the panel and right below it: the panel hides what never arrived.
    let facing_up = |y: f64, width: f64| Gaussian {
        mean: DVec3::new(0.0, y, 0.0),
        rotation: DQuat::IDENTITY,
        standard_deviations: DVec3::new(width, 1e-5, width),
        opacity: 0.99,
        colour: Vec3::ONE,
    };
    let splats = splats([facing_up(0.0, 1e-3), facing_up(0.9, 10.0)]);
    let mut scene = Scene { splats, encoding: SplatEncoding::LinScene, ..Scene::default() };
    add_roof(&mut scene, lambert(0.5));
    let bvh = Bvh::build(&mut scene);
    shadows::darken(&mut scene, &bvh, TraceSettings::default());
    let ground = scene.splats.means.iter().position(|mean| mean.y == 0.0).unwrap();
    let displayed = sh::evaluate(scene.splats.sh_degree, scene.splats.sh_of(ground), Vec3::Y);
    assert!(displayed.x > 0.98, "{displayed}");
}
