//! The production tracers against the f64 reference.

use crate::common::{NoSurfaces, PatternedSurfaces, Random, add_random_triangles, cloud, hangs_on_rounding};
use crate::three_scenes::{Sample, three_scenes};
use glam::{DVec3, Vec3};
use splatprobe::bvh::Bvh;
use splatprobe::job::{Order, ShDirection};
use splatprobe::scene::{Scene, colour};
use splatprobe::shade::UnlitSurfaces;
use splatprobe::trace::gaussian::response;
use splatprobe::trace::ray::RayScratch;
use splatprobe::trace::{
    BeamTracer, Counters, Face, Footprint, Level, Radiance, Ray, RayTracer, ReferenceTracer, Surfaces, Tile,
    TileTracer, TraceSettings,
};

/// Largest difference of two results over colour in display space, coverage, and mean distance relative to itself.
fn difference(a: &Radiance, b: &Radiance) -> f32 {
    let display = |r: &Radiance| {
        let linear = r.to_linear(Default::default(), Default::default()).0;
        Vec3::new(colour::linear_to_srgb(linear.x), colour::linear_to_srgb(linear.y), colour::linear_to_srgb(linear.z))
    };
    let distance = (a.distance_sum - b.distance_sum).abs() / (1.0 + b.distance_sum.abs());
    (display(a) - display(b)).abs().max_element().max((a.transmittance - b.transmittance).abs()).max(distance)
}

#[derive(Default)]
struct Comparison {
    squares: f64,
    max: f32,
    texels: usize,
    /// Rays left out because the model itself jumps within rounding: see [`hangs_on_rounding`].
    jumps: usize,
}

impl Comparison {
    fn rms(&self) -> f64 {
        (self.squares / self.texels as f64).sqrt()
    }

    fn add(&mut self, scene: &Scene, ray: &Ray, seen: &Radiance, truth: &Radiance) {
        let d = difference(seen, truth);
        self.texels += 1;
        if d > 1e-5 && hangs_on_rounding(scene, ray) {
            self.jumps += 1;
            return;
        }
        self.squares += f64::from(d).powi(2);
        self.max = self.max.max(d);
    }
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
    let mut comparison = Comparison::default();
    for _ in 0..rays {
        let ray = Ray { origin, direction: random.direction() };
        comparison.add(scene, &ray, &fast.trace(&ray, &mut scratch), &truth.trace(&ray));
    }
    comparison
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
                assert!(seen.rms() <= 2e-5 && seen.max <= 1e-3, "{settings:?} {origin}: {} {}", seen.rms(), seen.max);
            }
        }
    }
}

