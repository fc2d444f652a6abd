//! A job's probes: as a grid, from a list, from a manifest, or adaptively.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;

use crate::encode::plan::PlanPicture;
use crate::job::Placement;
use crate::manifest::{Manifest, ProbeRecord};
use crate::place::adaptive::{PlacementRecord, PlacementSeconds};
use crate::place::{self, Adaptive, AdaptiveSettings, Probe, Sight};
use crate::scene::Bounds;
use crate::{Error, Result};

/// Probes and what is known about them.
#[derive(Default)]
pub(super) struct Placed {
    pub probes: Vec<Probe>,
    /// Per probe; empty unless placed adaptively.
    pub estimated_errors: Vec<f64>,
    pub record: Option<PlacementRecord>,
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
    if let Some(path) = &placement.placed {
        return from_manifest(path);
    }
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

/// The probes of an earlier placement or bake.
fn from_manifest(path: &Path) -> Result<Placed> {
    let Manifest { probes, placement, shard, unfinished, .. } = Manifest::read(path)?;
    if shard.is_some() || !unfinished.is_empty() || probes.is_empty() {
        return Err(Error::invalid(path, "/probes", "not all probes of a placement: give the manifest of `place`"));
    }
    let estimated_errors: Vec<f64> = probes.iter().filter_map(|probe| probe.estimated_error).collect();
    let ids: BTreeSet<&str> = probes.iter().map(|probe| probe.id.as_str()).collect();
    for (i, probe) in probes.iter().enumerate() {
        let place = |field: &str| format!("/probes/{i}/{field}");
        let is_name = probe.id.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-');
        if !is_name || probe.id.is_empty() {
            let what = format!("'{}' is not a name for a folder: letters, digits, '_' and '-'", probe.id);
            return Err(Error::invalid(path, place("id"), what));
        }
        if probe.position.iter().any(|coordinate| !coordinate.is_finite()) {
            return Err(Error::invalid(path, place("position"), "it is not finite"));
        }
    }
    if ids.len() != probes.len() || (!estimated_errors.is_empty() && estimated_errors.len() != probes.len()) {
        return Err(Error::invalid(path, "/probes", "an id is given twice, or some probes have no estimated error"));
    }
    let probe = |record: ProbeRecord| Probe {
        id: record.id,
        position: record.position.into(),
        influence: Bounds { min: record.influence.min.into(), max: record.influence.max.into() },
        proxy: record.proxy,
        blend: record.influence.blend,
    };
    let probes = probes.into_iter().map(probe).collect();
    Ok(Placed { probes, estimated_errors, record: placement, ..Placed::default() })
}
