//! Texels of a block as lanes of vectors.

use pulp::Simd;

/// Lanes of a block of 8 x 8 texels: for large faces, where most Gaussians fill several blocks, so that what is done once
/// per entry is shared by many rays.
pub(super) const WIDE: usize = 64;

/// Lanes of a block of 4 x 4 texels: for small faces, where larger blocks would leave most lanes idle.
pub(super) const NARROW: usize = 16;

/// Texels along the edge of a block with so many lanes.
pub(super) const fn edge(lanes: usize) -> u32 {
    if lanes == WIDE { 8 } else { 4 }
}

/// Texels along the edge of the squares that a block's lanes go through one after the other: a vector of 16 lanes is a
/// square, so that small Gaussians touch few vectors.
const QUAD: u32 = 4;

/// Column and row of a lane in its block.
pub(super) const fn texel_of_lane(lanes: usize, lane: usize) -> [u32; 2] {
    let (lane, quads_per_row) = (lane as u32, edge(lanes) / QUAD);
    let (quad, inside) = (lane / (QUAD * QUAD), lane % (QUAD * QUAD));
    [quad % quads_per_row * QUAD + inside % QUAD, quad / quads_per_row * QUAD + inside / QUAD]
}

/// The lane of a texel, by its column and row in the block.
pub(super) const fn lane_of_texel(lanes: usize, [x, y]: [u32; 2]) -> usize {
    let quad = y / QUAD * (edge(lanes) / QUAD) + x / QUAD;
    (quad * QUAD * QUAD + y % QUAD * QUAD + x % QUAD) as usize
}

/// First and last column, and first and last row, that vector `v` of `width` lanes covers in its block.
#[inline(always)]
pub(super) fn texels_of_vector(lanes: usize, width: usize, v: usize) -> [[u32; 2]; 2] {
    let [left, top] = texel_of_lane(lanes, v * width);
    let [_, bottom] = texel_of_lane(lanes, (v + 1) * width - 1);
    [[left, left + QUAD - 1], [top, bottom]]
}

/// A value per texel of a block, aligned to the widest vector.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(super) struct Lanes<const N: usize>(pub [f32; N]);

impl<const N: usize> Lanes<N> {
    pub const fn splat(value: f32) -> Self {
        Self([value; N])
    }

    /// Vector `v` of `N / S::F32_LANES`.
    #[inline(always)]
    pub fn get<S: Simd>(&self, v: usize) -> S::f32s {
        S::as_simd_f32s(&self.0).0[v]
    }

    #[inline(always)]
    pub fn set<S: Simd>(&mut self, v: usize, vector: S::f32s) {
        S::as_mut_simd_f32s(&mut self.0).0[v] = vector;
    }
}
