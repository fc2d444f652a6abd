//! What a surface is made of: glTF 2.0 metallic-roughness with the KHR_materials_* extensions that change light.

use glam::{Mat3, Vec3, Vec4};

use super::LinearRgb;

/// A material. The default is glTF's default material: white, rough metal without textures or extensions.
///
/// Textures multiply the factors beside them; how a texture's numbers are encoded is said by the texture itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Name in the file, for messages.
    pub name: String,
    /// Linear base colour factor and alpha factor.
    pub base_colour: Vec4,
    /// Base colour and alpha texture.
    pub base_colour_texture: Option<TextureRef>,
    /// Linear emitted radiance, strength included.
    pub emissive: LinearRgb,
    /// Emissive texture.
    pub emissive_texture: Option<TextureRef>,
    /// How alpha is used.
    pub alpha: AlphaMode,
    /// Seen from both sides.
    pub double_sided: bool,
    /// KHR_materials_unlit: base colour is the radiance, emission is ignored.
    pub unlit: bool,
    /// Share of metal, 0 to 1.
    pub metallic: ScalarMap,
    /// Perceptual roughness, 0 to 1.
    pub roughness: ScalarMap,
    /// Direction of the surface's fine shape.
    pub normal: Option<NormalMap>,
    /// Share of indirect light that arrives, 0 to 1.
    pub occlusion: ScalarMap,
    /// KHR_materials_ior: index of refraction, at least 1; 0 stands for full reflection at all angles.
    pub ior: f32,
    /// KHR_materials_specular: strength of the dielectric's reflection, 0 to 1.
    pub specular: ScalarMap,
    /// KHR_materials_specular: colour of the dielectric's reflection at normal incidence.
    pub specular_colour: ColourMap,
    /// KHR_materials_clearcoat.
    pub clearcoat: Clearcoat,
    /// KHR_materials_sheen.
    pub sheen: Sheen,
    /// KHR_materials_transmission: share of the light not reflected that passes instead of being scattered.
    pub transmission: ScalarMap,
    /// KHR_materials_volume.
    pub volume: Volume,
    /// KHR_materials_anisotropy.
    pub anisotropy: Anisotropy,
    /// KHR_materials_iridescence.
    pub iridescence: Iridescence,
    /// KHR_materials_dispersion: 20 / Abbe number; 0 for none.
    pub dispersion: f32,
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
            metallic: 1.0.into(),
            roughness: 1.0.into(),
            normal: None,
            occlusion: 1.0.into(),
            ior: 1.5,
            specular: 1.0.into(),
            specular_colour: ColourMap::new(Vec3::ONE),
            clearcoat: Clearcoat { factor: 0.0.into(), roughness: 0.0.into(), normal: None },
            sheen: Sheen { colour: ColourMap::new(Vec3::ZERO), roughness: 0.0.into() },
            transmission: 0.0.into(),
            volume: Volume {
                thickness: 0.0.into(),
                attenuation_colour: LinearRgb(Vec3::ONE),
                attenuation_distance: f32::INFINITY,
            },
            anisotropy: Anisotropy { strength: 0.0, rotation: 0.0, texture: None },
            iridescence: Iridescence { factor: 0.0.into(), ior: 1.3, thickness_nm: 400.0.into() },
            dispersion: 0.0,
        }
    }
}

impl Material {
    /// The set of texture coordinates whose tangents the material needs; `None` when it needs none.
    pub fn tangent_uv_set(&self) -> Option<u8> {
        let of_normal = |map: &Option<NormalMap>| map.map(|map| map.texture.uv_set);
        let anisotropic = self.anisotropy.strength != 0.0;
        let of_anisotropy = anisotropic.then(|| self.anisotropy.texture.map_or(0, |texture| texture.uv_set));
        of_normal(&self.normal).or(of_normal(&self.clearcoat.normal)).or(of_anisotropy)
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
    /// Index into [`Meshes::textures`](super::Meshes::textures).
    pub texture: u32,
    /// Which of [`VertexAttributes::uv`](super::mesh::VertexAttributes::uv).
    pub uv_set: u8,
    /// KHR_texture_transform as a homogeneous 2D matrix applied to uv; identity when absent.
    pub uv_from_uv: Mat3,
}

/// A channel of a texture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channel {
    /// Red.
    R,
    /// Green.
    G,
    /// Blue.
    B,
    /// Alpha.
    A,
}

