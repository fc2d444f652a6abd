//! The response of a Gaussian along a ray, in f64: the definition that every faster kernel is measured against.

use glam::{DMat3, DVec3};

use crate::scene::splats::{ALPHA_MAX, ALPHA_MIN};

/// Where and how strongly a ray meets a Gaussian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Response {
    /// Distance of the strongest response from the ray's origin, in metres; negative behind it.
    pub distance: f64,
    /// `min(0.99, opacity exp(-m2 / 2))`.
    pub alpha: f64,
}

impl Response {
    /// The model's test: strong enough, and in front of `t_near`. False for NaN.
    #[inline]
    pub fn contributes(&self, t_near: f64) -> bool {
        self.alpha >= ALPHA_MIN && self.distance > t_near
    }
}

/// The response along a ray whose origin sees the mean at offset `mean_from_origin` (metres).
///
/// With `g = M (x - mu)` and `v = M d`: `t* = -(g.v)/(v.v)` and the squared Mahalanobis distance of the ray to the mean
/// is `|g x v|^2 / (v.v)` (3DGRT, Moenne-Loccoz et al. 2024, section 4.2; the cross product form does not cancel).
#[inline]
pub fn response(unit_from_world: &DMat3, opacity: f64, mean_from_origin: DVec3, direction: DVec3) -> Response {
    let g = -(*unit_from_world * mean_from_origin);
    let v = *unit_from_world * direction;
    let v_squared = v.length_squared();
    let m2 = g.cross(v).length_squared() / v_squared;
    Response { distance: -g.dot(v) / v_squared, alpha: (opacity * (-0.5 * m2).exp()).min(ALPHA_MAX) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_gaussian_responds_in_closed_form() {
        // Standard deviations 0.5, 0.2, 0.1 along the axes, mean 3 m ahead on -Z and 0.2 m to the right.
        let m = DMat3::from_diagonal(DVec3::new(2.0, 5.0, 10.0));
        let seen = response(&m, 0.8, DVec3::new(0.2, 0.0, -3.0), DVec3::NEG_Z);
        assert!((seen.distance - 3.0).abs() < 1e-15);
        assert!((seen.alpha - 0.8 * (-0.5f64 * 0.16).exp()).abs() < 1e-15);
    }

    #[test]
    fn response_does_not_depend_on_a_common_rotation() {
        let turn = DMat3::from_rotation_y(0.7) * DMat3::from_rotation_x(-1.1);
        let m = DMat3::from_diagonal(DVec3::new(2.0, 50.0, 9.0)) * DMat3::from_rotation_z(0.4);
        let (mean, direction) = (DVec3::new(0.3, -0.1, -5.0), DVec3::new(0.05, -0.02, -1.0).normalize());
        let plain = response(&m, 0.9, mean, direction);
        let turned = response(&(m * turn.transpose()), 0.9, turn * mean, turn * direction);
        assert!((plain.alpha - turned.alpha).abs() < 1e-12 && (plain.distance - turned.distance).abs() < 1e-12);
    }

    #[test]
    fn inside_a_gaussian_the_peak_may_lie_behind() {
        let seen = response(&DMat3::IDENTITY, 1.0, DVec3::new(0.0, 0.0, 0.5), DVec3::NEG_Z);
        assert_eq!(seen.distance, -0.5);
        assert!(!seen.contributes(0.0));
    }

    #[test]
    fn at_the_mean_nothing_contributes_and_nothing_is_nan() {
        let seen = response(&DMat3::IDENTITY, 1.0, DVec3::ZERO, DVec3::NEG_Z);
        assert_eq!(seen.distance, 0.0);
        assert!(!seen.contributes(0.0) && seen.alpha.is_finite());
    }
}
