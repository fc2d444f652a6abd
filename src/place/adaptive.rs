//! Adaptive placement: probes where prediction fails.
//!
//! Error-driven insertion into a triangulation follows what Garland & Heckbert (1995, "Fast polygonal approximation of
//! terrains and height fields") do for heights; that fewer probes than a grid's suffice was shown by Wang et al. (I3D 2019,
//! "Fast non-uniform radiance probe placement and tracing").

use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use glam::DVec3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::free_space::{Reason, Space};
use super::held_out::{self, ErrorSummary};
use super::interpolate::Network;
use super::plan::Plan;
use super::search::{Budget, Candidate, Chosen, Search};
use super::signal::Signal;
use super::sites::Dropped;
use super::survey::{Sight, Survey, trace_all};
use super::triangulation::{Level, Share};
use super::walls::Traced;
use super::{Probe, grid, influence, probe_id};
use crate::error::Result;
use crate::scene::Bounds;
use crate::trace::ray::RayScratch;

/// What is asked of a placement.
#[derive(Debug, Clone, PartialEq)]
pub struct AdaptiveSettings {
    /// The box that the probes serve.
    pub bounds: Bounds,
    /// Heights at which probes stand; found from floors and ceilings where there are none.
    pub levels: Vec<f64>,
    /// Relative error that no place needs to be below.
    pub error: f64,
    /// Most probes; at least 1.
    pub max_probes: usize,
    /// When to stop adding probes. The result then depends on the machine.
    pub time: Option<Duration>,
    /// How many positions that placement does not use its error is measured at; 0 for none.
    pub held_out: usize,
}

/// What was placed.
pub struct Adaptive {
    /// The probes, by level and place.
    pub probes: Vec<Probe>,
    /// Per probe: the mean relative error expected where it has the greatest weight.
    pub estimated_errors: Vec<f64>,
    /// What the manifest says about them.
    pub record: PlacementRecord,
    /// The free cells of the levels that were looked at.
    pub plans: Vec<Plan>,
    /// Time of each stage.
    pub seconds: PlacementSeconds,
}

/// How probes of an adaptive placement are blended, and how well.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct PlacementRecord {
    /// The levels with their triangulations, from the lowest up.
    pub levels: Vec<Level>,
    /// Places that were considered for a probe.
    pub sites: usize,
    /// Of those, how many were moved out of matter.
    pub relocated: usize,
    /// Places that were left out, and why.
    pub dropped: Vec<Dropped>,
    /// What tracing found wrong with the result.
    pub checks: Checks,
    /// Error at positions that placement did not use; none where it was not measured.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub held_out: Option<HeldOut>,
}

/// Faults of a placement, found by tracing; all are 0 when all is well.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct Checks {
    /// Probes with opacity around them.
    pub probes_in_matter: usize,
    /// Triangles that a wall parts and that blend across it all the same: of three points in it, those that are free do not
    /// see each other.
    pub triangles_across_walls: usize,
    /// Held-out positions that no influence box holds.
    pub positions_without_influence: usize,
}

/// Errors at held-out positions.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct HeldOut {
    /// How many positions.
    pub positions: usize,
    /// Of this placement.
    pub adaptive: ErrorSummary,
    /// Of a regular grid with about as many probes, whose neighbours are blended linearly.
    pub grid: ErrorSummary,
    /// That grid's probes along x, y and z.
    pub grid_counts: [u32; 3],
}

/// Wall clock time by stage of a placement, in seconds.
#[derive(Debug, Clone, Copy, Default, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct PlacementSeconds {
    /// Levels, plans and sites.
    pub free_space: f64,
    /// Small cubemaps of all sites.
    pub signals: f64,
    /// Insertion and removal.
    pub search: f64,
    /// Checks and held-out errors.
    pub report: f64,
}

/// Places probes by the error of their prediction.
///
/// Fails as [`Survey::new`] does.
pub fn adaptive(sight: &Sight, settings: &AdaptiveSettings, cancel: &AtomicBool) -> Result<Adaptive> {
    Survey::new(sight, settings, cancel)?.place(sight, settings, cancel)
}

