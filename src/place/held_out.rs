//! How well probes predict places that placement has not seen.

use glam::DVec3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::free_space::Space;
use super::signal::{KINDS, Signal, errors};
use super::sites::LevelSites;
use super::triangulation::Share;
use crate::trace::ray::RayScratch;

/// Heights of held-out positions keep this distance, in metres, from floor and ceiling: nothing that reflects is nearer.
const CLEARANCE: f64 = 0.3;

/// Relative errors at held-out positions: root mean square of the differences over that of the truth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct ErrorSummary {
    /// Mean over the positions of the mean of the four.
    pub mean: f64,
    /// The mean of the four that 95 % of the positions stay below.
    pub p95: f64,
    /// Mean over the positions of each: radiance prefiltered at roughness 0.1, 0.3 and 0.6, and diffuse irradiance.
    pub by_kind: [f64; KINDS],
}

impl ErrorSummary {
    /// Summarises the errors of all positions; `None` without any.
    pub fn of(found: &[[f64; KINDS]]) -> Option<Self> {
        let count = found.len() as f64;
        let mut means: Vec<f64> = found.iter().map(|kinds| kinds.iter().sum::<f64>() / KINDS as f64).collect();
        means.sort_by(f64::total_cmp);
        let p95 = *means.get(((count * 0.95).ceil() as usize).checked_sub(1)?)?;
        let by_kind = std::array::from_fn(|kind| found.iter().map(|kinds| kinds[kind]).sum::<f64>() / count);
        Some(Self { mean: means.iter().sum::<f64>() / count, p95, by_kind })
    }
}

/// At most `count` random free positions at all heights of the levels' storeys; the same for the same plans.
pub fn positions(space: &Space, levels: &[LevelSites], count: usize) -> Vec<DVec3> {
    let cells: Vec<(usize, usize)> = levels
        .iter()
        .enumerate()
        .flat_map(|(i, level)| {
            (0..level.plan.free.len()).filter(|&cell| level.plan.free[cell]).map(move |cell| (i, cell))
        })
        .collect();
    if cells.is_empty() {
        return Vec::new();
    }
    let mut state = 0x0068_656c_646f_7574;
    let tries: Vec<DVec3> = (0..4 * count)
        .map(|_| {
            let [cell, x, y, z] = [(); 4].map(|()| super::random(&mut state));
            let (level, cell) = cells[(cell * cells.len() as f64) as usize];
            let LevelSites { plan, height, .. } = &levels[level];
            let (low, high) = ((height.floor + CLEARANCE).min(height.y), (height.ceiling - CLEARANCE).max(height.y));
            let within = DVec3::new(x - 0.5, 0.0, z - 0.5) * plan.lattice.cell;
            (plan.point(cell) + within).with_y(low + y * (high - low))
        })
        .collect();
    // Free by itself, and in sight of its cell's centre: not behind a thin wall, not inside of furniture.
    let is_free = |scratch: &mut RayScratch, position: &DVec3| {
        let level = levels.iter().find(|level| (level.height.floor..=level.height.ceiling).contains(&position.y));
        space.is_free(*position, scratch)
            && level.is_some_and(|level| space.is_open(*position, position.with_y(level.height.y), scratch))
    };
    let free: Vec<bool> = tries.par_iter().map_init(RayScratch::default, is_free).collect();
    tries.into_iter().zip(free).filter(|(_, free)| *free).map(|(position, _)| position).take(count).collect()
}

/// Errors at `truths` of the blend that `weights` gives of `probes`.
pub fn judge(truths: &[Signal], probes: &[&Signal], weights: impl Fn(DVec3) -> Vec<Share> + Sync) -> Vec<[f64; KINDS]> {
    let judge = |truth: &Signal| {
        let expected = truth.truth();
        let mut predicted = vec![glam::Vec3::ZERO; expected.len()];
        for share in weights(truth.position) {
            let view = probes[share.probe as usize].view(truth.position);
            predicted.iter_mut().zip(view).for_each(|(sum, value)| *sum += value * share.weight as f32);
        }
        errors(&predicted, &expected)
    };
    truths.par_iter().map(judge).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_summary_is_of_means_over_kinds() {
        let found: Vec<[f64; KINDS]> =
            (1..=100).map(|i| [f64::from(i) / 50.0, 0.0, f64::from(i) / 50.0, 0.0]).collect();
        let summary = ErrorSummary::of(&found).unwrap();
        assert!((summary.mean - 0.505).abs() < 1e-12 && (summary.p95 - 0.95).abs() < 1e-12);
        assert!((summary.by_kind[0] - 1.01).abs() < 1e-12 && summary.by_kind[1] == 0.0);
        assert_eq!(ErrorSummary::of(&[]), None);
    }
}
