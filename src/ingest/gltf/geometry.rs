//! Primitives to triangles: vertex attributes, topology, winding, and what is dropped.

use glam::{DAffine3, DMat3, DVec3, DVec4, Vec2, Vec3, Vec4};
use gltf::json::accessor::Type;
use gltf::json::mesh::{Mode, Primitive, Semantic};
use gltf::json::validation::Checked;
use gltf::json::{Accessor, Index};

use super::DroppedTriangles;
use super::accessor::{read_indices, read_vectors};
use super::container::Asset;
use crate::Result;
use crate::scene::mesh::{Meshes, VertexAttributes};

/// Most vertices and most triangles of a scene: instances multiply what a small file holds.
pub const MAX_ELEMENTS: usize = 1 << 27;

/// A primitive's vertices, in the coordinates that its file gives them in, and its triangles.
pub struct Geometry {
    /// One per vertex.
    pub positions: Vec<DVec3>,
    /// One per vertex; zero where the file has none.
    pub normals: Vec<DVec3>,
    /// Texture coordinates, sets 0 and 1; empty where the file has none.
    pub uv: [Vec<[f32; 2]>; 2],
    /// Tangents and the signs of the bitangents, one per vertex or none at all. Only read where a material needs them.
    pub tangents: Vec<DVec4>,
    /// Indices of vertices.
    pub triangles: Vec<[u32; 3]>,
    colours: Vec<[f32; 4]>,
}

/// The accessor of an attribute, if the primitive has it.
pub fn attribute(primitive: &Primitive, semantic: Semantic) -> Option<Index<Accessor>> {
    primitive.attributes.get(&Checked::Valid(semantic)).copied()
}

impl Geometry {
    /// Reads a primitive; `None` when it has no triangles because it is made of points or lines.
    pub fn read(asset: &Asset, primitive: &Primitive, here: &str) -> Result<Option<Self>> {
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
        Ok(Some(Self {
            positions: vectors(positions),
            normals: if normals.is_empty() { vec![DVec3::ZERO; count] } else { vectors(normals) },
            uv,
            tangents: Vec::new(),
            triangles: triangles(mode, &corners),
            colours,
        }))
    }

    /// Reads the primitive's tangents, if it has any. glTF ignores those of a primitive without normals.
    pub fn read_tangents(&mut self, asset: &Asset, primitive: &Primitive, here: &str) -> Result<()> {
        let count = self.positions.len();
        if attribute(primitive, Semantic::Normals).is_some() {
            let tangents = optional::<4>(asset, primitive, Semantic::Tangents, &[Type::Vec4], count, here)?;
            self.tangents = tangents.into_iter().map(|tangent| DVec4::from(tangent.map(f64::from))).collect();
        }
        Ok(())
    }

    /// Appends a copy of vertex `v`, without tangent; gives its index.
    pub fn repeat_vertex(&mut self, v: usize) -> u32 {
        self.positions.push(self.positions[v]);
        self.normals.push(self.normals[v]);
        self.uv.iter_mut().filter(|uv| !uv.is_empty()).for_each(|uv| uv.push(uv[v]));
        if let Some(&colour) = self.colours.get(v) {
            self.colours.push(colour);
        }
        self.positions.len() as u32 - 1
    }

    /// Appends the geometry once per placement; see [`Geometry::append_one`].
    ///
    /// Refuses what would pass [`MAX_ELEMENTS`] before it computes or stores anything.
    pub fn append(
        &self,
        asset: &Asset,
        stored_from_geometry: &[DAffine3],
        material: u32,
        meshes: &mut Meshes,
        dropped: &mut DroppedTriangles,
    ) -> Result<()> {
        let stored = meshes.positions.len().max(meshes.triangles.len());
        let each = self.positions.len().max(self.triangles.len());
        if stored.saturating_add(each.saturating_mul(stored_from_geometry.len())) > MAX_ELEMENTS {
            return Err(asset.unsupported(format!(
                "more than {MAX_ELEMENTS} vertices or triangles in one scene, instances counted; simplify it"
            )));
        }
        for &placement in stored_from_geometry {
            self.append_one(placement, material, meshes, dropped);
        }
        Ok(())
    }

