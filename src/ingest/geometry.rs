//! Triangles on their way into the scene: placed, mirrored where their placement mirrors, and checked.

use std::path::Path;

use glam::{DAffine3, DMat3, DVec3, DVec4, Vec2, Vec3, Vec4};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::scene::bounds::Bounds;
use crate::scene::mesh::{Meshes, VertexAttributes};
use crate::{Error, Result};

/// Most vertices and most triangles of a scene: instances multiply what a small file holds.
pub const MAX_ELEMENTS: usize = 1 << 27;

/// Triangles that were left out, by reason.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub struct DroppedTriangles {
    /// All corners on one line.
    pub zero_area: usize,
    /// A corner that is not a number, or too far away for f32.
    pub non_finite: usize,
}

/// Vertices in the coordinates that their file gives them in, and triangles counter-clockwise seen from the front.
#[derive(Default)]
pub struct Geometry {
    /// One per vertex.
    pub positions: Vec<DVec3>,
    /// One per vertex; zero where the file has none.
    pub normals: Vec<DVec3>,
    /// Texture coordinates, sets 0 and 1: one per vertex, or empty.
    pub uv: [Vec<[f32; 2]>; 2],
    /// Tangents and the signs of the bitangents, one per vertex or none at all. Only there where a material needs them.
    pub tangents: Vec<DVec4>,
    /// Linear, with alpha: one per vertex, or empty.
    pub colours: Vec<[f32; 4]>,
    /// Each of three vertices, all of which there are.
    pub triangles: Vec<[u32; 3]>,
}

impl Geometry {
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
    /// Refuses what would pass [`MAX_ELEMENTS`], in the name of `path`, before it computes or stores anything.
    pub fn append(
        &self,
        path: &Path,
        stored_from_geometry: &[DAffine3],
        material: u32,
        meshes: &mut Meshes,
        dropped: &mut DroppedTriangles,
    ) -> Result<()> {
        let stored = meshes.positions.len().max(meshes.triangles.len());
        let each = self.positions.len().max(self.triangles.len());
        if stored.saturating_add(each.saturating_mul(stored_from_geometry.len())) > MAX_ELEMENTS {
            let what =
                format!("more than {MAX_ELEMENTS} vertices or triangles in one scene, instances counted; simplify it");
            return Err(Error::unsupported(path, what));
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
        meshes.part_starts.push(meshes.positions.len() as u32);
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

/// The box, in the world, of the vertices of `meshes` from `first_vertex` on.
pub fn bounds(meshes: &Meshes, first_vertex: usize, origin: DVec3) -> Option<Bounds> {
    let positions = &meshes.positions[first_vertex..];
    let first = positions.first()?;
    let (min, max) = positions.iter().fold((*first, *first), |(min, max), &p| (min.min(p), max.max(p)));
    Some(Bounds { min: origin + min.as_dvec3(), max: origin + max.as_dvec3() })
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
    fn cofactors_are_the_determinant_times_the_inverse_transpose() {
        let m = DMat3::from_cols_array(&[2.0, 0.5, 0.0, -1.0, 3.0, 0.25, 0.0, 1.0, -4.0]);
        assert!(cofactor(m).abs_diff_eq(m.inverse().transpose() * m.determinant(), 1e-12));
    }
}
