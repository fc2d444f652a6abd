//! Packed splat formats: files built byte by byte from known Gaussians give those Gaussians, broken files give errors.

mod compressed_ply;
mod hostile;
mod ksplat;
mod splat;
mod spz;

use glam::{DMat3, DQuat, DVec3};
use splatprobe::ingest::{SceneReport, load_scene};
use splatprobe::job::{Frame, SplatInput};
use splatprobe::scene::{Scene, sh};

pub use crate::files::{bits, data, load, load_with};
use crate::packed_files::Known;

/// How far a format's steps may take a Gaussian.
pub struct Tolerance {
    pub mean: f64,
    /// Of the covariance, relative to the largest variance.
    pub covariance: f64,
    pub opacity: f64,
    pub dc: f64,
    pub rest: f64,
}

/// xorshift64*, so that the files are the same on every machine.
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    pub fn below(&mut self, end: usize) -> usize {
        ((self.bits() >> 32) as usize * end) >> 32
    }

    pub fn uniform(&mut self, least: f64, greatest: f64) -> f64 {
        least + (greatest - least) * (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// `count` Gaussians without any symmetry, within what every format can hold.
pub fn known(degree: u8, count: usize) -> Vec<Known> {
    let mut random = Random(0x9e37_79b9_7f4a_7c15 + u64::from(degree));
    let coefficients = 3 * sh::coefficient_count(degree);
    (0..count)
        .map(|_| {
            let mut uniform = |least, greatest| random.uniform(least, greatest);
            let rotation = DQuat::from_xyzw(uniform(-1., 1.), uniform(-1., 1.), uniform(-1., 1.), uniform(-1., 1.));
            let per_channel = coefficients / 3;
            Known {
                mean: DVec3::new(uniform(-3., 5.), uniform(-4., 2.), uniform(-1., 6.)),
                rotation: rotation.normalize(),
                deviations: DVec3::new(uniform(-4., 0.), uniform(-4., 0.), uniform(-4., 0.)).exp(),
                opacity: uniform(0.05, 0.99),
                // Band 0 within the colours that bytes between 0 and 1 can tell.
                sh: (0..coefficients)
                    .map(|i| if i % per_channel == 0 { uniform(-1.7, 1.7) } else { uniform(-0.9, 0.9) })
                    .collect(),
            }
        })
        .collect()
}

/// Loads `bytes` with the file's coordinates as they are.
pub fn load_raw(bytes: &[u8]) -> (Scene, SceneReport) {
    load_with(bytes, |input| input.frame = Some(Frame::RUB)).expect("loads")
}

pub fn error_of(bytes: &[u8]) -> String {
    load(bytes).expect_err("an error").to_string()
}

/// Asserts that `scene` holds `expected`, in their order.
pub fn assert_holds(scene: &Scene, expected: &[Known], tolerance: &Tolerance) {
    let splats = &scene.splats;
    assert_eq!(splats.len(), expected.len());
    for (i, known) in expected.iter().enumerate() {
        assert_near(scene, i, known, tolerance);
    }
}

/// Asserts that Gaussian `i` of `scene` is `known`.
pub fn assert_near(scene: &Scene, i: usize, known: &Known, tolerance: &Tolerance) {
    let splats = &scene.splats;
    let mean = scene.origin + splats.means[i].as_dvec3() - known.mean;
    assert!(mean.abs().max_element() <= tolerance.mean, "mean of {i}: off by {mean}");
    let rotation = DMat3::from_quat(known.rotation);
    let covariance = rotation * DMat3::from_diagonal(known.deviations * known.deviations) * rotation.transpose();
    let difference = (splats.covariance(i) - covariance).to_cols_array().map(f64::abs);
    let relative = difference.into_iter().fold(0.0, f64::max) / known.deviations.max_element().powi(2);
    assert!(relative <= tolerance.covariance, "covariance of {i}: off by {relative}");
    let opacity = f64::from(splats.opacities[i]) - known.opacity;
    assert!(opacity.abs() <= tolerance.opacity, "opacity of {i}: off by {opacity}");
    assert_eq!(splats.sh_of(i).len(), known.sh.len());
    let per_channel = known.sh.len() / 3;
    for (k, (&found, &expected)) in splats.sh_of(i).iter().zip(&known.sh).enumerate() {
        let bound = if k % per_channel == 0 { tolerance.dc } else { tolerance.rest };
        assert!((f64::from(found) - expected).abs() <= bound, "coefficient {k} of {i}: {found}, not {expected}");
    }
}

/// Asserts that the published file `name` holds the four Gaussians that all of its siblings hold: corners of a square in x
/// and z, 0.1 m large, the more red to the right, the more green to the front. Skips where the file is not at hand.
pub fn assert_is_the_published_square(name: &str, frame: Option<Frame>) {
    let Some(path) = data(name) else { return };
    let input = SplatInput { frame, ..SplatInput::new(path) };
    let (scene, report) = load_scene(&[input], &[]).expect("loads");
    assert_eq!((report.splats[0].count, report.splats[0].kept), (4, 4), "{name}");
    for i in 0..4 {
        let (right, front) = (i % 2 == 1, i >= 2);
        let expected = DVec3::new(if right { 0.0 } else { -1.0 }, 0.0, if front { 0.0 } else { 1.0 });
        assert!((scene.splats.means[i].as_dvec3() - expected).length() < 1e-6, "{name}, {i}");
        assert!((scene.splats.opacities[i] - 0.9).abs() < 0.003, "{name}, {i}");
        assert!((scene.splats.standard_deviations(i) / 0.1 - 1.0).abs().max_element() < 0.02, "{name}, {i}");
        let [red, green, blue] = scene.splats.sh_of(i) else { panic!("{name} has spherical harmonics") };
        assert!((red.abs() > 0.5, *red > 0.0) == (true, right), "{name}, {i}: red {red}");
        assert!((green.abs() > 0.5, *green > 0.0) == (true, front), "{name}, {i}: green {green}");
        assert!(blue.abs() < 0.02, "{name}, {i}: blue {blue}");
    }
}
