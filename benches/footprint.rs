//! What the footprint filter is worth: one ray per texel, filtered, against 16 x 16 unfiltered rays per texel.
//!
//! ```text
//! cargo bench --bench footprint                               # the generated interior
//! cargo bench --bench footprint -- --gaussians 100000
//! cargo bench --bench footprint -- --splats scene.ply --probe 0,1.5,0 --sizes 32,64
//! ```
//!
//! RMS over all texels and channels, in display space; in brackets the mean signed error, which a filter that adds light
//! shows. The truth is the mean of linear light, as a bake with `--samples 16` forms it.

use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use glam::DVec3;
use splatprobe::bake::{self, BakeSettings, Silent};
use splatprobe::bvh::Bvh;
use splatprobe::generate::{InteriorSettings, ROOM, interior};
use splatprobe::job::{self, SplatInput};
use splatprobe::scene::{Scene, colour};
use splatprobe::shade::UnlitSurfaces;
use splatprobe::trace::{BeamTracer, Footprint, TraceSettings};
use splatprobe::{ingest, place};

/// Widths of `pixel` to try, in texels.
const SIGMAS: [f64; 7] = [0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6];

/// Focal lengths of `train` to try, in pixels: of a full HD camera, and of a small one.
const FOCALS: [f64; 2] = [1200.0, 300.0];

/// Rays per axis of a texel of the truth.
const SAMPLES: u32 = 16;

struct Arguments {
    gaussians: usize,
    splats: Option<String>,
    probe: DVec3,
    sizes: Vec<u32>,
}

fn main() {
    let arguments = parse();
    let mut scene = load(&arguments);
    let bvh = Bvh::build(&mut scene);
    println!("{} Gaussians, probe {}, {SAMPLES} x {SAMPLES} rays per texel", scene.splats.len(), arguments.probe);
    let pixels = SIGMAS.map(|sigma| format!("pixel {sigma}"));
    let trains = FOCALS.map(|focal| format!("train:{focal}"));
    println!("| face | none | {} | {} |", pixels.join(" | "), trains.join(" | "));
    println!("|{}", "---|".repeat(2 + SIGMAS.len() + FOCALS.len()));
    for &size in &arguments.sizes {
        let truth = cube(&scene, &bvh, arguments.probe, Footprint::default(), size, SAMPLES);
        let footprints = [Footprint::default()].into_iter();
        let footprints = footprints.chain(SIGMAS.map(|sigma| Footprint::pixel(size, sigma)));
        let footprints = footprints.chain(FOCALS.map(|focal| Footprint::new(job::Footprint::Train(focal), size)));
        let cells: Vec<String> = footprints
            .map(|footprint| error(&cube(&scene, &bvh, arguments.probe, footprint, size, 1), &truth))
            .collect();
        println!("| {size} | {} |", cells.join(" | "));
    }
}

/// RMS of `seen` against `truth`, and in brackets its mean signed error.
fn error(seen: &[f32], truth: &[f32]) -> String {
    let differences = seen.iter().zip(truth).map(|(seen, truth)| f64::from(seen - truth));
    let (sum, squares) = differences.fold((0.0, 0.0), |(sum, squares), d| (sum + d, squares + d * d));
    let count = truth.len() as f64;
    format!("{:.5} ({:+.4})", (squares / count).sqrt(), sum / count)
}

/// Display values of all channels of a probe's cube.
fn cube(scene: &Scene, bvh: &Bvh, probe: DVec3, footprint: Footprint, face_size: u32, samples: u32) -> Vec<f32> {
    let surfaces = UnlitSurfaces::new(&scene.meshes);
    let settings = TraceSettings { footprint, ..TraceSettings::default() };
    let tracer = BeamTracer::new(scene, bvh, &surfaces, settings);
    let probes = place::list(&[probe], None, 0.0).expect("a finite position");
    let settings = BakeSettings { face_size, samples, distance: false, edge_texels: false };
    let values = Mutex::new(Vec::new());
    bake::bake_probes(&tracer, scene, &probes, &settings, &Silent, &AtomicBool::new(false), |_, cubemap, _| {
        let rgb = cubemap.texels.iter().flat_map(|&[red, green, blue, _]| [red, green, blue]);
        *values.lock().unwrap() = rgb.map(colour::linear_to_srgb).collect();
        Ok(())
    })
    .expect("nothing can fail without output");
    values.into_inner().unwrap()
}

fn load(arguments: &Arguments) -> Scene {
    match &arguments.splats {
        Some(path) => ingest::load_scene(&[SplatInput::new(path)], &[]).unwrap_or_else(|error| panic!("{error}")).0,
        None => {
            let settings =
                InteriorSettings { gaussians: arguments.gaussians, sh_degree: 0, ..InteriorSettings::default() };
            Scene { splats: interior(&settings), ..Scene::default() }
        }
    }
}

fn parse() -> Arguments {
    let probe = DVec3::new(1.5 * ROOM.x, 1.6, 1.5 * ROOM.z);
    let mut arguments = Arguments { gaussians: 1_500_000, splats: None, probe, sizes: vec![32, 64, 128, 256] };
    let mut words = std::env::args().skip(1).filter(|word| word != "--bench");
    while let Some(word) = words.next() {
        let value = words.next().unwrap_or_else(|| panic!("{word} needs a value"));
        match word.as_str() {
            "--gaussians" => arguments.gaussians = value.parse().expect("a number of Gaussians"),
            "--splats" => arguments.splats = Some(value),
            "--probe" => {
                let metres: Vec<f64> = value.split(',').filter_map(|x| x.parse().ok()).collect();
                arguments.probe = DVec3::from_slice(&metres);
            }
            "--sizes" => arguments.sizes = value.split(',').filter_map(|size| size.parse().ok()).collect(),
            _ => panic!("{word} is not an argument of this bench"),
        }
    }
    arguments
}
