//! The footprint filter: closed forms, and the production tracers against the f64 reference under it.

use crate::common::{
    Gaussian, NoSurfaces, PatternedSurfaces, Random, add_random_triangles, cloud, hangs_on_rounding_under, splats,
};
use crate::three_scenes::{Sample, three_scenes};
use glam::{DMat3, DQuat, DVec3, Vec3};
use splatprobe::bvh::Bvh;
use splatprobe::job::{self, Order};
use splatprobe::scene::splats::ALPHA_MIN;
use splatprobe::scene::{Scene, Splats, colour};
use splatprobe::shade::UnlitSurfaces;
use splatprobe::trace::{
    BeamTracer, Face, Footprint, Level, Radiance, Ray, RayTracer, ReferenceTracer, Surfaces, Tile, TileTracer,
    TraceSettings, gaussian,
};

/// Both kinds, at faces of `size` rays: `train` as wide as `pixel`.
fn both(size: u32) -> [Footprint; 2] {
    let pixel = Footprint::new(job::Footprint::Pixel, size);
    [pixel, Footprint { keeps_energy: false, ..pixel }]
}

fn settings(footprint: Footprint, order: Order) -> TraceSettings {
    TraceSettings { footprint, order, t_cutoff: 0.0, ..TraceSettings::default() }
}

fn texels(tracer: &dyn TileTracer, origin: DVec3, tile: &Tile) -> Vec<Radiance> {
    let mut texels = vec![Radiance::default(); tile.len()];
    tracer.trace_tile(origin, tile, &mut texels);
    texels
}

/// Largest difference over colour in display space, coverage, and mean distance relative to itself.
fn difference(a: &Radiance, b: &Radiance) -> f32 {
    let display = |r: &Radiance| {
        let linear = r.to_linear(Default::default(), Default::default()).0;
        Vec3::from_array(linear.to_array().map(colour::linear_to_srgb))
    };
    let distance = (a.distance_sum - b.distance_sum).abs() / (1.0 + b.distance_sum.abs());
    (display(a) - display(b)).abs().max_element().max((a.transmittance - b.transmittance).abs()).max(distance)
}

/// Whether `tracer` sees what `truth` sees in `tiles`, up to `rms` and 1e-3 in any texel; rays that hang on a rounding
/// are left out. `what` names the case.
fn assert_same(
    what: &str,
    scene: &Scene,
    [tracer, truth]: [&dyn TileTracer; 2],
    settings: TraceSettings,
    (origin, tiles): (DVec3, &[Tile]),
    rms: f64,
) {
    let (mut squares, mut max, mut rays, mut jumps, mut covered) = (0.0, 0.0f32, 0, 0, 0.0);
    for tile in tiles {
        let pairs = texels(tracer, origin, tile).into_iter().zip(texels(truth, origin, tile));
        for ((seen, expected), direction) in pairs.zip(tile.directions()) {
            let d = difference(&seen, &expected);
            rays += 1;
            covered += expected.coverage();
            if d > 1e-5 && hangs_on_rounding_under(settings.footprint, scene, &Ray { origin, direction }) {
                jumps += 1;
                continue;
            }
            squares += f64::from(d).powi(2);
            max = max.max(d);
        }
    }
    let seen_rms = (squares / f64::from(rays)).sqrt();
    println!("{what}, {:?}: rms {seen_rms:e}, max {max:e}, {jumps} jumps of {rays}", settings.footprint);
    assert!(seen_rms <= rms && max <= 1e-3, "{what}, {settings:?}: {seen_rms:e} {max:e}");
    assert!(jumps * 20 < rays, "{what}, {settings:?}: {jumps} jumps of {rays}");
    assert!(covered > 0.005 * rays as f32, "{what}, {settings:?}: nothing to see");
}

