//! A square of texels: contributions wait here until their order is settled, and are blended in exact order per ray.
//!
//! The order of two contributions may differ from ray to ray, and arriving in nearly the right order is not enough (it
//! errs by up to half the range of a colour on captured scenes). Instead of moving entries about lane by lane, which
//! needs gathers of colours, each entry carries the transmittance `before` it in every lane, and a new entry i corrects
//! the few that it precedes somewhere:
//!
//! ```text
//! before_i = max over open j with key_i < key_j of before_j, or that of the whole quad where there is none
//! before_j *= 1 - alpha_i   where key_i < key_j
//! ```
//!
//! (transmittance falls along a ray, so the largest is that of the entry right behind i). Going back from the newest,
//! this stops as soon as the running maximum of the keys lies below i's in all lanes: for parallel layers at once.
//! Entries arrive in the order of their keys in the middle of a block, so that these are few: three to five. An entry is
//! settled, and blended, once every key still to come lies beyond it.
//!
//! A ray ends long before that. Whatever is still to come only dims what has arrived, so a ray takes nothing beyond the
//! first entry behind which its transmittance is below the cut-off: `far`, which tells at once what need not be evaluated.
//
// Tried: sorting each lane's list by packed keys (Batcher's network over 16 lanes) and gathering alpha and colour by
// index; the four gathers per entry alone cost more than evaluating the response. Multiplying the weights of every pair
// whose key ranges overlap: exact too, but layers of a wall all overlap and a quad paid 20 pairs per entry.

use glam::{DVec3, Vec3};
use pulp::Simd;

use super::desk::{Colour, Desk, Entry};
use super::lanes::{LANES, Lanes, any, texel_of_lane};
use crate::trace::{Radiance, Tile};

/// Transmittance stops falling here. Nothing this faint is seen, and denormal numbers, which cost a hundred times more
/// than others, never arise.
const FAINTEST: f32 = 1e-30;

/// A quad whose unfinished entries outnumber this goes to the ray tracer: each of them may have to be corrected by
/// each.
const MAX_OPEN: usize = 1024;

/// What a quad's rays have gathered so far.
pub(super) struct Quad {
    /// Texel positions from the tile's corner, at texel centres.
    pub x: Lanes,
    pub y: Lanes,
    /// Length of the direction whose look component is 1: metres per unit of depth.
    pub metres_per_depth: Lanes,
    /// Depth from which on contributions count.
    pub near_depth: Lanes,
    /// Largest key of contributions that count; negative in lanes beyond the tile's edge.
    pub far: Lanes,
    /// Metres to the nearest opaque surface that has arrived: what surfaces behind it look like is never asked.
    pub opaque_distance: Lanes,
    splat_sum: [Lanes; 3],
    splat_weight: Lanes,
    surface_sum: [Lanes; 3],
    depth_sum: Lanes,
    /// Of what is blended.
    transmittance: Lanes,
    /// Of what has arrived.
    behind_all: Lanes,
    /// Largest key that has arrived.
    latest: Lanes,
    /// Unfinished contributions; while there are any.
    desk: Option<Box<Desk>>,
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

impl Quad {
    /// The quad whose first texel is (x, y) of the tile.
    #[inline(always)]
    pub fn new(tile: &Tile, x: u32, y: u32, t_near: f32) -> Self {
        let lane_x = Lanes(std::array::from_fn(|lane| x as f32 + texel_of_lane(lane)[0] as f32 + 0.5));
        let lane_y = Lanes(std::array::from_fn(|lane| y as f32 + texel_of_lane(lane)[1] as f32 + 0.5));
        // Lanes beyond the tile's edge have ended before they begin.
        let inside = |lane: usize| lane_x.0[lane] < tile.width as f32 && lane_y.0[lane] < tile.height as f32;
        let end = |lane: usize| if inside(lane) { f32::INFINITY } else { -1.0 };
        let mut quad = Self {
            x: lane_x,
            y: lane_y,
            metres_per_depth: Lanes::splat(1.0),
            near_depth: Lanes::splat(0.0),
            far: Lanes(std::array::from_fn(end)),
            opaque_distance: Lanes::splat(f32::INFINITY),
            splat_sum: [Lanes::splat(0.0); 3],
            splat_weight: Lanes::splat(0.0),
            surface_sum: [Lanes::splat(0.0); 3],
            depth_sum: Lanes::splat(0.0),
            transmittance: Lanes::splat(1.0),
            behind_all: Lanes::splat(1.0),
            latest: Lanes::splat(f32::NEG_INFINITY),
            desk: None,
            state: if inside(0) { State::Live } else { State::Done },
        };
        // The length of [`Self::direction`], which is the same on every face, for all lanes at once.
        let texel = 2.0 / f64::from(tile.face_size);
        for lane in 0..LANES {
            let right = (f64::from(tile.x) + f64::from(quad.x.0[lane])) * texel - 1.0;
            let down = (f64::from(tile.y) + f64::from(quad.y.0[lane])) * texel - 1.0;
            let metres_per_depth = (1.0 + right * right + down * down).sqrt() as f32;
            quad.metres_per_depth.0[lane] = metres_per_depth;
            quad.near_depth.0[lane] = t_near / metres_per_depth;
        }
        quad
    }

