//! A chunk of candidates in the quads of a tile: batch by batch, nearest first, until no ray takes anything more.

use glam::DVec3;
use pulp::Simd;

use super::candidate::Candidate;
use super::deal::{BLOCKS_PER_ROW, Listed, Lists, QUADS_PER_ROW};
use super::desk::{Colour, Desk, Entry};
use super::evaluate::{BATCH, evaluate};
use super::lanes::{LANES, Lanes};
use super::quad::{Quad, State};
use super::{BeamTracer, QUADS_PER_BLOCK};
use crate::job::{Order, ShDirection};
use crate::scene::sh;
use crate::trace::counters::Tally;
use crate::trace::{Ray, SurfaceHit, Tile, triangle};

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
                if length > 0 || quad.ends(simd, bound) {
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
        loop {
            let (next, last) = match rest.first() {
                Some(listed) => (listed.key_low.min(bound), !quad.takes(simd, listed.key_low)),
                None => (bound, true),
            };
            if last || desk.len() >= full {
                quad.settle(simd, &mut desk, next, cutoff, &self.buffers.lane_colours);
                if last || quad.state != State::Live {
                    break;
                }
                full = desk.len() * 2 + SETTLE_EVERY;
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
        }
        quad.return_desk(desk, &mut self.buffers.desks);
    }

    /// Makes the entries of some Gaussians; tells how many contribute.
    #[inline(always)]
    fn evaluate<S: Simd>(
        &mut self,
        simd: S,
        quad: &Quad,
        chunk: &[Candidate],
        batch: &[Listed],
        entries: &mut [Entry],
    ) -> usize {
        let made = evaluate(simd, quad, chunk, batch, self.tracer.settings.order, entries);
        let entries = &mut entries[..made];
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
        let linear = matches!(entry.colour, Colour::Linear(_));
        entry.colour = if linear { Colour::LinearLanes(place) } else { Colour::SplatLanes(place) };
    }
}
