//! Exports: what each engine finds in the files that are written for it, by its own look-up formulas, written here anew from
//! the engines' documentation and sources.

mod agreement;
mod bad_input;
mod blender;
#[path = "../common/cli.rs"]
mod cli;
mod command;
mod filament;
mod gltf;
mod godot;
mod ktx2_cube;
mod lookup;
mod unity;
mod unreal;
mod usd;

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use glam::{DVec3, Vec3};
use splatprobe::bake::{Calibration, Silent};
use splatprobe::encode::exr::read_exr;
use splatprobe::export::{Export, export};
use splatprobe::job::{Job, Placement};
use splatprobe::manifest::Manifest;
use splatprobe::pipeline;

/// Edge of the faces of the calibration bakes here.
const SIZE: u32 = 32;

/// A calibration bake of two probes in a room without symmetry, in a folder that goes with the test.
struct Baked {
    folder: tempfile::TempDir,
    manifest: Manifest,
}

impl Baked {
    fn new() -> Self {
        Self::with(|_| ())
    }

    fn with(change: impl FnOnce(&mut Job)) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let placement = Placement {
            bounds: Some([-1.0, 0.0, -2.0, 5.0, 2.5, 3.0]),
            grid: Some([2, 1, 1]),
            overlap: 0.2,
            ..Placement::default()
        };
        let mut job = Job {
            calibration: true,
            face_size: SIZE,
            placement,
            output: Some(folder.path().join("bake")),
            ..Job::default()
        };
        change(&mut job);
        pipeline::bake(&job, &Silent, &AtomicBool::new(false)).unwrap();
        let manifest = Manifest::read(&folder.path().join("bake/manifest.json")).unwrap();
        Self { folder, manifest }
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join("bake")
    }

    /// The same bake with another manifest.
    fn change_manifest(&self, change: impl FnOnce(&mut serde_json::Value)) {
        let path = self.path().join("manifest.json");
        let mut manifest = json(&path);
        change(&mut manifest);
        std::fs::write(&path, manifest.to_string()).unwrap();
    }

    /// Exports for an engine; the folder with the files.
    fn export(&self, engine: &str) -> PathBuf {
        self.exported(engine).0
    }

    fn exported(&self, engine: &str) -> (PathBuf, Export) {
        let out = self.folder.path().join(engine);
        let export = export(&self.path(), engine, &out).unwrap();
        assert!(!export.files.is_empty() && export.files.iter().all(|file| file.is_file()), "{export:?}");
        (out, export)
    }
}

/// What an engine finds at level 0 for a direction in the manifest's frame.
type Shown = Box<dyn Fn(DVec3) -> Vec3>;

/// The look-up of an engine in an export, written from that engine's documentation. An engine without one fails the tests.
fn shown(engine: &str, out: &Path, probe: &str) -> Shown {
    match engine {
        "unity" => unity::shown(out, probe),
        "unreal" => unreal::shown(out, probe),
        "godot" => godot::shown(out, probe),
        "filament" => filament::shown(out, probe),
        "blender" => blender::shown(out, probe),
        "gltf" => gltf::shown(out, probe),
        "usd" => usd::shown(out, probe),
        "three" | "babylon" | "playcanvas" => ktx2_cube::web(out, probe),
        "bevy" => ktx2_cube::bevy(out, probe),
        _ => panic!("no look-up of {engine} is known"),
    }
}

fn json(path: &Path) -> serde_json::Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// Pixels of an EXR with its width.
fn exr(path: &Path) -> (usize, Vec<Vec3>) {
    let image = read_exr(path).unwrap();
    let channel = |name: &str| &image.channels[name];
    let pixel = |i| Vec3::new(channel("R")[i], channel("G")[i], channel("B")[i]);
    (image.width, (0..image.width * image.height).map(pixel).collect())
}

/// Directions all over the sphere (a Fibonacci lattice, turned so that none lies on an edge of a face).
fn sphere() -> impl Iterator<Item = DVec3> {
    const COUNT: usize = 20_000;
    (0..COUNT).map(|i| {
        let y = 1.0 - (2 * i + 1) as f64 / COUNT as f64;
        let longitude = 0.123 + i as f64 * std::f64::consts::PI * (3.0 - 5f64.sqrt());
        let radius = (1.0 - y * y).sqrt();
        DVec3::new(radius * longitude.cos(), y, radius * longitude.sin())
    })
}

/// The bands 0 to 2 of the clamped cosine, all that nine coefficients of irradiance hold: P0 / 4 + P1 / 2 + 5 P2 / 16.
fn cosine_of_three_bands(cosine: f64) -> f64 {
    0.25 + 0.5 * cosine + 5.0 / 32.0 * (3.0 * cosine * cosine - 1.0)
}

/// How much brighter a coded radiance is than the code of `direction`: 1, or [`Calibration::MARK`] in marks.
fn factor(radiance: Vec3, direction: DVec3) -> f64 {
    let code = (direction + 1.0) / 2.0;
    radiance.as_dvec3().dot(code) / code.length_squared()
}

/// The direction that a coded radiance, seen along `direction`, stands for; `None` where a mark and what is beside it are
/// mixed, and the mark's own texel has almost all to say of it.
fn coded_direction(radiance: Vec3, direction: DVec3) -> Option<DVec3> {
    let k = factor(radiance, direction);
    let is_pure = [1.0, f64::from(Calibration::MARK)].into_iter().any(|pure| (k / pure - 1.0).abs() < 0.1);
    is_pure.then(|| radiance.as_dvec3() / k * 2.0 - 1.0)
}

/// T1 and T3: `shown`, what the engine finds for a direction in the manifest's frame, is within a texel of that direction
/// everywhere, and the marks, which are not symmetric, are where they are.
fn assert_is_calibration(engine: &str, shown: &dyn Fn(DVec3) -> Vec3) {
    // A texel in the middle of a face, where it is widest.
    let texel = 2.0 / f64::from(SIZE);
    let mark = f64::from(Calibration::MARK);
    let is_marked = |radiance: Vec3, direction: DVec3| factor(radiance, direction) > 0.5 * mark;
    let (mut largest, mut clear, mut marks, mut mirrored, mut count) = (0.0_f64, 0, 0, 0, 0);
    for direction in sphere() {
        let radiance = shown(direction);
        if let Some(found) = coded_direction(radiance, direction) {
            largest = largest.max(found.angle_between(direction));
            clear += 1;
        }
        let expected = is_marked(Calibration::radiance(direction), direction);
        marks += u32::from(is_marked(radiance, direction) == expected);
        let mirror = direction * DVec3::new(-1.0, 1.0, 1.0);
        mirrored += u32::from(is_marked(shown(mirror), mirror) == expected);
        count += 1;
    }
    let share = |part: u32| f64::from(part) / f64::from(count);
    let texels = largest / texel;
    println!(
        "{engine}: {texels:.2} texels at most in {:.3}, marks {:.3}, mirrored {:.3}",
        share(clear),
        share(marks),
        share(mirrored)
    );
    assert!(texels <= 1.0 && share(clear) > 0.75, "{engine}: {texels} texels off in {}", share(clear));
    // Marks are made of dots little larger than a texel, so that their edges move by parts of one.
    assert!(share(marks) > 0.95, "{engine}: {}", share(marks));
    assert!(share(mirrored) < share(marks) - 0.05, "{engine}: {} in a mirror", share(mirrored));
}
