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

impl Parameters {
    /// With every value taken to the nearest in its range, and to the range's lower end where it is not a number.
    pub(super) fn in_range(&self) -> Self {
        let share = |value: f32| value.max(0.0).min(1.0);
        let colour = |colour: Vec3| colour.map(|value| value.max(0.0).min(1.0));
        let positive = |value: f32| value.max(0.0).min(f32::MAX);
        let ior = |value: f32| value.max(1.0).min(MAX_IOR);
        Self {
            base_colour: colour(self.base_colour),
            metallic: share(self.metallic),
            roughness: share(self.roughness),
            ior: if self.ior == 0.0 { 0.0 } else { ior(self.ior) },
            specular: share(self.specular),
            specular_colour: self.specular_colour.map(positive),
            clearcoat: share(self.clearcoat),
            clearcoat_roughness: share(self.clearcoat_roughness),
            sheen_colour: colour(self.sheen_colour),
            sheen_roughness: share(self.sheen_roughness),
            transmission: share(self.transmission),
            thickness: positive(self.thickness),
            anisotropy_strength: share(self.anisotropy_strength),
            anisotropy_rotation: if self.anisotropy_rotation.is_finite() { self.anisotropy_rotation } else { 0.0 },
            iridescence: share(self.iridescence),
            iridescence_ior: ior(self.iridescence_ior),
            iridescence_thickness_nm: positive(self.iridescence_thickness_nm),
            dispersion: positive(self.dispersion),
            attenuation_colour: colour(self.attenuation_colour),
            attenuation_distance: self.attenuation_distance,
        }
    }

    /// Share of light that is left after `distance` metres inside the volume (KHR_materials_volume).
    pub fn attenuation(&self, distance: f32) -> Vec3 {
        // Infinite, absent and broken distances do not attenuate.
        let exponent = distance / self.attenuation_distance;
        if !(exponent > 0.0 && self.attenuation_distance > 0.0) {
            return Vec3::ONE;
        }
        self.attenuation_colour.map(|channel| channel.max(0.0).min(1.0).powf(exponent))
    }

    /// The same material as one channel (0, 1, 2 for red, green, blue) is refracted by it (KHR_materials_dispersion).
    pub fn dispersed(&self, channel: usize) -> Self {
        let half_spread = (self.ior - 1.0) * 0.025 * self.dispersion;
        Self { ior: self.ior + half_spread * (channel as f32 - 1.0), dispersion: 0.0, ..*self }
    }
}

/// More than any material has; the tables end in the vicinity.
const MAX_IOR: f32 = 100.0;
