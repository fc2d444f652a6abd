//! Triangles of all mesh inputs, flattened into world space, with their materials and textures.

use std::ops::Range;

use glam::{Vec2, Vec3, Vec4};

use super::bounds::Bounds;
use super::material::Material;
use super::texture::Texture;
use crate::Result;

/// All triangles of the scene with what their surfaces need.
#[derive(Debug, Default, Clone)]
pub struct Meshes {
    /// Vertex positions, in metres relative to the scene origin.
    pub positions: Vec<Vec3>,
    /// Vertex attributes, one per position.
    pub attributes: Vec<VertexAttributes>,
    /// Tangents of the vertices whose material needs them: unit xyz, and the bitangent's sign in w, so that the bitangent
    /// is `cross(normal, tangent) * w`. Zero for a vertex without one; ends after the last vertex that has one.
    pub tangents: Vec<Vec4>,
    /// Indices into `positions`, counter-clockwise seen from the front.
    pub triangles: Vec<[u32; 3]>,
    /// Index into `materials`, one per triangle.
    pub triangle_materials: Vec<u32>,
    /// First vertex of each part: what one placement of one geometry of a file became. Ascending, and parts share no
    /// vertices.
    pub part_starts: Vec<u32>,
    /// Materials of all inputs; glTF's default material is stored like any other.
    pub materials: Vec<Material>,
    /// Textures of all inputs.
    pub textures: Vec<Texture>,
    /// Where the triangles of each input end; those behind the last are of none.
    pub input_ends: Vec<usize>,
}

/// What a vertex carries beside its position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VertexAttributes {
    /// Unit normal; zero when the file has none (the face normal then serves).
    pub normal: Vec3,
    /// Texture coordinates, sets 0 and 1; (0, 0) is the first pixel of row 0.
    pub uv: [Vec2; 2],
    /// Linear vertex colour and alpha; 1 when the file has none.
    pub colour: Vec4,
}

impl Default for VertexAttributes {
    fn default() -> Self {
        Self { normal: Vec3::ZERO, uv: [Vec2::ZERO; 2], colour: Vec4::ONE }
    }
}

impl Meshes {
    /// The three corners of triangle `i`, relative to the scene origin.
    pub fn corners(&self, i: usize) -> [Vec3; 3] {
        self.triangles[i].map(|v| self.positions[v as usize])
    }

    /// The triangles of each input, in at most `count` ranges: the last one holds what is left. Some may be empty.
    pub fn triangles_by_input(&self, count: usize) -> Vec<Range<usize>> {
        let all = self.triangles.len();
        let ends = self.input_ends.iter().copied().take(count.saturating_sub(1)).chain([all]);
        let mut start = 0;
        ends.map(|end| std::mem::replace(&mut start, end)..end).collect()
    }

    /// The material of triangle `i`.
    pub fn material_of(&self, i: usize) -> &Material {
        &self.materials[self.triangle_materials[i] as usize]
    }

    /// The part that triangle `i` belongs to; 0 where parts are not known.
    pub fn part_of(&self, i: usize) -> usize {
        let vertex = self.triangles[i][0];
        self.part_starts.partition_point(|&start| start <= vertex).saturating_sub(1)
    }

    /// Bytes of vertices and triangles.
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.positions)
            + size_of_val(&*self.attributes)
            + size_of_val(&*self.tangents)
            + size_of_val(&*self.triangles)
            + size_of_val(&*self.triangle_materials)
    }

    /// The box of each part's vertices, in metres relative to the scene origin; `None` for a part without any. Meshes whose
    /// parts are not known are one.
    pub fn part_bounds(&self) -> Vec<Option<Bounds>> {
        let first = if self.part_starts.is_empty() { &[0][..] } else { &self.part_starts };
        let ends = first.iter().skip(1).copied().chain([self.positions.len() as u32]);
        let parts = first.iter().zip(ends).map(|(&start, end)| &self.positions[start as usize..end as usize]);
        parts.map(|part| Bounds::of(part.iter().map(|position| position.as_dvec3()))).collect()
    }

    /// The tangent of vertex `v`; zero when it has none.
    pub fn tangent_of(&self, v: usize) -> Vec4 {
        self.tangents.get(v).copied().unwrap_or(Vec4::ZERO)
    }

    /// The first texture whose pixels a ray asked for and that has none, as an error.
    pub fn check_textures(&self) -> Result<()> {
        self.textures.iter().find_map(|texture| texture.image.failure()).map_or(Ok(()), |broken| Err(broken.to_error()))
    }

    /// Puts the triangles in `order`: element k becomes what was element `order[k]`. `order` must be a permutation that
    /// leaves every triangle in its part.
    pub fn reorder_triangles(&mut self, order: &[u32]) {
        self.triangles = order.iter().map(|&i| self.triangles[i as usize]).collect();
        self.triangle_materials = order.iter().map(|&i| self.triangle_materials[i as usize]).collect();
    }
}
