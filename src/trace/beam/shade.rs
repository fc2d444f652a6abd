//! A chunk of candidates into the blocks of a tile: dealt to them, sorted there, evaluated in SIMD lanes.

use glam::DVec3;
use pulp::Simd;

use super::BeamTracer;
use super::block::{Block, State};
use super::desk::{Colour, Desk, Entry, KeyRange};
use super::lanes::{Lanes, edge, texels_of_vector};
use super::project::{Candidate, LOG2_ALPHA_MIN};
use crate::job::{Order, ShDirection};
use crate::scene::sh;
use crate::scene::splats::ALPHA_MAX;
use crate::trace::counters::Tally;
use crate::trace::{Ray, SurfaceHit, Tile, triangle};

/// Candidates that a block evaluates before it looks which of them come next: enough for their arithmetic to overlap,
/// few enough not to evaluate much behind an opaque surface.
const BATCH: usize = 8;

/// Shades blocks; holds what they share so that nothing is allocated per block.
pub(super) struct Shader<'a, const N: usize> {
    tracer: &'a BeamTracer<'a>,
    origin: DVec3,
    tile: Tile,
    /// Per block of the tile, the chunk's candidates that may touch it: key bound in the block, and index.
    lists: Vec<Vec<u64>>,
    /// Colours of entries whose lanes differ.
    lane_colours: Vec<[Lanes<N>; 3]>,
    desks: Vec<Box<Desk<N>>>,
    pub tally: Tally,
}

impl<'a, const N: usize> Shader<'a, N> {
    pub fn new(tracer: &'a BeamTracer<'a>, origin: DVec3, tile: &Tile) -> Self {
        Self {
            tracer,
            origin,
            tile: *tile,
            lists: vec![Vec::new(); 64],
            lane_colours: Vec::new(),
            desks: Vec::new(),
            tally: Tally::default(),
        }
    }

    /// Shades `chunk` in all live blocks. `bound` is a lower bound on the keys of all candidates after the chunk; `live`
    /// has a bit per block with rays that have not ended, and is updated.
    #[inline(always)]
    pub fn shade_chunk<S: Simd>(
        &mut self,
        simd: S,
        blocks: &mut [Block<N>],
        chunk: &[Candidate],
        bound: f32,
        live: &mut u64,
    ) {
        self.deal(chunk, *live);
        for (i, block) in blocks.iter_mut().enumerate() {
            let mut list = std::mem::take(&mut self.lists[i]);
            if *live & 1 << i != 0 && (!list.is_empty() || bound == f32::INFINITY) {
                list.sort_unstable();
                self.shade(simd, block, chunk, &list, bound);
                if block.state != State::Live {
                    *live &= !(1 << i);
                }
            }
            list.clear();
            self.lists[i] = list;
        }
    }

    /// Lists each candidate in the live blocks it may touch, with the least key it can have there.
    #[inline(always)]
    fn deal(&mut self, chunk: &[Candidate], live: u64) {
        let edge = edge(N) as f32;
        for (i, candidate) in chunk.iter().enumerate() {
            let mut blocks = candidate.blocks & live;
            while blocks != 0 {
                let block = blocks.trailing_zeros();
                blocks &= blocks - 1;
                let key_low = match self.tracer.settings.order {
                    Order::RayHitDistance => {
                        candidate.depth_low_in((block % 8) as f32 * edge, (block / 8) as f32 * edge, edge)
                    }
                    Order::CameraDistance => candidate.key_low,
                };
                // Keys are not negative, so their bit patterns order as they do.
                self.lists[block as usize].push(u64::from(key_low.to_bits()) << 32 | i as u64);
            }
        }
    }

