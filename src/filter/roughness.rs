//! Which roughness each mip of a chain has, by consumer. All roughnesses are perceptual: GGX alpha is their square.

use crate::job::RoughnessCurve;

/// Texels along an edge of the roughest mip for runtimes that do not say: a lobe of roughness 1 is no finer.
pub const ROUGHEST_SIZE: u32 = 4;

/// Mips of a chain from faces of `face_size` texels along an edge by halves down to `least`.
pub fn mip_count(face_size: u32, least: u32) -> u32 {
    1 + (face_size / least).max(1).ilog2()
}

impl RoughnessCurve {
    /// Perceptual roughness of mip `index` of `count`, whose faces have `face_size` texels along an edge.
    pub fn roughness(self, index: u32, count: u32, face_size: u32) -> f64 {
        let l = f64::from(index) / f64::from(count.saturating_sub(1).max(1));
        match self {
            Self::Linear => l,
            Self::Filament => 1.0 - (1.0 - l).sqrt(),
            Self::Unity => (1.7 - (1.7 * 1.7 - 2.8 * l).sqrt()) / 1.4,
            Self::Unreal => ((1.0 - f64::from(face_size).log2()) / 1.2).exp2().min(1.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chain(curve: RoughnessCurve) -> [f64; 7] {
        std::array::from_fn(|mip| curve.roughness(mip as u32, 7, 128 >> mip))
    }

    /// The values of the consumers' formulas for seven mips, to three digits; Unreal's for mip 0 of 128 px.
    #[test]
    fn curves_are_those_of_the_engines() {
        let expected = [
            (RoughnessCurve::Linear, [0.0, 0.167, 0.333, 0.5, 0.667, 0.833, 1.0]),
            (RoughnessCurve::Filament, [0.0, 0.087, 0.184, 0.293, 0.423, 0.592, 1.0]),
            (RoughnessCurve::Unity, [0.0, 0.102, 0.215, 0.342, 0.492, 0.681, 1.0]),
            (RoughnessCurve::Unreal, [0.031, 0.056, 0.099, 0.177, 0.315, 0.561, 1.0]),
        ];
        for (curve, values) in expected {
            for (found, expected) in chain(curve).into_iter().zip(values) {
                assert!((found - expected).abs() < 6e-4, "{curve:?}: {found} is not {expected}");
            }
        }
    }

    #[test]
    fn a_chain_of_one_mip_is_the_mirror() {
        for curve in [RoughnessCurve::Linear, RoughnessCurve::Filament, RoughnessCurve::Unity] {
            assert_eq!(curve.roughness(0, 1, 256), 0.0);
        }
    }
}
