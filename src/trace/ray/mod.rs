//! One ray with any origin, in exact order: in windows of the sort key, nearest first.
//!
//! Everything that may contribute with a key inside the window is visited in any order, a stack deep, and what it
//! contributes is collected; what lies beyond waits. Once a window has been visited, nothing unseen can precede the
//! contributions inside it: they are sorted and blended, and the next window begins. So the order is exact whatever the
//! boxes look like, nothing is kept in order that is not blended, a ray ends within a window of where its transmittance
//! falls below the cut-off, and memory is bounded by what the ray meets.
//
// Tried: two priority queues, one of nodes by their lower bound and one of contributions; as many nodes, and a seventh to
// a half more time. The rays of a tile in squares of 8 instead of rows, for the caches' sake: no faster. Writing
// the masked lanes past the lists' ends instead of copying them there, and gathering batches in f32: no faster.

mod responses;
mod slabs;
mod visibility;

use glam::{DVec3, Vec3};
use pulp::Simd;

use self::responses::{LaneResponse, Responses};
use self::slabs::Slabs;
use super::batch::BATCH;
use super::composite::Blender;
use super::gaussian::Response;
use super::{Fragment, Radiance, Ray, SurfaceHit, Surfaces, Tile, TileTracer, TraceSettings, triangle};
use crate::bvh::{Bvh, Child, WIDTH};
use crate::job::{Order, ShDirection};
use crate::scene::{Scene, sh};

/// Traces single rays through the tree.
pub struct RayTracer<'a> {
    /// What is traced, in the order that [`Bvh::build`] left it in.
    pub scene: &'a Scene,
    /// The tree over `scene`.
    pub bvh: &'a Bvh,
    /// What surfaces look like.
    pub surfaces: &'a dyn Surfaces,
    /// Order, colour direction, near end, cut-off and footprint.
    pub settings: TraceSettings,
}

/// Lists that rays use one after another, so that a ray allocates nothing, and what one ray can tell the next.
pub struct RayScratch {
    /// Nodes to open in this window.
    open: Vec<u32>,
    /// Gaussians whose boxes the ray meets in this window.
    gaussians: Vec<u32>,
    /// What begins behind this window, with a lower bound on its keys.
    later: Vec<(f32, Child)>,
    responses: Responses,
    events: Vec<Event>,
    met: Vec<Met>,
    /// Where the last ray ended: a neighbour's end is likely near it.
    last_end: f32,
    origin: DVec3,
    /// Counts the origins, so that colours seen from earlier ones are known to be old.
    origin_number: u32,
    /// By index modulo [`COLOURS`]: which Gaussian, the number of the origin that saw it, and its colour from there.
    colours: Vec<(u32, u32, Vec3)>,
}

/// Colours kept between rays: what a tile of rays sees of a captured room fits several times.
const COLOURS: usize = 1 << 13;

impl Default for RayScratch {
    fn default() -> Self {
        Self {
            open: Vec::new(),
            gaussians: Vec::new(),
            later: Vec::new(),
            responses: Responses::default(),
            events: Vec::new(),
            met: Vec::new(),
            last_end: 0.0,
            origin: DVec3::NAN,
            origin_number: 0,
            colours: vec![(u32::MAX, 0, Vec3::ZERO); COLOURS],
        }
    }
}

impl RayScratch {
    fn begin(&mut self, origin: DVec3) {
        self.open.clear();
        self.later.clear();
        self.events.clear();
        self.met.clear();
        if self.origin != origin {
            self.origin = origin;
            self.origin_number = self.origin_number.wrapping_add(1);
            if self.origin_number == 0 {
                self.colours.fill((u32::MAX, 0, Vec3::ZERO));
            }
        }
    }

    #[inline(always)]
    fn meet(&mut self, key: f64, rank: u32, met: Met) {
        self.events.push(event(key, rank, self.met.len() as u32));
        self.met.push(met);
    }
}

