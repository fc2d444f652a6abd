//! A square of texels: contributions wait here until their order is settled, and are blended in exact order per ray.
//!
//! The order of two contributions may differ from ray to ray, and arriving in nearly the right order is not enough (it
//! errs by up to half the range of a colour on captured scenes). Instead of moving entries about lane by lane, which
//! needs gathers of colours, each entry carries the transmittance `before` it in every lane, and a new entry i corrects
//! the few that it precedes somewhere:
//!
//! ```text
//! before_i = max over open j with key_i < key_j of before_j, or that of the whole block where there is none
//! before_j *= 1 - alpha_i   where key_i < key_j
//! ```
//!
//! (transmittance falls along a ray, so the largest is that of the entry right behind i). Going back from the newest,
//! this stops as soon as the running maximum of the keys lies below i's in all lanes: for parallel layers at once.
//! Entries arrive in the order of
//! their least keys, so that there are few; an entry is finished once every key still to come lies beyond its largest.
//
// Tried: sorting each lane's list by packed keys (Batcher's network over 16 lanes) and gathering alpha and colour by
// index; the four gathers per entry alone cost more than evaluating the response. Multiplying the weights of every pair
// whose key ranges overlap: exact too, but layers of a wall all overlap and a block paid 20 pairs per entry.

use glam::{DVec3, Vec3};
use pulp::Simd;

use super::desk::{Colour, Desk, Entry, Open, Waiting};
use super::lanes::{Lanes, texel_of_lane};
use crate::trace::{Radiance, Tile};

/// Transmittance stops falling here. Nothing this faint is seen, and denormal numbers, which cost a hundred times more
/// than others, never arise.
const FAINTEST: f32 = 1e-30;

/// A block whose unfinished entries outnumber this goes to the ray tracer: each of them may have to be corrected by
/// each.
const MAX_OPEN: usize = 1024;

/// What a block's rays have gathered so far.
pub(super) struct Block<const N: usize> {
    /// Texel positions from the tile's corner, at texel centres.
    pub x: Lanes<N>,
    pub y: Lanes<N>,
    /// Length of the direction whose look component is 1: metres per unit of depth.
    pub metres_per_depth: Lanes<N>,
    /// Depth from which on contributions count; infinite in lanes whose ray has ended.
    pub near_depth: Lanes<N>,
    /// Metres to the nearest opaque surface that has arrived: what surfaces behind it look like is never asked.
    pub opaque_distance: Lanes<N>,
    splat_sum: [Lanes<N>; 3],
    splat_weight: Lanes<N>,
    surface_sum: [Lanes<N>; 3],
    depth_sum: Lanes<N>,
    /// Of what is blended.
    transmittance: Lanes<N>,
    /// Of what has arrived.
    behind_all: Lanes<N>,
    /// Largest key that has arrived.
    latest: Lanes<N>,
    /// Unfinished contributions; while there are any.
    desk: Option<Box<Desk<N>>>,
    pub state: State,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum State {
    Live,
    /// Every ray has ended.
    Done,
    /// Too many entries overlap; the ray tracer must do it.
    Overflowed,
}

impl<const N: usize> Block<N> {
    /// The block whose first texel is (x, y) of the tile.
    pub fn new(tile: &Tile, x: u32, y: u32, t_near: f32) -> Self {
        let lane_x = Lanes(std::array::from_fn(|lane| x as f32 + texel_of_lane(N, lane)[0] as f32 + 0.5));
        let lane_y = Lanes(std::array::from_fn(|lane| y as f32 + texel_of_lane(N, lane)[1] as f32 + 0.5));
        // Lanes beyond the tile's edge have ended before they begin.
        let inside = |lane: usize| lane_x.0[lane] < tile.width as f32 && lane_y.0[lane] < tile.height as f32;
        let mut block = Self {
            x: lane_x,
            y: lane_y,
            metres_per_depth: Lanes::splat(1.0),
            near_depth: Lanes::splat(0.0),
            opaque_distance: Lanes::splat(f32::INFINITY),
            splat_sum: [Lanes::splat(0.0); 3],
            splat_weight: Lanes::splat(0.0),
            surface_sum: [Lanes::splat(0.0); 3],
            depth_sum: Lanes::splat(0.0),
            transmittance: Lanes(std::array::from_fn(|lane| f32::from(inside(lane)))),
            behind_all: Lanes::splat(1.0),
            latest: Lanes::splat(f32::NEG_INFINITY),
            desk: None,
            state: State::Live,
        };
        for lane in 0..N {
            let metres_per_depth = block.direction(tile, lane).length() as f32;
            block.metres_per_depth.0[lane] = metres_per_depth;
            block.near_depth.0[lane] = if inside(lane) { t_near / metres_per_depth } else { f32::INFINITY };
        }
        block
    }

