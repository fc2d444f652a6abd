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

#[path = "common/arguments.rs"]
mod arguments;
#[path = "common/scene.rs"]
mod scene;

use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use self::arguments::Arguments;
use self::scene::scene;
use glam::DVec3;
use splatprobe::bake::{self, BakeSettings, Silent};
use splatprobe::bvh::Bvh;
use splatprobe::generate::InteriorSettings;
use splatprobe::job;
use splatprobe::place;
use splatprobe::scene::{Scene, colour};
use splatprobe::shade::UnlitSurfaces;
use splatprobe::trace::{BeamTracer, Footprint, TraceSettings};

/// Widths of `pixel` to try, in texels.
const SIGMAS: [f64; 7] = [0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6];

/// Focal lengths of `train` to try, in pixels: of a full HD camera, and of a small one.
const FOCALS: [f64; 2] = [1200.0, 300.0];

/// Rays per axis of a texel of the truth.
const SAMPLES: u32 = 16;

fn main() {
    let arguments = Arguments::parse(1_500_000, &[32, 64, 128, 256]);
    let settings = InteriorSettings { gaussians: arguments.gaussians, sh_degree: 0, ..InteriorSettings::default() };
    let mut scene = scene(arguments.splats.as_deref(), settings);
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