/// Faces of 45 texels have packets that are cut by a tile's edge, and some whose directions change sign on an axis.
#[test]
fn each_ray_of_a_packet_gathers_what_it_gathers_alone_to_the_last_bit() {
    let mut scene = Scene { splats: cloud(4000, [0.01, 0.4], 3, 1), ..Scene::default() };
    add_random_triangles(&mut scene, 60, 2);
    let bvh = Bvh::build(&mut scene);
    let surfaces = PatternedSurfaces(&scene);
    let widened = Footprint { sigma_per_metre: 0.02, keeps_energy: true };
    for order in [Order::RayHitDistance, Order::CameraDistance] {
        for (footprint, t_cutoff) in [(Footprint::default(), 0.0), (Footprint::default(), 0.01), (widened, 0.01)] {
            let settings = TraceSettings { order, t_cutoff, footprint, ..TraceSettings::default() };
            let tracer = RayTracer { scene: &scene, bvh: &bvh, surfaces: &surfaces, settings };
            for face in Face::ALL {
                let (tile, origin) =
                    (Tile { face, face_size: 45, x: 0, y: 0, width: 45, height: 45 }, DVec3::splat(0.3));
                let mut texels = vec![Radiance::default(); tile.len()];
                tracer.trace_tile(origin, &tile, &mut texels);
                let mut scratch = RayScratch::default();
                for (i, (texel, direction)) in texels.iter().zip(tile.directions()).enumerate() {
                    assert_eq!(
                        *texel,
                        tracer.trace(&Ray { origin, direction }, &mut scratch),
                        "{settings:?} {face:?} {i}"
                    );
                }
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

/// Differences of two tracers over some tiles of a probe's cube, one of them cut by the face's edge.
fn compare_tiles(scene: &Scene, a: &dyn TileTracer, b: &dyn TileTracer, origin: DVec3) -> Comparison {
    let mut comparison = Comparison::default();
    for face in Face::ALL {
        for (x, y, width, height) in [(0, 0, 16, 24), (32, 16, 13, 5)] {
            let tile = Tile { face, face_size: 45, x, y, width, height };
            let (mut seen, mut truth) = (vec![Radiance::default(); tile.len()], vec![Radiance::default(); tile.len()]);
            a.trace_tile(origin, &tile, &mut seen);
            b.trace_tile(origin, &tile, &mut truth);
            for ((seen, truth), direction) in seen.iter().zip(&truth).zip(tile.directions()) {
                comparison.add(scene, &Ray { origin, direction }, seen, truth);
            }
        }
    }
    comparison
}

#[test]
fn beam_equals_ray_at_every_level_order_and_colour_direction() {
    let mut scene = Scene { splats: cloud(4000, [0.01, 0.4], 3, 1), ..Scene::default() };
    add_random_triangles(&mut scene, 60, 2);
    let bvh = Bvh::build(&mut scene);
    let surfaces = PatternedSurfaces(&scene);
    for level in Level::available() {
        println!("level {}", level.name());
        for order in [Order::RayHitDistance, Order::CameraDistance] {
            for sh_direction in [ShDirection::Mean, ShDirection::Ray] {
                for origin in [DVec3::ZERO, DVec3::new(3.0, 2.0, -5.0)] {
                    for t_cutoff in [0.0, 1e-3] {
                        let settings = TraceSettings { order, sh_direction, t_cutoff, ..TraceSettings::default() };
                        let beam = BeamTracer { level, ..BeamTracer::new(&scene, &bvh, &surfaces, settings) };
                        let ray = RayTracer { scene: &scene, bvh: &bvh, surfaces: &surfaces, settings };
                        let seen = compare_tiles(&scene, &beam, &ray, origin);
                        let (rms, max) = (seen.rms(), seen.max);
                        assert!(rms <= 1e-6 && max <= 1e-5, "{} {settings:?} {origin}: {rms:e} {max:e}", level.name());
                        assert!(seen.jumps * 100 < seen.texels);
                    }
                }
            }
        }
    }
}

/// Compares `tracers` with the reference at 4000 random pixels of a 256 px cube.
fn compare_pixels(
    scene: &Scene,
    tracers: &[&dyn TileTracer],
    truth: &dyn TileTracer,
    origin: DVec3,
) -> Vec<Comparison> {
    let mut comparisons: Vec<Comparison> = tracers.iter().map(|_| Comparison::default()).collect();
    let mut random = Random(41);
    for _ in 0..4000 {
        let (face, x, y) = (Face::ALL[random.below(6)], random.below(256) as i32, random.below(256) as i32);
        let tile = Tile { face, face_size: 256, x, y, width: 1, height: 1 };
        let trace = |tracer: &dyn TileTracer| {
            let mut texel = [Radiance::default()];
            tracer.trace_tile(origin, &tile, &mut texel);
            texel[0]
        };
        let expected = trace(truth);
        for (tracer, comparison) in tracers.iter().zip(&mut comparisons) {
            comparison.add(scene, &Ray { origin, direction: tile.direction(0, 0) }, &trace(*tracer), &expected);
        }
    }
    comparisons
}

#[test]
fn four_thousand_pixels_of_three_scenes_equal_the_reference() {
    for Sample { name, mut scene, origin, rms, patterned } in three_scenes() {
        let bvh = Bvh::build(&mut scene);
        let scene = &scene;
        let (pattern, unlit) = (PatternedSurfaces(scene), UnlitSurfaces::new(&scene.meshes));
        let surfaces: &dyn Surfaces = if patterned { &pattern } else { &unlit };
        let settings = TraceSettings { t_cutoff: 0.0, ..TraceSettings::default() };
        let ray = RayTracer { scene, bvh: &bvh, surfaces, settings };
        let beam = BeamTracer::new(scene, &bvh, surfaces, settings);
        let truth = ReferenceTracer { scene, surfaces, settings };
        for (tracer, seen) in ["ray", "beam"].iter().zip(compare_pixels(scene, &[&ray, &beam], &truth, origin)) {
            println!("{name}, {tracer}: rms {:e}, max {:e}, {} jumps", seen.rms(), seen.max, seen.jumps);
            assert!(seen.rms() <= rms && seen.max <= 1e-3, "{name}, {tracer}: {:e} {:e}", seen.rms(), seen.max);
            assert!(seen.jumps * 20 < seen.texels, "{name}, {tracer}: {} jumps", seen.jumps);
        }
    }
}

#[test]
fn counters_count_every_response_and_every_gaussian_that_responds() {
    let mut scene = Scene { splats: cloud(500, [0.05, 0.4], 1, 7), ..Scene::default() };
    let bvh = Bvh::build(&mut scene);
    let settings = TraceSettings { t_cutoff: 0.0, ..TraceSettings::default() };
    let origin = DVec3::new(0.1, 0.2, -0.3);
    let tile = Tile { face: Face::PosX, face_size: 40, x: 0, y: 0, width: 40, height: 40 };
    let (mut responses, mut seen) = (0, vec![false; scene.splats.len()]);
    for direction in tile.directions() {
        for (i, seen) in seen.iter_mut().enumerate() {
            let m = scene.splats.unit_from_world[i].as_dmat3();
            let mean = scene.splats.means[i].as_dvec3() - origin;
            let contributes = response(&m, f64::from(scene.splats.opacities[i]), mean, direction).contributes(0.0);
            responses += usize::from(contributes);
            *seen |= contributes;
        }
    }
    let counters = Counters::new(scene.splats.len());
    let silent = BeamTracer::new(&scene, &bvh, &NoSurfaces, settings);
    let counting = BeamTracer { counters: Some(&counters), ..BeamTracer::new(&scene, &bvh, &NoSurfaces, settings) };
    let [mut texels, mut counted] = [vec![Radiance::default(); tile.len()], vec![Radiance::default(); tile.len()]];
    silent.trace_tile(origin, &tile, &mut texels);
    counting.trace_tile(origin, &tile, &mut counted);
    assert_eq!(texels, counted);
    let report = counters.report();
    assert_eq!((report.rays, report.tiles, report.fallback_rays, report.gaussians), (1600, 1, 0, 500));
    // Responses at the threshold may fall on either side of it in f32.
    let counted = report.contributions_per_ray * 1600.0;
    assert!((counted - responses as f64).abs() <= 2e-4 * responses as f64, "{counted} of {responses}");
    assert!(report.evaluations_per_ray >= report.contributions_per_ray && report.lanes_used > 0.05);
    let responding = seen.iter().filter(|&&seen| seen).count();
    assert!(report.gaussians_touched >= responding && responding > 50, "{report:?}, {responding}");
    assert!(report.candidates_per_tile >= report.gaussians_touched as f64);
}
