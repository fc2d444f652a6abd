//! What it saves to skip what a scene does not need: each measured beside the same work without the skip.
//!
//! ```text
//! cargo bench --bench skips -- --gaussians 500000
//! ```
//!
//! Times are on all cores, in the generated interior: medians of five, but for the last three rows. A cubemap has 256 px.

#[path = "common/scene.rs"]
#[allow(dead_code)]
mod scene;
#[path = "../tests/light/scenes.rs"]
#[allow(dead_code)]
mod scenes;

use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use base64::Engine;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use scene::eye;
use scenes::{add_panel, add_sphere, lambert};
use splatprobe::bake::{self, BakeSettings, Silent};
use splatprobe::bvh::Bvh;
use splatprobe::generate::{InteriorSettings, interior};
use splatprobe::ingest::load_scene;
use splatprobe::job::{Job, MeshInput, Placement, SplatInput};
use splatprobe::pipeline;
use splatprobe::place::free_space::Space;
use splatprobe::place::{AdaptiveSettings, Probe, Sight, Survey};
use splatprobe::scene::bounds::robust_bounds;
use splatprobe::scene::texture::{Encoding, Image};
use splatprobe::scene::{Material, Scene, Splats, sh};
use splatprobe::shade::{PathSettings, PathSurfaces, UnlitSurfaces};
use splatprobe::trace::{BeamTracer, Counters, RayTracer, Surfaces, TraceSettings};

fn main() {
    let mut gaussians = 500_000;
    let mut words = std::env::args().skip(1).filter(|word| word != "--bench");
    while let Some(word) = words.next() {
        match (word.as_str(), words.next().map(|value| value.parse())) {
            ("--gaussians", Some(Ok(count))) => gaussians = count,
            _ => panic!("--gaussians COUNT is all that this bench is asked"),
        }
    }
    let splats = interior(&InteriorSettings { gaussians, ..InteriorSettings::default() });
    println!("{} Gaussians of degree {}, {} cores\n", splats.len(), splats.sh_degree, rayon::current_num_threads());
    println!("| skipped | measured | with the skip, s | without, s | without / with |");
    println!("|---|---|---|---|---|");
    transparent_gaussians(&splats);
    empty_bands(&splats);
    colours_of_untouched(&splats);
    unseen_textures();
    needless_tangents();
    needless_paths(&splats);
    absent_triangles(&splats);
    redundant_probes(&splats);
    unchanged_probes();
}

fn row(skipped: &str, measured: &str, with: f64, without: f64) {
    println!("| {skipped} | {measured} | {with:.4} | {without:.4} | {:.2} |", without / with);
}

/// Median seconds of five.
fn time(mut work: impl FnMut()) -> f64 {
    let mut times = [0; 5].map(|_| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64()
    });
    times.sort_by(f64::total_cmp);
    times[2]
}

fn scene_of(splats: Splats) -> Scene {
    Scene { splats, ..Scene::default() }
}

/// Seconds that the tree and one cubemap take.
fn build_and_bake(splats: Splats) -> f64 {
    let mut scene = scene_of(splats);
    let mut bvh = Bvh::default();
    let build = time(|| bvh = Bvh::build(&mut scene));
    build + time(|| bake_one(&scene, &bvh, &UnlitSurfaces::new(&scene.meshes)))
}

/// One cubemap from the eye.
fn bake_one(scene: &Scene, bvh: &Bvh, surfaces: &dyn Surfaces) {
    bake_at(&BeamTracer::new(scene, bvh, surfaces, TraceSettings::default()), &[eye()]);
}

fn bake_at(tracer: &BeamTracer, positions: &[DVec3]) {
    let settings = BakeSettings { face_size: 256, samples: 1, distance: false, edge_texels: false };
    let probes: Vec<Probe> = splatprobe::place::list(positions, None, 0.1).expect("a probe");
    bake::bake_probes(tracer, tracer.scene, &probes, &settings, &Silent, &AtomicBool::new(false), |_, _, _| Ok(()))
        .expect("a bake");
}

/// Of a loaded file they are left out; here they stay in the tree, a tenth as many as the others.
fn transparent_gaussians(splats: &Splats) {
    let mut all = splats.clone();
    for i in (0..splats.len()).step_by(10) {
        all.means.push(splats.means[i] + Vec3::splat(0.01));
        all.unit_from_world.push(splats.unit_from_world[i]);
        all.opacities.push(0.003);
        all.sh.extend_from_slice(splats.sh_of(i));
    }
    let seconds = [splats.clone(), all].map(build_and_bake);
    row("Gaussians under 1/255", "tree and a cubemap with a tenth more of them", seconds[0], seconds[1]);
}

/// Bands that are zero everywhere are not stored.
fn empty_bands(splats: &Splats) {
    let mut kept = splats.clone();
    kept.lower_sh_degree(0);
    let mut padded = kept.clone();
    padded.sh_degree = 3;
    padded.sh = (0..kept.len() * 3).flat_map(|i| [kept.sh[i]].into_iter().chain([0.0; 15])).collect();
    let measured =
        format!("tree and a cubemap, {} bytes a Gaussian or {}", Splats::bytes_each(0), Splats::bytes_each(3));
    let seconds = [kept, padded].map(build_and_bake);
    row("bands of spherical harmonics that are zero", &measured, seconds[0], seconds[1]);
}

