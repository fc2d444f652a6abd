//! Boxes of primitives: conservative, finite, and as small as the opacity allows.

use glam::Vec3;

use crate::scene::{Meshes, Splats};

/// An axis-aligned box, in metres relative to the scene origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Box3 {
    /// Lower corner.
    pub min: Vec3,
    /// Upper corner.
    pub max: Vec3,
}

/// Boxes end here: 1e15 m squared stays far inside f32, and obvhs's surface areas stay finite.
const REACH: f32 = 1e15;

impl Box3 {
    /// The box of no points.
    pub const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    /// The smallest box around both.
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// Half the surface area, in square metres; 0 for the empty box.
    pub fn half_area(self) -> f32 {
        let edge = (self.max - self.min).max(Vec3::ZERO);
        edge.x * edge.y + edge.y * edge.z + edge.z * edge.x
    }

    /// Rounds outward by a few units in the last place (slab tests are not exact) and forces finite corners:
    /// obvhs indexes out of bounds on NaN and infinity. A box with a NaN corner becomes unbounded, which is slow
    /// but never wrong.
    fn padded(self) -> Self {
        let pad = |corner: Vec3| corner.abs() * (4.0 * f32::EPSILON) + Vec3::splat(f32::MIN_POSITIVE);
        let (min, max) = (self.min - pad(self.min), self.max + pad(self.max));
        let lower = |x: f32| if x >= -REACH { x.min(REACH) } else { -REACH };
        let upper = |x: f32| if x <= REACH { x.max(-REACH) } else { REACH };
        Self {
            min: Vec3::new(lower(min.x), lower(min.y), lower(min.z)),
            max: Vec3::new(upper(max.x), upper(max.y), upper(max.z)),
        }
    }
}

/// The box of the ellipsoid outside which Gaussian `i` responds with less than 1/255.
///
/// The ellipsoid `|M (p - mu)| <= r` reaches `r sqrt(Sigma_aa)` along axis a. A Gaussian whose peak is below the
/// threshold never contributes; its box is its mean.
pub fn gaussian_box(splats: &Splats, i: usize) -> Box3 {
    let radius = Splats::support_radius_squared(splats.opacities[i]).max(0.0).sqrt();
    let covariance = splats.covariance(i);
    let variances = glam::DVec3::new(covariance.x_axis.x, covariance.y_axis.y, covariance.z_axis.z);
    let reach = glam::DVec3::new(variances.x.sqrt(), variances.y.sqrt(), variances.z.sqrt()) * radius;
    let mean = splats.means[i].as_dvec3();
    Box3 { min: (mean - reach).as_vec3(), max: (mean + reach).as_vec3() }.padded()
}

/// The box of triangle `i`.
pub fn triangle_box(meshes: &Meshes, i: usize) -> Box3 {
    let [a, b, c] = meshes.corners(i);
    Box3 { min: a.min(b).min(c), max: a.max(b).max(c) }.padded()
}