    /// Evaluates `list`, sorted, in `block`; blends everything whose order is settled when all keys still to come are
    /// at least `bound`.
    #[inline(always)]
    fn shade<S: Simd>(&mut self, simd: S, block: &mut Block<N>, chunk: &[Candidate], list: &[u64], bound: f32) {
        let cutoff = self.tracer.settings.t_cutoff;
        let mut desk = block.take_desk(&mut self.desks);
        let mut rest = list.iter();
        loop {
            let mut batch = [(0u32, KeyRange::EMPTY, 0u32); BATCH];
            let mut filled = 0;
            let mut next = bound;
            for &listed in rest.by_ref() {
                let candidate = &chunk[listed as u32 as usize];
                let slot = desk.slot();
                let keys = if candidate.is_gaussian() {
                    self.evaluate(simd, block, candidate, desk.entry(slot))
                } else {
                    self.intersect(block, candidate, desk.entry(slot))
                };
                batch[filled] = (slot, keys, candidate.index);
                filled += 1;
                if filled == BATCH {
                    next = f32::from_bits((listed >> 32) as u32).min(bound);
                    break;
                }
            }
            for &(slot, keys, index) in &batch[..filled] {
                if keys.is_empty() { desk.release(slot) } else { desk.wait(slot, keys, index) }
            }
            block.advance(simd, &mut desk, next, cutoff, &self.lane_colours);
            if filled < BATCH || block.state != State::Live {
                break;
            }
        }
        block.return_desk(desk, &mut self.desks);
    }

    /// Makes the entry of a Gaussian; its keys are empty if no lane sees it respond with at least 1/255 where it still
    /// counts.
    #[inline(always)]
    fn evaluate<S: Simd>(
        &mut self,
        simd: S,
        block: &Block<N>,
        candidate: &Candidate,
        entry: &mut Entry<N>,
    ) -> KeyRange {
        let Candidate { u, s, h, falloff, log2_opacity, depth, .. } = *candidate;
        let fixed_key = (self.tracer.settings.order == Order::CameraDistance).then_some(candidate.key_low);
        let (nowhere, infinity) = (simd.splat_f32s(f32::NEG_INFINITY), simd.splat_f32s(f32::INFINITY));
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        let (mut key_min, mut key_max) = (infinity, nowhere);
        let (left, top) = (block.x.0[0] as i32, block.y.0[0] as i32);
        let columns = candidate.columns.map(|column| i32::from(column) - left);
        let rows = candidate.rows.map(|row| i32::from(row) - top);
        for v in 0..N / S::F32_LANES {
            let near_depth = block.near_depth.get::<S>(v);
            let [across, down] = texels_of_vector(N, S::F32_LANES, v).map(|ends| ends.map(|end| end as i32));
            let outside =
                (columns[0] > across[1]) | (columns[1] < across[0]) | (rows[0] > down[1]) | (rows[1] < down[0]);
            if outside || simd.first_true_m32s(simd.less_than_f32s(near_depth, infinity)) >= S::F32_LANES {
                entry.key.set::<S>(v, nowhere);
                entry.depth.set::<S>(v, zero);
                entry.alpha.set::<S>(v, zero);
                continue;
            }
            self.tally.evaluations += S::F32_LANES as u64;
            let (x, y) = (block.x.get::<S>(v), block.y.get::<S>(v));
            let u = affine(simd, u, x, y);
            let h = affine(simd, h, x, y);
            let s = simd.mul_add_e_f32s(simd.splat_f32s(s[1]), y, simd.splat_f32s(s[0]));
            let across = simd.mul_add_e_f32s(u, u, simd.mul_f32s(s, s));
            let v_squared_inverse = simd.div_f32s(one, simd.mul_add_e_f32s(h, h, across));
            let fall = simd.mul_f32s(simd.splat_f32s(falloff), simd.mul_f32s(across, v_squared_inverse));
            let exponent = simd.sub_f32s(simd.splat_f32s(log2_opacity), fall);
            let lane_depth = simd.mul_f32s(simd.mul_f32s(simd.splat_f32s(depth), h), v_squared_inverse);
            let contributes = simd.and_m32s(
                simd.greater_than_or_equal_f32s(exponent, simd.splat_f32s(LOG2_ALPHA_MIN as f32)),
                simd.greater_than_f32s(lane_depth, near_depth),
            );
            let alpha = simd.min_f32s(exp2(simd, exponent), simd.splat_f32s(ALPHA_MAX as f32));
            let key = match fixed_key {
                Some(key) => simd.splat_f32s(key),
                None => lane_depth,
            };
            let stored_key = simd.select_f32s(contributes, key, nowhere);
            key_min = simd.min_f32s(key_min, simd.select_f32s(contributes, key, infinity));
            key_max = simd.max_f32s(key_max, stored_key);
            entry.key.set::<S>(v, stored_key);
            entry.depth.set::<S>(v, lane_depth);
            entry.alpha.set::<S>(v, simd.select_f32s(contributes, alpha, zero));
        }
        let key_min = simd.reduce_min_f32s(key_min);
        if key_min == f32::INFINITY {
            return KeyRange::EMPTY;
        }
        if self.tracer.counters.is_some() {
            self.tally.contributions += entry.alpha.0.iter().filter(|&&alpha| alpha > 0.0).count() as u64;
        }
        let linear = self.tracer.scene.splats.is_linear(candidate.index as usize);
        entry.colour = match (self.tracer.settings.sh_direction, linear) {
            (ShDirection::Mean, false) => Colour::Splat(candidate.colour),
            (ShDirection::Mean, true) => Colour::Linear(candidate.colour),
            (ShDirection::Ray, false) => Colour::SplatLanes(self.colours_along_rays(block, candidate.index as usize)),
            (ShDirection::Ray, true) => Colour::LinearLanes(self.colours_along_rays(block, candidate.index as usize)),
        };
        KeyRange { min: key_min, max: simd.reduce_max_f32s(key_max) }
    }

