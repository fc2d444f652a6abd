//! Tangents of primitives whose material needs them and whose file has none: MikkTSpace, as glTF asks.

use std::collections::BTreeMap;

use bevy_mikktspace::{Geometry as Faces, TangentSpace, generate_tangents};
use glam::{DVec3, DVec4, Vec3};

use super::geometry::Geometry;

/// Gives every vertex of `geometry` the tangent of its faces, for texture coordinates `uv_set`. A vertex whose faces do
/// not agree on one is split. Without such coordinates nothing changes: no direction in the surface is better than another.
pub fn generate(geometry: &mut Geometry, uv_set: u8) {
    if geometry.uv[usize::from(uv_set)].is_empty() {
        return;
    }
    let mut faces =
        MikkFaces { geometry, uv_set: usize::from(uv_set), tangents: vec![[0.0; 4]; geometry.triangles.len() * 3] };
    if generate_tangents(&mut faces).is_err() {
        return;
    }
    let tangents = faces.tangents;
    assign(geometry, &tangents);
}

/// Stores the tangents of all corners, three for each triangle.
fn assign(geometry: &mut Geometry, of_corners: &[[f32; 4]]) {
    let mut of_vertices = vec![None; geometry.positions.len()];
    let mut split: BTreeMap<(u32, [u32; 4]), u32> = BTreeMap::new();
    let mut triangles = std::mem::take(&mut geometry.triangles);
    for (corner, &tangent) in triangles.as_flattened_mut().iter_mut().zip(of_corners) {
        let vertex = *corner as usize;
        match of_vertices[vertex] {
            None => of_vertices[vertex] = Some(tangent),
            Some(first) if first == tangent => {}
            Some(_) => {
                let key = (*corner, tangent.map(f32::to_bits));
                *corner = *split.entry(key).or_insert_with(|| {
                    of_vertices.push(Some(tangent));
                    geometry.repeat_vertex(vertex)
                });
            }
        }
    }
    geometry.triangles = triangles;
    let tangents = of_vertices.into_iter().map(|tangent| DVec4::from(tangent.unwrap_or([0.0; 4]).map(f64::from)));
    geometry.tangents = tangents.collect();
}

/// What is not a number becomes 0: such triangles are dropped later, and until then nothing may compare with them.
fn finite<const N: usize>(values: [f32; N]) -> [f32; N] {
    values.map(|value| if value.is_finite() { value } else { 0.0 })
}

/// A primitive as MikkTSpace sees it.
struct MikkFaces<'a> {
    geometry: &'a Geometry,
    uv_set: usize,
    /// Unit xyz and the bitangent's sign, three for each triangle.
    tangents: Vec<[f32; 4]>,
}

impl MikkFaces<'_> {
    fn vertex(&self, face: usize, corner: usize) -> usize {
        self.geometry.triangles[face][corner] as usize
    }
}

impl Faces for MikkFaces<'_> {
    fn num_faces(&self) -> usize {
        self.geometry.triangles.len()
    }

    fn num_vertices_of_face(&self, _face: usize) -> usize {
        3
    }

    fn position(&self, face: usize, corner: usize) -> [f32; 3] {
        finite(self.geometry.positions[self.vertex(face, corner)].as_vec3().to_array())
    }

    fn normal(&self, face: usize, corner: usize) -> [f32; 3] {
        let normal = self.geometry.normals[self.vertex(face, corner)];
        if normal != DVec3::ZERO {
            return finite(normal.normalize_or_zero().as_vec3().to_array());
        }
        // Flat, as the surface is shaded without normals.
        let [a, b, c] = self.geometry.triangles[face].map(|v| self.geometry.positions[v as usize]);
        finite((b - a).cross(c - a).normalize_or_zero().as_vec3().to_array())
    }

    fn tex_coord(&self, face: usize, corner: usize) -> [f32; 2] {
        finite(self.geometry.uv[self.uv_set][self.vertex(face, corner)])
    }

    fn set_tangent(&mut self, space: Option<TangentSpace>, face: usize, corner: usize) {
        let Some(space) = space else { return };
        let [x, y, z, sign] = space.tangent_encoded();
        let unit = Vec3::new(x, y, z).normalize_or_zero();
        // MikkTSpace counts texture coordinates from the bottom up, glTF from the top down.
        self.tangents[face * 3 + corner] = [unit.x, unit.y, unit.z, -sign];
    }
}
