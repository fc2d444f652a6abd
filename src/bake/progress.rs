//! How a running bake is told of.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Hears how a bake goes. Called from any thread, in any order between `begin` and `finish`; `stage` before, and `warn` at
/// any time.
pub trait Progress: Sync {
    /// Something begins that takes a while before the first ray of a probe: `what`.
    fn stage(&self, _what: &str) {}

    /// A bake of `probes` probes and `rays` rays in all begins. Rays of tiles that are kept from an earlier bake count.
    fn begin(&self, probes: usize, rays: u64);

    /// `rays` more rays have been traced.
    fn advance(&self, rays: u64);

    /// The probe with this index in the list of probes has been traced and delivered.
    fn probe_done(&self, index: usize);

    /// The bake has ended, whether it succeeded or not.
    fn finish(&self);

    /// Something that its user should know and that stops nothing.
    fn warn(&self, _message: &str) {}
}

/// Reports nothing.
#[derive(Debug, Clone, Copy)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _probes: usize, _rays: u64) {}

    fn advance(&self, _rays: u64) {}

    fn probe_done(&self, _index: usize) {}

    fn finish(&self) {}
}

/// A line of `--progress json`. Readers should pass over events that they do not know.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "event", rename_all = "camelCase")]
pub enum ProgressEvent {
    /// Something begins that takes a while before tracing does.
    Stage {
        /// What it is, for people.
        message: String,
    },
    /// Tracing begins; the counts of what is done are 0.
    Begin(ProgressState),
    /// It goes on; at most once a second.
    Progress(ProgressState),
    /// It has ended. Whether the bake succeeded is the process's exit code.
    Finish(ProgressState),
    /// Something that stops nothing. May come at any time.
    Warning {
        /// What it is, for people.
        message: String,
    },
}

/// How far a bake is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub struct ProgressState {
    /// Probes to trace; those that are known from an earlier bake are not among them.
    pub probes: usize,
    /// Of those, how many are written.
    pub probes_done: usize,
    /// Rays of those probes.
    pub rays: u64,
    /// Rays traced, and rays of tiles that were kept.
    pub rays_done: u64,
    /// Wall clock time since the beginning, in seconds.
    pub seconds: f64,
}
