//! Writes the packed splat formats, for tests and benches.

pub mod compressed_ply;
pub mod ksplat;
pub mod splat;
pub mod spz;

use glam::{DQuat, DVec3};

/// A Gaussian as its file is to tell it, in the file's own frame.
#[derive(Clone)]
pub struct Known {
    pub mean: DVec3,
    pub rotation: DQuat,
    pub deviations: DVec3,
    pub opacity: f64,
    /// Red, green, blue, each `(degree + 1)^2` long.
    pub sh: Vec<f64>,
}
