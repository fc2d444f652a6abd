//! A chunk of candidates in the quads of a tile: evaluated in SIMD lanes, batch by batch, nearest first.

use glam::DVec3;
use pulp::Simd;

use super::candidate::Candidate;
use super::deal::{BLOCKS_PER_ROW, Listed, Lists, QUADS_PER_ROW};
use super::desk::{Colour, Desk, Entry};
use super::lanes::{LANES, Lanes, any};
use super::project::LOG2_ALPHA_MIN;
use super::quad::{Quad, State};
use super::{BeamTracer, QUADS_PER_BLOCK};
use crate::job::{Order, ShDirection};
use crate::scene::sh;
use crate::scene::splats::ALPHA_MAX;
use crate::trace::counters::Tally;
use crate::trace::{Ray, SurfaceHit, Tile, triangle};

/// Candidates that a quad evaluates before it orders them: enough for their arithmetic to overlap, few enough not to
/// evaluate much behind an opaque surface.
const BATCH: usize = 8;

/// A quad whose desk holds this many more entries than after it was last cleared settles what it can: few enough for the
/// desk to stay in the fastest cache.
const SETTLE_EVERY: usize = 32;

/// Shades quads; holds what they share so that nothing is allocated per quad.
pub(super) struct Shader<'a> {
    tracer: &'a BeamTracer<'a>,
    origin: DVec3,
    tile: Tile,
    /// Per row of quads, a bit for each whose rays have not all ended.
    live: [u32; QUADS_PER_ROW],
    buffers: &'a mut ShaderBuffers,
    pub tally: Tally,
}

/// What a shader needs room for.
#[derive(Default)]
pub(super) struct ShaderBuffers {
    lists: Lists,
    /// What reaches a block, in order.
    listed: Vec<Listed>,
    /// What of that reaches a quad.
    list: Vec<Listed>,
    /// Colours of entries whose lanes differ.
    lane_colours: Vec<[Lanes; 3]>,
    desks: Vec<Box<Desk>>,
}

impl<'a> Shader<'a> {
    pub fn new(
        tracer: &'a BeamTracer<'a>,
        origin: DVec3,
        tile: &Tile,
        quads: &[Quad],
        buffers: &'a mut ShaderBuffers,
    ) -> Self {
        let mut live = [0; QUADS_PER_ROW];
        for (i, quad) in quads.iter().enumerate() {
            live[i / QUADS_PER_ROW] |= u32::from(quad.state == State::Live) << (i % QUADS_PER_ROW);
        }
        buffers.lane_colours.clear();
        Self { tracer, origin, tile: *tile, live, buffers, tally: Tally::default() }
    }

    /// The blocks that have rays which have not ended.
    pub fn live_blocks(&self) -> u64 {
        let mut blocks = 0;
        for (row, live) in self.live.iter().enumerate() {
            let mut live = *live;
            while live != 0 {
                let column = live.trailing_zeros() as usize;
                live &= live - 1;
                blocks |= 1 << (row / QUADS_PER_BLOCK * BLOCKS_PER_ROW + column / QUADS_PER_BLOCK);
            }
        }
        blocks
    }

    /// Shades `chunk` in all live quads. `bound` is a lower bound on the keys of all candidates after the chunk.
    #[inline(always)]
    pub fn shade_chunk<S: Simd>(&mut self, simd: S, quads: &mut [Quad], chunk: &[Candidate], bound: f32) {
        self.buffers.lists.deal(simd, chunk, self.tracer.settings.order, &self.live);
        let mut listed = std::mem::take(&mut self.buffers.listed);
        let mut list = std::mem::take(&mut self.buffers.list);
        for block in 0..BLOCKS_PER_ROW * BLOCKS_PER_ROW {
            self.buffers.lists.order(block, &mut listed);
            list.resize(listed.len().max(list.len()), Listed::default());
            let (first_row, first_column) =
                (block / BLOCKS_PER_ROW * QUADS_PER_BLOCK, block % BLOCKS_PER_ROW * QUADS_PER_BLOCK);
            for k in 0..QUADS_PER_BLOCK * QUADS_PER_BLOCK {
                let (row, column) = (first_row + k / QUADS_PER_BLOCK, first_column + k % QUADS_PER_BLOCK);
                let quad = &mut quads[row * QUADS_PER_ROW + column];
                if quad.state != State::Live {
                    continue;
                }
                let mut length = 0;
                for &candidate in &listed {
                    list[length] = candidate;
                    length += usize::from(candidate.reaches(k));
                }
                if length > 0 || bound == f32::INFINITY || !quad.takes(simd, bound) {
                    self.shade(simd, quad, chunk, &list[..length], bound);
                }
                self.live[row] &= !(u32::from(quad.state != State::Live) << column);
            }
        }
        self.buffers.listed = listed;
        self.buffers.list = list;
    }

