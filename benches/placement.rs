//! Probes against held-out error, adaptive beside a regular grid, and the time of a placement by stage.
//!
//! ```text
//! cargo bench --bench placement                               # the demo's two rooms, and a building
//! cargo bench --bench placement -- --gaussians 1500000        # the building as dense as a capture
//! cargo bench --bench placement -- --splats scene.ply
//! cargo bench --bench placement -- --counts 16,64 --levels 0.7,1.9 --held-out 100 --bake
//! ```
//!
//! Errors are relative root mean squares at `--held-out` random free positions: the mean of radiance prefiltered at roughness
//! 0.1, 0.3, 0.6 and diffuse irradiance, all of small cubemaps. The grid has the same fitted proxy boxes and linear weights.
//! `--bake` also bakes the largest placement at 256 pixels, for comparison of times.

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use splatprobe::bake::{self, BakeSettings, Silent};
use splatprobe::bvh::Bvh;
use splatprobe::generate::{CORRIDOR_AND_HALL, InteriorSettings, interior};
use splatprobe::ingest;
use splatprobe::job::SplatInput;
use splatprobe::place::free_space::Space;
use splatprobe::place::{AdaptiveSettings, Sight, Survey};
use splatprobe::scene::{Scene, bounds::robust_bounds};
use splatprobe::shade::UnlitSurfaces;
use splatprobe::trace::{BeamTracer, Level, RayTracer, TraceSettings};

struct Arguments {
    gaussians: usize,
    splats: Option<String>,
    counts: Vec<usize>,
    levels: Vec<f64>,
    held_out: usize,
    bake: bool,
}

fn main() {
    let arguments = parse();
    if let Some(path) = &arguments.splats {
        let scene = ingest::load_scene(&[SplatInput::new(path)], &[]).expect("a splat file").0;
        return measure(path, scene, &arguments);
    }
    let demo =
        InteriorSettings { gaussians: 52_000, rooms: [2, 1], sh_degree: 0, gaussian_size: 1.6, ..Default::default() };
    // As large as a capture's where they are as many.
    let gaussian_size = (1.5e6 / arguments.gaussians as f64).sqrt().max(1.0);
    let building = InteriorSettings {
        gaussians: arguments.gaussians,
        joined: CORRIDOR_AND_HALL,
        sh_degree: 1,
        gaussian_size,
        ..Default::default()
    };
    for (name, settings) in [("two rooms", demo), ("building", building)] {
        measure(name, Scene { splats: interior(&settings), ..Scene::default() }, &arguments);
    }
}

fn measure(name: &str, mut scene: Scene, arguments: &Arguments) {
    let bvh = Bvh::build(&mut scene);
    let bounds = robust_bounds(&scene.splats.means).expect("Gaussians").translated(scene.origin);
    let surfaces = UnlitSurfaces::new(&scene.meshes);
    let rules = TraceSettings::default();
    let tracer = RayTracer { scene: &scene, bvh: &bvh, surfaces: &surfaces, settings: rules };
    let sight = Sight { space: Space { tracer }, tiles: &tracer };
    let never = AtomicBool::new(false);
    let asked = |max_probes: usize| AdaptiveSettings {
        bounds,
        levels: arguments.levels.clone(),
        error: 0.0,
        max_probes,
        time: None,
        held_out: arguments.held_out,
    };

    println!("\n## {name}: {} Gaussians, {}", scene.splats.len(), Level::best().name());
    let survey = Survey::new(&sight, &asked(1), &never).expect("free space");
    println!(
        "| probes | adaptive mean | p95 | r 0.1, 0.3, 0.6, diffuse | grid | mean | p95 | r 0.1, 0.3, 0.6, diffuse |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let mut last = None;
    for &count in &arguments.counts {
        let placed = survey.place(&sight, &asked(count), &never).expect("a placement");
        if let Some(held_out) = placed.record.held_out {
            let [[a, b, c, d], [e, f, g, h]] = [held_out.adaptive, held_out.grid].map(|summary| summary.by_kind);
            println!(
                "| {} | {:.4} | {:.4} | {a:.3} {b:.3} {c:.3} {d:.3} | {:?} | {:.4} | {:.4} | {e:.3} {f:.3} {g:.3} {h:.3} |",
                placed.probes.len(),
                held_out.adaptive.mean,
                held_out.adaptive.p95,
                held_out.grid_counts,
                held_out.grid.mean,
                held_out.grid.p95,
            );
        }
        last = Some(placed);
    }
    let Some(placed) = last else { return };
    let (record, seconds) = (&placed.record, placed.seconds);
    println!(
        "\n{} sites, {} moved, {} left out; {:?}",
        record.sites,
        record.relocated,
        record.dropped.len(),
        record.checks
    );
    println!(
        "{} probes: free space {:.2} s, signals {:.2} s, search {:.2} s; report {:.2} s",
        placed.probes.len(),
        seconds.free_space,
        seconds.signals,
        seconds.search,
        seconds.report
    );
    if arguments.bake {
        let settings = BakeSettings { face_size: 256, samples: 1, distance: false, edge_texels: false };
        let start = Instant::now();
        let beams = BeamTracer::new(&scene, &bvh, &surfaces, rules);
        bake::bake_probes(&beams, &scene, &placed.probes, &settings, &Silent, &never, |_, _, _| Ok(()))
            .expect("a bake");
        println!("the same probes baked at 256 pixels: {:.2} s", start.elapsed().as_secs_f64());
    }
}

fn parse() -> Arguments {
    let mut arguments = Arguments {
        gaussians: 400_000,
        splats: None,
        counts: vec![8, 16, 32, 64, 128],
        levels: Vec::new(),
        held_out: 500,
        bake: false,
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().expect("a value after the flag");
        match word.as_str() {
            "--gaussians" => arguments.gaussians = value().parse().expect("a number"),
            "--splats" => arguments.splats = Some(value()),
            "--counts" => arguments.counts = value().split(',').map(|count| count.parse().expect("a number")).collect(),
            "--levels" => arguments.levels = value().split(',').map(|y| y.parse().expect("a height")).collect(),
            "--held-out" => arguments.held_out = value().parse().expect("a number"),
            "--bake" => arguments.bake = true,
            // What cargo adds.
            _ => {}
        }
    }
    arguments
}
