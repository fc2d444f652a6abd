//! Reflectance of interfaces: dielectric, metal, thin film.

use std::f32::consts::PI;

use glam::{Mat3, Vec3};

/// Unpolarised reflectance of a dielectric interface (Fresnel's equations); `eta` is the index of refraction on the far side
/// divided by that on the near side, `cosine` that of the angle of incidence. 1 beyond the critical angle.
pub(super) fn dielectric(cosine: f32, eta: f32) -> f32 {
    let sine_squared = (1.0 - cosine * cosine) / (eta * eta);
    if sine_squared >= 1.0 {
        return 1.0;
    }
    let refracted = (1.0 - sine_squared).sqrt();
    let parallel = (eta * cosine - refracted) / (eta * cosine + refracted);
    let perpendicular = (cosine - eta * refracted) / (cosine + eta * refracted);
    if cosine <= 0.0 { 1.0 } else { 0.5 * (parallel * parallel + perpendicular * perpendicular) }
}

/// Reflectance of a dielectric interface at normal incidence.
pub(super) fn dielectric_f0(eta: f32) -> f32 {
    ((eta - 1.0) / (eta + 1.0)).powi(2)
}

/// The mean of [`dielectric`] over all directions, weighted by their cosine (Walsh 1926). What passes from the denser side
/// is what passes from the other, divided by the square of the indices' ratio.
pub(super) fn dielectric_average(eta: f32) -> f32 {
    if eta < 1.0 {
        return 1.0 - (1.0 - dielectric_average(1.0 / eta)) * eta * eta;
    }
    let n = f64::from(eta);
    // Terms of order 1 / (n - 1)^2 cancel; nearer to 1 than this, nothing is reflected.
    if n < 1.0001 {
        return 0.0;
    }
    let (n2, n3, n4) = (n * n, n.powi(3), n.powi(4));
    let rational = 0.5 + (n - 1.0) * (3.0 * n + 1.0) / (6.0 * (n + 1.0).powi(2))
        - 2.0 * n3 * (n2 + 2.0 * n - 1.0) / ((n2 + 1.0) * (n4 - 1.0));
    let first = n2 * (n2 - 1.0).powi(2) / (n2 + 1.0).powi(3) * ((n - 1.0) / (n + 1.0)).ln();
    let second = 8.0 * n4 * (n4 + 1.0) / ((n2 + 1.0) * (n4 - 1.0).powi(2)) * n.ln();
    (rational + first + second) as f32
}

/// Weight of grazing reflectance in Schlick's approximation (1994).
pub(super) fn schlick_weight(cosine: f32) -> f32 {
    (1.0 - cosine.clamp(0.0, 1.0)).powi(5)
}

/// Schlick's approximation, with a reflectance of 1 at grazing incidence.
pub(super) fn schlick(f0: Vec3, cosine: f32) -> Vec3 {
    f0 + (Vec3::ONE - f0) * schlick_weight(cosine)
}

/// The mean of Schlick's reflectance over all directions, weighted by their cosine.
pub(super) fn schlick_average(f0: Vec3) -> Vec3 {
    f0 + (Vec3::ONE - f0) / 21.0
}

/// Reflectance of a base, whose own reflectance at normal incidence is `base_f0`, under a film of `film_ior` that is
/// `thickness_nm` thick, in air, as KHR_materials_iridescence has it (Belcour and Barla 2017).
pub(super) fn thin_film(cosine: f32, film_ior: f32, thickness_nm: f32, base_f0: Vec3) -> Vec3 {
    // A film that vanishes takes the index of the air.
    let presence = (thickness_nm / 0.03).clamp(0.0, 1.0);
    let film_ior = 1.0 + (film_ior - 1.0) * presence * presence * (3.0 - 2.0 * presence);
    let sine_squared = (1.0 - cosine * cosine) / (film_ior * film_ior);
    if sine_squared >= 1.0 {
        return Vec3::ONE;
    }
    let cosine_inside = (1.0 - sine_squared).sqrt();

    let outer = schlick(Vec3::splat(dielectric_f0(film_ior)), cosine).x;
    let outer_phase = if film_ior < 1.0 { 0.0 } else { PI };
    let root = (base_f0.clamp(Vec3::ZERO, Vec3::splat(0.9999)) + 1e-4).min(Vec3::splat(0.9999)).map(f32::sqrt);
    let base_ior = (1.0 + root) / (1.0 - root);
    let inner_f0 = ((base_ior - film_ior) / (base_ior + film_ior)).powf(2.0);
    let inner = schlick(inner_f0, cosine_inside);
    let phase = outer_phase + base_ior.map(|ior| if ior < film_ior { PI } else { 0.0 });

    let path_difference = 2.0 * film_ior * thickness_nm * cosine_inside;
    let through = 1.0 - outer;
    let round_trip = (outer * inner).clamp(Vec3::splat(1e-5), Vec3::splat(0.9999));
    let amplitude = round_trip.map(f32::sqrt);
    let summed = through * through * inner / (1.0 - round_trip);
    let mut reflectance = outer + summed;
    let mut order_weight = summed - through;
    for order in [1.0, 2.0] {
        order_weight *= amplitude;
        reflectance += order_weight * 2.0 * sensitivity(order * path_difference, order * phase);
    }
    reflectance.clamp(Vec3::ZERO, Vec3::ONE)
}

/// Fourier transform of the eye's sensitivities, fitted by Gaussians and taken to linear Rec.709 (Belcour and Barla 2017,
/// section 4). `path_difference` is in nanometres.
fn sensitivity(path_difference_nm: f32, shift: Vec3) -> Vec3 {
    const XYZ: [(f32, f32, f32); 3] =
        [(5.4856e-13, 1.681e6, 4.3278e9), (4.4201e-13, 1.7953e6, 9.3046e9), (5.2481e-13, 2.2084e6, 6.6121e9)];
    let phase = 2.0 * PI * path_difference_nm * 1e-9;
    let bump = |(value, position, variance): (f32, f32, f32), shift: f32| {
        value * (2.0 * PI * variance).sqrt() * (position * phase + shift).cos() * (-phase * phase * variance).exp()
    };
    let mut xyz = Vec3::new(bump(XYZ[0], shift.x), bump(XYZ[1], shift.y), bump(XYZ[2], shift.z));
    xyz.x += bump((9.747e-14, 2.2399e6, 4.5282e9), shift.x);
    rec709_from_xyz() * (xyz / 1.0685e-7)
}

fn rec709_from_xyz() -> Mat3 {
    Mat3::from_cols(
        Vec3::new(3.240_454_2, -0.969_266, 0.055_643_4),
        Vec3::new(-1.537_138_5, 1.876_010_8, -0.204_025_9),
        Vec3::new(-0.498_531_4, 0.041_556, 1.057_225_2),
    )
}
