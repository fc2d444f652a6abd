//! Texels of a quad as lanes of vectors.

use pulp::Simd;

/// Texels along the edge of a quad: a vector of 16 lanes is a square, so that small Gaussians touch few vectors.
pub(super) const QUAD: u32 = 4;

/// Texels of a quad.
pub(super) const LANES: usize = (QUAD * QUAD) as usize;

/// Column and row of a lane in its quad.
pub(super) const fn texel_of_lane(lane: usize) -> [u32; 2] {
    [lane as u32 % QUAD, lane as u32 / QUAD]
}

/// A value per texel of a quad, aligned to the widest vector.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(super) struct Lanes(pub [f32; LANES]);

impl Lanes {
    pub const fn splat(value: f32) -> Self {
        Self([value; LANES])
    }

    /// Vector `v` of `LANES / S::F32_LANES`.
    #[inline(always)]
    pub fn get<S: Simd>(&self, v: usize) -> S::f32s {
        S::as_simd_f32s(&self.0).0[v]
    }

    #[inline(always)]
    pub fn set<S: Simd>(&mut self, v: usize, vector: S::f32s) {
        S::as_mut_simd_f32s(&mut self.0).0[v] = vector;
    }
}

/// Whether `mask` holds in any lane.
#[inline(always)]
pub(super) fn any<S: Simd>(simd: S, mask: S::m32s) -> bool {
    simd.first_true_m32s(mask) < S::F32_LANES
}
