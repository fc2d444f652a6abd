//! 4 x 4 texels: evaluate candidates in SIMD lanes and blend them in exact order per ray.
//!
//! The order of two contributions may differ from ray to ray, and arriving in nearly the right order is not enough (it
//! errs by up to half the range of a colour on captured scenes). Sorting per ray would need gathers of colours. Instead
//! each contribution's weight is completed pair by pair: of two entries, whichever comes second in a lane is multiplied
//! by the other's `1 - alpha` there,
//!
//! ```text
//! weight_i = alpha_i T prod over j with key_j < key_i of (1 - alpha_j)
//! ```
//!
//! so colours stay uniform over the lanes and any order is exact. An entry is finished ("retired") once every key still
//! to come lies beyond its largest; only entries whose key ranges overlap are ever paired.
//
// Tried: sorting each lane's list by packed keys (Batcher's network over 16 lanes) and gathering alpha and colour by
// index. The four gathers per entry alone cost more than evaluating the response.

use glam::{DVec3, Vec3};
use pulp::{Simd, WithSimd};

use super::project::Candidate;
use super::{BeamTracer, CELL_EDGE};
use crate::job::{Order, ShDirection};
use crate::scene::sh;
use crate::scene::splats::ALPHA_MAX;
use crate::trace::{Radiance, Ray, SurfaceHit, Tile, triangle};

/// Texels along an edge of a block.
pub(super) const BLOCK_EDGE: u32 = 4;

/// Texels in a block.
pub(super) const LANES: usize = (BLOCK_EDGE * BLOCK_EDGE) as usize;

/// A block whose unfinished entries outnumber this goes to the ray tracer: pairing grows with the square of the
/// number of entries that overlap in depth.
const MAX_PENDING: usize = 1024;

/// A value per texel of a block.
type Lanes = [f32; LANES];

/// What a block's rays have gathered so far.
pub(super) struct Block {
    /// Texel positions from the tile's corner, at texel centres.
    x: Lanes,
    y: Lanes,
    /// Length of the direction whose look component is 1: metres per unit of depth.
    metres_per_depth: Lanes,
    /// Depth of the near end.
    near_depth: Lanes,
    splat_sum: [Lanes; 3],
    splat_weight: Lanes,
    surface_sum: [Lanes; 3],
    depth_sum: Lanes,
    transmittance: Lanes,
    pending: Vec<Entry>,
    state: State,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Live,
    /// Every ray has ended.
    Done,
    /// Too many entries overlap; the ray tracer must do it.
    Overflowed,
}

/// A candidate's contributions to a block that are not yet finished.
#[derive(Clone, Copy)]
struct Entry {
    key: Lanes,
    depth: Lanes,
    alpha: Lanes,
    weight: Lanes,
    /// Range of `key` over the lanes that contribute.
    key_min: f32,
    key_max: f32,
    /// Ties in the key go to the lower index, triangles last.
    index: u32,
    colour: Colour,
}

#[derive(Clone, Copy)]
enum Colour {
    /// The same in all lanes, in the splats' encoding.
    Splat([f32; 3]),
    /// Into [`Shader::lane_colours`].
    SplatLanes(u32),
    /// Into [`Shader::lane_colours`], linear radiance.
    SurfaceLanes(u32),
}

impl Block {
    /// The block whose first texel is (x, y) of the tile.
    pub fn new(tile: &Tile, x: u32, y: u32, t_near: f32) -> Self {
        let lane_x = std::array::from_fn(|lane| x as f32 + (lane as u32 % BLOCK_EDGE) as f32 + 0.5);
        let lane_y = std::array::from_fn(|lane| y as f32 + (lane as u32 / BLOCK_EDGE) as f32 + 0.5);
        let metres_per_depth: Lanes =
            std::array::from_fn(|lane| lane_direction(tile, &lane_x, &lane_y, lane).length() as f32);
        Self {
            x: lane_x,
            y: lane_y,
            near_depth: metres_per_depth.map(|length| t_near / length),
            metres_per_depth,
            splat_sum: [[0.0; LANES]; 3],
            splat_weight: [0.0; LANES],
            surface_sum: [[0.0; LANES]; 3],
            depth_sum: [0.0; LANES],
            // Lanes beyond the tile's edge have ended before they begin.
            transmittance: std::array::from_fn(|lane| {
                f32::from(lane_x[lane] < tile.width as f32 && lane_y[lane] < tile.height as f32)
            }),
            pending: Vec::new(),
            state: State::Live,
        }
    }

