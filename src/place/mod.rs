//! Where probes stand and how far they reach.

pub mod adaptive;
pub mod contours;
pub mod free_space;
pub mod grid;
pub mod held_out;
pub mod influence;
pub mod interpolate;
pub mod levels;
pub mod list;
pub mod plan;
pub mod proxy;
pub mod search;
pub mod signal;
pub mod sites;
pub mod survey;
pub mod triangulation;
pub mod walls;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::scene::Bounds;

pub use adaptive::{Adaptive, AdaptiveSettings, adaptive};
pub use grid::grid;
pub use interpolate::{Network, interpolate};
pub use list::list;
pub use survey::{Sight, Survey};

/// A reflection probe: where its cubemap is taken and where it is used.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Probe {
    /// Unique name, sortable because its number is padded with zeros: `probe_003`.
    pub id: String,
    /// Where the cubemap is taken: world space, metres.
    pub position: DVec3,
    /// Where the probe is used: world space, metres.
    pub influence: Bounds,
    /// Box that reflections are corrected against: world space, metres.
    pub proxy: Bounds,
    /// How far inside each face of `influence` the probe fades out, in metres, in the order +X -X +Y -Y +Z -Z;
    /// 0 ends it at once. [`Probe::weight`] is the exact meaning.
    pub blend: [f64; 6],
}

impl Probe {
    /// Blend weight at a world position, in [0, 1]: the product of a linear ramp over the blend distance at each face,
    /// and 0 outside the box. Where several probes reach a point, their weights are divided by their sum.
    pub fn weight(&self, point: DVec3) -> f64 {
        if !self.influence.contains(point) {
            return 0.0;
        }
        let inside = [self.influence.max - point, point - self.influence.min];
        let ramp = |depth: f64, blend: f64| if depth < blend { depth / blend } else { 1.0 };
        (0..3)
            .map(|axis| ramp(inside[0][axis], self.blend[2 * axis]) * ramp(inside[1][axis], self.blend[2 * axis + 1]))
            .product()
    }
}

/// `probe_` and the index, with as many digits as the last of `count` probes needs, but three at least.
fn probe_id(index: usize, count: usize) -> String {
    let digits = count.saturating_sub(1).to_string().len().max(3);
    format!("probe_{index:0digits$}")
}

/// The next of a fixed sequence of numbers, even in [0, 1) (splitmix64; Steele, Lea & Flood 2014).
fn random(state: &mut u64) -> f64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Fails unless `bounds` is finite and has a volume.
fn check_bounds(bounds: &Bounds) -> Result<()> {
    let size = bounds.extent();
    if size.is_finite() && size.cmpgt(DVec3::ZERO).all() {
        return Ok(());
    }
    let Bounds { min, max } = bounds;
    let why = format!("{min} to {max} is not a box: every maximum must lie above its minimum, and all must be finite");
    Err(Error::request("bounds", why))
}

/// Fails unless `overlap` is a share: 0 to 1.
fn check_overlap(overlap: f64) -> Result<()> {
    if (0.0..=1.0).contains(&overlap) {
        return Ok(());
    }
    Err(Error::request(
        "overlap",
        format!("{overlap} is not between 0 (boxes touch) and 1 (boxes reach the neighbour)"),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_sort_in_probe_order_for_any_count() {
        assert_eq!(probe_id(3, 8), "probe_003");
        assert_eq!(probe_id(3, 1000), "probe_003");
        assert_eq!(probe_id(3, 1001), "probe_0003");
        let ids: Vec<String> = (0..1200).map(|i| probe_id(i, 1200)).collect();
        assert!(ids.is_sorted());
    }
}
