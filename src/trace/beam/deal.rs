//! Which quads a candidate reaches, by the cone in which it responds, and in which order they take it.

use pulp::Simd;

use super::candidate::Candidate;
use super::lanes::{LANES, Lanes, QUAD};
use super::{BLOCK_EDGE, QUADS_PER_BLOCK};
use crate::job::Order;
use crate::trace::Tile;

/// Quads along an edge of the largest tile: a row of them is as many lanes as a quad has texels.
pub(super) const QUADS_PER_ROW: usize = LANES;

/// Blocks along an edge of the largest tile.
pub(super) const BLOCKS_PER_ROW: usize = QUADS_PER_ROW / QUADS_PER_BLOCK;

/// The bits of a row of a block's quads.
const ROW_OF_BLOCK: u32 = (1 << QUADS_PER_BLOCK) - 1;

const _: () = assert!(QUADS_PER_ROW == (Tile::EDGE / QUAD) as usize);

/// Middles of a row of quads, in texels.
const MIDDLES: Lanes = {
    let mut middles = [0.0; LANES];
    let mut i = 0;
    while i < LANES {
        middles[i] = (i as f32 + 0.5) * QUAD as f32;
        i += 1;
    }
    Lanes(middles)
};

/// A bit per quad of a row; sums of them are exact in f32.
const BITS: Lanes = {
    let mut bits = [0.0; LANES];
    let mut i = 0;
    while i < LANES {
        bits[i] = (1u32 << i) as f32;
        i += 1;
    }
    Lanes(bits)
};

/// A candidate in a block's list.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Listed {
    /// In the chunk.
    pub index: u32,
    /// The block's quads that it reaches, a bit each.
    quads: u32,
    /// A lower bound on the keys in the block of this candidate and all that follow it.
    pub key_low: f32,
}

impl Listed {
    /// Whether the candidate reaches the quad that is so many along in the block.
    #[inline(always)]
    pub fn reaches(self, quad: usize) -> bool {
        self.quads >> quad & 1 != 0
    }
}

/// Per block of a tile, the chunk's candidates that reach its quads.
#[derive(Default)]
pub(super) struct Lists {
    of_block: Vec<BlockList>,
}

/// What reaches one block.
#[derive(Default, Clone)]
struct BlockList {
    listed: Vec<Listed>,
    /// Bits of the key at the block's middle, and the place in `listed`: the order in which quads take them.
    order: Vec<u64>,
}

impl Lists {
    /// The block's candidates in the order of their keys at its middle, into `ordered`.
    #[inline(always)]
    pub fn order(&mut self, block: usize, ordered: &mut Vec<Listed>) {
        let BlockList { listed, order } = &mut self.of_block[block];
        order.sort_unstable();
        ordered.clear();
        ordered.extend(order.iter().map(|&place| listed[place as u32 as usize]));
        let mut least = f32::INFINITY;
        for listed in ordered.iter_mut().rev() {
            least = if listed.key_low < least { listed.key_low } else { least };
            listed.key_low = least;
        }
    }

    /// Lists each candidate in the blocks where it reaches a live quad; `live` has a bit per quad in a word per row.
    #[inline(always)]
    pub fn deal<S: Simd>(&mut self, simd: S, chunk: &[Candidate], by: Order, live: &[u32; QUADS_PER_ROW]) {
        self.of_block.resize(BLOCKS_PER_ROW * BLOCKS_PER_ROW, BlockList::default());
        for BlockList { listed, order } in &mut self.of_block {
            listed.clear();
            order.clear();
        }
        for (index, candidate) in chunk.iter().enumerate() {
            let [left, right] = candidate.columns.map(|column| column as u32 / QUAD);
            let [top, bottom] = candidate.rows.map(|row| row as u32 / QUAD);
            let columns = (u32::MAX << left) & (u32::MAX >> (31 - right));
            for block_row in top as usize / QUADS_PER_BLOCK..=bottom as usize / QUADS_PER_BLOCK {
                let mut rows = [0; QUADS_PER_BLOCK];
                for (k, row) in rows.iter_mut().enumerate() {
                    let quad_row = block_row * QUADS_PER_BLOCK + k;
                    let candidates = live[quad_row] & columns;
                    if candidates != 0 && (top as usize..=bottom as usize).contains(&quad_row) {
                        *row = candidates & reached(simd, candidate, quad_row);
                    }
                }
                let mut any = rows[0] | rows[1];
                while any != 0 {
                    let block = any.trailing_zeros() as usize / QUADS_PER_BLOCK;
                    let first = block * QUADS_PER_BLOCK;
                    let quads = rows[0] >> first & ROW_OF_BLOCK | (rows[1] >> first & ROW_OF_BLOCK) << QUADS_PER_BLOCK;
                    any &= !(ROW_OF_BLOCK << first);
                    let (key, key_low) = match by {
                        Order::RayHitDistance => {
                            let edge = BLOCK_EDGE as f32;
                            let (x, y) = (block as f32 * edge, block_row as f32 * edge);
                            let low = candidate.depth_low_in(x, y, edge);
                            (candidate.depth_at(x + 0.5 * edge, y + 0.5 * edge).max(low), low)
                        }
                        Order::CameraDistance => (candidate.key_low, candidate.key_low),
                    };
                    let BlockList { listed, order } = &mut self.of_block[block_row * BLOCKS_PER_ROW + block];
                    // Keys are not negative, so their bit patterns order as they do.
                    order.push(u64::from(key.to_bits()) << 32 | listed.len() as u64);
                    listed.push(Listed { index: index as u32, quads, key_low });
                }
            }
        }
    }
}