    /// Evaluates `list`, in its order, in `quad`, until no ray takes anything more; blends everything whose order is settled
    /// when all keys still to come are at least `bound`.
    #[inline(always)]
    fn shade<S: Simd>(&mut self, simd: S, quad: &mut Quad, chunk: &[Candidate], list: &[Listed], bound: f32) {
        let cutoff = self.tracer.settings.t_cutoff;
        let mut desk = quad.take_desk(&mut self.buffers.desks);
        let mut full = desk.len() + SETTLE_EVERY;
        let mut rest = list;
        while !rest.is_empty() {
            if !quad.takes(simd, rest[0].key_low) {
                break;
            }
            let first = desk.len();
            let gaussians =
                rest.iter().take(BATCH).take_while(|listed| chunk[listed.index as usize].is_gaussian()).count();
            let (batch, after) = rest.split_at(gaussians.max(1));
            let entries = desk.room(batch.len());
            let made = match gaussians {
                0 => self.intersect(quad, &chunk[batch[0].index as usize], &mut entries[0]),
                _ => self.evaluate(simd, quad, chunk, batch, entries),
            };
            desk.keep(made);
            quad.arrive(simd, desk.entries(), first, cutoff);
            rest = after;
            if desk.len() >= full {
                let next = rest.first().map_or(bound, |listed| listed.key_low.min(bound));
                quad.settle(simd, &mut desk, next, cutoff, &self.buffers.lane_colours);
                if quad.state != State::Live {
                    break;
                }
                full = desk.len() * 2 + SETTLE_EVERY;
            }
        }
        if quad.state == State::Live {
            let next = rest.first().map_or(bound, |listed| listed.key_low.min(bound));
            quad.settle(simd, &mut desk, next, cutoff, &self.buffers.lane_colours);
        }
        quad.return_desk(desk, &mut self.buffers.desks);
    }

    /// Makes the entries of some Gaussians, where they respond with at least 1/255 and still count; tells how many do.
    ///
    /// In three sweeps over the batch: the chain of one evaluation takes longer than its arithmetic, and the processor looks
    /// ahead over more of them when each sweep is short. What contributes nowhere drops out before the last.
    #[inline(always)]
    fn evaluate<S: Simd>(
        &mut self,
        simd: S,
        quad: &Quad,
        chunk: &[Candidate],
        batch: &[Listed],
        entries: &mut [Entry],
    ) -> usize {
        let by_camera = self.tracer.settings.order == Order::CameraDistance;
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
        let entries = &mut entries[..made];
        for v in 0..LANES / S::F32_LANES {
            for entry in &mut *entries {
                let alpha = simd.min_f32s(exp2(simd, entry.alpha.get::<S>(v)), simd.splat_f32s(ALPHA_MAX as f32));
                let contributes = simd.greater_than_f32s(entry.key.get::<S>(v), nowhere);
                entry.alpha.set::<S>(v, simd.select_f32s(contributes, alpha, zero));
            }
        }
        if self.tracer.settings.sh_direction == ShDirection::Ray {
            for entry in &mut *entries {
                self.colour_by_ray(quad, entry);
            }
        }
        self.tally.evaluations += (LANES * batch.len()) as u64;
        if self.tracer.counters.is_some() {
            for entry in entries {
                self.tally.contributions += entry.alpha.0.iter().filter(|&&alpha| alpha > 0.0).count() as u64;
            }
        }
        made
    }

    /// Makes the entry of a triangle; 0 if no lane sees it, or else 1.
    fn intersect(&mut self, quad: &mut Quad, candidate: &Candidate, entry: &mut Entry) -> usize {
        let index = candidate.triangle();
        let (scene, surfaces) = (self.tracer.scene, self.tracer.surfaces);
        let corners = scene.meshes.corners(index as usize).map(|corner| corner.as_dvec3() - self.origin);
        let (double_sided, opaque) = (surfaces.is_double_sided(index), surfaces.is_opaque(index));
        let mut colours = [Lanes::splat(0.0); 3];
        *entry = Entry { index: candidate.index, ..Entry::EMPTY };
        let mut seen_by_any = false;
        for lane in 0..LANES {
            // The same unit direction as the ray tracer's, so that both see the same edges.
            let direction = quad.direction(&self.tile, lane).normalize();
            let Some(met) = triangle::intersect(corners, direction) else { continue };
            let seen = met.front || double_sided;
            let distance = met.distance as f32;
            if !seen
                || met.distance <= f64::from(self.tracer.settings.t_near)
                || distance > quad.opaque_distance.0[lane]
            {
                continue;
            }
            if opaque {
                quad.opaque_distance.0[lane] = distance;
            }
            let depth = distance / quad.metres_per_depth.0[lane];
            let key = match self.tracer.settings.order {
                Order::RayHitDistance => depth,
                Order::CameraDistance => distance,
            };
            if key > quad.far.0[lane] {
                continue;
            }
            let hit =
                SurfaceHit { triangle: index, barycentric: met.barycentric, front: met.front, distance: met.distance };
            let fragment = surfaces.fragment(&Ray { origin: self.origin, direction }, &hit);
            if fragment.alpha <= 0.0 {
                continue;
            }
            entry.depth.0[lane] = depth;
            entry.key.0[lane] = key;
            entry.alpha.0[lane] = fragment.alpha;
            seen_by_any = true;
            for (channel, value) in colours.iter_mut().zip(fragment.radiance.0.to_array()) {
                channel.0[lane] = value;
            }
        }
        if seen_by_any {
            entry.colour = Colour::LinearLanes(self.buffers.lane_colours.len() as u32);
            self.buffers.lane_colours.push(colours);
        }
        usize::from(seen_by_any)
    }

    /// Evaluates a Gaussian's colour along each lane's ray.
    fn colour_by_ray(&mut self, quad: &Quad, entry: &mut Entry) {
        let splats = &self.tracer.scene.splats;
        let mut colours = [Lanes::splat(0.0); 3];
        for lane in 0..LANES {
            let direction = quad.direction(&self.tile, lane).normalize().as_vec3();
            let colour = sh::evaluate(splats.sh_degree, splats.sh_of(entry.index as usize), direction);
            for (channel, value) in colours.iter_mut().zip(colour.to_array()) {
                channel.0[lane] = value;
            }
        }
        let place = self.buffers.lane_colours.len() as u32;
        self.buffers.lane_colours.push(colours);
        entry.colour = match entry.colour {
            Colour::Linear(_) | Colour::LinearLanes(_) => Colour::LinearLanes(place),
            Colour::Splat(_) | Colour::SplatLanes(_) => Colour::SplatLanes(place),
        };
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
