//! Rays per second and error of the tracers, in one table.
//!
//! ```text
//! cargo bench --bench trace                                   # the generated interior, 1.5 M Gaussians, SH 3
//! cargo bench --bench trace -- --gaussians 750000 --sh 0
//! cargo bench --bench trace -- --splats scene.ply --probe 0,1.5,0
//! cargo bench --bench trace -- --cases beam-800,beam-64 --runs 9 --pixels 4000
//! ```
//!
//! A line under each case of the beam tracer says what it counted, in a run of its own.
//!
//! Times are medians over `--runs`: wall time at all cores, processor time at one. Errors are against `reference` in display space at
//! `--pixels` random texels of the case's cube.

#[path = "common/scene.rs"]
mod scene;

use std::time::Instant;

use self::scene::{eye, scene};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use splatprobe::bvh::Bvh;
use splatprobe::generate::InteriorSettings;
use splatprobe::job::{self, Order};
use splatprobe::scene::{Scene, colour};
use splatprobe::shade::UnlitSurfaces;
use splatprobe::trace::{
    BeamTracer, Counters, Face, Footprint, Level, Radiance, Ray, RayTracer, ReferenceTracer, Tile, TileTracer,
    TraceSettings,
};

struct Arguments {
    gaussians: usize,
    sh_degree: u8,
    splats: Option<String>,
    probe: Option<DVec3>,
    cases: Vec<String>,
    runs: usize,
    pixels: usize,
    threads: usize,
}

fn main() {
    let arguments = parse();
    let start = Instant::now();
    let settings = InteriorSettings {
        gaussians: arguments.gaussians,
        sh_degree: arguments.sh_degree,
        ..InteriorSettings::default()
    };
    let mut scene = scene(arguments.splats.as_deref(), settings);
    println!("scene: {} Gaussians, SH {}, {:.2} s to load", scene.splats.len(), scene.splats.sh_degree, seconds(start));
    reset_peak_memory();
    let before = peak_memory();
    let start = Instant::now();
    let bvh = Bvh::build(&mut scene);
    println!("tree: {} nodes, {:.2} s to build", bvh.nodes.len(), seconds(start));
    let per_gaussian = |bytes: f64| bytes / scene.splats.len() as f64;
    println!(
        "memory: {:.0} bytes per Gaussian before the build, at most {:.0} in it",
        per_gaussian(before),
        per_gaussian(peak_memory())
    );
    let probe = arguments.probe.unwrap_or_else(eye) - scene.origin;
    println!("level {}, {} cores, probe {probe}", Level::best().name(), arguments.threads);
    println!("| case | seconds | Mrays/s | on one core | RMS | max | over 1e-3 |");
    println!("|---|---|---|---|---|---|---|");
    for case in &arguments.cases {
        measure(&scene, &bvh, probe, case, &arguments);
    }
}

/// A case's name is `tracer-size`, then `-camera` for cameraDistance, `-pixel` for the footprint
/// filter, and `-avx2` or `-scalar` for a lower level.
fn measure(scene: &Scene, bvh: &Bvh, probe: DVec3, case: &str, arguments: &Arguments) {
    let mut words = case.split('-');
    let (tracer, size) = (words.next().unwrap_or(""), words.next().and_then(|s| s.parse().ok()).unwrap_or(256));
    let mut settings = TraceSettings::default();
    let mut level = Level::best();
    for word in words {
        match word {
            "camera" => settings.order = Order::CameraDistance,
            "pixel" => settings.footprint = Footprint::new(job::Footprint::Pixel, size),
            name => {
                let named = |l: &Level| l.name().to_lowercase() == name;
                level = Level::available().into_iter().find(named).unwrap_or(level);
            }
        }
    }
    let surfaces = UnlitSurfaces::new(&scene.meshes);
    let beam = BeamTracer { level, ..BeamTracer::new(scene, bvh, &surfaces, settings) };
    let ray = RayTracer { scene, bvh, surfaces: &surfaces, settings };
    let is_ray = tracer == "ray";
    let tracer: &dyn TileTracer = if is_ray { &ray } else { &beam };

    let rays = 6.0 * f64::from(size) * f64::from(size);
    let median = |threads: usize, clock: &dyn Fn() -> f64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        let mut times: Vec<f64> = (0..arguments.runs)
            .map(|_| {
                let start = clock();
                pool.install(|| cube(tracer, probe, size));
                clock() - start
            })
            .collect();
        times.sort_by(f64::total_cmp);
        times[times.len() / 2]
    };
    let start = Instant::now();
    let (all, one) = (median(arguments.threads, &|| seconds(start)), median(1, &cpu_seconds));
    let error = error(scene, &surfaces, settings, tracer, probe, size, arguments.pixels);
    println!(
        "| {case} | {all:.3} | {:.2} | {:.2} | {:.1e} | {:.1e} | {} of {} |",
        rays / all / 1e6,
        rays / one / 1e6,
        error.rms,
        error.max,
        error.large,
        arguments.pixels,
    );
    if !is_ray {
        let counters = Counters::new(scene.splats.len());
        cube(&BeamTracer { counters: Some(&counters), ..beam }, probe, size);
        let report = counters.report();
        println!(
            "  {:.0} nodes and {:.0} candidates a tile of {:.0} rays, {:.1} evaluations and {:.1} contributions a ray, \
             {} Gaussians touched, {} rays that fell back",
            report.nodes_per_tile,
            report.candidates_per_tile,
            report.rays as f64 / report.tiles as f64,
            report.evaluations_per_ray,
            report.contributions_per_ray,
            report.gaussians_touched,
            report.fallback_rays,
        );
    }
}