/// Something met along a ray.
#[derive(Clone, Copy)]
enum Met {
    Gaussian { index: u32, response: Response },
    Surface(SurfaceHit),
}

/// From the top: a key's bits, a rank for equal keys (Gaussians before triangles, lower indices first, as the reference
/// has it), and which of [`RayScratch::met`] it is. Keys are not negative, so their bit patterns order as they do.
type Event = u128;

fn event(key: f64, rank: u32, met: u32) -> Event {
    u128::from(key.to_bits()) << 64 | u128::from(rank) << 32 | u128::from(met)
}

/// Ranks of triangles start here; scenes of 2^31 primitives do not fit in memory.
const TRIANGLE_RANK: u32 = 1 << 31;

/// A window ends this much farther than the one before it: more would visit what is never seen, less would begin
/// windows for a handful of boxes.
const WINDOW_GROWTH: f32 = 1.12;

/// Where the first window ends, as a share of the last ray's end.
const FIRST_WINDOW: f32 = 0.9;

/// What a surface looks like, by hit and transmittance before it. Not a type parameter: the walk is compiled for every
/// instruction level as it is.
type FragmentAt<'a> = &'a mut dyn FnMut(&SurfaceHit, f64) -> Fragment;

impl RayTracer<'_> {
    /// Everything along one ray until its transmittance falls below the cut-off.
    pub fn trace(&self, ray: &Ray, scratch: &mut RayScratch) -> Radiance {
        self.trace_with(ray, f64::INFINITY, scratch, &mut |hit, _| self.surfaces.fragment(ray, hit))
    }

    /// Everything along one ray whose sort key is below `limit`, surfaces as `fragment` gives them. It is told the hit and
    /// the transmittance before it, front to back, and only of hits that light reaches the ray's origin from.
    pub fn trace_with(&self, ray: &Ray, limit: f64, scratch: &mut RayScratch, fragment: FragmentAt) -> Radiance {
        pulp::Arch::new().dispatch(TraceRay { tracer: self, ray, limit, scratch, fragment })
    }

    #[inline(always)]
    fn walk<S: Simd>(
        &self,
        simd: S,
        ray: &Ray,
        limit: f64,
        scratch: &mut RayScratch,
        fragment: FragmentAt,
    ) -> Radiance {
        let slabs = Slabs::new(ray, self.settings.order, self.settings.footprint);
        let mut blender = Blender::default();
        // Nothing with a larger key can be seen: the limit, or the nearest surface that is surely opaque.
        let mut horizon = limit;
        scratch.begin(ray.origin);
        let mut window = FIRST_WINDOW * scratch.last_end;
        if !self.bvh.nodes.is_empty() {
            scratch.open.push(0);
        }
        loop {
            while let Some(index) = scratch.open.pop() {
                let node = &self.bvh.nodes[index as usize];
                let met = slabs.meet(node, window);
                // One kind after another, and without a branch per child: what a ray meets cannot be predicted.
                append(&mut scratch.open, &node.index, met.now & node.nodes);
                append(&mut scratch.gaussians, &node.index, met.now & node.gaussians);
                for lane in bits(met.now & node.triangles) {
                    horizon = self.meet_triangle(ray, node.index[lane], horizon, scratch);
                }
                for lane in bits(met.later) {
                    scratch.later.push((met.keys[lane], node.child(lane)));
                }
            }
            self.meet_gaussians(simd, ray, scratch);
            let nearest = scratch.later.iter().fold(f32::INFINITY, |nearest, &(key, _)| nearest.min(key));
            // Nothing waits, or nothing of it can be seen.
            let last = nearest == f32::INFINITY || f64::from(nearest) > horizon;
            let end = if last { limit } else { limit.min(f64::from(window)) };
            if !self.blend_below(end, ray, &mut blender, scratch, fragment) || last {
                break;
            }
            // At least one box more, even if its key is 0 or cannot be told from the window's end.
            window = (window.max(nearest) * WINDOW_GROWTH).max(f32::MIN_POSITIVE);
            horizon = self.begin_window(window, ray, horizon, scratch);
        }
        blender.finish()
    }

    /// Visits what waited and begins before `window`; returns the horizon.
    #[inline(always)]
    fn begin_window(&self, window: f32, ray: &Ray, mut horizon: f64, scratch: &mut RayScratch) -> f64 {
        let mut waiting = 0;
        for i in 0..scratch.later.len() {
            let (key, child) = scratch.later[i];
            if key >= window {
                scratch.later[waiting] = (key, child);
                waiting += 1;
                continue;
            }
            match child {
                Child::Node(child) => scratch.open.push(child),
                Child::Gaussian(index) => scratch.gaussians.push(index),
                Child::Triangle(index) => horizon = self.meet_triangle(ray, index, horizon, scratch),
            }
        }
        scratch.later.truncate(waiting);
        horizon
    }

    /// Blends all events with keys below `end`; false once the ray's transmittance is below the cut-off.
    #[inline(always)]
    fn blend_below(
        &self,
        end: f64,
        ray: &Ray,
        blender: &mut Blender,
        scratch: &mut RayScratch,
        fragment: FragmentAt,
    ) -> bool {
        let end = event(end, 0, 0);
        let mut waiting = 0;
        for i in 0..scratch.events.len() {
            scratch.events.swap(i, waiting);
            waiting += usize::from(scratch.events[waiting] >= end);
        }
        scratch.events[waiting..].sort_unstable();
        let cutoff = f64::from(self.settings.t_cutoff);
        for i in waiting..scratch.events.len() {
            let event = scratch.events[i];
            match scratch.met[event as u32 as usize] {
                Met::Gaussian { index, response: Response { distance, alpha } } => {
                    let colour = self.colour(index, ray, scratch);
                    if self.scene.splats.is_linear(index as usize) {
                        blender.linear_splat(alpha, colour, distance);
                    } else {
                        blender.splat(alpha, colour, distance);
                    }
                }
                Met::Surface(hit) => blender.surface(fragment(&hit, blender.transmittance), hit.distance),
            }
            if blender.transmittance < cutoff || blender.transmittance <= 0.0 {
                scratch.last_end = f64::from_bits((event >> 64) as u64) as f32;
                return false;
            }
        }
        scratch.events.truncate(waiting);
        true
    }

    /// Collects what the Gaussians met in this window contribute.
    #[inline(always)]
    fn meet_gaussians<S: Simd>(&self, simd: S, ray: &Ray, scratch: &mut RayScratch) {
        let near = f64::from(self.settings.t_near);
        let RayScratch { gaussians, responses, events, met, .. } = scratch;
        for indices in gaussians.chunks(BATCH) {
            for &index in indices {
                responses.add(&self.scene.splats, index, ray.origin);
            }
            let mut contributing = [0; BATCH];
            let mut count = 0;
            for lane in 0..responses.evaluate(simd, ray.direction, self.settings.footprint) {
                let LaneResponse { index, response, mean_from_origin } = responses.lane(lane);
                let key = match self.settings.order {
                    Order::RayHitDistance => response.distance,
                    Order::CameraDistance => mean_from_origin.length(),
                };
                // Written always and kept by the count: whether one contributes cannot be predicted either.
                contributing[count] = event(key, index, met.len() as u32);
                count += usize::from(response.contributes(near));
                met.push(Met::Gaussian { index, response });
            }
            let collected = events.len() + count;
            events.extend_from_slice(&contributing);
            events.truncate(collected);
        }
        gaussians.clear();
    }

    /// Returns the horizon, nearer if the triangle is opaque.
    fn meet_triangle(&self, ray: &Ray, index: u32, horizon: f64, scratch: &mut RayScratch) -> f64 {
        let Some(hit) = self.hit(ray, index, horizon) else { return horizon };
        scratch.meet(hit.distance, TRIANGLE_RANK | index, Met::Surface(hit));
        if self.surfaces.is_opaque(index) { hit.distance } else { horizon }
    }

    /// Where the ray meets the triangle, if it sees that side and before `horizon`.
    #[inline]
    pub fn hit(&self, ray: &Ray, index: u32, horizon: f64) -> Option<SurfaceHit> {
        let corners = self.scene.meshes.corners(index as usize).map(|corner| corner.as_dvec3() - ray.origin);
        let met = triangle::intersect(corners, ray.direction)?;
        let seen = met.front || self.surfaces.is_double_sided(index);
        let distance = met.distance;
        if !seen || distance <= f64::from(self.settings.t_near) || distance > horizon {
            return None;
        }
        Some(SurfaceHit { triangle: index, barycentric: met.barycentric, front: met.front, distance })
    }

    /// The Gaussian's colour along the ray. Rays of one probe ask for the same ones again and again.
    #[inline(always)]
    fn colour(&self, index: u32, ray: &Ray, scratch: &mut RayScratch) -> DVec3 {
        let splats = &self.scene.splats;
        let evaluate =
            |direction: DVec3| sh::evaluate(splats.sh_degree, splats.sh_of(index as usize), direction.as_vec3());
        if self.settings.sh_direction == ShDirection::Ray {
            return evaluate(ray.direction).as_dvec3();
        }
        let cached = &mut scratch.colours[index as usize % COLOURS];
        if cached.0 != index || cached.1 != scratch.origin_number {
            let direction = (splats.means[index as usize].as_dvec3() - ray.origin).normalize();
            *cached = (index, scratch.origin_number, evaluate(direction));
        }
        cached.2.as_dvec3()
    }
}