/// A number that a channel of a texture may vary: `offset + factor * channel`. Without a texture the channel is 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScalarMap {
    /// What is added: 0 in most uses.
    pub offset: f32,
    /// What the channel is multiplied with.
    pub factor: f32,
    /// The channel.
    pub texture: Option<(TextureRef, Channel)>,
}

impl From<f32> for ScalarMap {
    fn from(factor: f32) -> Self {
        Self { offset: 0.0, factor, texture: None }
    }
}

/// A linear colour that a texture may vary: factor times texture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColourMap {
    /// Linear factor.
    pub factor: Vec3,
    /// The texture.
    pub texture: Option<TextureRef>,
}

impl ColourMap {
    /// One colour everywhere.
    pub fn new(factor: Vec3) -> Self {
        Self { factor, texture: None }
    }
}

/// Normals in tangent space: x along the tangent, y along the bitangent, z out of the surface, each stored as
/// `(value + 1) / 2`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalMap {
    /// The texture; its numbers are not sRGB-encoded.
    pub texture: TextureRef,
    /// Factor of x and y.
    pub scale: f32,
}

/// KHR_materials_clearcoat: a colourless dielectric layer on top.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clearcoat {
    /// Intensity, 0 to 1; 0 for none.
    pub factor: ScalarMap,
    /// Perceptual roughness.
    pub roughness: ScalarMap,
    /// The layer's own normals; without them it follows the geometry, not the material's normal map.
    pub normal: Option<NormalMap>,
}

/// KHR_materials_sheen: fibres that scatter light at grazing angles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sheen {
    /// Colour; black for none.
    pub colour: ColourMap,
    /// Perceptual roughness.
    pub roughness: ScalarMap,
}

/// KHR_materials_volume: what lies behind a surface that transmits light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Volume {
    /// 0 for a thin wall; anything above for the boundary of a volume, whose real extent a ray tracer finds by itself.
    pub thickness: ScalarMap,
    /// What white light turns into after `attenuation_distance`.
    pub attenuation_colour: LinearRgb,
    /// In metres; infinite for no attenuation.
    pub attenuation_distance: f32,
}

/// KHR_materials_anisotropy: roughness that depends on the direction in the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anisotropy {
    /// 0 to 1; 0 for none.
    pub strength: f32,
    /// Radians, counter-clockwise from the tangent.
    pub rotation: f32,
    /// Red and green: the direction, stored as `(value + 1) / 2`; blue: a factor of the strength.
    pub texture: Option<TextureRef>,
}

/// KHR_materials_iridescence: interference in a thin film.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Iridescence {
    /// Intensity, 0 to 1; 0 for none.
    pub factor: ScalarMap,
    /// Index of refraction of the film.
    pub ior: f32,
    /// Thickness of the film in nanometres.
    pub thickness_nm: ScalarMap,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tangents_are_needed_for_normal_maps_and_anisotropy_alone() {
        let texture = TextureRef { texture: 0, uv_set: 1, uv_from_uv: Mat3::IDENTITY };
        let map = Some(NormalMap { texture, scale: 1.0 });
        let coat = Clearcoat { normal: map, ..Material::default().clearcoat };
        let brushed = Anisotropy { strength: 0.5, rotation: 0.0, texture: None };
        assert_eq!(Material { base_colour_texture: Some(texture), ..Material::default() }.tangent_uv_set(), None);
        assert_eq!(Material { normal: map, ..Material::default() }.tangent_uv_set(), Some(1));
        assert_eq!(Material { clearcoat: coat, ..Material::default() }.tangent_uv_set(), Some(1));
        assert_eq!(Material { anisotropy: brushed, ..Material::default() }.tangent_uv_set(), Some(0));
    }
}