#[test]
fn one_round_gaussian_is_widened_in_closed_form() {
    let (mean, s, opacity) = (DVec3::new(0.3, -0.2, -3.0), 0.1, 0.8f32);
    let gaussian = Gaussian {
        mean,
        rotation: DQuat::IDENTITY,
        standard_deviations: DVec3::splat(s),
        opacity: f64::from(opacity),
        colour: Vec3::ONE,
    };
    let mut scene = Scene { splats: splats([gaussian]), ..Scene::default() };
    let bvh = Bvh::build(&mut scene);
    let mean = scene.splats.means[0].as_dvec3();
    let tile = Tile { face: Face::NegZ, face_size: 32, x: 0, y: 0, width: 32, height: 32 };
    for footprint in both(16) {
        let settings = settings(footprint, Order::RayHitDistance);
        let (scene, surfaces) = (&scene, &NoSurfaces);
        let variance = s * s + (footprint.sigma_per_metre * mean.length()).powi(2);
        let peak = f64::from(opacity) * if footprint.keeps_energy { s * s / variance } else { 1.0 };
        let tracers: [&dyn TileTracer; 3] = [
            &ReferenceTracer { scene, surfaces, settings },
            &RayTracer { scene, bvh: &bvh, surfaces, settings },
            &BeamTracer::new(scene, &bvh, surfaces, settings),
        ];
        for tracer in tracers {
            let mut seen_by = 0;
            for (direction, seen) in tile.directions().zip(texels(tracer, DVec3::ZERO, &tile)) {
                let alpha = peak * (-0.5 * direction.cross(mean).length_squared() / variance).exp();
                let alpha = if alpha >= ALPHA_MIN { alpha } else { 0.0 };
                assert!((f64::from(seen.coverage()) - alpha).abs() < 2e-6, "{footprint:?}: {seen:?} {alpha}");
                seen_by += usize::from(alpha > 0.0);
            }
            assert!(seen_by >= 8, "{seen_by}");
        }
    }
}

#[test]
fn pixel_keeps_the_light_of_an_anisotropic_gaussian_and_train_adds_to_it() {
    let turn = DQuat::from_xyzw(0.3, -0.5, 0.2, 0.7).normalize();
    let unit_from_world = Splats::unit_from_world(turn, DVec3::new(0.002, 0.03, 0.01)).as_dmat3();
    let mean = DVec3::new(1.0, -2.0, -4.0);
    // Over the directions near the mean, on a plane across the direction to it.
    let light = |m: &DMat3, opacity: f64| {
        let (x, y) = mean.normalize().any_orthonormal_pair();
        let (step, half) = (0.001, 400);
        let offsets = (-half..=half).flat_map(|i| (-half..=half).map(move |j| (f64::from(i), f64::from(j))));
        let alphas = offsets.map(|(i, j)| {
            let direction = (mean + step * (i * x + j * y)).normalize();
            gaussian::response(m, opacity, mean, direction).alpha
        });
        alphas.sum::<f64>() * step * step
    };
    let plain = light(&unit_from_world, 0.1);
    let [pixel, train] = both(64).map(|footprint| {
        let (m, opacity) = footprint.widened(&unit_from_world, 0.1, mean);
        light(&m, opacity)
    });
    assert!((pixel / plain - 1.0).abs() < 2e-3, "{pixel} {plain}");
    assert!(train > 2.0 * plain, "{train} {plain}");
}

#[test]
fn at_the_mean_and_without_a_footprint_a_gaussian_stays_as_it_is() {
    let m = DMat3::from_diagonal(DVec3::new(1.0, 20.0, 1e5));
    for footprint in both(8) {
        assert_eq!(footprint.widened(&m, 0.7, DVec3::ZERO), (m, 0.7));
    }
    assert_eq!(Footprint::default().widened(&m, 0.7, DVec3::X), (m, 0.7));
}

