//! What a material says at one point of a surface: the numbers that the BSDF is made from.

use glam::Vec3;

/// A glTF 2.0 metallic-roughness material with the KHR_materials_* extensions, at one point, textures and vertex colours
/// applied. Colours are linear Rec.709 factors. The default is glTF's: white metal that is rough, without extensions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameters {
    /// Albedo of the dielectric, reflectance at normal incidence of the metal.
    pub base_colour: Vec3,
    /// Share of metal, 0 to 1.
    pub metallic: f32,
    /// Perceptual roughness, 0 to 1; its square is the width of the GGX distribution.
    pub roughness: f32,
    /// KHR_materials_ior: index of refraction, 1 or more. 0 stands for a reflectance of 1 at all angles.
    pub ior: f32,
    /// KHR_materials_specular: strength of the dielectric's reflection, 0 to 1.
    pub specular: f32,
    /// KHR_materials_specular: colour of the dielectric's reflection at normal incidence, 0 or more.
    pub specular_colour: Vec3,
    /// KHR_materials_clearcoat: intensity of the coat, 0 to 1.
    pub clearcoat: f32,
    /// Perceptual roughness of the coat.
    pub clearcoat_roughness: f32,
    /// KHR_materials_sheen: colour at grazing directions; black is no sheen.
    pub sheen_colour: Vec3,
    /// Perceptual roughness of the sheen.
    pub sheen_roughness: f32,
    /// KHR_materials_transmission: share of light that enters the surface and is not scattered back, 0 to 1.
    pub transmission: f32,
    /// KHR_materials_volume: thickness below the surface; 0 is a thin-walled surface, anything more the boundary of a
    /// volume, whose thickness is then found by tracing.
    pub thickness: f32,
    /// KHR_materials_volume: what white light becomes after `attenuation_distance`.
    pub attenuation_colour: Vec3,
    /// KHR_materials_volume: metres; infinite is no absorption.
    pub attenuation_distance: f32,
    /// KHR_materials_anisotropy: strength, 0 to 1.
    pub anisotropy_strength: f32,
    /// KHR_materials_anisotropy: direction of the stronger roughness, in radians counter-clockwise from the tangent.
    pub anisotropy_rotation: f32,
    /// KHR_materials_iridescence: intensity of the thin film, 0 to 1.
    pub iridescence: f32,
    /// Index of refraction of the film.
    pub iridescence_ior: f32,
    /// Thickness of the film, in nanometres.
    pub iridescence_thickness_nm: f32,
    /// KHR_materials_dispersion: 20 divided by the Abbe number; 0 is none.
    pub dispersion: f32,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            base_colour: Vec3::ONE,
            metallic: 1.0,
            roughness: 1.0,
            ior: 1.5,
            specular: 1.0,
            specular_colour: Vec3::ONE,
            clearcoat: 0.0,
            clearcoat_roughness: 0.0,
            sheen_colour: Vec3::ZERO,
            sheen_roughness: 0.0,
            transmission: 0.0,
            thickness: 0.0,
            attenuation_colour: Vec3::ONE,
            attenuation_distance: f32::INFINITY,
            anisotropy_strength: 0.0,
            anisotropy_rotation: 0.0,
            iridescence: 0.0,
            iridescence_ior: 1.3,
            iridescence_thickness_nm: 400.0,
            dispersion: 0.0,
        }
    }
}