    /// Appends the triangles that can be seen, with the vertices that they use, and counts the others.
    ///
    /// `stored_from_geometry` leads to coordinates relative to the scene's origin. Where it mirrors, corners swap so
    /// that counter-clockwise stays the front (glTF 2.0, section 3.7.4).
    fn append_one(
        &self,
        stored_from_geometry: DAffine3,
        material: u32,
        meshes: &mut Meshes,
        dropped: &mut DroppedTriangles,
    ) {
        let linear = stored_from_geometry.matrix3;
        let mirrored = linear.determinant() < 0.0;
        let normal_map = cofactor(linear) * if mirrored { -1.0 } else { 1.0 };
        let stored: Vec<Vec3> =
            self.positions.iter().map(|&p| stored_from_geometry.transform_point3(p).as_vec3()).collect();
        let mut appended_as = vec![None; stored.len()];
        for &[a, b, c] in &self.triangles {
            let triangle = if mirrored { [a, c, b] } else { [a, b, c] };
            let corners = triangle.map(|v| stored[v as usize]);
            if !corners.iter().all(|corner| corner.is_finite()) {
                dropped.non_finite += 1;
                continue;
            }
            if doubled_area(corners) == 0.0 {
                dropped.zero_area += 1;
                continue;
            }
            meshes.triangles.push(triangle.map(|v| {
                let v = v as usize;
                *appended_as[v].get_or_insert_with(|| {
                    meshes.positions.push(stored[v]);
                    meshes.attributes.push(self.attributes(v, normal_map));
                    if let Some(&tangent) = self.tangents.get(v) {
                        meshes.tangents.resize(meshes.positions.len() - 1, Vec4::ZERO);
                        meshes.tangents.push(placed_tangent(tangent, linear, mirrored));
                    }
                    meshes.positions.len() as u32 - 1
                })
            }));
            meshes.triangle_materials.push(material);
        }
    }

    /// Attributes of vertex `v`. What is not a number in the file becomes what it would be without the attribute.
    fn attributes(&self, v: usize, normal_map: DMat3) -> VertexAttributes {
        let uv = |set: usize| self.uv[set].get(v).map_or(Vec2::ZERO, |&uv| Vec2::from(uv));
        let uv = [uv(0), uv(1)].map(|uv| if uv.is_finite() { uv } else { Vec2::ZERO });
        let colour = self.colours.get(v).map_or(Vec4::ONE, |&colour| Vec4::from(colour));
        let colour = if colour.is_finite() { colour.max(Vec4::ZERO) } else { Vec4::ONE };
        let normal = (normal_map * self.normals[v]).normalize_or_zero().as_vec3();
        VertexAttributes { normal, uv, colour }
    }
}

/// A tangent under a linear map. It moves with the surface, and so does the bitangent; where the map mirrors, that stands
/// on the other side of normal and tangent.
fn placed_tangent(tangent: DVec4, linear: DMat3, mirrored: bool) -> Vec4 {
    let along = (linear * tangent.truncate()).normalize_or_zero().as_vec3();
    let sign = if (tangent.w < 0.0) != mirrored { -1.0 } else { 1.0 };
    if along.is_finite() { along.extend(sign) } else { Vec4::ZERO }
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

/// Twice the area of a triangle.
fn doubled_area([a, b, c]: [Vec3; 3]) -> f64 {
    (b.as_dvec3() - a.as_dvec3()).cross(c.as_dvec3() - a.as_dvec3()).length()
}

/// The matrix of cofactors, determinant x inverse transpose: it carries normals even where there is no inverse.
pub fn cofactor(m: DMat3) -> DMat3 {
    DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis))
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

    #[test]
    fn cofactors_are_the_determinant_times_the_inverse_transpose() {
        let m = DMat3::from_cols_array(&[2.0, 0.5, 0.0, -1.0, 3.0, 0.25, 0.0, 1.0, -4.0]);
        assert!(cofactor(m).abs_diff_eq(m.inverse().transpose() * m.determinant(), 1e-12));
    }
}
