//! Undoing a tone mapper before an engine applies it.
//!
//! Where an engine tone-maps meshes and what they reflect, but shows the splats as they are, a mirror looks other than what it
//! mirrors. Light that went through the mapper's inverse comes out of the mapper as the splats are shown. The forms are those
//! of three.js (tonemapping_pars_fragment.glsl.js) and, for ACES without its factor 1/0.6, of Bevy and Babylon.js too.

use glam::{DMat3, DVec3, Vec3};

use crate::job::Tonemapper;

/// Largest radiance that is written in place of a display value that the mapper reaches only at infinity.
pub const MAX_RADIANCE: f64 = 64.0;

/// Linear light that `tonemapper` shows as `display`, linear too; 0 to [`MAX_RADIANCE`] in each channel.
pub fn inverse(tonemapper: Tonemapper, display: Vec3) -> Vec3 {
    let display = display.as_dvec3();
    let light = match tonemapper {
        Tonemapper::None => return display.as_vec3(),
        Tonemapper::Reinhard => display.map(|y| if y < 1.0 { y / (1.0 - y) } else { MAX_RADIANCE }),
        Tonemapper::Aces => ACES_INPUT.inverse() * (ACES_OUTPUT.inverse() * display).map(inverse_aces_fit),
        Tonemapper::Agx => inverse_agx(display),
        Tonemapper::PbrNeutral => inverse_pbr_neutral(display),
    };
    // A mapper's matrices take some saturated colours outside of what light can be.
    light.clamp(DVec3::ZERO, DVec3::splat(MAX_RADIANCE)).as_vec3()
}

/// Stephen Hill's fit of ACES: sRGB to the space of the curve, and back.
const ACES_INPUT: DMat3 = DMat3::from_cols(
    DVec3::new(0.59719, 0.07600, 0.02840),
    DVec3::new(0.35458, 0.90834, 0.13383),
    DVec3::new(0.04823, 0.01566, 0.83777),
);
const ACES_OUTPUT: DMat3 = DMat3::from_cols(
    DVec3::new(1.60475, -0.10208, -0.00327),
    DVec3::new(-0.53108, 1.10813, -0.07276),
    DVec3::new(-0.07367, -0.00605, 1.07602),
);

/// The positive root of `y = (v (v + 0.0245786) - 0.000090537) / (v (0.983729 v + 0.4329510) + 0.238081)`.
fn inverse_aces_fit(y: f64) -> f64 {
    // The curve tends to 1 / 0.983729, where the quadratic term is gone.
    let y = y.clamp(0.0, 1.0 / 0.983729 - 1e-3);
    let (a, b, c) = (1.0 - 0.983729 * y, 0.0245786 - 0.4329510 * y, -0.000090537 - 0.238081 * y);
    (-b + (b * b - 4.0 * a * c).sqrt()) / (2.0 * a)
}

/// AgX works in Rec.2020.
const SRGB_FROM_REC2020: DMat3 = DMat3::from_cols(
    DVec3::new(1.6605, -0.1246, -0.0182),
    DVec3::new(-0.5876, 1.1329, -0.1006),
    DVec3::new(-0.0728, -0.0083, 1.1187),
);
const AGX_INSET: DMat3 = DMat3::from_cols(
    DVec3::new(0.856627153315983, 0.137318972929847, 0.11189821299995),
    DVec3::new(0.0951212405381588, 0.761241990602591, 0.0767994186031903),
    DVec3::new(0.0482516061458583, 0.101439036467562, 0.811302368396859),
);
const AGX_OUTSET_INVERSE: DMat3 = DMat3::from_cols(
    DVec3::new(0.899796955911611, 0.11142098895748, 0.11142098895748),
    DVec3::new(0.0871996192028351, 0.875575586156966, 0.0871996192028349),
    DVec3::new(0.013003424885555, 0.0130034248855548, 0.801379391839686),
);
const AGX_EV: [f64; 2] = [-12.47393, 4.026069];

fn agx_contrast(x: f64) -> f64 {
    const COEFFICIENTS: [f64; 7] = [15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232];
    COEFFICIENTS.into_iter().fold(0.0, |sum, coefficient| sum * x + coefficient)
}

