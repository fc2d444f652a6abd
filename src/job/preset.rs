//! Settings that go together: how much time a bake may take for how little error.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Job;

/// Where the settings come from that a job does not state: those of speed and accuracy. What a job states always wins.
///
/// Values in [`Preset::job`]; errors and times of each are measured by `splatprobe bench`.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// For a first look.
    Draft,
    /// Every setting at its default. The default.
    #[default]
    Standard,
    /// For the last bake.
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
