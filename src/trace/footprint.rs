//! A pixel is an area, a ray is not: Gaussians are widened to about a pixel, so that fine ones do not alias.
//!
//! Each Gaussian is convolved with an isotropic one whose standard deviation grows with the distance D from the ray's
//! origin to the mean, `sigma = sigma_per_metre D`: Mip-Splatting's 2D filter (Yu et al. 2024, section 4.2) on the sphere
//! instead of the image plane. It depends on the origin alone, not on the face or the ray, so there are no seams, and a
//! Gaussian stays a Gaussian with the same axes: only the rows of M shrink.

use glam::{DMat3, DVec3};
use pulp::Simd;

use super::batch::{BATCH, Batch, dot, scaled};
use crate::job;

/// Standard deviation of `pixel`, in edges of a texel: close to that of a square's area, `1 / sqrt(12)` = 0.29. Measured by
/// `benches/footprint.rs`: on the generated interior and on captured scenes the best of 0.2 to 0.6 at faces of 64 to 256,
/// and within a tenth of it at 32; in the interior, 0.2 and 0.4 err a third more.
pub const PIXEL_SIGMA: f64 = 0.3;

/// Variance that 3DGS adds to every Gaussian's image when it trains, in square pixels.
const TRAINED_VARIANCE: f64 = 0.3;

/// The largest Mahalanobis radius of a support, `sqrt(2 ln 255)` = 3.329, rounded up.
const SUPPORT_RADIUS_MAX: f64 = 3.33;

/// How wide what a ray stands for is, in radians, on faces of `rays_per_edge` rays squared: the root of the mean solid
/// angle of all, `sqrt(4 pi / (6 n^2))`.
pub fn ray_angle(rays_per_edge: u32) -> f64 {
    (4.0 * std::f64::consts::PI / 6.0).sqrt() / f64::from(rays_per_edge)
}

/// How Gaussians are widened before rays meet them.
#[derive(Debug, Default, Clone, Copy, PartialEq)]
pub struct Footprint {
    /// Standard deviation that is added, per metre between the ray's origin and the mean. 0, the default, adds nothing.
    pub sigma_per_metre: f64,
    /// Whether opacity is lowered so that the integral of the response over the cross-section toward the mean is kept.
    pub keeps_energy: bool,
}

impl Footprint {
    /// What a job asks for, on faces of `rays_per_edge` rays squared.
    pub fn new(asked: job::Footprint, rays_per_edge: u32) -> Self {
        match asked {
            job::Footprint::None => Self::default(),
            job::Footprint::Pixel => Self::pixel(rays_per_edge, PIXEL_SIGMA),
            job::Footprint::Train(focal) => {
                Self { sigma_per_metre: TRAINED_VARIANCE.sqrt() / focal, keeps_energy: false }
            }
        }
    }

    /// Widens by `sigma` texels of a face of `rays_per_edge` rays squared.
    pub fn pixel(rays_per_edge: u32, sigma: f64) -> Self {
        Self { sigma_per_metre: sigma * ray_angle(rays_per_edge), keeps_energy: true }
    }

    /// Whether Gaussians stay as they are.
    #[inline(always)]
    pub fn is_none(&self) -> bool {
        self.sigma_per_metre == 0.0
    }

    /// M and the opacity of a Gaussian, widened: the definition. `mean_from_origin` is in metres.
    ///
    /// `s_k^2` becomes `s_k^2 + sigma^2`, so row k of M, of length `1 / s_k`, shrinks by `sqrt(1 + sigma^2 |row_k|^2)`. The
    /// integral of `exp(-m2 / 2)` across d, the direction to the mean, is `2 pi |M d| / |det M|`.
    pub fn widened(&self, unit_from_world: &DMat3, opacity: f64, mean_from_origin: DVec3) -> (DMat3, f64) {
        let variance = self.sigma_per_metre.powi(2) * mean_from_origin.length_squared();
        if variance == 0.0 {
            return (*unit_from_world, opacity);
        }
        let rows = unit_from_world.transpose();
        let factor = |row: DVec3| (1.0 + variance * row.length_squared()).sqrt().recip();
        let factors = DVec3::new(factor(rows.x_axis), factor(rows.y_axis), factor(rows.z_axis));
        let widened = DMat3::from_diagonal(factors) * *unit_from_world;
        if !self.keeps_energy {
            return (widened, opacity);
        }
        let across = |m: &DMat3| (*m * mean_from_origin).length();
        (widened, opacity * factors.element_product() * across(unit_from_world) / across(&widened))
    }

    /// By how much more of its distance to the origin a widened Gaussian's support reaches than the unwidened one's:
    /// `sqrt(s^2 + sigma^2) <= s + sigma`, and opacities do not rise. Rounded up.
    pub(super) fn reach(&self) -> f32 {
        (SUPPORT_RADIUS_MAX * self.sigma_per_metre) as f32 * (1.0 + 1e-5)
    }

    /// Widens the Gaussians of a full batch; a batch is widened once.
    #[inline(always)]
    pub(super) fn widen<S: Simd>(&self, simd: S, batch: &mut Batch) {
        let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
        let per_metre_squared = simd.splat_f64s(self.sigma_per_metre.powi(2));
        for v in 0..BATCH / S::F64_LANES {
            let [x, y, z] = &batch.mean_from_origin;
            let mean = [x.get::<S>(v), y.get::<S>(v), z.get::<S>(v)];
            let variance = simd.mul_f64s(per_metre_squared, dot(simd, mean, mean));
            let m = &mut batch.unit_from_world;
            let [mut across, mut widened_across, mut product] = [zero, zero, one];
            for row in 0..3 {
                let m_row = [m[row].get::<S>(v), m[3 + row].get::<S>(v), m[6 + row].get::<S>(v)];
                let growth = simd.sqrt_f64s(simd.mul_add_e_f64s(variance, dot(simd, m_row, m_row), one));
                let factor = simd.div_f64s(one, growth);
                let ahead = dot(simd, m_row, mean);
                let widened_ahead = simd.mul_f64s(ahead, factor);
                across = simd.mul_add_e_f64s(ahead, ahead, across);
                widened_across = simd.mul_add_e_f64s(widened_ahead, widened_ahead, widened_across);
                product = simd.mul_f64s(product, factor);
                for (axis, entry) in scaled(simd, m_row, factor).into_iter().enumerate() {
                    m[3 * axis + row].set::<S>(v, entry);
                }
            }
            if self.keeps_energy {
                let kept = simd.mul_f64s(product, simd.sqrt_f64s(simd.div_f64s(across, widened_across)));
                // At the mean nothing is widened, and `kept` is 0 / 0.
                let kept = simd.select_f64s(simd.greater_than_f64s(widened_across, zero), kept, one);
                batch.opacity.set::<S>(v, simd.mul_f64s(batch.opacity.get::<S>(v), kept));
            }
        }
    }
}
