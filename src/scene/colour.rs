//! Colour spaces as types, and the one conversion between them.
//!
//! Splats are display-referred: KHR_gaussian_splatting asks for blending first and conversion afterwards.

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Linear radiance with Rec.709 primaries, unclamped; 1 is paper white.
#[derive(Debug, Default, Clone, Copy, PartialEq)]
pub struct LinearRgb(pub Vec3);

/// Colour as a display takes it (sRGB-encoded Rec.709), unclamped.
#[derive(Debug, Default, Clone, Copy, PartialEq)]
pub struct DisplayRgb(pub Vec3);

/// What the blended splat colours of an input mean.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum SplatEncoding {
    /// sRGB-encoded display colour: what photographs and therefore almost all captures are. The default.
    #[default]
    SrgbDisplay,
    /// Linear display colour (KHR_gaussian_splatting's `lin_rec709_display`).
    LinDisplay,
    /// Linear scene radiance, as trained from HDR or RAW captures.
    LinScene,
}

impl SplatEncoding {
    /// Linear light of a blended splat colour.
    pub fn decode(self, blended: DisplayRgb) -> LinearRgb {
        match self {
            Self::SrgbDisplay => LinearRgb(Vec3::new(
                srgb_to_linear(blended.0.x),
                srgb_to_linear(blended.0.y),
                srgb_to_linear(blended.0.z),
            )),
            Self::LinDisplay | Self::LinScene => LinearRgb(blended.0),
        }
    }
}

/// The exact sRGB transfer function from display to linear (IEC 61966-2-1), extended beyond 1 by the same power
/// curve; negative values are taken as 0.
pub fn srgb_to_linear(display: f32) -> f32 {
    if display <= 0.04045 { display.max(0.0) / 12.92 } else { ((display + 0.055) / 1.055).powf(2.4) }
}

/// The inverse of [`srgb_to_linear`], extended beyond 1 likewise.
pub fn linear_to_srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { linear.max(0.0) * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_round_trips_within_two_ulps_of_one() {
        for i in 0..=2000 {
            let display = i as f32 / 1000.0;
            assert!((linear_to_srgb(srgb_to_linear(display)) - display).abs() < 5e-7, "{display}");
        }
    }

    #[test]
    fn srgb_agrees_with_the_standards_values() {
        assert_eq!(srgb_to_linear(0.0), 0.0);
        assert!((srgb_to_linear(0.5) - 0.214_041_14).abs() < 1e-7);
        assert_eq!(srgb_to_linear(1.0), 1.0);
        assert_eq!(srgb_to_linear(-1.0), 0.0);
    }
}