    /// Makes the entry of a triangle; its keys are empty if no lane sees it.
    fn intersect(&mut self, block: &mut Block<N>, candidate: &Candidate, entry: &mut Entry<N>) -> KeyRange {
        let index = candidate.triangle();
        let (scene, surfaces) = (self.tracer.scene, self.tracer.surfaces);
        let corners = scene.meshes.corners(index as usize).map(|corner| corner.as_dvec3() - self.origin);
        let (double_sided, opaque) = (surfaces.is_double_sided(index), surfaces.is_opaque(index));
        let mut colours = [Lanes::splat(0.0); 3];
        *entry = Entry::EMPTY;
        let mut keys = KeyRange::EMPTY;
        for lane in 0..N {
            if block.near_depth.0[lane] == f32::INFINITY {
                continue;
            }
            // The same unit direction as the ray tracer's, so that both see the same edges.
            let direction = block.direction(&self.tile, lane).normalize();
            let Some(met) = triangle::intersect(corners, direction) else { continue };
            let seen = met.front || double_sided;
            let distance = met.distance as f32;
            if !seen
                || met.distance <= f64::from(self.tracer.settings.t_near)
                || distance > block.opaque_distance.0[lane]
            {
                continue;
            }
            if opaque {
                block.opaque_distance.0[lane] = distance;
            }
            let hit =
                SurfaceHit { triangle: index, barycentric: met.barycentric, front: met.front, distance: met.distance };
            let fragment = surfaces.fragment(&Ray { origin: self.origin, direction }, &hit);
            if fragment.alpha <= 0.0 {
                continue;
            }
            entry.depth.0[lane] = met.distance as f32 / block.metres_per_depth.0[lane];
            entry.key.0[lane] = match self.tracer.settings.order {
                Order::RayHitDistance => entry.depth.0[lane],
                Order::CameraDistance => met.distance as f32,
            };
            entry.alpha.0[lane] = fragment.alpha;
            keys.min = keys.min.min(entry.key.0[lane]);
            keys.max = keys.max.max(entry.key.0[lane]);
            for (channel, value) in colours.iter_mut().zip(fragment.radiance.0.to_array()) {
                channel.0[lane] = value;
            }
        }
        if !keys.is_empty() {
            entry.colour = Colour::LinearLanes(self.lane_colours.len() as u32);
            self.lane_colours.push(colours);
        }
        keys
    }

    fn colours_along_rays(&mut self, block: &Block<N>, index: usize) -> u32 {
        let splats = &self.tracer.scene.splats;
        let mut colours = [Lanes::splat(0.0); 3];
        for lane in 0..N {
            let direction = block.direction(&self.tile, lane).normalize().as_vec3();
            let colour = sh::evaluate(splats.sh_degree, splats.sh_of(index), direction);
            for (channel, value) in colours.iter_mut().zip(colour.to_array()) {
                channel.0[lane] = value;
            }
        }
        self.lane_colours.push(colours);
        self.lane_colours.len() as u32 - 1
    }
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
