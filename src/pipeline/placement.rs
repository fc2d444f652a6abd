//! A job's probes: as a grid, from a list, or adaptively.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;

use crate::encode::plan::PlanPicture;
use crate::job::Placement;
use crate::manifest::Manifest;
use crate::place::adaptive::{PlacementRecord, PlacementSeconds};
use crate::place::{self, Adaptive, AdaptiveSettings, Probe, Sight};
use crate::scene::Bounds;
use crate::{Error, Result};

/// Probes and what is known about them.
#[derive(Default)]
pub(super) struct Placed {
    pub probes: Vec<Probe>,
    /// Per probe; empty unless placed adaptively.
    estimated_errors: Vec<f64>,
    record: Option<PlacementRecord>,
    pub picture: Option<PlanPicture>,
    pub seconds: Option<PlacementSeconds>,
}

/// Places the probes; `scene_bounds` is the box that most of the scene fills.
pub(super) fn place_probes(
    placement: &Placement,
    scene_bounds: Option<Bounds>,
    sight: &Sight,
    cancel: &AtomicBool,
) -> Result<Placed> {
    let given = placement
        .bounds
        .map(|[x0, y0, z0, x1, y1, z1]| Bounds { min: DVec3::new(x0, y0, z0), max: DVec3::new(x1, y1, z1) });
    let bounds = || {
        let bounds = given.or(scene_bounds);
        bounds.ok_or_else(|| Error::request("--bounds", "the scene is empty: give the box that the probes serve"))
    };
    let probes = match placement.grid {
        _ if placement.adaptive => return adaptive(placement, bounds()?, sight, cancel),
        Some(grid) => place::grid(bounds()?, grid, placement.overlap)?,
        None => {
            let positions: Vec<DVec3> = placement.probes.iter().copied().map(DVec3::from).collect();
            place::list(&positions, given, placement.overlap)?
        }
    };
    Ok(Placed { probes, ..Placed::default() })
}

fn adaptive(placement: &Placement, bounds: Bounds, sight: &Sight, cancel: &AtomicBool) -> Result<Placed> {
    let settings = AdaptiveSettings {
        bounds,
        levels: placement.levels.clone(),
        error: placement.error,
        max_probes: placement.max_probes as usize,
        time: placement.time.map(Duration::from_secs_f64),
        held_out: placement.held_out as usize,
    };
    let Adaptive { probes, estimated_errors, record, plans, seconds } = place::adaptive(sight, &settings, cancel)?;
    let picture = PlanPicture::new(&record.levels, &plans, &estimated_errors);
    Ok(Placed { probes, estimated_errors, record: Some(record), picture: Some(picture), seconds: Some(seconds) })
}

impl Placed {
    /// Adds what the manifest says about placement.
    pub fn describe(self, manifest: Manifest) -> Manifest {
        let mut manifest = Manifest { placement: self.record, ..manifest };
        for (probe, error) in manifest.probes.iter_mut().zip(self.estimated_errors) {
            probe.estimated_error = Some(error);
        }
        manifest
    }
}
