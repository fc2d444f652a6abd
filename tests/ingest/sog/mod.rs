//! SOG files: versions 1 and 2, bundled and loose, streamed; what their bytes mean, and that broken ones give errors.

mod builder;
mod malformed;
mod real;
mod streamed;

use std::path::Path;

use glam::{DQuat, DVec3};
use splatprobe::Error;
use splatprobe::ingest::{SceneReport, load_scene};
use splatprobe::job::{Frame, SplatInput};
use splatprobe::scene::{Scene, Splats, sh};

use crate::files::{bits, load_with};
use builder::{Builder, codebook};

/// Loads a file as it stands.
fn load_path(path: &Path) -> splatprobe::Result<(Scene, SceneReport)> {
    load_scene(&[SplatInput { frame: Some(Frame::RUB), ..SplatInput::new(path) }], &[])
}

/// Loads `bytes` as a bundled SOG.
fn load(bytes: &[u8]) -> splatprobe::Result<(Scene, SceneReport)> {
    load_with(bytes, |input| input.frame = Some(Frame::RUB))
}

fn assert_near(found: f64, expected: f64, what: &str) {
    assert!((found - expected).abs() <= 2e-6 * (1.0 + expected.abs()), "{what}: {found}, not {expected}");
}

/// What Gaussian `i` of `file` must be, by the formulas of the format.
fn assert_meaning(splats: &Splats, file: &Builder, version: u8, degree: u8, i: usize) {
    let pixels = &file.gaussians[i];
    let (mins, maxs) = ([-1.0, -2.0, 0.5], [1.5, 0.25, 3.0]);
    for axis in 0..3 {
        let log: f64 = mins[axis] + (maxs[axis] - mins[axis]) * f64::from(pixels.mean[axis]) / 65535.0;
        assert_near(f64::from(splats.means[i][axis]), log.signum() * (log.abs().exp() - 1.0), "mean");
    }
    let between = |min: f64, max: f64, byte: u8| min + (max - min) * f64::from(byte) / 255.0;
    let log_scale = |axis: usize| match version {
        1 => between([-6.0, -5.0, -4.0][axis], [-1.0, 0.0, 1.0][axis], pixels.scale[axis]),
        _ => codebook(-6.0, 0.0)[usize::from(pixels.scale[axis])],
    };
    let deviations = DVec3::new(log_scale(0), log_scale(1), log_scale(2)).exp();
    let [a, b, c] = [0, 1, 2].map(|k| (f64::from(pixels.quat[k]) / 255.0 - 0.5) * std::f64::consts::SQRT_2);
    let rest = (1.0 - a * a - b * b - c * c).max(0.0).sqrt();
    let rotation = match pixels.quat[3] {
        252 => DQuat::from_xyzw(a, b, c, rest),
        253 => DQuat::from_xyzw(rest, b, c, a),
        254 => DQuat::from_xyzw(b, rest, c, a),
        _ => DQuat::from_xyzw(b, c, rest, a),
    };
    let expected = Splats::unit_from_world(rotation.normalize(), deviations);
    let difference = splats.unit_from_world[i] * expected.inverse() - glam::Mat3::IDENTITY;
    assert!(difference.abs().to_cols_array().into_iter().all(|entry| entry < 1e-5), "{difference}");
    let opacity = match version {
        1 => 1.0 / (1.0 + (-between(-4.0, 6.0, pixels.sh0[3])).exp()),
        _ => f64::from(pixels.sh0[3]) / 255.0,
    };
    assert_near(f64::from(splats.opacities[i]), opacity, "opacity");
    let count = sh::coefficient_count(degree);
    for c in 0..3 {
        let dc = match version {
            1 => between([-1.0, -1.5, -2.0][c], [1.0, 1.5, 2.0][c], pixels.sh0[c]),
            _ => codebook(-1.5, 2.0)[usize::from(pixels.sh0[c])],
        };
        assert_near(f64::from(splats.sh_of(i)[c * count]), dc, "band 0");
        for k in 1..count {
            let byte = file.palette[usize::from(pixels.label)][k - 1][c];
            let expected = match version {
                1 => between(-0.75, 0.5, byte),
                _ => codebook(-0.6, 0.8)[usize::from(byte)],
            };
            assert_near(f64::from(splats.sh_of(i)[c * count + k]), expected, "higher band");
        }
    }
}