    /// Direction through a lane's texel; its look component is 1.
    pub fn direction(&self, tile: &Tile, lane: usize) -> DVec3 {
        let (x, y) = (f64::from(self.x.0[lane]), f64::from(self.y.0[lane]));
        tile.face.direction(tile.face_size, f64::from(tile.x) + x, f64::from(tile.y) + y)
    }

    /// The result of one lane.
    #[inline(always)]
    pub fn radiance(&self, lane: usize) -> Radiance {
        let [red, green, blue] = &self.splat_sum;
        let [linear_red, linear_green, linear_blue] = &self.surface_sum;
        Radiance {
            splat_sum: Vec3::new(red.0[lane], green.0[lane], blue.0[lane]),
            splat_weight: self.splat_weight.0[lane],
            surface_sum: Vec3::new(linear_red.0[lane], linear_green.0[lane], linear_blue.0[lane]),
            distance_sum: self.depth_sum.0[lane] * self.metres_per_depth.0[lane],
            transmittance: self.transmittance.0[lane],
        }
    }

    /// The quad's desk, one from the `pool`, or a new one.
    #[inline(always)]
    pub fn take_desk(&mut self, pool: &mut Vec<Box<Desk>>) -> Box<Desk> {
        self.desk.take().or_else(|| pool.pop()).unwrap_or_default()
    }

    /// Keeps the desk while something is unfinished.
    #[inline(always)]
    pub fn return_desk(&mut self, mut desk: Box<Desk>, pool: &mut Vec<Box<Desk>>) {
        if self.state == State::Live && desk.len() > 0 {
            self.desk = Some(desk);
        } else {
            desk.clear();
            pool.push(desk);
        }
    }

    /// Whether a contribution with `key` counts in any lane.
    #[inline(always)]
    pub fn takes<S: Simd>(&self, simd: S, key: f32) -> bool {
        let key = simd.splat_f32s(key);
        let mut takes = false;
        for v in 0..LANES / S::F32_LANES {
            takes |= any(simd, simd.less_than_or_equal_f32s(key, self.far.get::<S>(v)));
        }
        takes
    }

    /// Whether nothing counts any more when every key still to come is at least `bound`.
    #[inline(always)]
    pub fn ends<S: Simd>(&self, simd: S, bound: f32) -> bool {
        bound == f32::INFINITY || !self.takes(simd, bound)
    }

