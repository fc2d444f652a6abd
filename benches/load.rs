//! Load rate of splat files: from page cache to a scene ready to trace, without its tree.
//!
//! ```text
//! cargo bench --bench load                                    # 1 M Gaussians, SH 3, in all formats written here
//! cargo bench --bench load -- --gaussians 3000000 --sh 0 --runs 3
//! cargo bench --bench load -- scene.ply scene.sog             # files of one's own
//! ```
//!
//! Times are medians over `--runs`, on all cores. Peak memory is that of one load, the mapped file and the scene included.

#[path = "../tests/ingest/packed_files/mod.rs"]
mod packed_files;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use glam::{DMat3, DQuat, DVec3};
use splatprobe::generate::{InteriorSettings, interior};
use splatprobe::ingest::load_scene;
use splatprobe::job::SplatInput;
use splatprobe::scene::Splats;

use packed_files::compressed_ply::Variant;
use packed_files::{Known, compressed_ply, ksplat, splat, spz};

struct Arguments {
    gaussians: usize,
    sh_degree: u8,
    runs: usize,
    files: Vec<PathBuf>,
}

fn main() {
    let arguments = parse();
    if arguments.files.is_empty() { measure_own(&arguments) } else { measure_all(&arguments) }
}

/// Measures files that are written here, in a process of its own: this one keeps what writing took.
fn measure_own(arguments: &Arguments) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let files = write_all(folder.path(), arguments);
    let runs = ["--runs".into(), arguments.runs.to_string()];
    let program = std::env::current_exe().expect("this program");
    let status = Command::new(program).args(runs).args(files).status().expect("started");
    assert!(status.success(), "{status}");
}

fn measure_all(arguments: &Arguments) {
    println!("| file | MB | Gaussians | SH | seconds | M Gaussians/s | GB/s | peak MB | scene MB |");
    println!("|---|---|---|---|---|---|---|---|---|");
    for file in &arguments.files {
        measure(file, arguments.runs);
    }
}

fn measure(file: &Path, runs: usize) {
    let megabytes = std::fs::metadata(file).expect("a file").len() as f64 / 1e6;
    let mut times = Vec::new();
    let mut scene_size = 0.0;
    let mut loaded = (0, 0);
    reset_peak_memory();
    for _ in 0..runs {
        let start = Instant::now();
        let (scene, _) = load_scene(&[SplatInput::new(file)], &[]).unwrap_or_else(|error| panic!("{error}"));
        times.push(start.elapsed().as_secs_f64());
        let splats = &scene.splats;
        loaded = (splats.len(), splats.sh_degree);
        scene_size = splats.len() as f64 * (52.0 + 4.0 * splats.sh_stride() as f64) / 1e6;
    }
    times.sort_by(f64::total_cmp);
    let seconds = times[times.len() / 2];
    println!(
        "| {} | {megabytes:.0} | {} | {} | {seconds:.3} | {:.2} | {:.2} | {:.0} | {scene_size:.0} |",
        file.file_name().unwrap_or_default().to_string_lossy(),
        loaded.0,
        loaded.1,
        loaded.0 as f64 / seconds / 1e6,
        megabytes / seconds / 1e3,
        peak_memory() / 1e6,
    );
}

/// The generated interior in every format that this crate's tests can write.
fn write_all(folder: &Path, arguments: &Arguments) -> Vec<PathBuf> {
    let (gaussians, sh_degree) = (arguments.gaussians, arguments.sh_degree);
    let scene = interior(&InteriorSettings { gaussians, sh_degree, ..InteriorSettings::default() });
    let write = |name: &str, bytes: Vec<u8>| {
        let path = folder.join(name);
        std::fs::write(&path, bytes).expect("written");
        path
    };
    let mut files = vec![write("plain.ply", plain_ply(&scene))];
    let known: Vec<Known> = (0..scene.len()).map(|i| gaussian(&scene, i)).collect();
    drop(scene);
    let variant = Variant { chunk_colours: true, strangers: false };
    files.push(write("compressed.ply", compressed_ply::file(&known, sh_degree, variant)));
    files.push(write("scene.splat", splat::file(&known)));
    files.push(write("v3-8-bit.spz", spz::file(3, &known)));
    let coarse: Vec<Known> = known.iter().cloned().map(with_coarse_harmonics).collect();
    files.extend((2..=4).map(|version| write(&format!("v{version}.spz"), spz::file(version, &coarse))));
    if sh_degree <= 2 {
        let buckets: Vec<usize> = known.chunks(256).map(<[Known]>::len).collect();
        let sections = [ksplat::Section { gaussians: known, buckets, capacity: 256, degree: sh_degree }];
        files.extend((0..=2).map(|level| write(&format!("level{level}.ksplat"), ksplat::file(level, &sections))));
    }
    files
}

