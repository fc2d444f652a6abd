//! The GGX distribution of microfacet normals with Smith's masking, isotropic or not.
//!
//! All directions are of unit length in the local frame whose z axis is the normal; both of a pair lie above it, z > 0.
//! Sources: Walter et al. 2007 (the distribution), Heitz 2014 (masking, eq. 72, 86 and 99), Dupuy and Benyoub 2023
//! (sampling of visible normals by spherical caps).

use std::f32::consts::PI;

use glam::{Vec2, Vec3};

/// A distribution of microfacet normals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ggx {
    /// Widths along x and y.
    alpha: Vec2,
}

/// Narrower distributions than this are mirrors: their lobe is a twentieth of a degree wide, and f32 directions still
/// resolve the narrowest that is not.
const MIRROR_BELOW: f32 = 1e-3;

impl Ggx {
    /// Of a perceptual roughness, stretched along x by `anisotropy_strength` (KHR_materials_anisotropy).
    pub fn new(roughness: f32, anisotropy_strength: f32) -> Self {
        let alpha = roughness * roughness;
        Self { alpha: Vec2::new(alpha + (1.0 - alpha) * anisotropy_strength * anisotropy_strength, alpha) }
    }

    /// Whether all normals are taken to be the surface's.
    pub fn is_mirror(&self) -> bool {
        self.alpha.y < MIRROR_BELOW
    }

    /// Density of normals per solid angle.
    pub fn distribution(&self, normal: Vec3) -> f32 {
        let stretched = (normal.truncate() / self.alpha).extend(normal.z);
        1.0 / (PI * self.alpha.x * self.alpha.y * stretched.length_squared().powi(2))
    }

    /// Smith's Lambda.
    fn lambda(&self, direction: Vec3) -> f32 {
        let slope = (self.alpha * direction.truncate()).length_squared() / (direction.z * direction.z);
        0.5 * ((1.0 + slope).sqrt() - 1.0)
    }

    /// Share of microfacets that are visible from a direction.
    pub fn masking(&self, direction: Vec3) -> f32 {
        1.0 / (1.0 + self.lambda(direction))
    }

    /// Share visible from both, heights correlated. `b` may be mirrored to the upper side.
    pub fn masking_shadowing(&self, a: Vec3, b: Vec3) -> f32 {
        1.0 / (1.0 + self.lambda(a) + self.lambda(b))
    }

    /// A normal drawn from those visible along `view`.
    pub fn sample_normal(&self, view: Vec3, random: Vec2) -> Vec3 {
        let stretched = (self.alpha * view.truncate()).extend(view.z).normalize();
        let azimuth = 2.0 * PI * random.x;
        let z = (1.0 - random.y) * (1.0 + stretched.z) - stretched.z;
        let radius = (1.0 - z * z).max(0.0).sqrt();
        let cap = Vec3::new(radius * azimuth.cos(), radius * azimuth.sin(), z);
        let half = cap + stretched;
        // Of visible normals only z = 0 itself can round to below the horizon.
        (self.alpha * half.truncate()).extend(half.z.max(1e-7)).normalize()
    }
}

/// The direction that `view` is mirrored to by `normal`.
pub(super) fn reflect(view: Vec3, normal: Vec3) -> Vec3 {
    2.0 * view.dot(normal) * normal - view
}

/// The direction that light seen along `view` comes from through an interface; `eta` is the index of refraction on the
/// far side divided by that on the view's side. `None` when it is reflected totally.
pub(super) fn refract(view: Vec3, normal: Vec3, eta: f32) -> Option<Vec3> {
    let cosine = view.dot(normal);
    let sine_squared = (1.0 - cosine * cosine).max(0.0) / (eta * eta);
    (sine_squared < 1.0).then(|| ((cosine / eta - (1.0 - sine_squared).sqrt()) * normal - view / eta).normalize())
}