    /// Whether any of the block's texels belongs to `tile`.
    pub fn is_inside(&self, tile: &Tile) -> bool {
        self.x.0[0] < tile.width as f32 && self.y.0[0] < tile.height as f32
    }

    /// Direction through a lane's texel; its look component is 1.
    pub fn direction(&self, tile: &Tile, lane: usize) -> DVec3 {
        let (x, y) = (f64::from(self.x.0[lane]), f64::from(self.y.0[lane]));
        tile.face.direction(tile.face_size, f64::from(tile.x) + x, f64::from(tile.y) + y)
    }

    /// The result of one lane, `None` if the block overflowed.
    pub fn radiance(&self, lane: usize) -> Option<Radiance> {
        (self.state != State::Overflowed).then(|| Radiance {
            splat_sum: Vec3::from_array(self.splat_sum.map(|channel| channel.0[lane])),
            splat_weight: self.splat_weight.0[lane],
            surface_sum: Vec3::from_array(self.surface_sum.map(|channel| channel.0[lane])),
            distance_sum: self.depth_sum.0[lane] * self.metres_per_depth.0[lane],
            transmittance: self.transmittance.0[lane],
        })
    }

    /// The block's desk, one from the `pool`, or a new one.
    #[inline(always)]
    pub fn take_desk(&mut self, pool: &mut Vec<Box<Desk<N>>>) -> Box<Desk<N>> {
        self.desk.take().or_else(|| pool.pop()).unwrap_or_default()
    }

    /// Keeps the desk while something is unfinished.
    #[inline(always)]
    pub fn return_desk(&mut self, mut desk: Box<Desk<N>>, pool: &mut Vec<Box<Desk<N>>>) {
        if self.state == State::Live && !desk.is_empty() {
            self.desk = Some(desk);
        } else {
            desk.clear();
            pool.push(desk);
        }
    }

    /// Lets arrive and blends all whose turn has come, when every key still to be waited for is at least `bound`; ends
    /// the block when every ray has ended.
    #[inline(always)]
    pub fn advance<S: Simd>(
        &mut self,
        simd: S,
        desk: &mut Desk<N>,
        bound: f32,
        cutoff: f32,
        lane_colours: &[[Lanes<N>; 3]],
    ) {
        let limit = u64::from(bound.to_bits()) << 32;
        while let Some(Waiting { slot, key_max, .. }) = desk.take_before(limit) {
            self.arrive(simd, desk, Open { slot, key_max });
        }
        let least = desk.least_waiting().min(bound);
        self.settle(simd, desk, least, cutoff, lane_colours);
        if desk.open.len() > MAX_OPEN {
            self.state = State::Overflowed;
        }
    }

    /// Finds the transmittance before an entry, and dims what it precedes.
    #[inline(always)]
    fn arrive<S: Simd>(&mut self, simd: S, desk: &mut Desk<N>, arrived: Open) {
        let Desk { entries, open, .. } = desk;
        let slot = arrived.slot;
        let faintest = simd.splat_f32s(FAINTEST);
        for v in 0..N / S::F32_LANES {
            let entry = &entries[slot as usize];
            let (own_key, alpha) = (entry.key.get::<S>(v), entry.alpha.get::<S>(v));
            let passes = simd.sub_f32s(simd.splat_f32s(1.0), alpha);
            let contributes = simd.greater_than_f32s(alpha, simd.splat_f32s(0.0));
            if simd.first_true_m32s(contributes) >= S::F32_LANES {
                entries[slot as usize].latest.set::<S>(v, self.latest.get::<S>(v));
                continue;
            }
            // Lanes that it does not contribute to precede nothing.
            let key = simd.select_f32s(contributes, own_key, simd.splat_f32s(f32::INFINITY));
            let behind_all = self.behind_all.get::<S>(v);
            let mut before = behind_all;
            let mut latest = self.latest.get::<S>(v);
            for &Open { slot: j, .. } in open.iter().rev() {
                // Where every earlier key is no larger, nothing earlier is preceded.
                let preceded = simd.less_than_f32s(key, latest);
                if simd.first_true_m32s(preceded) >= S::F32_LANES {
                    break;
                }
                let other = &mut entries[j as usize];
                let other_before = other.before.get::<S>(v);
                let precedes = simd.less_than_f32s(key, other.key.get::<S>(v));
                before = simd.select_f32s(precedes, simd.max_f32s(before, other_before), before);
                let dimmed = simd.max_f32s(simd.mul_f32s(other_before, passes), faintest);
                other.before.set::<S>(v, simd.select_f32s(precedes, dimmed, other_before));
                latest = other.latest.get::<S>(v);
            }
            let stored = &mut entries[slot as usize];
            stored.before.set::<S>(v, before);
            stored.latest.set::<S>(v, self.latest.get::<S>(v));
            let behind = simd.max_f32s(simd.mul_f32s(behind_all, passes), faintest);
            self.behind_all.set::<S>(v, behind);
            self.latest.set::<S>(v, simd.max_f32s(self.latest.get::<S>(v), own_key));
        }
        open.push(arrived);
    }

