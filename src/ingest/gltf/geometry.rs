//! Primitives to triangles: vertex attributes and topology.

use glam::{DVec3, DVec4, Vec3};
use gltf::json::accessor::Type;
use gltf::json::mesh::{Mode, Primitive, Semantic};
use gltf::json::validation::Checked;
use gltf::json::{Accessor, Index};

use super::accessor::{read_indices, read_vectors};
use super::container::Asset;
use crate::Result;
use crate::ingest::geometry::Geometry;

/// The accessor of an attribute, if the primitive has it.
pub fn attribute(primitive: &Primitive, semantic: Semantic) -> Option<Index<Accessor>> {
    primitive.attributes.get(&Checked::Valid(semantic)).copied()
}

/// Reads a primitive; `None` when it has no triangles because it is made of points or lines.
pub fn read(asset: &Asset, primitive: &Primitive, here: &str) -> Result<Option<Geometry>> {
    let mode = match primitive.mode {
        Checked::Valid(mode @ (Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan)) => mode,
        Checked::Valid(_) => return Ok(None),
        Checked::Invalid => return Err(asset.invalid(here, "its mode is none that glTF 2.0 knows")),
    };
    let position = attribute(primitive, Semantic::Positions);
    let position = position.ok_or_else(|| asset.invalid(here, "it has no POSITION"))?;
    let positions: Vec<[f32; 3]> = read_vectors(asset, position, &[Type::Vec3], &format!("{here} POSITION"))?;
    let count = positions.len();
    let normals = optional::<3>(asset, primitive, Semantic::Normals, &[Type::Vec3], count, here)?;
    let uv = |set| optional(asset, primitive, Semantic::TexCoords(set), &[Type::Vec2], count, here);
    let uv = [uv(0)?, uv(1)?];
    let colours = optional(asset, primitive, Semantic::Colors(0), &[Type::Vec3, Type::Vec4], count, here)?;
    let corners = match primitive.indices {
        Some(indices) => read_indices(asset, indices, &format!("{here} indices"))?,
        None => (0..count as u32).collect(),
    };
    if let Some(index) = corners.iter().find(|&&index| index as usize >= count) {
        return Err(asset.invalid(here, format!("index {index} is out of range: it has {count} vertices")));
    }
    let vectors = |values: Vec<[f32; 3]>| values.into_iter().map(|v| Vec3::from(v).as_dvec3()).collect();
    Ok(Some(Geometry {
        positions: vectors(positions),
        normals: if normals.is_empty() { vec![DVec3::ZERO; count] } else { vectors(normals) },
        uv,
        tangents: Vec::new(),
        triangles: triangles(mode, &corners),
        colours,
    }))
}

/// Reads the primitive's tangents, if it has any. glTF ignores those of a primitive without normals.
pub fn read_tangents(asset: &Asset, primitive: &Primitive, geometry: &mut Geometry, here: &str) -> Result<()> {
    let count = geometry.positions.len();
    if attribute(primitive, Semantic::Normals).is_some() {
        let tangents = optional::<4>(asset, primitive, Semantic::Tangents, &[Type::Vec4], count, here)?;
        geometry.tangents = tangents.into_iter().map(|tangent| DVec4::from(tangent.map(f64::from))).collect();
    }
    Ok(())
}

/// An attribute that may be absent (then empty), with as many elements as there are positions.
fn optional<const N: usize>(
    asset: &Asset,
    primitive: &Primitive,
    semantic: Semantic,
    accepted: &[Type],
    count: usize,
    here: &str,
) -> Result<Vec<[f32; N]>> {
    let here = format!("{here} {}", semantic.to_string());
    let Some(index) = attribute(primitive, semantic) else { return Ok(Vec::new()) };
    let values = read_vectors(asset, index, accepted, &here)?;
    if values.len() != count {
        return Err(asset.invalid(here, format!("it has {} elements for {count} positions", values.len())));
    }
    Ok(values)
}

/// Triangles of a list, strip or fan of corners (glTF 2.0, section 3.7.2.1). Corners left over make none.
fn triangles(mode: Mode, corners: &[u32]) -> Vec<[u32; 3]> {
    let windows = corners.windows(3);
    match mode {
        Mode::TriangleStrip => {
            windows.enumerate().map(|(i, w)| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[0], w[2], w[1]] }).collect()
        }
        Mode::TriangleFan => windows.map(|w| [w[1], w[2], corners[0]]).collect(),
        _ => corners.chunks_exact(3).map(|w| [w[0], w[1], w[2]]).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_alternate_and_fans_share_their_first_corner() {
        let corners = [10, 11, 12, 13, 14];
        assert_eq!(triangles(Mode::TriangleStrip, &corners), [[10, 11, 12], [11, 13, 12], [12, 13, 14]]);
        assert_eq!(triangles(Mode::TriangleFan, &corners), [[11, 12, 10], [12, 13, 10], [13, 14, 10]]);
        assert_eq!(triangles(Mode::Triangles, &corners), [[10, 11, 12]]);
        assert!(triangles(Mode::TriangleFan, &corners[..2]).is_empty());
    }
}