    /// Lets the entries from `first` on arrive: finds the transmittance before each, dims what it precedes, and tells where
    /// rays now end.
    #[inline(always)]
    pub fn arrive<S: Simd>(&mut self, simd: S, entries: &mut [Entry], first: usize, cutoff: f32) {
        let (faintest, end) = (simd.splat_f32s(FAINTEST), simd.splat_f32s(least_passing(cutoff)));
        let (zero, one, infinity) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0), simd.splat_f32s(f32::INFINITY));
        for v in 0..LANES / S::F32_LANES {
            let mut behind_all = self.behind_all.get::<S>(v);
            let mut latest_of_all = self.latest.get::<S>(v);
            let mut far = self.far.get::<S>(v);
            for i in first..entries.len() {
                let (earlier, rest) = entries.split_at_mut(i);
                let Some(arrived) = rest.first_mut() else { break };
                let (own_key, alpha) = (arrived.key.get::<S>(v), arrived.alpha.get::<S>(v));
                let passes = simd.sub_f32s(one, alpha);
                let index = simd.splat_u32s(arrived.index);
                // Lanes that it does not contribute to precede nothing.
                let key = simd.select_f32s(simd.greater_than_f32s(alpha, zero), own_key, infinity);
                let (mut before, mut latest) = (behind_all, latest_of_all);
                for other in earlier.iter_mut().rev() {
                    // Where every earlier key is smaller, nothing earlier is preceded.
                    if !any(simd, simd.less_than_or_equal_f32s(key, latest)) {
                        break;
                    }
                    let (other_key, other_before) = (other.key.get::<S>(v), other.before.get::<S>(v));
                    // Of equal keys, that of the lower index comes first.
                    let tied = simd.less_than_u32s(index, simd.splat_u32s(other.index));
                    let precedes = simd.or_m32s(
                        simd.less_than_f32s(key, other_key),
                        simd.and_m32s(tied, simd.equal_f32s(key, other_key)),
                    );
                    before = simd.select_f32s(precedes, simd.max_f32s(before, other_before), before);
                    let dimmed = simd.max_f32s(simd.mul_f32s(other_before, passes), faintest);
                    other.before.set::<S>(v, simd.select_f32s(precedes, dimmed, other_before));
                    let unseen = simd.and_m32s(precedes, simd.less_than_f32s(dimmed, end));
                    far = simd.select_f32s(unseen, simd.min_f32s(far, other_key), far);
                    latest = other.latest.get::<S>(v);
                }
                arrived.before.set::<S>(v, before);
                arrived.latest.set::<S>(v, latest_of_all);
                let beyond = simd.mul_f32s(before, passes);
                far = simd.select_f32s(simd.less_than_f32s(beyond, end), simd.min_f32s(far, key), far);
                behind_all = simd.max_f32s(simd.mul_f32s(behind_all, passes), faintest);
                latest_of_all = simd.max_f32s(latest_of_all, own_key);
            }
            self.far.set::<S>(v, far);
            self.behind_all.set::<S>(v, behind_all);
            self.latest.set::<S>(v, latest_of_all);
        }
    }

    /// Blends the arrived entries whose keys all lie below `bound`, the least key that may still arrive; all of them, and
    /// ends the quad, when nothing that may still arrive counts.
    #[inline(always)]
    pub fn settle<S: Simd>(&mut self, simd: S, desk: &mut Desk, bound: f32, cutoff: f32, lane_colours: &[[Lanes; 3]]) {
        let ends = self.ends(simd, bound);
        let least = simd.splat_f32s(if ends { f32::INFINITY } else { bound });
        for entry in desk.entries() {
            let mut open = false;
            for v in 0..LANES / S::F32_LANES {
                open |= any(simd, simd.greater_than_or_equal_f32s(entry.key.get::<S>(v), least));
            }
            entry.settled = !open;
        }
        for v in 0..LANES / S::F32_LANES {
            self.blend(simd, v, desk.entries(), cutoff, lane_colours);
        }
        desk.drop_settled();
        if ends {
            self.state = State::Done;
        } else if desk.len() > MAX_OPEN {
            self.state = State::Overflowed;
        }
    }

    /// Adds the settled entries to vector `v`. A ray takes nothing more once the transmittance before is below the cut-off.
    #[inline(always)]
    fn blend<S: Simd>(&mut self, simd: S, v: usize, entries: &[Entry], cutoff: f32, lane_colours: &[[Lanes; 3]]) {
        let (cutoff, zero, one) = (simd.splat_f32s(cutoff), simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        let mut transmittance = self.transmittance.get::<S>(v);
        let mut depth_sum = self.depth_sum.get::<S>(v);
        let mut splat_weight = self.splat_weight.get::<S>(v);
        let mut red = self.splat_sum[0].get::<S>(v);
        let mut green = self.splat_sum[1].get::<S>(v);
        let mut blue = self.splat_sum[2].get::<S>(v);
        for entry in entries {
            if !entry.settled {
                continue;
            }
            let before = entry.before.get::<S>(v);
            let reached = simd.greater_than_or_equal_f32s(before, cutoff);
            let alpha = simd.select_f32s(reached, entry.alpha.get::<S>(v), zero);
            let weight = simd.mul_f32s(alpha, before);
            let passes = simd.sub_f32s(one, alpha);
            transmittance = simd.max_f32s(simd.mul_f32s(transmittance, passes), simd.splat_f32s(FAINTEST));
            depth_sum = simd.mul_add_e_f32s(weight, entry.depth.get::<S>(v), depth_sum);
            match entry.colour {
                Colour::Splat(colour) => {
                    red = simd.mul_add_e_f32s(weight, simd.splat_f32s(colour[0]), red);
                    green = simd.mul_add_e_f32s(weight, simd.splat_f32s(colour[1]), green);
                    blue = simd.mul_add_e_f32s(weight, simd.splat_f32s(colour[2]), blue);
                    splat_weight = simd.add_f32s(weight, splat_weight);
                }
                Colour::SplatLanes(colours) => {
                    let colours = &lane_colours[colours as usize];
                    red = simd.mul_add_e_f32s(weight, colours[0].get::<S>(v), red);
                    green = simd.mul_add_e_f32s(weight, colours[1].get::<S>(v), green);
                    blue = simd.mul_add_e_f32s(weight, colours[2].get::<S>(v), blue);
                    splat_weight = simd.add_f32s(weight, splat_weight);
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
        self.transmittance.set::<S>(v, transmittance);
        self.depth_sum.set::<S>(v, depth_sum);
        self.splat_weight.set::<S>(v, splat_weight);
        self.splat_sum[0].set::<S>(v, red);
        self.splat_sum[1].set::<S>(v, green);
        self.splat_sum[2].set::<S>(v, blue);
    }
}

/// The least transmittance with which a ray goes on.
#[inline(always)]
fn least_passing(cutoff: f32) -> f32 {
    cutoff.max(2.0 * FAINTEST)
}

/// `sum += weight * value` in vector `v`.
#[inline(always)]
fn add_weighted<S: Simd>(simd: S, sum: &mut Lanes, v: usize, weight: S::f32s, value: S::f32s) {
    sum.set::<S>(v, simd.mul_add_e_f32s(weight, value, sum.get::<S>(v)));
}
