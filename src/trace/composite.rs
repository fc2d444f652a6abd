//! What a ray gathers, and its conversion to linear light.

use glam::{DVec3, Vec3};

use crate::scene::{DisplayRgb, LinearRgb, SplatEncoding};

use super::Fragment;

/// Front-to-back blending of one ray, in f64: `C += T alpha colour, T *= 1 - alpha`.
#[derive(Debug, Clone, Copy)]
pub struct Blender {
    splat_sum: DVec3,
    splat_weight: f64,
    surface_sum: DVec3,
    distance_sum: f64,
    /// Share of light that passes everything blended so far.
    pub transmittance: f64,
}

impl Default for Blender {
    fn default() -> Self {
        Self {
            splat_sum: DVec3::ZERO,
            splat_weight: 0.0,
            surface_sum: DVec3::ZERO,
            distance_sum: 0.0,
            transmittance: 1.0,
        }
    }
}

impl Blender {
    /// Blends a Gaussian's response, `distance` metres away.
    #[inline]
    pub fn splat(&mut self, alpha: f64, colour: DVec3, distance: f64) {
        let weight = self.advance(alpha, distance);
        self.splat_sum += colour * weight;
        self.splat_weight += weight;
    }

    /// Blends the response of a Gaussian whose colour is linear light: it joins the surfaces.
    #[inline]
    pub fn linear_splat(&mut self, alpha: f64, radiance: DVec3, distance: f64) {
        let weight = self.advance(alpha, distance);
        self.surface_sum += radiance * weight;
    }

    /// Blends a surface, `distance` metres away.
    #[inline]
    pub fn surface(&mut self, fragment: Fragment, distance: f64) {
        let weight = self.advance(f64::from(fragment.alpha), distance);
        self.surface_sum += fragment.radiance.0.as_dvec3() * weight;
    }

    fn advance(&mut self, alpha: f64, distance: f64) -> f64 {
        let weight = self.transmittance * alpha;
        self.distance_sum += weight * distance;
        self.transmittance *= 1.0 - alpha;
        weight
    }

    /// The sums so far, rounded to f32.
    pub fn finish(&self) -> Radiance {
        Radiance {
            splat_sum: self.splat_sum.as_vec3(),
            splat_weight: self.splat_weight as f32,
            surface_sum: self.surface_sum.as_vec3(),
            distance_sum: self.distance_sum as f32,
            transmittance: self.transmittance as f32,
        }
    }
}

/// Sums gathered front to back along one ray. Display-referred splats and linear surfaces stay apart, because
/// splats are blended in their own encoding and converted once, after blending.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Radiance {
    /// Sum of splat weights times splat colours, in the splats' encoding.
    pub splat_sum: Vec3,
    /// Sum of splat weights.
    pub splat_weight: f32,
    /// Sum of weights times linear radiance, of surfaces and, in a scene of mixed encodings, of linear Gaussians.
    pub surface_sum: Vec3,
    /// Sum of all weights times their distance, in metres.
    pub distance_sum: f32,
    /// Share of light that passes everything gathered.
    pub transmittance: f32,
}

impl Default for Radiance {
    fn default() -> Self {
        Self {
            splat_sum: Vec3::ZERO,
            splat_weight: 0.0,
            surface_sum: Vec3::ZERO,
            distance_sum: 0.0,
            transmittance: 1.0,
        }
    }
}

impl Radiance {
    /// Share of the ray that ended in the scene: 1 - transmittance.
    pub fn coverage(&self) -> f32 {
        1.0 - self.transmittance
    }

    /// Mean distance of what was gathered, in metres; 0 where nothing was.
    pub fn mean_distance(&self) -> f32 {
        if self.coverage() > 0.0 { self.distance_sum / self.coverage() } else { 0.0 }
    }

    /// Linear radiance: `A_s EOTF(C_s / A_s) + sum w_j L_j + T L_background`.
    pub fn to_linear(&self, encoding: SplatEncoding, background: LinearRgb) -> LinearRgb {
        let splats = if self.splat_weight > 0.0 {
            encoding.decode(DisplayRgb(self.splat_sum / self.splat_weight)).0 * self.splat_weight
        } else {
            Vec3::ZERO
        };
        LinearRgb(splats + self.surface_sum + background.0 * self.transmittance)
    }
}
