//! Values over the surface of a mesh (primvars and normals), for each corner of each face.

use openusd::usd::{Attribute, Prim};

use super::OpenedStage;
use super::mesh::Topology;
use super::values::{integers, name_of};
use crate::Result;

/// What has a value of its own (UsdGeomPrimvar). On meshes `varying` is the same as `vertex`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Interpolation {
    /// The mesh.
    Constant,
    /// Each face.
    Uniform,
    /// Each point.
    Vertex,
    /// Each corner of each face.
    FaceVarying,
}

/// A corner of a face, by the numbers that values are found with.
#[derive(Debug, Clone, Copy)]
pub struct Corner {
    /// Which face.
    pub face: usize,
    /// Which point.
    pub point: usize,
    /// Place among the corners of all faces.
    pub corner: usize,
}

/// Values of `N` numbers over a mesh.
#[derive(Debug)]
pub struct Primvar<const N: usize> {
    pub interpolation: Interpolation,
    /// As many as the interpolation asks for, or those that `indices` chooses from.
    pub values: Vec<[f32; N]>,
    pub indices: Option<Vec<usize>>,
}

impl<const N: usize> Primvar<N> {
    /// One value for all of a mesh.
    pub fn constant(value: [f32; N]) -> Self {
        Self { interpolation: Interpolation::Constant, values: vec![value], indices: None }
    }

    /// The primvar `name` (without `primvars:`) of `prim`, or the constant one of the nearest ancestor that has one.
    pub fn find(stage: &OpenedStage, prim: &Prim, name: &str, topology: &Topology) -> Result<Option<Self>> {
        let attribute = format!("primvars:{name}");
        let own = Self::read(stage, prim, &attribute, Interpolation::Constant, topology)?;
        if own.is_some() {
            return Ok(own);
        }
        for path in prim.path().strict_ancestors().take_while(|path| !path.is_abs_root()) {
            let ancestor = stage.stage.prim(path);
            let found = Self::read_any(stage, &ancestor, &attribute, Interpolation::Constant)?;
            if let Some(inherited) = found.filter(|found| found.interpolation == Interpolation::Constant) {
                inherited.check(stage, &ancestor, &attribute, topology)?;
                return Ok(Some(inherited));
            }
        }
        Ok(None)
    }

    /// The attribute `name` of `prim`; `unauthored` is its interpolation where the file says none. An empty array is none.
    pub fn read(
        stage: &OpenedStage,
        prim: &Prim,
        name: &str,
        unauthored: Interpolation,
        topology: &Topology,
    ) -> Result<Option<Self>> {
        let found = Self::read_any(stage, prim, name, unauthored)?;
        found.as_ref().map_or(Ok(()), |found| found.check(stage, prim, name, topology))?;
        Ok(found)
    }

    fn read_any(stage: &OpenedStage, prim: &Prim, name: &str, unauthored: Interpolation) -> Result<Option<Self>> {
        let Some(values) = stage.vectors::<N>(prim, name)?.filter(|values| !values.is_empty()) else { return Ok(None) };
        let interpolation = interpolation(stage, prim, &prim.attribute(name), unauthored)?;
        let indices = stage.value(prim, &format!("{name}:indices"))?.map(|value| {
            let indices = integers(value);
            let indices = indices.ok_or_else(|| stage.invalid(prim, format!("{name}:indices are not integers")))?;
            let checked = indices.into_iter().map(|index| {
                let inside = usize::try_from(index).ok().filter(|&index| index < values.len());
                let what = || format!("{name}:indices has {index}, and there are {} values", values.len());
                inside.ok_or_else(|| stage.invalid(prim, what()))
            });
            checked.collect::<Result<Vec<_>>>()
        });
        Ok(Some(Self { interpolation, values, indices: indices.transpose()? }))
    }

    /// Refuses what has fewer or more values than the mesh has places for. A constant one uses its first.
    fn check(&self, stage: &OpenedStage, prim: &Prim, name: &str, topology: &Topology) -> Result<()> {
        let found = self.indices.as_ref().map_or(self.values.len(), Vec::len);
        let (needed, of) = match self.interpolation {
            Interpolation::Constant => (found.max(1), "constant"),
            Interpolation::Uniform => (topology.counts.len(), "uniform: one per face"),
            Interpolation::Vertex => (topology.points, "vertex: one per point"),
            Interpolation::FaceVarying => (topology.corners.len(), "faceVarying: one per corner"),
        };
        if found != needed {
            return Err(stage.invalid(prim, format!("{name} has {found} values where {needed} are needed ({of})")));
        }
        Ok(())
    }

    /// The value at `corner`, which must be one of the mesh's.
    pub fn at(&self, corner: Corner) -> [f32; N] {
        let place = match self.interpolation {
            Interpolation::Constant => 0,
            Interpolation::Uniform => corner.face,
            Interpolation::Vertex => corner.point,
            Interpolation::FaceVarying => corner.corner,
        };
        self.values[self.indices.as_ref().map_or(place, |indices| indices[place])]
    }
}

fn interpolation(
    stage: &OpenedStage,
    prim: &Prim,
    attribute: &Attribute,
    unauthored: Interpolation,
) -> Result<Interpolation> {
    let Some(value) = stage.metadata(prim, attribute.path(), "interpolation")? else { return Ok(unauthored) };
    let name = name_of(value).unwrap_or_default();
    Ok(match name.as_str() {
        "constant" => Interpolation::Constant,
        "uniform" => Interpolation::Uniform,
        "vertex" | "varying" => Interpolation::Vertex,
        "faceVarying" => Interpolation::FaceVarying,
        _ => return Err(stage.invalid(prim, format!("interpolation '{name}' is none that USD knows"))),
    })
}