impl Survey {
    /// Places probes; of `settings` the error and the budget count. Fails with [`Error::Cancelled`](crate::Error::Cancelled)
    /// when `cancel` is set.
    pub fn place(&self, sight: &Sight, settings: &AdaptiveSettings, cancel: &AtomicBool) -> Result<Adaptive> {
        let begun = Instant::now();
        let budget = Budget {
            error: settings.error,
            probes: settings.max_probes.max(1),
            end: settings.time.map(|time| self.begun + time),
        };
        let chosen = Search::new(&sight.space, &self.levels, &self.candidates, budget).run();
        let searched = Instant::now();
        let mut placed = Placed::new(self, chosen, &settings.bounds);
        placed.check(&sight.space);
        placed.judge(sight, settings.bounds, &self.truths, cancel)?;
        let Placed { probes, estimated_errors, record, .. } = placed;
        let seconds = PlacementSeconds {
            search: (searched - begun).as_secs_f64(),
            report: self.seconds.report + searched.elapsed().as_secs_f64(),
            ..self.seconds
        };
        let plans = self.levels.iter().map(|level| level.plan.clone()).collect();
        Ok(Adaptive { probes, estimated_errors, record, plans, seconds })
    }
}

/// A result on its way to the caller.
struct Placed<'a> {
    candidates: &'a [Candidate],
    /// The candidates that became probes, in the probes' order.
    chosen: Vec<usize>,
    probes: Vec<Probe>,
    estimated_errors: Vec<f64>,
    record: PlacementRecord,
}

impl<'a> Placed<'a> {
    /// Numbers the probes by level and place, and leaves out levels without any.
    fn new(survey: &'a Survey, chosen: Chosen, bounds: &Bounds) -> Self {
        let Survey { levels: sites, candidates, .. } = survey;
        let Chosen { probes: mut indices, network, errors, .. } = chosen;
        let weights: Vec<Vec<Share>> =
            candidates.par_iter().map(|candidate| network.weights(candidate.signal.position)).collect();
        let mut dropped: Vec<Dropped> = sites.iter().flat_map(|level| level.dropped.iter().copied()).collect();
        indices.sort_unstable();
        let number = |candidate: u32| indices.binary_search(&(candidate as usize)).unwrap_or(0) as u32;
        let mut levels: Vec<Level> = network
            .levels
            .into_iter()
            .filter(|level| level.vertices.iter().any(|vertex| !vertex.blend.is_empty()))
            .collect();
        for share in levels.iter_mut().flat_map(|level| &mut level.vertices).flat_map(|vertex| &mut vertex.blend) {
            share.probe = number(share.probe);
        }
        // Where each probe counts most.
        let mut sums = vec![(0.0, 0); indices.len()];
        for (blend, error) in weights.iter().zip(&errors) {
            let heaviest = blend.iter().max_by(|a, b| a.weight.total_cmp(&b.weight).then(b.probe.cmp(&a.probe)));
            if let Some(share) = heaviest {
                let sum = &mut sums[number(share.probe) as usize];
                *sum = (sum.0 + error, sum.1 + 1);
            }
        }
        let positions: Vec<DVec3> = indices.iter().map(|&i| candidates[i].signal.position).collect();
        let margin = sites.iter().map(|level| level.plan.lattice.cell).fold(0.0, f64::max);
        let influences = influence::influences(&positions, &levels, margin, bounds);
        let probes = indices.iter().zip(influences).enumerate().map(|(i, (&candidate, (influence, blend)))| Probe {
            id: probe_id(i, indices.len()),
            position: candidates[candidate].signal.position,
            influence,
            proxy: candidates[candidate].signal.proxy,
            blend,
        });
        let left = |i: &usize| indices.binary_search(i).is_err();
        dropped.extend(
            (0..candidates.len())
                .filter(left)
                .map(|i| Dropped { position: candidates[i].signal.position, reason: Reason::Predicted }),
        );
        let record = PlacementRecord {
            sites: candidates.len(),
            relocated: sites.iter().map(|level| level.relocated).sum(),
            dropped,
            levels,
            checks: Checks::default(),
            held_out: None,
        };
        // A probe that is nowhere the heaviest adds to others only.
        let estimated_errors = sums.iter().map(|&(sum, count)| sum / f64::from(count.max(1))).collect();
        Self { probes: probes.collect(), estimated_errors, candidates, chosen: indices, record }
    }