/// Single texels, anywhere on a cube of `size`.
fn random_texels(size: u32, count: usize) -> Vec<Tile> {
    let mut random = Random(41);
    let mut below = |end: u32| random.below(end as usize) as u32;
    (0..count)
        .map(|_| Tile {
            face: Face::ALL[below(6) as usize],
            face_size: size,
            x: below(size) as i32,
            y: below(size) as i32,
            width: 1,
            height: 1,
        })
        .collect()
}

#[test]
fn the_tracers_agree_on_three_scenes_under_both_footprints() {
    for Sample { name, mut scene, origin, rms, patterned } in three_scenes() {
        let bvh = Bvh::build(&mut scene);
        let scene = &scene;
        let (pattern, unlit) = (PatternedSurfaces(scene), UnlitSurfaces::new(&scene.meshes));
        let surfaces: &dyn Surfaces = if patterned { &pattern } else { &unlit };
        for footprint in both(64) {
            let settings = settings(footprint, Order::RayHitDistance);
            let ray = RayTracer { scene, bvh: &bvh, surfaces, settings };
            let beam = BeamTracer::new(scene, &bvh, surfaces, settings);
            let truth = ReferenceTracer { scene, surfaces, settings };
            let tiles = random_texels(64, 400);
            assert_same(&format!("{name}, ray"), scene, [&ray, &truth], settings, (origin, &tiles), rms);
            assert_same(&format!("{name}, beam"), scene, [&beam, &truth], settings, (origin, &tiles), rms);
        }
    }
}

/// Widened boxes lose nothing: what is seen of these is hundreds of times larger than their boxes. `pixel` leaves little
/// of such small ones, so those that it shows are larger.
#[test]
fn gaussians_far_smaller_than_a_texel_are_found_in_every_order_at_every_level() {
    for (sizes, footprint) in [[1e-4, 2e-3], [0.04, 0.15]].into_iter().zip([both(16)[1], both(16)[0]]) {
        let mut scene = Scene { splats: cloud(600, sizes, 1, 7), ..Scene::default() };
        add_random_triangles(&mut scene, 10, 8);
        let bvh = Bvh::build(&mut scene);
        let (scene, surfaces) = (&scene, &PatternedSurfaces(&scene));
        let tiles = Face::ALL.map(|face| Tile { face, face_size: 16, x: 0, y: 0, width: 16, height: 16 });
        for order in [Order::RayHitDistance, Order::CameraDistance] {
            for origin in [DVec3::ZERO, DVec3::new(3.0, 2.0, -5.0)] {
                let settings = settings(footprint, order);
                let truth = ReferenceTracer { scene, surfaces, settings };
                let ray = RayTracer { scene, bvh: &bvh, surfaces, settings };
                assert_same("ray", scene, [&ray, &truth], settings, (origin, &tiles), 2e-5);
                for level in Level::available() {
                    let beam = BeamTracer { level, ..BeamTracer::new(scene, &bvh, surfaces, settings) };
                    assert_same(level.name(), scene, [&beam, &truth], settings, (origin, &tiles), 2e-5);
                }
            }
        }
    }
}

/// Texels beyond a face's edge lie in directions of its neighbour: the face's own view of them is the same.
#[test]
fn what_a_face_sees_beyond_its_edge_is_what_its_neighbour_sees() {
    let mut scene = Scene { splats: cloud(2000, [0.01, 0.3], 1, 9), ..Scene::default() };
    let bvh = Bvh::build(&mut scene);
    let (scene, surfaces) = (&scene, &NoSurfaces);
    let beyond = Face::ALL.map(|face| Tile { face, face_size: 32, x: 32, y: 0, width: 4, height: 32 });
    for footprint in both(32) {
        let settings = settings(footprint, Order::RayHitDistance);
        let beam = BeamTracer::new(scene, &bvh, surfaces, settings);
        // It knows rays, not faces.
        let ray = RayTracer { scene, bvh: &bvh, surfaces, settings };
        assert_same("beyond", scene, [&beam, &ray], settings, (DVec3::ZERO, &beyond), 1e-6);
    }
}
