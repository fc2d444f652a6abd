//! Triangles, materials and textures of all mesh inputs, flattened into world space.

use std::sync::Arc;

use glam::{Mat3, Vec2, Vec3, Vec4};

use super::LinearRgb;

/// All triangles of the scene with what their surfaces need.
#[derive(Debug, Default, Clone)]
pub struct Meshes {
    /// Vertex positions, in metres relative to the scene origin.
    pub positions: Vec<Vec3>,
    /// Vertex attributes, one per position.
    pub attributes: Vec<VertexAttributes>,
    /// Indices into `positions`, counter-clockwise seen from the front.
    pub triangles: Vec<[u32; 3]>,
    /// Index into `materials`, one per triangle.
    pub triangle_materials: Vec<u32>,
    /// Materials of all inputs; glTF's default material is stored like any other.
    pub materials: Vec<Material>,
    /// Textures of all inputs.
    pub textures: Vec<Texture>,
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

/// A glTF 2.0 material, the part that leaves light without being lit.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Name in the file, for messages.
    pub name: String,
    /// Linear base colour factor and alpha factor.
    pub base_colour: Vec4,
    /// Base colour texture (sRGB-encoded colour, linear alpha).
    pub base_colour_texture: Option<TextureRef>,
    /// Linear emitted radiance, strength included.
    pub emissive: LinearRgb,
    /// Emissive texture (sRGB-encoded).
    pub emissive_texture: Option<TextureRef>,
    /// How alpha is used.
    pub alpha: AlphaMode,
    /// Seen from both sides.
    pub double_sided: bool,
    /// KHR_materials_unlit: base colour is the radiance, emission is ignored.
    pub unlit: bool,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            name: String::new(),
            base_colour: Vec4::ONE,
            base_colour_texture: None,
            emissive: LinearRgb::default(),
            emissive_texture: None,
            alpha: AlphaMode::Opaque,
            double_sided: false,
            unlit: false,
        }
    }
}

/// glTF's alphaMode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AlphaMode {
    /// Alpha is ignored; the surface ends the ray.
    Opaque,
    /// Present where alpha is at least the cutoff, absent elsewhere.
    Mask {
        /// alphaCutoff.
        cutoff: f32,
    },
    /// Composited by alpha.
    Blend,
}

/// A use of a texture: which one, by which coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TextureRef {
    /// Index into [`Meshes::textures`].
    pub texture: u32,
    /// Which of [`VertexAttributes::uv`].
    pub uv_set: u8,
    /// KHR_texture_transform as a homogeneous 2D matrix applied to uv; identity when absent.
    pub uv_from_uv: Mat3,
}

/// An image with its sampler.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    /// Pixels per row.
    pub width: u32,
    /// Rows; row 0 is the top of the image.
    pub height: u32,
    /// RGBA, 8 bit, row by row, as the file encodes them (colour sRGB-encoded, alpha linear). Textures that differ
    /// only in their sampler share it.
    pub rgba: Arc<[[u8; 4]]>,
    /// Wrapping in u and v.
    pub wrap: [Wrap; 2],
    /// Nearest pixel instead of bilinear.
    pub nearest: bool,
}

/// glTF's wrap modes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wrap {
    /// REPEAT, the default.
    Repeat,
    /// CLAMP_TO_EDGE.
    Clamp,
    /// MIRRORED_REPEAT.
    Mirror,
}

impl Meshes {
    /// The three corners of triangle `i`, relative to the scene origin.
    pub fn corners(&self, i: usize) -> [Vec3; 3] {
        self.triangles[i].map(|v| self.positions[v as usize])
    }

    /// The material of triangle `i`.
    pub fn material_of(&self, i: usize) -> &Material {
        &self.materials[self.triangle_materials[i] as usize]
    }

    /// Puts the triangles in `order`: element k becomes what was element `order[k]`. `order` must be a permutation.
    pub fn reorder_triangles(&mut self, order: &[u32]) {
        self.triangles = order.iter().map(|&i| self.triangles[i as usize]).collect();
        self.triangle_materials = order.iter().map(|&i| self.triangle_materials[i as usize]).collect();
    }
}
