//! PointInstancer prims: copies of prototypes, each with a place of its own (UsdGeomPointInstancer).

use std::collections::BTreeSet;

use glam::{DAffine3, DQuat, Quat, Vec3};
use openusd::sdf::{Path, Value};
use openusd::usd::Prim;

use super::OpenedStage;
use crate::Result;

/// A prototype and where its instances stand, relative to the instancer.
pub struct Instances {
    pub prototype: Path,
    pub instancer_from_instances: Vec<DAffine3>,
}

/// The instances of `prim` that are neither invisible nor inactive, by prototype.
pub fn instances(stage: &OpenedStage, prim: &Prim) -> Result<Vec<Instances>> {
    let prototypes = stage.ask(prim, prim.relationship("prototypes").forwarded_targets())?;
    let indices = stage.integers(prim, "protoIndices")?;
    let count = indices.len();
    let array = |name: &str| -> Result<Option<Vec<[f32; 3]>>> {
        let values = stage.vectors::<3>(prim, name)?.filter(|values| !values.is_empty());
        check_count(stage, prim, name, values.as_ref().map(Vec::len), count).map(|()| values)
    };
    let positions = array("positions")?;
    let scales = array("scales")?;
    let orientations = orientations(stage, prim, count)?;
    if count > 0 && positions.is_none() {
        return Err(stage.invalid(prim, "it has no positions for its instances"));
    }
    let ids = stage.integers(prim, "ids")?;
    check_count(stage, prim, "ids", Some(ids.len()).filter(|&ids| ids > 0), count)?;
    let masked = masked_ids(stage, prim)?;
    let mut by_prototype: Vec<Instances> =
        prototypes.into_iter().map(|prototype| Instances { prototype, instancer_from_instances: Vec::new() }).collect();
    let prototype_count = by_prototype.len();
    for (i, index) in indices.into_iter().enumerate() {
        if masked.contains(&ids.get(i).copied().unwrap_or(i as i64)) {
            continue;
        }
        let instances = usize::try_from(index).ok().and_then(|index| by_prototype.get_mut(index));
        let out = || stage.invalid(prim, format!("protoIndices has {index}; there are {prototype_count} prototypes"));
        let vector = |values: &Option<Vec<[f32; 3]>>, none: Vec3| values.as_ref().map_or(none, |it| Vec3::from(it[i]));
        let placed = DAffine3::from_scale_rotation_translation(
            vector(&scales, Vec3::ONE).as_dvec3(),
            orientations.as_ref().map_or(DQuat::IDENTITY, |it| it[i]),
            vector(&positions, Vec3::ZERO).as_dvec3(),
        );
        // A place that is not finite is left to its triangles, which are dropped and counted.
        instances.ok_or_else(out)?.instancer_from_instances.push(placed);
    }
    by_prototype.retain(|instances| !instances.instancer_from_instances.is_empty());
    Ok(by_prototype)
}

/// Those of full precision where there are any, else those of half precision; made unit, w first in the file.
fn orientations(stage: &OpenedStage, prim: &Prim, count: usize) -> Result<Option<Vec<DQuat>>> {
    for name in ["orientationsf", "orientations"] {
        let Some(values) = stage.vectors::<4>(prim, name)?.filter(|values| !values.is_empty()) else { continue };
        check_count(stage, prim, name, Some(values.len()), count)?;
        let unit = |[w, x, y, z]: [f32; 4]| {
            let rotation = Quat::from_xyzw(x, y, z, w).as_dquat();
            if rotation.length() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY }
        };
        return Ok(Some(values.into_iter().map(unit).collect()));
    }
    Ok(None)
}

fn check_count(stage: &OpenedStage, prim: &Prim, name: &str, found: Option<usize>, count: usize) -> Result<()> {
    match found {
        Some(found) if found != count => {
            Err(stage.invalid(prim, format!("{name} has {found} elements for {count} instances")))
        }
        _ => Ok(()),
    }
}

/// What invisibleIds and the metadata inactiveIds leave out.
fn masked_ids(stage: &OpenedStage, prim: &Prim) -> Result<BTreeSet<i64>> {
    let mut masked: BTreeSet<i64> = stage.integers(prim, "invisibleIds")?.into_iter().collect();
    match stage.metadata(prim, prim.path(), "inactiveIds")? {
        Some(Value::Int64ListOp(ids)) => masked.extend(ids.iter()),
        Some(Value::IntListOp(ids)) => masked.extend(ids.iter().map(|&id| i64::from(id))),
        _ => {}
    }
    Ok(masked)
}