    /// The result of one lane, `None` if the block overflowed.
    pub fn radiance(&self, lane: usize) -> Option<Radiance> {
        (self.state != State::Overflowed).then(|| Radiance {
            splat_sum: Vec3::from_array(self.splat_sum.map(|channel| channel[lane])),
            splat_weight: self.splat_weight[lane],
            surface_sum: Vec3::from_array(self.surface_sum.map(|channel| channel[lane])),
            distance_sum: self.depth_sum[lane] * self.metres_per_depth[lane],
            transmittance: self.transmittance[lane],
        })
    }
}

fn lane_direction(tile: &Tile, x: &Lanes, y: &Lanes, lane: usize) -> DVec3 {
    tile.face.direction(tile.face_size, f64::from(tile.x) + f64::from(x[lane]), f64::from(tile.y) + f64::from(y[lane]))
}

/// Shades blocks; holds what they share so that nothing is allocated per block.
pub(super) struct Shader<'a> {
    tracer: &'a BeamTracer<'a>,
    origin: DVec3,
    /// Per cell of the tile, the chunk's candidates that may touch it.
    cells: Vec<Vec<u32>>,
    /// The block at work: entries in arrival order, then their order by `key_min`, then those not yet retired.
    entries: Vec<Entry>,
    sorted: Vec<(u32, u32)>,
    open: Vec<u32>,
    /// Colours of entries whose lanes differ.
    lane_colours: Vec<[Lanes; 3]>,
}

impl<'a> Shader<'a> {
    pub fn new(tracer: &'a BeamTracer<'a>, origin: DVec3) -> Self {
        Self {
            tracer,
            origin,
            cells: vec![Vec::new(); 64],
            entries: Vec::new(),
            sorted: Vec::new(),
            open: Vec::new(),
            lane_colours: Vec::new(),
        }
    }
}

/// One chunk of candidates into all blocks of a tile.
pub(super) struct ShadeChunk<'a, 'b> {
    pub shader: &'a mut Shader<'b>,
    pub tile: &'a Tile,
    pub blocks: &'a mut [Block],
    pub blocks_per_row: u32,
    /// In the order of `key_low`.
    pub chunk: &'a [Candidate],
    /// A lower bound on the keys of all candidates after this chunk.
    pub bound: f32,
    /// Cells with rays that have not ended; updated.
    pub live: &'a mut u64,
}

impl WithSimd for ShadeChunk<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { shader, tile, blocks, blocks_per_row, chunk, bound, live } = self;
        for (i, candidate) in chunk.iter().enumerate() {
            let mut cells = candidate.cells & *live;
            while cells != 0 {
                shader.cells[cells.trailing_zeros() as usize].push(i as u32);
                cells &= cells - 1;
            }
        }
        let rows = blocks.len() as u32 / blocks_per_row;
        let per_cell = CELL_EDGE / BLOCK_EDGE;
        for cell in 0..64u32 {
            let list = std::mem::take(&mut shader.cells[cell as usize]);
            if *live & 1 << cell != 0 && (!list.is_empty() || bound == f32::INFINITY) {
                let mut alive = false;
                for k in 0..per_cell * per_cell {
                    let (column, row) = (cell % 8 * per_cell + k % per_cell, cell / 8 * per_cell + k / per_cell);
                    if column < blocks_per_row && row < rows {
                        let block = &mut blocks[(row * blocks_per_row + column) as usize];
                        if block.state == State::Live {
                            shader.shade(simd, tile, block, chunk, &list, bound);
                        }
                        alive |= block.state == State::Live;
                    }
                }
                if !alive {
                    *live &= !(1 << cell);
                }
            }
            let mut list = list;
            list.clear();
            shader.cells[cell as usize] = list;
        }
    }
}

