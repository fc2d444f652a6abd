//! Time and error of lit surfaces: path tracing by paths per hit, and the cubemaps of `--surface probe` beside it.
//!
//! ```text
//! cargo bench --bench surface -- --gaussians 100000 --paths 4,16,64,256 --truth 4096
//! ```
//!
//! Four spheres (diffuse, rough metal, mirror, coated) stand in the generated interior; a cubemap of 64 px looks at them from
//! their middle. Errors are of the texels that show a sphere, relative to the root mean square of the truth, which takes
//! `--truth` paths. Times are of one run on all cores, cubemaps of `probe` included.

#[path = "../tests/light/scenes.rs"]
#[allow(dead_code)]
mod scenes;

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use scenes::{add_sphere, lambert, metal};
use splatprobe::bvh::Bvh;
use splatprobe::generate::{InteriorSettings, ROOM, interior};
use splatprobe::scene::Scene;
use splatprobe::shade::{LocallyLitSurfaces, PathSettings, PathSurfaces};
use splatprobe::trace::{BeamTracer, Face, Radiance, Surfaces, Tile, TileTracer, TraceSettings};

const FACE_SIZE: u32 = 64;

fn main() {
    let (mut gaussians, mut paths, mut truth) = (100_000, vec![4, 16, 64, 256], 4096);
    let mut words = std::env::args().skip(1).filter(|word| word != "--bench");
    while let Some(word) = words.next() {
        let value = words.next().expect("a value after each option");
        let number = |text: &str| text.parse::<u32>().expect("a number");
        match word.as_str() {
            "--gaussians" => gaussians = number(&value) as usize,
            "--paths" => paths = value.split(',').map(number).collect(),
            "--truth" => truth = number(&value),
            _ => panic!("unknown option {word}"),
        }
    }
    let splats = interior(&InteriorSettings { gaussians, ..InteriorSettings::default() });
    let mut scene = Scene { splats, ..Scene::default() };
    let middle = DVec3::new(1.5 * ROOM.x, 1.4, 1.5 * ROOM.z);
    let coated = {
        let mut coated = lambert(0.5);
        coated.clearcoat.factor = 1.0.into();
        coated
    };
    for (material, offset) in
        [(lambert(0.8), Vec3::X), (metal(0.4), Vec3::NEG_X), (metal(0.0), Vec3::Z), (coated, Vec3::NEG_Z)]
    {
        add_sphere(&mut scene, material, middle.as_vec3() + offset * 0.9, 0.3);
    }
    let bvh = Bvh::build(&mut scene);
    let trace = TraceSettings::default();
    let path = |max_paths: u32| {
        let settings = PathSettings { noise: 0.0, max_paths, ..PathSettings::default() };
        PathSurfaces::new(&scene, &bvh, trace, settings, &[])
    };
    let truth = image(&scene, &bvh, &path(truth), middle);
    println!(
        "{} Gaussians, {} triangles, {} cores",
        scene.splats.len(),
        scene.meshes.triangles.len(),
        rayon::current_num_threads()
    );
    println!("| surfaces | seconds | relative RMSE |");
    println!("|---|---|---|");
    let report = |name: &str, start: Instant, seen: &[Vec3]| {
        let squares =
            |values: &mut dyn Iterator<Item = Vec3>| values.map(|v| f64::from(v.length_squared())).sum::<f64>();
        let error = squares(&mut seen.iter().zip(&truth).map(|(a, b)| *a - *b));
        let relative = (error / squares(&mut truth.iter().copied())).sqrt();
        println!("| {name} | {:.2} | {relative:.4} |", start.elapsed().as_secs_f64());
    };
    for count in paths {
        let start = Instant::now();
        let seen = image(&scene, &bvh, &path(count), middle);
        report(&format!("path, {count}"), start, &seen);
    }
    let start = Instant::now();
    let lit = LocallyLitSurfaces::new(&scene, &bvh, trace, &AtomicBool::new(false)).expect("finite light");
    let seen = image(&scene, &bvh, &lit, middle);
    report("probe", start, &seen);
}

/// Light of the surfaces in each texel of a cubemap; black where there are none.
fn image(scene: &Scene, bvh: &Bvh, surfaces: &dyn Surfaces, origin: DVec3) -> Vec<Vec3> {
    let tracer = BeamTracer::new(scene, bvh, surfaces, TraceSettings::default());
    let tiles: Vec<Tile> = Face::ALL
        .into_iter()
        .flat_map(|face| (0..FACE_SIZE).step_by(16).map(move |y| (face, y)))
        .map(|(face, y)| Tile { face, face_size: FACE_SIZE, x: 0, y: y as i32, width: FACE_SIZE, height: 16 })
        .collect();
    tiles
        .par_iter()
        .flat_map_iter(|tile| {
            let mut texels = vec![Radiance::default(); tile.len()];
            tracer.trace_tile(origin, tile, &mut texels);
            texels.into_iter().map(|texel| texel.surface_sum)
        })
        .collect()
}