/// Splatting evaluates the colours of all Gaussians for a view; here only what a tile shades has one.
fn colours_of_untouched(splats: &Splats) {
    let mut scene = scene_of(splats.clone());
    let bvh = Bvh::build(&mut scene);
    let counters = Counters::new(scene.splats.len());
    let surfaces = UnlitSurfaces::new(&scene.meshes);
    let tracer = BeamTracer::new(&scene, &bvh, &surfaces, TraceSettings::default());
    bake_at(&BeamTracer { counters: Some(&counters), ..tracer }, &[eye()]);
    let colours = |count: usize| {
        let splats = &scene.splats;
        time(|| {
            let sum = |i: usize| {
                let direction = (splats.means[i].as_dvec3() - eye()).normalize().as_vec3();
                sh::evaluate(splats.sh_degree, splats.sh_of(i), direction)
            };
            std::hint::black_box((0..count).into_par_iter().map(sum).reduce(|| Vec3::ZERO, |a, b| a + b));
        })
    };
    let touched = counters.report().gaussians_touched;
    let measured = format!("colours of the {touched} touched for a cubemap, or of all");
    row("Gaussians that no tile touches", &measured, colours(touched), colours(scene.splats.len()));
}

/// A picture is decoded when the first hit asks for it.
fn unseen_textures() {
    const EDGE: u32 = 2048;
    let picture = image::RgbImage::from_fn(EDGE, EDGE, |x, y| image::Rgb([x as u8, y as u8, ((x * y) >> 8) as u8]));
    let mut png = Cursor::new(Vec::new());
    picture.write_to(&mut png, image::ImageFormat::Png).expect("a PNG");
    let png = png.into_inner();
    let make = || {
        let png = png.clone();
        Image::new(EDGE, EDGE, Encoding::Srgb, move || {
            let decoded = image::load_from_memory(&png).expect("a PNG").into_rgba8();
            Ok(decoded.pixels().map(|pixel| pixel.0).collect())
        })
    };
    let unseen = time(|| drop(std::hint::black_box(make())));
    let seen = time(|| assert!(std::hint::black_box(make()).levels().is_ok()));
    row("textures that no hit asks for", "a PNG of 2048 x 2048 and its mips", unseen, seen);
}

/// Tangents are made where a normal map needs them.
fn needless_tangents() {
    let folder = tempfile::tempdir().expect("a folder");
    let seconds = [false, true].map(|has_normal_map| {
        let path = grid_mesh(folder.path(), has_normal_map);
        time(|| drop(load_scene(&[], &[MeshInput::new(&path)]).expect("a mesh")))
    });
    row("tangents without normal maps", "loading 500,000 triangles", seconds[0], seconds[1]);
}

/// A glTF file of a bumpy square of 500 x 500 quads with normals and texture coordinates.
fn grid_mesh(folder: &Path, has_normal_map: bool) -> PathBuf {
    const EDGE: u32 = 500;
    let row = EDGE + 1;
    let vertices = || (0..row * row).map(|i| [(i % row) as f32 / EDGE as f32, (i / row) as f32 / EDGE as f32]);
    let positions = vertices().flat_map(|[x, y]| [x, 0.05 * (20.0 * x).sin() * (15.0 * y).cos(), y]);
    let normals = vertices().flat_map(|_| [0.0f32, 1.0, 0.0]);
    let coordinates = vertices().flatten();
    let values = positions.chain(normals).chain(coordinates).flat_map(f32::to_le_bytes);
    let corners = (0..EDGE * EDGE).flat_map(|i| {
        let first = i / EDGE * row + i % EDGE;
        [first, first + row, first + 1, first + 1, first + row, first + row + 1]
    });
    let bytes: Vec<u8> = values.chain(corners.flat_map(u32::to_le_bytes)).collect();
    let count = (row * row) as usize;
    let (vec3, vec2, indices) = (12 * count, 8 * count, 4 * 6 * (EDGE * EDGE) as usize);
    let view =
        |start: usize, length: usize| serde_json::json!({"buffer": 0, "byteOffset": start, "byteLength": length});
    let accessor = |view: usize, kind: &str| serde_json::json!({"bufferView": view, "componentType": 5126, "count": count, "type": kind});
    let mut material = serde_json::json!({"doubleSided": true});
    let mut flat = Cursor::new(Vec::new());
    image::RgbImage::from_pixel(1, 1, image::Rgb([128, 128, 255]))
        .write_to(&mut flat, image::ImageFormat::Png)
        .expect("a PNG");
    let base64 = |bytes: &[u8]| base64::engine::general_purpose::STANDARD.encode(bytes);
    if has_normal_map {
        material["normalTexture"] = serde_json::json!({"index": 0});
    }
    let mut positions = accessor(0, "VEC3");
    positions["min"] = serde_json::json!([0.0, -0.05, 0.0]);
    positions["max"] = serde_json::json!([1.0, 0.05, 1.0]);
    let document = serde_json::json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3, "material": 0}]}],
        "materials": [material], "textures": [{"source": 0}],
        "images": [{"uri": format!("data:image/png;base64,{}", base64(&flat.into_inner()))}],
        "accessors": [positions, accessor(1, "VEC3"), accessor(2, "VEC2"),
            {"bufferView": 3, "componentType": 5125, "count": 6 * EDGE * EDGE, "type": "SCALAR"}],
        "bufferViews": [view(0, vec3), view(vec3, vec3), view(2 * vec3, vec2), view(2 * vec3 + vec2, indices)],
        "buffers": [{"byteLength": bytes.len(), "uri": "grid.bin"}],
    });
    std::fs::write(folder.join("grid.bin"), bytes).expect("written");
    let path = folder.join(format!("grid-{has_normal_map}.gltf"));
    std::fs::write(&path, document.to_string()).expect("written");
    path
}

