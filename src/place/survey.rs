//! What placement finds out about a scene before any probe stands: free space, sites, and what is seen there.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use glam::DVec3;
use rayon::prelude::*;

use super::adaptive::{AdaptiveSettings, PlacementSeconds};
use super::free_space::{Reason, Space};
use super::levels::{self, Height};
use super::plan::{Lattice, Plan};
use super::search::Candidate;
use super::signal::Signal;
use super::sites::{Dropped, LevelSites, stride};
use super::{check_bounds, held_out};
use crate::error::{Error, Result};
use crate::scene::{Bounds, Scene};
use crate::trace::TileTracer;

/// What placement sees the scene with.
pub struct Sight<'a> {
    /// Single rays.
    pub space: Space<'a>,
    /// Cubemaps of [`signal::FACE_SIZE`](super::signal::FACE_SIZE) texels.
    pub tiles: &'a dyn TileTracer,
}

/// A surveyed scene. Probes can be placed in it again and again, with other budgets.
pub struct Survey {
    /// Levels that have sites.
    pub(super) levels: Vec<LevelSites>,
    /// The sites of all levels with what is seen there.
    pub(super) candidates: Vec<Candidate>,
    /// What is seen at held-out positions.
    pub(super) truths: Vec<Signal>,
    /// When the survey began.
    pub(super) begun: Instant,
    /// Time of each stage so far.
    pub(super) seconds: PlacementSeconds,
}

impl Survey {
    /// Finds levels, free space and sites, and traces a small cubemap at each; of `settings` the bounds, the levels and the
    /// number of held-out positions count.
    ///
    /// Fails with [`Error::Request`] when the bounds are no box with a volume, a level is outside of them or has no free
    /// space, or there is no free space at all; with [`Error::Cancelled`] when `cancel` is set.
    pub fn new(sight: &Sight, settings: &AdaptiveSettings, cancel: &AtomicBool) -> Result<Self> {
        let begun = Instant::now();
        check_bounds(&settings.bounds)?;
        let levels = level_sites(&sight.space, settings)?;
        let free_space = begun.elapsed();
        let sites = || levels.iter().enumerate().flat_map(|(i, level)| level.sites.iter().map(move |&site| (i, site)));
        let signals = trace_all(sight, sites().map(|(_, site)| site), cancel)?;
        let candidates = sites()
            .zip(signals)
            .map(|((level, _), signal)| Candidate { level, truth: signal.truth(), signal })
            .collect();
        let traced = begun.elapsed();
        let positions = held_out::positions(&sight.space, &levels, settings.held_out);
        let truths = trace_all(sight, positions, cancel)?;
        let seconds = PlacementSeconds {
            free_space: free_space.as_secs_f64(),
            signals: (traced - free_space).as_secs_f64(),
            search: 0.0,
            report: (begun.elapsed() - traced).as_secs_f64(),
        };
        Ok(Self { levels, candidates, truths, begun, seconds })
    }
}

/// Free space and sites of every level.
fn level_sites(space: &Space, settings: &AdaptiveSettings) -> Result<Vec<LevelSites>> {
    let bounds = &settings.bounds;
    let lattice = Lattice::over(bounds);
    let storeys = levels::storeys(space, &lattice, bounds);
    let heights = if settings.levels.is_empty() {
        levels::spread(&storeys)
    } else {
        levels::given(&settings.levels, &storeys, bounds)?
    };
    let plans: Vec<(Height, Plan)> =
        heights.into_iter().map(|height| (height, Plan::trace(space, lattice, height.y))).collect();
    let area = plans.iter().map(|(_, plan)| plan.area()).sum();
    let stride = stride(lattice.cell, area);
    // Rays of this length have left the bounds, and whatever stands around them.
    let reach = 4.0 * bounds.extent().length();
    let mut levels: Vec<LevelSites> =
        plans.into_iter().map(|(height, plan)| LevelSites::new(space, plan, height, stride, reach)).collect();
    if let Some(level) = levels.iter().find(|level| level.sites.is_empty() && !settings.levels.is_empty()) {
        return Err(Error::request("--levels", format!("{} m: {}", level.height.y, why_none(&level.dropped))));
    }
    if levels.iter().all(|level| level.sites.is_empty()) {
        let dropped: Vec<Dropped> = levels.iter().flat_map(|level| level.dropped.iter().copied()).collect();
        let Bounds { min, max } = bounds;
        let why = format!("{min} to {max} holds no place for a probe: {}", why_none(&dropped));
        return Err(Error::request("--bounds", why));
    }
    levels.retain(|level| !level.sites.is_empty());
    Ok(levels)
}

/// What stands against a probe, in words.
fn why_none(dropped: &[Dropped]) -> String {
    let count = |reason: Reason| dropped.iter().filter(|dropped| dropped.reason == reason).count();
    match dropped.len() {
        0 => "no floor with 1.5 m of free height above it was found; give --levels or other --bounds".into(),
        all => format!(
            "of {all} places {} lie in matter, {} see mostly nothing, {} have no floor below",
            count(Reason::Matter),
            count(Reason::Outside),
            count(Reason::NoFloor)
        ),
    }
}

/// Small cubemaps at all `places`, in their order.
pub(super) fn trace_all(
    sight: &Sight,
    places: impl IntoIterator<Item = DVec3>,
    cancel: &AtomicBool,
) -> Result<Vec<Signal>> {
    let scene: &Scene = sight.space.tracer.scene;
    let trace = |place: DVec3| {
        if cancel.load(Ordering::Relaxed) {
            return Err(Error::Cancelled);
        }
        Signal::trace(sight.tiles, scene, place)
    };
    places.into_iter().collect::<Vec<_>>().into_par_iter().with_max_len(1).map(trace).collect()
}
