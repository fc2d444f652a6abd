//! Probes to cubemaps, on all cores.

mod calibration;
mod progress;
mod schedule;
mod traced;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::job::{MAX_FACE_SIZE, MAX_SAMPLES};
use crate::shade::path::SurfaceNoise;
use crate::trace::{Face, Tile};

pub use calibration::Calibration;
pub use progress::{Progress, ProgressEvent, ProgressState, Silent};
pub use schedule::{bake_probes, rebake_probes};
pub use traced::{Earlier, TileSums, Traced};

// The rays of a texel are traced in one tile.
const _: () = assert!(MAX_SAMPLES <= Tile::EDGE);

/// What a baked cubemap looks like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BakeSettings {
    /// Texels along an edge of a face, 1 to [`MAX_FACE_SIZE`].
    pub face_size: u32,
    /// Rays along an edge of a texel, 1 to [`MAX_SAMPLES`]; a texel is the mean of its `samples * samples` rays.
    pub samples: u32,
    /// Whether the distance layer is kept.
    pub distance: bool,
    /// Whether the first and last texels of a face lie on its edges, texel i of N at i / (N - 1), instead of at pixel
    /// centres, (i + 1/2) / N. The rays around such a texel reach beyond the edge, and `samples` must be even.
    pub edge_texels: bool,
}

impl BakeSettings {
    /// Rays that a probe takes.
    pub fn rays_per_probe(&self) -> u64 {
        let edge = u64::from(self.face_size) * u64::from(self.samples);
        6 * edge * edge
    }

    fn check(&self) -> Result<()> {
        if !(1..=MAX_FACE_SIZE).contains(&self.face_size) {
            return Err(Error::request("face-size", format!("{} is not 1 to {MAX_FACE_SIZE} texels", self.face_size)));
        }
        if !(1..=MAX_SAMPLES).contains(&self.samples) {
            let why = format!("{} is not 1 to {MAX_SAMPLES} rays along a texel's edge", self.samples);
            return Err(Error::request("samples", why));
        }
        if self.edge_texels && (self.face_size < 2 || !self.samples.is_multiple_of(2)) {
            let why = "texels on edges need at least 2 along an edge, and an even number of rays";
            return Err(Error::request("face-size", why));
        }
        Ok(())
    }
}

/// Linear radiance around a point.
#[derive(Debug, Clone, PartialEq)]
pub struct Cubemap {
    /// Texels along an edge of a face.
    pub face_size: u32,
    /// Linear RGB (Rec.709, what is seen plus the background behind it) and coverage A = 1 - T; RGB of the scene is
    /// premultiplied by coverage. Six faces in file order (+X -X +Y -Y +Z -Z), each row by row from its top left.
    pub texels: Vec<[f32; 4]>,
    /// Mean distance along each texel's rays, in metres, weighted by coverage; 0 where coverage is 0. Same order.
    pub distance: Option<Vec<f32>>,
}

impl Cubemap {
    /// A cubemap that nothing has been traced into.
    fn empty(settings: &BakeSettings) -> Self {
        let len = 6 * (settings.face_size as usize).pow(2);
        Self {
            face_size: settings.face_size,
            texels: vec![[0.0; 4]; len],
            distance: settings.distance.then(|| vec![0.0; len]),
        }
    }

    /// The texels of one face, row by row.
    pub fn face(&self, face: Face) -> &[[f32; 4]] {
        let len = (self.face_size as usize).pow(2);
        let start = face as usize * len;
        &self.texels[start..start + len]
    }
}

/// What a probe sees, in numbers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct ProbeStatistics {
    /// Rays traced.
    pub rays: u64,
    /// Mean coverage of all texels (not weighted by solid angle).
    pub mean_coverage: f64,
    /// Distances of what was seen, in metres; `None` where nothing was.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub distance: Option<DistanceStatistics>,
    /// Share of directions in which the nearest mesh shows a back that no ray sees: 1 inside a closed mesh. `None` without
    /// meshes.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub hidden_backs: Option<f64>,
    /// Noise of surfaces that were lit by path tracing; `None` where there were none.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub surface_noise: Option<SurfaceNoise>,
}

/// Distances around a probe, in metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct DistanceStatistics {
    /// Distance of the nearest texel that has any coverage.
    pub min: f64,
    /// Mean over all texels, weighted by coverage.
    pub mean: f64,
    /// Distance of the farthest texel that has any coverage.
    pub max: f64,
}
