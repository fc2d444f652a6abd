//! Exports: what each engine finds in the files that are written for it, by its own look-up formulas, written here anew from
//! the engines' documentation and sources.

mod agreement;
mod bad_input;
mod blender;
#[path = "../cli_support/mod.rs"]
mod cli_support;
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

/// Angle between `expected` and the direction that a coded radiance stands for, whatever its brightness: with an unknown
/// factor k, radiance is k (d + 1) / 2 of a unit vector for two values of k, of which the better is taken. So a mean of
/// marked and unmarked texels can be read too.
fn angle(radiance: Vec3, expected: DVec3) -> f64 {
    let c = radiance.as_dvec3();
    let (sum, square) = (c.element_sum(), c.length_squared());
    let root = (sum * sum - 2.0 * square).max(0.0).sqrt();
    let codes = [-1.0, 1.0].map(|sign| (c * ((sum + sign * root) / square) - 1.0).normalize());
    codes.into_iter().map(|d| d.angle_between(expected)).fold(f64::INFINITY, f64::min)
}

/// T1 and T3: `shown`, what the engine finds for a direction in the manifest's frame, is within a texel of that direction
/// everywhere, and the marks, which are not symmetric, are where they are.
fn assert_is_calibration(engine: &str, shown: &dyn Fn(DVec3) -> Vec3) {
    // A texel in the middle of a face, where it is widest.
    let texel = 2.0 / f64::from(SIZE);
    let (mut largest, mut marks, mut mirrored, mut count) = (0.0_f64, 0, 0, 0);
    let is_marked = |radiance: Vec3| radiance.max_element() > 1.3;
    for direction in sphere() {
        let radiance = shown(direction);
        largest = largest.max(angle(radiance, direction));
        let expected = is_marked(Calibration::radiance(direction));
        marks += u32::from(is_marked(radiance) == expected);
        mirrored += u32::from(is_marked(shown(direction * DVec3::new(-1.0, 1.0, 1.0))) == expected);
        count += 1;
    }
    println!("{engine}: {:.2} texels at most, marks {:.3}", largest / texel, f64::from(marks) / f64::from(count));
    assert!(largest <= texel, "{engine}: {} texels off", largest / texel);
    assert!(f64::from(marks) > 0.97 * f64::from(count), "{engine}: {marks} of {count} marks");
    assert!(mirrored + count / 20 < marks, "{engine}: {mirrored} of {count} marks in a mirror");
}