fn tiles(size: u32) -> Vec<Tile> {
    let starts = || (0..size).step_by(Tile::EDGE as usize);
    let mut tiles = Vec::new();
    for face in Face::ALL {
        for y in starts() {
            tiles.extend(starts().map(|x| Tile {
                face,
                face_size: size,
                x: x as i32,
                y: y as i32,
                width: Tile::EDGE.min(size - x),
                height: Tile::EDGE.min(size - y),
            }));
        }
    }
    tiles
}

fn cube(tracer: &dyn TileTracer, probe: DVec3, size: u32) -> Vec<Vec<Radiance>> {
    tiles(size)
        .into_par_iter()
        .map(|tile| {
            let mut texels = vec![Radiance::default(); tile.len()];
            tracer.trace_tile(probe, &tile, &mut texels);
            texels
        })
        .collect()
}

struct Error {
    rms: f64,
    max: f32,
    large: usize,
}

fn error(
    scene: &Scene,
    surfaces: &UnlitSurfaces,
    settings: TraceSettings,
    tracer: &dyn TileTracer,
    probe: DVec3,
    size: u32,
    pixels: usize,
) -> Error {
    let texels: Vec<(Ray, Radiance)> = tiles(size)
        .iter()
        .zip(cube(tracer, probe, size))
        .flat_map(|(tile, texels)| {
            let rays: Vec<Ray> = tile.directions().map(|direction| Ray { origin: probe, direction }).collect();
            rays.into_iter().zip(texels)
        })
        .collect();
    let truth = ReferenceTracer { scene, surfaces, settings };
    // A stride prime to any face size visits all parts of the cube.
    let differences: Vec<f32> = (0..pixels)
        .into_par_iter()
        .map(|k| {
            let (ray, seen) = &texels[(k * 7_919_993) % texels.len()];
            (display(seen) - display(&truth.trace(ray))).abs().max_element()
        })
        .collect();
    let squares: f64 = differences.iter().map(|&d| f64::from(d).powi(2)).sum();
    Error {
        rms: (squares / pixels as f64).sqrt(),
        max: differences.iter().copied().fold(0.0, f32::max),
        large: differences.iter().filter(|&&d| d > 1e-3).count(),
    }
}

fn display(radiance: &Radiance) -> Vec3 {
    let linear = radiance.to_linear(Default::default(), Default::default()).0;
    Vec3::from_array(linear.to_array().map(colour::linear_to_srgb))
}

fn parse() -> Arguments {
    let mut arguments = Arguments {
        gaussians: 1_500_000,
        sh_degree: 3,
        splats: None,
        probe: None,
        cases: ["beam-800", "beam-800-camera", "beam-256", "beam-64", "beam-256-avx2", "ray-256"]
            .map(String::from)
            .into(),
        runs: 5,
        pixels: 400,
        threads: std::thread::available_parallelism().map_or(1, usize::from),
    };
    let mut words = std::env::args().skip(1).filter(|word| word != "--bench");
    while let Some(word) = words.next() {
        let value = words.next().unwrap_or_else(|| panic!("{word} needs a value"));
        let number = || value.parse::<usize>().unwrap_or_else(|_| panic!("{word}: '{value}' is not a number"));
        match word.as_str() {
            "--gaussians" => arguments.gaussians = number(),
            "--sh" => arguments.sh_degree = number() as u8,
            "--splats" => arguments.splats = Some(value),
            "--probe" => {
                let metres: Vec<f64> = value.split(',').filter_map(|x| x.parse().ok()).collect();
                arguments.probe = Some(DVec3::from_slice(&metres));
            }
            "--cases" => arguments.cases = value.split(',').map(String::from).collect(),
            "--runs" => arguments.runs = number(),
            "--pixels" => arguments.pixels = number(),
            "--threads" => arguments.threads = number(),
            _ => panic!("{word} is not an argument of this bench"),
        }
    }
    arguments
}

fn seconds(start: Instant) -> f64 {
    start.elapsed().as_secs_f64()
}

/// Processor time of this process, in seconds: what one core takes, whatever else the machine does. Wall time where the
/// system does not tell.
fn cpu_seconds() -> f64 {
    static START: std::sync::LazyLock<Instant> = std::sync::LazyLock::new(Instant::now);
    // The 14th and 15th field, of which the 2nd ends at the last parenthesis; in hundredths of a second.
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = stat.rsplit(')').next().unwrap_or("").split_whitespace().skip(11).take(2);
    let ticks: Vec<f64> = fields.filter_map(|field| field.parse().ok()).collect();
    if ticks.len() == 2 { (ticks[0] + ticks[1]) / 100.0 } else { seconds(*START) }
}

/// Forgets the peak of the scene's generation. Where the system does not allow it, the peak includes it.
fn reset_peak_memory() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// The largest resident set so far, in bytes; 0 where the system does not tell.
fn peak_memory() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM:")).unwrap_or("");
    line.split_whitespace().nth(1).and_then(|kib| kib.parse::<f64>().ok()).unwrap_or(0.0) * 1024.0
}