/// Gaussian `i` with its rotation and standard deviations, which the scene stores as one matrix.
fn gaussian(splats: &Splats, i: usize) -> Known {
    let axes = splats.unit_from_world[i].as_dmat3().transpose();
    let unit = DMat3::from_cols(axes.x_axis.normalize(), axes.y_axis.normalize(), axes.z_axis.normalize());
    let mirror = DMat3::from_diagonal(DVec3::new(1.0, 1.0, unit.determinant().signum()));
    Known {
        mean: splats.means[i].as_dvec3(),
        rotation: DQuat::from_mat3(&(unit * mirror)),
        deviations: splats.standard_deviations(i),
        opacity: splats.opacities[i].into(),
        sh: splats.sh_of(i).iter().map(|&value| value.into()).collect(),
    }
}

/// As SPZ's reference encoder stores it by default: coefficients of band 1 with 5 bits, of higher bands with 4.
fn with_coarse_harmonics(mut gaussian: Known) -> Known {
    let per_channel = gaussian.sh.len() / 3;
    for (i, value) in gaussian.sh.iter_mut().enumerate() {
        let step = match i % per_channel {
            0 => continue,
            1..4 => 8.0,
            _ => 16.0,
        };
        let byte = ((*value * 128.0 + 128.0) / step).round() * step;
        *value = (byte.clamp(0.0, 255.0) - 128.0) / 128.0;
    }
    gaussian
}

/// As 3DGS trainers write it, without normals.
fn plain_ply(splats: &Splats) -> Vec<u8> {
    let per_channel = splats.sh_stride() / 3;
    let names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2"].map(String::from).into_iter();
    let rest = (0..3 * (per_channel - 1)).map(|i| format!("f_rest_{i}"));
    let end = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"].map(String::from);
    let columns: String = names.chain(rest).chain(end).map(|name| format!("property float {name}\n")).collect();
    let count = splats.len();
    let header = format!("ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{columns}end_header\n");
    let mut bytes = header.into_bytes();
    for i in 0..count {
        let Known { mean, rotation, deviations, opacity, sh } = gaussian(splats, i);
        let [x, y, z, w] = rotation.to_array();
        let dc = (0..3).map(|c| sh[c * per_channel]);
        let rest = (0..sh.len()).filter(|k| k % per_channel != 0).map(|k| sh[k]);
        let end = [(opacity / (1.0 - opacity)).ln()].into_iter().chain(deviations.ln().to_array()).chain([w, x, y, z]);
        let values = mean.to_array().into_iter().chain(dc).chain(rest).chain(end);
        bytes.extend(values.flat_map(|value| (value as f32).to_le_bytes()));
    }
    bytes
}

fn parse() -> Arguments {
    let mut arguments = Arguments { gaussians: 1_000_000, sh_degree: 3, runs: 5, files: Vec::new() };
    let mut words = std::env::args().skip(1).filter(|word| word != "--bench");
    while let Some(word) = words.next() {
        let mut number = || {
            let value = words.next().unwrap_or_else(|| panic!("{word} needs a value"));
            value.parse::<usize>().unwrap_or_else(|_| panic!("{word}: '{value}' is not a number"))
        };
        match word.as_str() {
            "--gaussians" => arguments.gaussians = number(),
            "--sh" => arguments.sh_degree = number() as u8,
            "--runs" => arguments.runs = number(),
            _ => arguments.files.push(word.into()),
        }
    }
    arguments
}

/// Forgets the peak so far. Where the system does not allow it, later peaks include it.
fn reset_peak_memory() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// The largest resident set since then, in bytes; 0 where the system does not tell.
fn peak_memory() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM:")).unwrap_or("");
    line.split_whitespace().nth(1).and_then(|kib| kib.parse::<f64>().ok()).unwrap_or(0.0) * 1024.0
}
