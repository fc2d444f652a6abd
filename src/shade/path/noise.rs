//! How far the paths of a probe's surfaces differ, gathered from all threads.
//!
//! Sums are of integers, so that they do not depend on the order in which threads add to them.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use glam::DVec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Noise of the surfaces that a probe sees, where they are lit by path tracing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct SurfaceNoise {
    /// Paths traced.
    pub paths: u64,
    /// Root mean square, over all hits, of the estimated standard error of reflected light, as a share of that light or,
    /// where it is darker than 1/20 of paper white, of 1/20.
    pub standard_error: f64,
    /// The largest.
    pub max_standard_error: f64,
}

/// Sums by probe.
#[derive(Debug)]
pub(super) struct NoiseSums {
    probes: BTreeMap<[u64; 3], Sums>,
}

#[derive(Debug, Default)]
struct Sums {
    hits: AtomicU64,
    paths: AtomicU64,
    /// Of squared errors, in units of [`UNIT`].
    squares: AtomicU64,
    /// Bits of the largest error; errors are not negative, so their bit patterns order as they do.
    max: AtomicU32,
}

/// Squared errors are summed in steps of this: a hundredth of a percent is 1e-8, and 2^24 hits of the largest fit.
const UNIT: f64 = 1e-10;

/// Larger errors count as this one.
const MOST: f32 = 10.0;

impl NoiseSums {
    pub fn new(origins: &[DVec3]) -> Self {
        Self { probes: origins.iter().map(|origin| (key(*origin), Sums::default())).collect() }
    }

    /// Adds a hit seen from `origin`; one that is no probe's is left out.
    pub fn add(&self, origin: DVec3, paths: u32, error: f32) {
        let Some(sums) = self.probes.get(&key(origin)) else { return };
        let error = error.min(MOST);
        sums.hits.fetch_add(1, Ordering::Relaxed);
        sums.paths.fetch_add(u64::from(paths), Ordering::Relaxed);
        sums.squares.fetch_add((f64::from(error * error) / UNIT) as u64, Ordering::Relaxed);
        sums.max.fetch_max(error.to_bits(), Ordering::Relaxed);
    }

    pub fn of(&self, origin: DVec3) -> Option<SurfaceNoise> {
        let sums = self.probes.get(&key(origin))?;
        let hits = sums.hits.load(Ordering::Relaxed);
        (hits > 0).then(|| SurfaceNoise {
            paths: sums.paths.load(Ordering::Relaxed),
            standard_error: (sums.squares.load(Ordering::Relaxed) as f64 * UNIT / hits as f64).sqrt(),
            max_standard_error: f64::from(f32::from_bits(sums.max.load(Ordering::Relaxed))),
        })
    }
}

fn key(origin: DVec3) -> [u64; 3] {
    origin.to_array().map(f64::to_bits)
}