    /// Counts faults by tracing.
    fn check(&mut self, space: &Space) {
        let in_matter = |scratch: &mut RayScratch, probe: &Probe| usize::from(!space.is_free(probe.position, scratch));
        let checks = &mut self.record.checks;
        checks.probes_in_matter = self.probes.par_iter().map_init(RayScratch::default, in_matter).sum();
        let openings = Traced::new(space);
        let across = |level: &Level| {
            (0..level.triangles.len()).into_par_iter().filter(|&i| level.blends_across(i, &openings)).count()
        };
        checks.triangles_across_walls = self.record.levels.iter().map(across).sum();
    }

    /// Measures errors where the `truths` were traced, of this placement and of a grid.
    fn judge(&mut self, sight: &Sight, bounds: Bounds, truths: &[Signal], cancel: &AtomicBool) -> Result<()> {
        if truths.is_empty() {
            return Ok(());
        }
        let covers = |truth: &&Signal| self.probes.iter().any(|probe| probe.weight(truth.position) > 0.0);
        self.record.checks.positions_without_influence = truths.len() - truths.iter().filter(covers).count();
        let network = self.network();
        let own: Vec<&Signal> = self.chosen.iter().map(|&i| &self.candidates[i].signal).collect();
        let adaptive = ErrorSummary::of(&held_out::judge(truths, &own, |position| network.weights(position)));

        let grid_counts = grid_counts(bounds.extent(), self.probes.len());
        let (signals, weights) = grid_of(sight, bounds, grid_counts, cancel)?;
        let signals: Vec<&Signal> = signals.iter().collect();
        let grid = ErrorSummary::of(&held_out::judge(truths, &signals, weights));
        self.record.held_out =
            adaptive.zip(grid).map(|(adaptive, grid)| HeldOut { positions: truths.len(), adaptive, grid, grid_counts });
        Ok(())
    }

    fn network(&self) -> Network {
        let probes = self.probes.iter().map(|probe| (probe.position, probe.proxy)).collect();
        Network { probes, levels: self.record.levels.clone() }
    }
}

/// Signals of a regular grid, whose proxy boxes are fitted as those of adaptive probes are, and its linear weights.
pub fn grid_of(
    sight: &Sight,
    bounds: Bounds,
    counts: [u32; 3],
    cancel: &AtomicBool,
) -> Result<(Vec<Signal>, impl Fn(DVec3) -> Vec<Share> + Sync + use<>)> {
    // Boxes that reach to the neighbouring probes: their ramps are linear interpolation.
    let probes = grid(bounds, counts, 1.0)?;
    let signals = trace_all(sight, probes.iter().map(|probe| probe.position), cancel)?;
    let weights = move |position: DVec3| {
        let inside = position.clamp(bounds.min, bounds.max);
        let shares = (0..).zip(&probes).map(|(i, probe)| Share { probe: i, weight: probe.weight(inside) });
        let mut shares: Vec<Share> = shares.filter(|share| share.weight > 0.0).collect();
        let sum: f64 = shares.iter().map(|share| share.weight).sum();
        shares.iter_mut().for_each(|share| share.weight /= sum);
        shares
    };
    Ok((signals, weights))
}

/// Numbers along the axes whose product comes nearest to `count` from below, with cells as near to cubes as that allows.
pub fn grid_counts(extent: DVec3, count: usize) -> [u32; 3] {
    let count = count.max(1);
    let mut best = ([1; 3], f64::INFINITY);
    for y in 1..=count {
        for x in 1..=count / y {
            let z = count / (x * y);
            let cell = extent / DVec3::new(x as f64, y as f64, z as f64);
            let stretch = (cell.max_element() / cell.min_element()).ln();
            let missing = (count as f64 / (x * y * z) as f64).ln();
            // A tenth fewer probes is as bad as cells half as long again.
            let cost = stretch + 4.0 * missing;
            if cost < best.1 {
                best = ([x as u32, y as u32, z as u32], cost);
            }
        }
    }
    best.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_for_comparison_has_about_as_many_probes_in_cells_like_cubes() {
        assert_eq!(grid_counts(DVec3::new(20.0, 2.7, 16.8), 64), [8, 1, 8]);
        assert_eq!(grid_counts(DVec3::ONE, 27), [3, 3, 3]);
        assert_eq!(grid_counts(DVec3::new(10.0, 2.7, 4.2), 1), [1, 1, 1]);
        assert_eq!(grid_counts(DVec3::ONE, 0), [1, 1, 1]);
    }
}