/// The quads of a row in which the candidate may respond, a bit each.
#[inline(always)]
fn reached<S: Simd>(simd: S, candidate: &Candidate, quad_row: usize) -> u32 {
    let Candidate { u, s, cone, .. } = *candidate;
    let y = (quad_row as f32 + 0.5) * QUAD as f32;
    let at_row = [u[0] + u[2] * y, s[0] + s[1] * y, cone[0] + cone[2] * y];
    let s_squared = simd.splat_f32s(at_row[1] * at_row[1]);
    let zero = simd.splat_f32s(0.0);
    let mut bits = zero;
    for v in 0..LANES / S::F32_LANES {
        let x = MIDDLES.get::<S>(v);
        let u = simd.mul_add_e_f32s(simd.splat_f32s(u[1]), x, simd.splat_f32s(at_row[0]));
        let width = simd.mul_add_e_f32s(simd.splat_f32s(cone[1]), x, simd.splat_f32s(at_row[2]));
        let inside = simd.and_m32s(
            simd.less_than_or_equal_f32s(simd.mul_add_e_f32s(u, u, s_squared), simd.mul_f32s(width, width)),
            simd.greater_than_f32s(width, zero),
        );
        bits = simd.add_f32s(bits, simd.select_f32s(inside, BITS.get::<S>(v), zero));
    }
    simd.reduce_sum_f32s(bits) as u32
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use pulp::WithSimd;

    use super::*;
    use crate::generate::random::Random;
    use crate::scene::Splats;
    use crate::trace::beam::project::{LOG2_ALPHA_MIN, Projection};
    use crate::trace::{Face, Footprint, Level};

    /// The candidates of some Gaussians in a tile, and which quads each reaches, by rows.
    struct Reach<'a>(&'a Splats, &'a Tile);

    impl WithSimd for Reach<'_> {
        type Output = Vec<(Candidate, Vec<u32>)>;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            let mut projection = Projection::new(DVec3::ZERO, self.1, Order::RayHitDistance, Footprint::default());
            let mut reached_by = Vec::new();
            for index in 0..self.0.len() as u32 {
                projection.add(self.0, index);
                for lane in 0..projection.project(simd) {
                    if let Some(candidate) = projection.candidate(lane) {
                        let rows = (0..QUADS_PER_ROW).map(|row| reached(simd, &candidate, row)).collect();
                        reached_by.push((candidate, rows));
                    }
                }
            }
            reached_by
        }
    }

    #[test]
    fn a_cone_reaches_every_quad_with_a_texel_that_responds_and_few_others() {
        let mut random = Random::new(7, 0);
        let mut splats = Splats::default();
        for _ in 0..400 {
            let deviations = DVec3::from_array(std::array::from_fn(|_| random.log_range(0.001, 1.0)));
            splats.unit_from_world.push(Splats::unit_from_world(random.rotation(), deviations));
            let [right, up] = [random.range(-0.25, 0.25), random.range(-0.25, 0.25)];
            splats.means.push((DVec3::new(1.0, right, up) * random.log_range(0.2, 10.0)).as_vec3());
            splats.opacities.push(random.range(0.02, 0.99) as f32);
        }
        let tile = Tile { face: Face::PosX, face_size: 256, x: 96, y: 96, width: 64, height: 64 };
        for level in Level::available() {
            let (mut needed, mut reached) = (0, 0);
            for (candidate, rows) in level.run(Reach(&splats, &tile)) {
                let Candidate { u, s, h, .. } = candidate;
                let mut responding = [0u32; QUADS_PER_ROW];
                for texel in 0..64 * 64 {
                    let (column, row) = (texel % 64, texel / 64);
                    let (x, y) = (column as f32 + 0.5, row as f32 + 0.5);
                    let (u, s, h) = (u[0] + u[1] * x + u[2] * y, s[0] + s[1] * y, h[0] + h[1] * x + h[2] * y);
                    let exponent =
                        candidate.log2_opacity - candidate.falloff * (u * u + s * s) / (u * u + s * s + h * h);
                    if f64::from(exponent) >= LOG2_ALPHA_MIN && h > 0.0 {
                        responding[row / QUAD as usize] |= 1 << (column / QUAD as usize);
                    }
                }
                for (row, (responding, reached_by)) in responding.into_iter().zip(rows).enumerate() {
                    assert_eq!(responding & !reached_by, 0, "{} row {row}: {candidate:?}", level.name());
                    needed += responding.count_ones();
                    reached += reached_by.count_ones();
                }
            }
            // Of 256 quads each of 400 Gaussians; a share of them all, if it said yes to everything.
            assert!(needed > 4000 && reached < needed * 3 / 2, "{} of {needed} and {reached}", level.name());
        }
    }
}