impl Shader<'_> {
    /// Evaluates `list` in `block`, and blends everything whose key lies below `bound` or whose order is settled.
    #[inline(always)]
    fn shade<S: Simd>(
        &mut self,
        simd: S,
        tile: &Tile,
        block: &mut Block,
        chunk: &[Candidate],
        list: &[u32],
        bound: f32,
    ) {
        self.entries.clear();
        self.entries.append(&mut block.pending);
        self.open.clear();
        self.open.extend(0..self.entries.len() as u32);
        let carried = self.entries.len();
        let (left, top) = (block.x[0] as i16, block.y[0] as i16);
        let last = BLOCK_EDGE as i16 - 1;
        for &i in list {
            let candidate = &chunk[i as usize];
            let [x0, y0, x1, y1] = candidate.bounds;
            if x0 <= left + last && x1 >= left && y0 <= top + last && y1 >= top {
                if candidate.is_gaussian() {
                    self.evaluate(simd, tile, block, candidate);
                } else {
                    self.intersect(tile, block, candidate);
                }
            }
        }
        // Keys of contributions are not negative, so their bit patterns order as they do.
        self.sorted.clear();
        let keyed = |(i, entry): (usize, &Entry)| (entry.key_min.to_bits(), i as u32);
        self.sorted.extend(self.entries.iter().enumerate().skip(carried).map(keyed));
        self.sorted.sort_unstable();
        for k in 0..self.sorted.len() {
            let (key_bits, i) = self.sorted[k];
            self.retire(simd, block, f32::from_bits(key_bits).min(bound));
            if block.state != State::Live {
                return;
            }
            self.pair(simd, block, i as usize);
            if self.open.len() > MAX_PENDING {
                block.state = State::Overflowed;
                return;
            }
        }
        self.retire(simd, block, bound);
        if block.state == State::Live {
            block.pending.extend(self.open.iter().map(|&i| self.entries[i as usize]));
        }
        if block.pending.is_empty() && bound == f32::INFINITY && block.state == State::Live {
            block.state = State::Done;
        }
    }

    /// Adds an entry for a Gaussian if any lane sees it respond with at least 1/255 in front of the near end.
    #[inline(always)]
    fn evaluate<S: Simd>(&mut self, simd: S, tile: &Tile, block: &Block, candidate: &Candidate) {
        let Candidate { u, s, h, falloff, log2_opacity, depth, .. } = *candidate;
        let fixed_key = (self.tracer.settings.order == Order::CameraDistance).then_some(candidate.key_low);
        let splat = |value: f32| simd.splat_f32s(value);
        let (nowhere, infinity) = (splat(f32::NEG_INFINITY), splat(f32::INFINITY));
        let (mut key_min, mut key_max) = (infinity, nowhere);
        let mut entry = Entry {
            key: [0.0; LANES],
            depth: [0.0; LANES],
            alpha: [0.0; LANES],
            weight: [0.0; LANES],
            key_min: 0.0,
            key_max: 0.0,
            index: candidate.index,
            colour: Colour::Splat(candidate.colour),
        };
        for v in 0..LANES / S::F32_LANES {
            let (x, y) = (lanes::<S>(&block.x, v), lanes::<S>(&block.y, v));
            let affine = |form: [f32; 3]| {
                simd.mul_add_e_f32s(splat(form[1]), x, simd.mul_add_e_f32s(splat(form[2]), y, splat(form[0])))
            };
            let (u, h) = (affine(u), affine(h));
            let s = simd.mul_add_e_f32s(splat(s[1]), y, splat(s[0]));
            let across = simd.mul_add_e_f32s(u, u, simd.mul_f32s(s, s));
            let v_squared_inverse = simd.div_f32s(splat(1.0), simd.mul_add_e_f32s(h, h, across));
            let exponent = simd
                .sub_f32s(splat(log2_opacity), simd.mul_f32s(splat(falloff), simd.mul_f32s(across, v_squared_inverse)));
            let lane_depth = simd.mul_f32s(simd.mul_f32s(splat(depth), h), v_squared_inverse);
            let contributes = simd.and_m32s(
                simd.greater_than_or_equal_f32s(exponent, splat(LOG2_ALPHA_MIN)),
                simd.greater_than_f32s(lane_depth, lanes::<S>(&block.near_depth, v)),
            );
            let alpha = simd.min_f32s(exp2(simd, exponent), splat(ALPHA_MAX as f32));
            let key = fixed_key.map_or(lane_depth, splat);
            key_min = simd.min_f32s(key_min, simd.select_f32s(contributes, key, infinity));
            key_max = simd.max_f32s(key_max, simd.select_f32s(contributes, key, nowhere));
            set_lanes::<S>(&mut entry.key, v, key);
            set_lanes::<S>(&mut entry.depth, v, lane_depth);
            set_lanes::<S>(&mut entry.alpha, v, simd.select_f32s(contributes, alpha, splat(0.0)));
        }
        entry.key_max = simd.reduce_max_f32s(key_max);
        if entry.key_max == f32::NEG_INFINITY {
            return;
        }
        entry.key_min = simd.reduce_min_f32s(key_min);
        if self.tracer.settings.sh_direction == ShDirection::Ray {
            entry.colour = Colour::SplatLanes(self.lane_colours.len() as u32);
            let colours = self.colours_along_rays(tile, block, candidate.index as usize);
            self.lane_colours.push(colours);
        }
        self.entries.push(entry);
    }

    /// Adds an entry for a triangle if any lane sees it.
    fn intersect(&mut self, tile: &Tile, block: &Block, candidate: &Candidate) {
        let index = candidate.triangle();
        let (scene, surfaces) = (self.tracer.scene, self.tracer.surfaces);
        let corners = scene.meshes.corners(index as usize).map(|corner| corner.as_dvec3() - self.origin);
        let double_sided = surfaces.is_double_sided(index);
        let mut entry = Entry {
            key: [0.0; LANES],
            depth: [0.0; LANES],
            alpha: [0.0; LANES],
            weight: [0.0; LANES],
            key_min: f32::INFINITY,
            key_max: f32::NEG_INFINITY,
            index: candidate.index,
            colour: Colour::SurfaceLanes(self.lane_colours.len() as u32),
        };
        let mut colours = [[0.0; LANES]; 3];
        for lane in 0..LANES {
            let inside = block.x[lane] < tile.width as f32 && block.y[lane] < tile.height as f32;
            if !inside || block.transmittance[lane] <= 0.0 {
                continue;
            }
            // The same unit direction as the ray tracer's, so that both see the same edges.
            let direction = lane_direction(tile, &block.x, &block.y, lane).normalize();
            let Some(met) = triangle::intersect(corners, direction) else { continue };
            if !(met.front || double_sided) || met.distance <= f64::from(self.tracer.settings.t_near) {
                continue;
            }
            let hit =
                SurfaceHit { triangle: index, barycentric: met.barycentric, front: met.front, distance: met.distance };
            let fragment = surfaces.fragment(&Ray { origin: self.origin, direction }, &hit);
            if fragment.alpha <= 0.0 {
                continue;
            }
            let depth = met.distance as f32 / block.metres_per_depth[lane];
            entry.depth[lane] = depth;
            entry.key[lane] = match self.tracer.settings.order {
                Order::RayHitDistance => depth,
                Order::CameraDistance => met.distance as f32,
            };
            entry.alpha[lane] = fragment.alpha;
            entry.key_min = entry.key_min.min(entry.key[lane]);
            entry.key_max = entry.key_max.max(entry.key[lane]);
            for (channel, value) in colours.iter_mut().zip(fragment.radiance.0.to_array()) {
                channel[lane] = value;
            }
        }
        if entry.key_max > f32::NEG_INFINITY {
            self.lane_colours.push(colours);
            self.entries.push(entry);
        }
    }

    /// Starts entry `i`: what was finished before it dims it, and it and the open entries dim each other.
    #[inline(always)]
    fn pair<S: Simd>(&mut self, simd: S, block: &Block, i: usize) {
        let (one, mut new) = (simd.splat_f32s(1.0), self.entries[i]);
        for v in 0..LANES / S::F32_LANES {
            let alpha = lanes::<S>(&new.alpha, v);
            let (key, passes) = (lanes::<S>(&new.key, v), simd.sub_f32s(one, alpha));
            let mut weight = simd.mul_f32s(alpha, lanes::<S>(&block.transmittance, v));
            for &j in &self.open {
                let other = &mut self.entries[j as usize];
                let (other_key, other_weight) = (lanes::<S>(&other.key, v), lanes::<S>(&other.weight, v));
                let other_passes = simd.sub_f32s(one, lanes::<S>(&other.alpha, v));
                let other_first = if other.index < new.index {
                    simd.less_than_or_equal_f32s(other_key, key)
                } else {
                    simd.less_than_f32s(other_key, key)
                };
                weight = simd.select_f32s(other_first, simd.mul_f32s(weight, other_passes), weight);
                let dimmed = simd.select_f32s(other_first, other_weight, simd.mul_f32s(other_weight, passes));
                set_lanes::<S>(&mut other.weight, v, dimmed);
            }
            set_lanes::<S>(&mut new.weight, v, weight);
        }
        self.entries[i].weight = new.weight;
        self.open.push(i as u32);
    }

    /// Finishes the open entries whose keys all lie below `bound`; ends the block when every ray has.
    #[inline(always)]
    fn retire<S: Simd>(&mut self, simd: S, block: &mut Block, bound: f32) {
        let mut retired = false;
        let mut kept = 0;
        for k in 0..self.open.len() {
            let i = self.open[k];
            if self.entries[i as usize].key_max < bound {
                self.blend(simd, block, i as usize);
                retired = true;
            } else {
                self.open[kept] = i;
                kept += 1;
            }
        }
        self.open.truncate(kept);
        if retired && self.all_ended(simd, block) {
            // What is still open may precede, in some lane, what ended the ray; nothing yet to come can.
            for k in 0..self.open.len() {
                self.blend(simd, block, self.open[k] as usize);
            }
            block.state = State::Done;
        }
    }

    /// Adds a finished entry. A ray takes nothing more once its transmittance is below the cut-off: the weight of an
    /// entry is its alpha times the transmittance before it, so that is known lane by lane.
    #[inline(always)]
    fn blend<S: Simd>(&self, simd: S, block: &mut Block, i: usize) {
        let entry = &self.entries[i];
        let cutoff = simd.splat_f32s(self.tracer.settings.t_cutoff);
        for v in 0..LANES / S::F32_LANES {
            let alpha = lanes::<S>(&entry.alpha, v);
            let weight = lanes::<S>(&entry.weight, v);
            let reached = simd.greater_than_or_equal_f32s(weight, simd.mul_f32s(cutoff, alpha));
            let alpha = simd.select_f32s(reached, alpha, simd.splat_f32s(0.0));
            let weight = simd.select_f32s(reached, weight, simd.splat_f32s(0.0));
            let add = |sum: &mut Lanes, value: S::f32s| {
                let total = simd.mul_add_e_f32s(weight, value, lanes::<S>(sum, v));
                set_lanes::<S>(sum, v, total);
            };
            let passes = simd.sub_f32s(simd.splat_f32s(1.0), alpha);
            let transmittance = simd.mul_f32s(lanes::<S>(&block.transmittance, v), passes);
            set_lanes::<S>(&mut block.transmittance, v, transmittance);
            add(&mut block.depth_sum, lanes::<S>(&entry.depth, v));
            match entry.colour {
                Colour::Splat(colour) => {
                    for (sum, value) in block.splat_sum.iter_mut().zip(colour) {
                        add(sum, simd.splat_f32s(value));
                    }
                    add(&mut block.splat_weight, simd.splat_f32s(1.0));
                }
                Colour::SplatLanes(colours) => {
                    for (sum, value) in block.splat_sum.iter_mut().zip(&self.lane_colours[colours as usize]) {
                        add(sum, lanes::<S>(value, v));
                    }
                    add(&mut block.splat_weight, simd.splat_f32s(1.0));
                }
                Colour::SurfaceLanes(colours) => {
                    for (sum, value) in block.surface_sum.iter_mut().zip(&self.lane_colours[colours as usize]) {
                        add(sum, lanes::<S>(value, v));
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn all_ended<S: Simd>(&self, simd: S, block: &Block) -> bool {
        // Below the cut-off, or at 0 when there is none.
        let end = simd.splat_f32s(self.tracer.settings.t_cutoff.max(f32::MIN_POSITIVE));
        (0..LANES / S::F32_LANES).all(|v| {
            let alive = simd.greater_than_or_equal_f32s(lanes::<S>(&block.transmittance, v), end);
            simd.first_true_m32s(alive) >= S::F32_LANES
        })
    }

    fn colours_along_rays(&self, tile: &Tile, block: &Block, index: usize) -> [Lanes; 3] {
        let splats = &self.tracer.scene.splats;
        let mut colours = [[0.0; LANES]; 3];
        for lane in 0..LANES {
            let direction = lane_direction(tile, &block.x, &block.y, lane).normalize().as_vec3();
            let colour = sh::evaluate(splats.sh_degree, splats.sh_of(index), direction);
            for (channel, value) in colours.iter_mut().zip(colour.to_array()) {
                channel[lane] = value;
            }
        }
        colours
    }
}

/// log2(1/255).
const LOG2_ALPHA_MIN: f32 = -7.994_353_4;

/// 2^x for -126 < x < 126, to 1.5e-7 relative: `2^round(x)` through the exponent bits times a polynomial of degree 5,
/// fitted to least relative error (7.5e-8) on [-1/2, 1/2].
#[inline(always)]
fn exp2<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    const COEFFICIENTS: [f32; 6] = [
        1.000_000_071_654_656_9,
        0.693_146_967_063_865,
        0.240_221_197_239_337_74,
        0.055_507_132_749_622_635,
        0.009_675_541_330_688_348,
        0.001_327_647_151_927_401,
    ];
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

/// Vector `v` of a block's lanes.
#[inline(always)]
fn lanes<S: Simd>(values: &Lanes, v: usize) -> S::f32s {
    S::as_simd_f32s(values).0[v]
}

#[inline(always)]
fn set_lanes<S: Simd>(values: &mut Lanes, v: usize, vector: S::f32s) {
    S::as_mut_simd_f32s(values).0[v] = vector;
}

#[cfg(test)]
mod tests {
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
        assert!((f64::from(LOG2_ALPHA_MIN) - ALPHA_MIN.log2()).abs() < 5e-7);
    }
}