impl TileTracer for RayTracer<'_> {
    fn trace_tile(&self, origin: DVec3, tile: &Tile, texels: &mut [Radiance]) {
        let mut scratch = RayScratch::default();
        for (texel, direction) in texels.iter_mut().zip(tile.directions()) {
            *texel = self.trace(&Ray { origin, direction }, &mut scratch);
        }
    }
}

/// Appends the lanes of `values` that `mask` has. All eight are written and then cut: no branch, no length to copy.
#[inline(always)]
fn append(list: &mut Vec<u32>, values: &[u32; WIDTH], mask: u8) {
    let order = &MASKED_FIRST[usize::from(mask)];
    let mut first = [0; WIDTH];
    for k in 0..WIDTH {
        first[k] = values[usize::from(order[k]) % WIDTH];
    }
    let end = list.len() + mask.count_ones() as usize;
    list.extend_from_slice(&first);
    list.truncate(end);
}

/// By mask: its lanes, from the lowest, and then lane 0.
const MASKED_FIRST: [[u8; WIDTH]; 256] = {
    let mut orders = [[0; WIDTH]; 256];
    let mut mask = 0;
    while mask < 256 {
        let (mut lane, mut count) = (0, 0);
        while lane < WIDTH {
            if mask >> lane & 1 == 1 {
                orders[mask][count] = lane as u8;
                count += 1;
            }
            lane += 1;
        }
        mask += 1;
    }
    orders
};

/// The numbers of the bits set, from the lowest.
#[inline(always)]
fn bits(mask: u8) -> impl Iterator<Item = usize> {
    let mut rest = u32::from(mask);
    std::iter::from_fn(move || {
        let bit = rest.trailing_zeros() as usize;
        rest &= rest.wrapping_sub(1);
        (bit < 32).then_some(bit)
    })
}

/// One ray at the machine's best instruction level: a closure would be compiled outside of it.
struct TraceRay<'a, 'b> {
    tracer: &'a RayTracer<'b>,
    ray: &'a Ray,
    limit: f64,
    scratch: &'a mut RayScratch,
    fragment: FragmentAt<'a>,
}

impl pulp::WithSimd for TraceRay<'_, '_> {
    type Output = Radiance;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Radiance {
        self.tracer.walk(simd, self.ray, self.limit, self.scratch, self.fragment)
    }
}
