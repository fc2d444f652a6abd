//! What rays write to on their way, kept from ray to ray so that none allocates.

use glam::{DVec3, Vec3};

use super::responses::Responses;
use crate::bvh::Child;
use crate::trace::SurfaceHit;
use crate::trace::batch::BATCH;
use crate::trace::composite::Blender;

/// Colours kept between rays: what a tile of rays sees of a captured room fits several times.
const COLOURS: usize = 1 << 13;

/// Lists that packets of rays use one after another, and what one can tell the next.
pub struct RayScratch {
    /// Nodes to open in this window.
    pub(super) open: Vec<u32>,
    /// Gaussians whose boxes the packet meets in this window.
    pub(super) gaussians: Vec<u32>,
    /// What begins behind this window, with a lower bound on its keys.
    pub(super) later: Vec<(f32, Child)>,
    pub(super) responses: Responses,
    /// By ray of the packet.
    pub(super) gathered: Vec<Gathered>,
    /// Where the ray before ended: a neighbour's end is likely near it.
    pub(super) last_end: f32,
    origin: DVec3,
    /// Counts the origins, so that colours seen from earlier ones are known to be old.
    origin_number: u32,
    /// By index modulo [`COLOURS`]: which Gaussian, the number of the origin that saw it, and its colour from there.
    colours: Vec<(u32, u32, Vec3)>,
}

impl Default for RayScratch {
    fn default() -> Self {
        Self {
            open: Vec::new(),
            gaussians: Vec::new(),
            later: Vec::new(),
            responses: Responses::default(),
            gathered: Vec::new(),
            last_end: 0.0,
            origin: DVec3::NAN,
            origin_number: 0,
            colours: vec![(u32::MAX, 0, Vec3::ZERO); COLOURS],
        }
    }
}

impl RayScratch {
    /// Empties the lists for rays from `origin`.
    pub(super) fn begin(&mut self, origin: DVec3) {
        self.open.clear();
        self.later.clear();
        if self.origin != origin {
            self.origin = origin;
            self.origin_number = self.origin_number.wrapping_add(1);
            if self.origin_number == 0 {
                self.colours.fill((u32::MAX, 0, Vec3::ZERO));
            }
        }
    }

    /// Gaussian `index`'s colour from the present origin: kept, or else what `evaluate` gives.
    #[inline(always)]
    pub(super) fn colour(&mut self, index: u32, evaluate: impl FnOnce() -> Vec3) -> Vec3 {
        let kept = &mut self.colours[index as usize % COLOURS];
        if kept.0 != index || kept.1 != self.origin_number {
            *kept = (index, self.origin_number, evaluate());
        }
        kept.2
    }
}

/// One ray's way.
#[derive(Default)]
pub(super) struct Gathered {
    /// What was met, in any order.
    pub met: Vec<Met>,
    /// What of it is not blended yet: the upper half of its key's bits, and its place in `met`. Keys are not negative, so
    /// their bit patterns order as they do.
    pub waiting: Vec<u64>,
    /// What [`Met::surface`] refers to.
    pub surfaces: Vec<SurfaceHit>,
    pub blender: Blender,
    /// Nothing with a larger key can be seen: that of the nearest surface that is surely opaque.
    pub horizon: f64,
    /// Whether nothing farther can change what the ray gathered.
    pub ended: bool,
}

/// A contribution along a ray.
#[derive(Clone, Copy)]
pub(super) struct Met {
    pub key: f64,
    /// Metres from the origin.
    pub distance: f64,
    /// A Gaussian's; surfaces are asked when they are reached.
    pub alpha: f64,
    /// Of equal keys, that of the lower rank comes first: Gaussians by index, then triangles, as the reference has it.
    pub rank: u32,
    /// For triangles: into [`Gathered::surfaces`].
    pub surface: u32,
}

/// Ranks of triangles start here; scenes of 2^31 primitives do not fit in memory.
pub(super) const TRIANGLE_RANK: u32 = 1 << 31;

impl Met {
    pub const NOTHING: Self = Self { key: 0.0, distance: 0.0, alpha: 0.0, rank: 0, surface: 0 };
}

impl Gathered {
    /// Empties the lists for the next ray.
    pub fn begin(&mut self) {
        self.met.clear();
        self.waiting.clear();
        self.surfaces.clear();
        self.blender = Blender::default();
        self.horizon = f64::INFINITY;
        self.ended = false;
    }

    /// Adds the first `count` of a batch.
    #[inline(always)]
    pub fn meet(&mut self, met: &[Met; BATCH], count: usize) {
        let place = self.met.len() as u64;
        let mut waiting = [0; BATCH];
        for k in 0..BATCH {
            waiting[k] = upper_half(met[k].key) | (place + k as u64);
        }
        // All are written and then cut: no branch, no length to copy.
        let (all_met, all_waiting) = (self.met.len() + count, self.waiting.len() + count);
        self.met.extend_from_slice(met);
        self.met.truncate(all_met);
        self.waiting.extend_from_slice(&waiting);
        self.waiting.truncate(all_waiting);
    }

    /// Adds a surface.
    pub fn meet_surface(&mut self, hit: SurfaceHit) {
        self.waiting.push(upper_half(hit.distance) | self.met.len() as u64);
        self.met.push(Met {
            key: hit.distance,
            distance: hit.distance,
            alpha: 0.0,
            rank: TRIANGLE_RANK | hit.triangle,
            surface: self.surfaces.len() as u32,
        });
        self.surfaces.push(hit);
    }

    /// Sorts what waits with keys that are certainly below `end`, and tells where it begins; what waits on comes before it.
    #[inline(always)]
    pub fn sort_below(&mut self, end: f64) -> usize {
        let (end, mut first) = (upper_half(end), 0);
        for i in 0..self.waiting.len() {
            self.waiting.swap(i, first);
            first += usize::from(self.waiting[first] >= end);
        }
        let sorted = &mut self.waiting[first..];
        sorted.sort_unstable();
        // Keys with the same upper half differ by less than 1e-6 of themselves.
        for run in sorted.chunk_by_mut(|a, b| a >> 32 == b >> 32) {
            if run.len() > 1 {
                let whole = |event: &u64| {
                    let met = &self.met[*event as u32 as usize];
                    (met.key.to_bits(), met.rank)
                };
                run.sort_unstable_by_key(whole);
            }
        }
        first
    }
}

/// The upper half of a key's bits, in its place.
#[inline(always)]
fn upper_half(key: f64) -> u64 {
    key.to_bits() & !u64::from(u32::MAX)
}