fn inverse_agx(display: DVec3) -> DVec3 {
    let rec2020 = SRGB_FROM_REC2020.inverse() * display;
    let curved = AGX_OUTSET_INVERSE * rec2020.max(DVec3::ZERO).map(|y| y.powf(1.0 / 2.2));
    let [low, high] = AGX_EV;
    let light = curved.map(|y| {
        // The contrast curve rises all the way; 40 bisections are beyond f32.
        let (mut below, mut above) = (0.0, 1.0);
        for _ in 0..40 {
            let middle = 0.5 * (below + above);
            if agx_contrast(middle) < y { below = middle } else { above = middle }
        }
        (low + (high - low) * below).exp2()
    });
    SRGB_FROM_REC2020 * (AGX_INSET.inverse() * light)
}

/// Khronos PBR Neutral: the analytical inverse of the steps of its specification.
fn inverse_pbr_neutral(display: DVec3) -> DVec3 {
    const START: f64 = 0.8 - 0.04;
    const DESATURATION: f64 = 0.15;
    let peak = display.max_element().min(1.0 - 1e-6);
    let uncompressed = if peak > START {
        let d = 1.0 - START;
        let light_peak = d * d / (1.0 - peak) - d + START;
        let white = 1.0 - 1.0 / (DESATURATION * (light_peak - peak) + 1.0);
        (display - white * peak) / (1.0 - white) * (light_peak / peak)
    } else {
        display
    };
    let least = uncompressed.min_element().max(0.0);
    // Fresnel's offset was x - (x - 6.25 x^2) below 0.08, and 0.04 above.
    let offset = if least < 0.04 { 0.4 * least.sqrt() - least } else { 0.04 };
    uncompressed + offset
}

#[cfg(test)]
mod tests {
    use super::*;

    fn aces_fit(v: f64) -> f64 {
        (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.4329510) + 0.238081)
    }

    /// The mappers, as their sources state them.
    fn mapped(tonemapper: Tonemapper, light: DVec3) -> DVec3 {
        match tonemapper {
            Tonemapper::None => light,
            Tonemapper::Reinhard => light / (light + 1.0),
            Tonemapper::Aces => ACES_OUTPUT * (ACES_INPUT * light).map(aces_fit),
            Tonemapper::Agx => {
                let inset = AGX_INSET * (SRGB_FROM_REC2020.inverse() * light);
                let encoded =
                    inset.map(|v| ((v.max(1e-10).log2() - AGX_EV[0]) / (AGX_EV[1] - AGX_EV[0])).clamp(0.0, 1.0));
                let outset = AGX_OUTSET_INVERSE.inverse() * encoded.map(agx_contrast);
                SRGB_FROM_REC2020 * outset.max(DVec3::ZERO).map(|v| v.powf(2.2))
            }
            Tonemapper::PbrNeutral => {
                let (start, least) = (0.76, light.min_element());
                let colour = light - if least < 0.08 { least - 6.25 * least * least } else { 0.04 };
                let peak = colour.max_element();
                if peak < start {
                    return colour;
                }
                let new_peak = 1.0 - 0.24 * 0.24 / (peak + 0.24 - start);
                let white = 1.0 - 1.0 / (0.15 * (peak - new_peak) + 1.0);
                (colour * new_peak / peak).lerp(DVec3::splat(new_peak), white)
            }
        }
    }

    #[test]
    fn light_comes_back_through_every_mapper_and_its_inverse() {
        let tonemappers =
            [Tonemapper::None, Tonemapper::Reinhard, Tonemapper::Aces, Tonemapper::Agx, Tonemapper::PbrNeutral];
        for tonemapper in tonemappers {
            for i in 0..300 {
                let light = DVec3::new(1.0, 0.3 + 0.002 * f64::from(i), 0.6) * (f64::from(i) / 40.0 - 5.0).exp2();
                let display = mapped(tonemapper, light).as_vec3();
                // What a mapper clips or nearly does cannot come back.
                if display.max_element() > 0.95 {
                    continue;
                }
                let found = inverse(tonemapper, display).as_dvec3();
                let error = ((found - light) / light.max_element()).abs().max_element();
                assert!(error < 2e-3, "{tonemapper:?}: {found} is not {light}");
            }
        }
    }

    #[test]
    fn what_no_light_shows_is_the_brightest_there_is() {
        for tonemapper in [Tonemapper::Reinhard, Tonemapper::Aces, Tonemapper::Agx, Tonemapper::PbrNeutral] {
            let light = inverse(tonemapper, Vec3::splat(4.0));
            assert!(
                light.is_finite() && light.min_element() > 5.0 && light.max_element() <= 64.0,
                "{tonemapper:?}: {light}"
            );
            let dark = inverse(tonemapper, Vec3::NEG_ONE);
            assert!(dark.min_element() >= 0.0 && dark.max_element() < 0.01, "{tonemapper:?}: {dark}");
        }
    }
}