#[test]
fn bytes_mean_what_the_format_says_in_both_versions_and_every_degree() {
    for version in [1, 2] {
        for degree in 0..=3 {
            let file = Builder::new(version, degree, 10);
            let (scene, report) = load(&file.bundle()).expect("loads");
            assert_eq!((scene.splats.len(), scene.splats.sh_degree), (10, degree));
            assert_eq!(report.splats[0].format, format!("SOG version {version}"));
            (0..10).for_each(|i| assert_meaning(&scene.splats, &file, version, degree, i));
        }
    }
}

#[test]
fn a_folder_its_index_and_a_bundle_are_the_same_scene() {
    let file = Builder::new(2, 2, 5000);
    let folder = tempfile::tempdir().expect("a folder");
    file.write_loose(folder.path());
    let expected = bits(&load(&file.bundle()).expect("loads").0);
    for path in [folder.path().to_path_buf(), folder.path().join("meta.json")] {
        assert!(bits(&load_path(&path).expect("loads").0) == expected, "{}", path.display());
    }
}

#[test]
fn a_bundle_may_be_deflated() {
    let mut file = Builder::new(2, 0, 4);
    // Only one entry is compressed: what it lacks is the first image.
    let error =
        load(&builder::deflated("meta.json", file.meta.to_string().as_bytes(), file.meta.to_string().len() as u32));
    assert!(error.expect_err("no images").to_string().contains("means_l.webp"));
    file.meta["version"] = 3.into();
    let text = file.meta.to_string();
    let error = load(&builder::deflated("meta.json", text.as_bytes(), text.len() as u32)).expect_err("version 3");
    assert!(matches!(error, Error::Unsupported { .. }) && error.to_string().contains("version 3"), "{error}");
}

#[test]
fn colours_stay_where_alpha_is_zero() {
    let mut file = Builder::new(2, 0, 3);
    // In version 1 the alpha of sh0 is a logit between two values, so that 0 can be any opacity.
    file.gaussians[1].sh0 = [200, 100, 50, 0];
    let mut old = Builder { meta: Builder::new(1, 0, 3).meta, ..file };
    old.meta["sh0"]["mins"][3] = 1.0.into();
    let (scene, _) = load(&old.bundle()).expect("loads");
    let [r, g, b] =
        [(-1.0, 1.0, 200.0), (-1.5, 1.5, 100.0), (-2.0, 2.0, 50.0)].map(|(a, z, byte)| a + (z - a) * byte / 255.0);
    for (found, expected) in scene.splats.sh_of(1).iter().zip([r, g, b]) {
        assert_near(f64::from(*found), expected, "band 0");
    }
}

#[test]
fn it_stands_as_the_ply_it_was_made_of() {
    let bytes = Builder::new(2, 1, 8).bundle();
    let file = tempfile::NamedTempFile::new().expect("a temporary file");
    std::fs::write(file.path(), &bytes).expect("written");
    let (scene, report) = load_scene(&[SplatInput::new(file.path())], &[]).expect("loads");
    assert_eq!(report.splats[0].frame, Frame::RDF);
    let raw = load(&bytes).expect("loads").0;
    for (mean, raw) in scene.splats.means.iter().zip(&raw.splats.means) {
        assert_eq!(mean.to_array(), [raw.x, -raw.y, -raw.z]);
    }
}

#[test]
fn the_result_is_the_same_for_any_thread_count() {
    let bytes = Builder::new(2, 1, 20_000).bundle();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| bits(&load(&bytes).expect("loads").0))
    };
    assert!(with(1) == with(5));
}
