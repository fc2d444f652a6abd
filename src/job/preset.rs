//! Settings that go together: how much time a bake may take for how little error.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Job;

/// Where the settings come from that a job does not state: those of speed and accuracy. What a job states always wins.
///
/// Errors and times are those that `splatprobe bench interior:300000` measures: of the image that a mirror shows, root mean
/// square in display space, and time on one core.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// For a first look: faces of 128 px, rays that end at 1/256, path-traced surfaces to 10 % noise. Error 0.0054 (45 dB),
    /// FLIP 0.021, in 0.3 times the standard's time.
    Draft,
    /// Every setting at its default: faces of 256 px. Error 0.0026 (52 dB), FLIP 0.008. The default.
    #[default]
    Standard,
    /// For the last bake: faces of 512 px with 4 x 4 rays per pixel that end at 1/16384, path-traced surfaces to 0.5 % noise.
    /// Error 0.00016 (76 dB), FLIP 0.001, in 30 times the standard's time.
    Reference,
}

impl Preset {
    /// All of them, the fastest first.
    pub const ALL: [Self; 3] = [Self::Draft, Self::Standard, Self::Reference];

    /// A job that states nothing else.
    pub fn job(self) -> Job {
        let standard = Job::default();
        let settings = match self {
            Self::Draft => Job { face_size: 128, t_cutoff: 1.0 / 256.0, noise: 0.1, max_paths: 64, ..standard },
            Self::Standard => standard,
            Self::Reference => {
                Job { face_size: 512, samples: 4, t_cutoff: 1.0 / 16384.0, noise: 0.005, max_paths: 16384, ..standard }
            }
        };
        Job { preset: self, ..settings }
    }
}