    /// Blends the arrived entries whose keys all lie below `bound`, the least key that may still arrive.
    #[inline(always)]
    fn settle<S: Simd>(
        &mut self,
        simd: S,
        desk: &mut Desk<N>,
        bound: f32,
        cutoff: f32,
        lane_colours: &[[Lanes<N>; 3]],
    ) {
        let mut kept = 0;
        for k in 0..desk.open.len() {
            let open = desk.open[k];
            if open.key_max < bound {
                self.blend(simd, &desk.entries[open.slot as usize], cutoff, lane_colours);
                desk.free.push(open.slot);
            } else {
                desk.open[kept] = open;
                kept += 1;
            }
        }
        let settled = kept < desk.open.len();
        desk.open.truncate(kept);
        if bound == f32::INFINITY {
            self.state = State::Done;
        } else if settled && self.all_ended(simd, cutoff) {
            // What is still open may precede, in some lane, what ended the ray; nothing yet to come can.
            for k in 0..desk.open.len() {
                self.blend(simd, &desk.entries[desk.open[k].slot as usize], cutoff, lane_colours);
            }
            self.state = State::Done;
        }
    }

    /// Adds a finished entry. A ray takes nothing more once the transmittance before is below the cut-off.
    #[inline(always)]
    fn blend<S: Simd>(&mut self, simd: S, entry: &Entry<N>, cutoff: f32, lane_colours: &[[Lanes<N>; 3]]) {
        let (cutoff, zero) = (simd.splat_f32s(cutoff), simd.splat_f32s(0.0));
        for v in 0..N / S::F32_LANES {
            let contributed = entry.alpha.get::<S>(v);
            if simd.first_true_m32s(simd.greater_than_f32s(contributed, zero)) >= S::F32_LANES {
                continue;
            }
            let before = entry.before.get::<S>(v);
            let reached = simd.greater_than_or_equal_f32s(before, cutoff);
            let alpha = simd.select_f32s(reached, contributed, zero);
            let weight = simd.mul_f32s(alpha, before);
            let passes = simd.sub_f32s(simd.splat_f32s(1.0), alpha);
            let transmittance = simd.mul_f32s(self.transmittance.get::<S>(v), passes);
            let transmittance = simd.max_f32s(transmittance, simd.splat_f32s(FAINTEST));
            let ended = simd.less_than_f32s(transmittance, cutoff);
            let near = simd.select_f32s(ended, simd.splat_f32s(f32::INFINITY), self.near_depth.get::<S>(v));
            self.transmittance.set::<S>(v, transmittance);
            self.near_depth.set::<S>(v, near);
            add_weighted(simd, &mut self.depth_sum, v, weight, entry.depth.get::<S>(v));
            match entry.colour {
                Colour::Splat(colour) => {
                    for (sum, value) in self.splat_sum.iter_mut().zip(colour) {
                        add_weighted(simd, sum, v, weight, simd.splat_f32s(value));
                    }
                    add_weighted(simd, &mut self.splat_weight, v, weight, simd.splat_f32s(1.0));
                }
                Colour::SplatLanes(colours) => {
                    for (sum, value) in self.splat_sum.iter_mut().zip(&lane_colours[colours as usize]) {
                        add_weighted(simd, sum, v, weight, value.get::<S>(v));
                    }
                    add_weighted(simd, &mut self.splat_weight, v, weight, simd.splat_f32s(1.0));
                }
                Colour::Linear(colour) => {
                    for (sum, value) in self.surface_sum.iter_mut().zip(colour) {
                        add_weighted(simd, sum, v, weight, simd.splat_f32s(value));
                    }
                }
                Colour::LinearLanes(colours) => {
                    for (sum, value) in self.surface_sum.iter_mut().zip(&lane_colours[colours as usize]) {
                        add_weighted(simd, sum, v, weight, value.get::<S>(v));
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn all_ended<S: Simd>(&self, simd: S, cutoff: f32) -> bool {
        let end = simd.splat_f32s(cutoff.max(2.0 * FAINTEST));
        (0..N / S::F32_LANES).all(|v| {
            let alive = simd.greater_than_or_equal_f32s(self.transmittance.get::<S>(v), end);
            simd.first_true_m32s(alive) >= S::F32_LANES
        })
    }
}

/// `sum += weight * value` in vector `v`.
#[inline(always)]
fn add_weighted<S: Simd, const N: usize>(simd: S, sum: &mut Lanes<N>, v: usize, weight: S::f32s, value: S::f32s) {
    sum.set::<S>(v, simd.mul_add_e_f32s(weight, value, sum.get::<S>(v)));
}