/// Surfaces that only shine send no secondary rays.
fn needless_paths(splats: &Splats) {
    let seconds = [true, false].map(|unlit| {
        let mut scene = scene_of(splats.clone());
        add_sphere(&mut scene, Material { unlit, ..lambert(0.8) }, eye().as_vec3() + Vec3::new(0.9, -0.4, 0.0), 0.3);
        let bvh = Bvh::build(&mut scene);
        let settings = PathSettings { noise: 0.0, max_paths: 16, ..PathSettings::default() };
        time(|| bake_one(&scene, &bvh, &PathSurfaces::new(&scene, &bvh, TraceSettings::default(), settings, &[])))
    });
    row(
        "secondary rays of surfaces that need none",
        "a sphere under `path`, unlit or lit by 16 paths",
        seconds[0],
        seconds[1],
    );
}

/// A scene of Gaussians alone never comes to what meets triangles; a triangle out of sight costs its box.
fn absent_triangles(splats: &Splats) {
    let seconds = [false, true].map(|has_triangles| {
        let mut scene = scene_of(splats.clone());
        if has_triangles {
            add_panel(&mut scene, lambert(0.5), Vec3::new(0.0, -90.0, 0.0), Vec3::X, Vec3::Z);
        }
        let bvh = Bvh::build(&mut scene);
        time(|| bake_one(&scene, &bvh, &UnlitSurfaces::new(&scene.meshes)))
    });
    row("triangles in scenes without", "a cubemap, two triangles out of sight", seconds[0], seconds[1]);
}

/// Sites whose light the probes around them predict get no probe.
fn redundant_probes(splats: &Splats) {
    let mut scene = scene_of(splats.clone());
    let bvh = Bvh::build(&mut scene);
    let surfaces = UnlitSurfaces::new(&scene.meshes);
    let tracer = RayTracer { scene: &scene, bvh: &bvh, surfaces: &surfaces, settings: TraceSettings::default() };
    let sight = Sight { space: Space { tracer }, tiles: &tracer };
    let bounds = robust_bounds(&scene.splats.means).expect("Gaussians").translated(scene.origin);
    let settings =
        AdaptiveSettings { bounds, levels: Vec::new(), error: 0.25, max_probes: usize::MAX, time: None, held_out: 0 };
    let never = AtomicBool::new(false);
    let start = Instant::now();
    let survey = Survey::new(&sight, &settings, &never).expect("free space");
    let placed = survey.place(&sight, &settings, &never).expect("a placement");
    let placement = start.elapsed().as_secs_f64();
    let positions: Vec<DVec3> = placed.probes.iter().map(|probe| probe.position).take(8).collect();
    let beams = BeamTracer::new(&scene, &bvh, &surfaces, TraceSettings::default());
    let each = time(|| bake_at(&beams, &positions)) / positions.len() as f64;
    let (kept, sites) = (placed.probes.len(), placed.record.sites);
    let measured =
        format!("{kept} probes of {sites} sites, predicted to 0.25, placement included; eight baked, scaled");
    row("probes that others predict", &measured, placement + each * kept as f64, each * sites as f64);
}

/// A bake of the demo's scene, the same again, and with the lamp moved.
fn unchanged_probes() {
    let folder = tempfile::tempdir().expect("a folder");
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/demo");
    let mut job = Job {
        splats: vec![SplatInput::new(demo.join("demo.ply"))],
        meshes: vec![MeshInput::new(demo.join("lamp.glb"))],
        output: Some(folder.path().join("out")),
        placement: Placement { grid: Some([3, 3, 3]), ..Placement::default() },
        face_size: 256,
        cache: Some(folder.path().join("cache")),
        ..Job::default()
    };
    let seconds = |job: &Job| {
        let start = Instant::now();
        pipeline::bake(job, &Silent, &AtomicBool::new(false)).expect("a bake");
        start.elapsed().as_secs_f64()
    };
    let first = seconds(&job);
    row("probes whose inputs have not changed", "a bake of 27 probes again", seconds(&job), first);
    job.meshes[0].transform.translation = [0.25, 0.0, 0.0];
    let moved = seconds(&job);
    row("tiles that see nothing of what changed", "27 probes, the lamp moved", moved, first);
}
