//! The sheen of cloth: KHR_materials_sheen's "Charlie" distribution and masking (Conty and Kulla 2017).

use std::f32::consts::PI;

use glam::Vec3;

/// Roughness under which the distribution is not resolved any more: all of its normals lie within 3 degrees of the horizon.
const LEAST_ROUGHNESS: f32 = 0.07;

/// What white sheen reflects from `wi` to `wo`, times the cosine of `wi`; both above the surface.
pub(super) fn evaluate(wo: Vec3, wi: Vec3, roughness: f32) -> f32 {
    let alpha = roughness.max(LEAST_ROUGHNESS).powi(2);
    let half = (wo + wi).normalize_or(Vec3::Z);
    let sine_squared = (1.0 - half.z * half.z).max(0.0);
    let distribution = (2.0 + 1.0 / alpha) * sine_squared.powf(0.5 / alpha) / (2.0 * PI);
    distribution / ((1.0 + lambda(wo.z, alpha) + lambda(wi.z, alpha)) * 4.0 * wo.z)
}

fn lambda(cosine: f32, alpha: f32) -> f32 {
    let fit = |x: f32| {
        let smooth = (1.0 - alpha) * (1.0 - alpha);
        let mix = |rough: f32, fine: f32| rough + (fine - rough) * smooth;
        let (a, b, c) = (mix(21.5473, 25.3245), mix(3.82987, 3.32435), mix(0.19823, 0.16801));
        let (d, e) = (mix(-1.9776, -1.27393), mix(-4.32054, -4.85967));
        a / (1.0 + b * x.powf(c)) + d * x + e
    };
    if cosine < 0.5 { fit(cosine).exp() } else { (2.0 * fit(0.5) - fit((1.0 - cosine).max(0.0))).exp() }
}
