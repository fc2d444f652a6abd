//! What Gaussians respond with in the lanes of a quad.

use pulp::Simd;

use super::candidate::Candidate;
use super::deal::Listed;
use super::desk::{Colour, Entry};
use super::lanes::{LANES, Lanes, any};
use super::project::LOG2_ALPHA_MIN;
use super::quad::Quad;
use crate::job::Order;
use crate::scene::splats::ALPHA_MAX;

/// Candidates that a quad evaluates before it orders them: enough for their arithmetic to overlap, few enough not to
/// evaluate much behind an opaque surface.
pub(super) const BATCH: usize = 8;

/// Makes the entries of some Gaussians, where they respond with at least 1/255 and still count; tells how many do.
///
/// In three sweeps over the batch: the chain of one evaluation takes longer than its arithmetic, and the processor looks
/// ahead over more of them when each sweep is short. What contributes nowhere drops out before the last.
#[inline(always)]
pub(super) fn evaluate<S: Simd>(
    simd: S,
    quad: &Quad,
    chunk: &[Candidate],
    batch: &[Listed],
    order: Order,
    entries: &mut [Entry],
) -> usize {
    let by_camera = order == Order::CameraDistance;
    let (nowhere, zero, one) = (simd.splat_f32s(f32::NEG_INFINITY), simd.splat_f32s(0.0), simd.splat_f32s(1.0));
    // v.v, |p|^2 (u^2 + s^2) in units of the exponent, and |p| h.
    let mut forms = [[Lanes::splat(0.0); 3]; BATCH];
    for v in 0..LANES / S::F32_LANES {
        let (x, y) = (quad.x.get::<S>(v), quad.y.get::<S>(v));
        for (listed, [squared, fall, depth_of]) in batch.iter().zip(&mut forms) {
            let Candidate { u, s, h, falloff, depth, .. } = chunk[listed.index as usize];
            let u = affine(simd, u, x, y);
            let h = affine(simd, h, x, y);
            let s = simd.mul_add_e_f32s(simd.splat_f32s(s[1]), y, simd.splat_f32s(s[0]));
            let across = simd.mul_add_e_f32s(u, u, simd.mul_f32s(s, s));
            squared.set::<S>(v, simd.mul_add_e_f32s(h, h, across));
            fall.set::<S>(v, simd.mul_f32s(simd.splat_f32s(falloff), across));
            depth_of.set::<S>(v, simd.mul_f32s(simd.splat_f32s(depth), h));
        }
    }
    let mut made = 0;
    for (listed, [squared, fall, depth_of]) in batch.iter().zip(&forms) {
        let candidate = &chunk[listed.index as usize];
        let entry = &mut entries[made];
        let mut contributes_somewhere = false;
        for v in 0..LANES / S::F32_LANES {
            let v_squared_inverse = simd.div_f32s(one, squared.get::<S>(v));
            let fall = simd.mul_f32s(fall.get::<S>(v), v_squared_inverse);
            let exponent = simd.sub_f32s(simd.splat_f32s(candidate.log2_opacity), fall);
            let depth = simd.mul_f32s(depth_of.get::<S>(v), v_squared_inverse);
            let key = if by_camera { simd.splat_f32s(candidate.key_low) } else { depth };
            let responds = simd.greater_than_or_equal_f32s(exponent, simd.splat_f32s(LOG2_ALPHA_MIN as f32));
            let counts = simd.and_m32s(
                simd.greater_than_f32s(depth, quad.near_depth.get::<S>(v)),
                simd.less_than_or_equal_f32s(key, quad.far.get::<S>(v)),
            );
            let contributes = simd.and_m32s(responds, counts);
            contributes_somewhere |= any(simd, contributes);
            entry.key.set::<S>(v, simd.select_f32s(contributes, key, nowhere));
            entry.depth.set::<S>(v, depth);
            entry.alpha.set::<S>(v, exponent);
        }
        entry.index = candidate.index;
        entry.colour = match candidate.linear {
            true => Colour::Linear(candidate.colour),
            false => Colour::Splat(candidate.colour),
        };
        made += usize::from(contributes_somewhere);
    }
    for v in 0..LANES / S::F32_LANES {
        for entry in &mut entries[..made] {
            let alpha = simd.min_f32s(exp2(simd, entry.alpha.get::<S>(v)), simd.splat_f32s(ALPHA_MAX as f32));
            let contributes = simd.greater_than_f32s(entry.key.get::<S>(v), nowhere);
            entry.alpha.set::<S>(v, simd.select_f32s(contributes, alpha, zero));
        }
    }
    made
}

/// An affine form of the texel position.
#[inline(always)]
fn affine<S: Simd>(simd: S, form: [f32; 3], x: S::f32s, y: S::f32s) -> S::f32s {
    let constant = simd.mul_add_e_f32s(simd.splat_f32s(form[2]), y, simd.splat_f32s(form[0]));
    simd.mul_add_e_f32s(simd.splat_f32s(form[1]), x, constant)
}

/// 2^x for -126 < x < 126, to 1.5e-7 relative: `2^round(x)` through the exponent bits times a polynomial of degree 5,
/// fitted to least relative error (7.5e-8) on [-1/2, 1/2].
#[inline(always)]
fn exp2<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    const COEFFICIENTS: [f32; 6] =
        [1.000_000_1, 0.693_146_97, 0.240_221_2, 0.055_507_133, 0.009_675_541, 0.001_327_647_2];
    // Adding 1.5 * 2^23 rounds to an integer and leaves it in the low bits of the mantissa.
    let magic = simd.splat_f32s(12_582_912.0);
    let rounded = simd.add_f32s(x, magic);
    let fraction = simd.sub_f32s(x, simd.sub_f32s(rounded, magic));
    let mut power = simd.splat_f32s(COEFFICIENTS[5]);
    for coefficient in COEFFICIENTS[..5].iter().rev() {
        power = simd.mul_add_e_f32s(power, fraction, simd.splat_f32s(*coefficient));
    }
    let exponent = simd.wrapping_dyn_shl_u32s(simd.transmute_u32s_f32s(rounded), simd.splat_u32s(23));
    simd.transmute_f32s_u32s(simd.add_u32s(simd.transmute_u32s_f32s(power), exponent))
}

#[cfg(test)]
mod tests {
    use pulp::WithSimd;

    use super::*;
    use crate::scene::splats::ALPHA_MIN;
    use crate::trace::level::Level;

    struct Powers<'a>(&'a [f32], &'a mut [f32]);

    impl WithSimd for Powers<'_> {
        type Output = ();

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            let (inputs, outputs) = (S::as_simd_f32s(self.0).0, S::as_mut_simd_f32s(self.1).0);
            for (x, power) in inputs.iter().zip(outputs) {
                *power = exp2(simd, *x);
            }
        }
    }

    #[test]
    fn exp2_is_good_to_two_ulps_at_every_level_over_the_range_of_responses() {
        let inputs: Vec<f32> = (0..16_000).map(|i| -10.0 + i as f32 / 1600.0).collect();
        for level in Level::available() {
            let mut outputs = vec![0.0; inputs.len()];
            level.run(Powers(&inputs, &mut outputs));
            for (x, power) in inputs.iter().zip(&outputs) {
                let exact = f64::from(*x).exp2();
                assert!((f64::from(*power) / exact - 1.0).abs() < 2.4e-7, "{} 2^{x}", level.name());
            }
        }
    }

    #[test]
    fn the_threshold_in_log2_is_the_models() {
        assert!((f64::from(LOG2_ALPHA_MIN as f32) - ALPHA_MIN.log2()).abs() < 5e-7);
    }
}
