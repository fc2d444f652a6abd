//! One ray with any origin, in exact order: best-first through the tree.
//!
//! Nodes leave a queue in the order of a lower bound on the sort keys of everything below them. What a leaf's members
//! contribute waits in a second queue until its key lies below that bound; then nothing unseen can precede it, and it
//! is blended. So the order is exact whatever the boxes look like, a ray ends as soon as its transmittance is below the
//! cut-off, and memory is bounded by what the ray meets.
//!
//! Responses are formed in f64, eight Gaussians side by side: per-ray tracing is bound by the tree, not by arithmetic,
//! and thin Gaussians (1e-5 m seen from 10 m) lose up to 0.2 standard deviations in f32.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::{DMat3, DVec3, Vec3};

use super::composite::Blender;
use super::gaussian::Response;
use super::{Radiance, Ray, SurfaceHit, Surfaces, Tile, TileTracer, TraceSettings, triangle};
use crate::bvh::{Bvh, Child, WIDTH, WideNode};
use crate::job::{Order, ShDirection};
use crate::scene::splats::ALPHA_MAX;
use crate::scene::{Scene, sh};

/// Slab distances in f32 carry a few roundings of relative size 6e-8 each; this covers them with room to spare.
const SLAB_SLACK: f32 = 1e-6;

/// No Gaussian responds beyond this squared Mahalanobis distance: 2 ln 255, rounded up.
const MAX_SUPPORT: f64 = 11.083;

/// Traces single rays through the tree.
pub struct RayTracer<'a> {
    /// What is traced, in the order that [`Bvh::build`] left it in.
    pub scene: &'a Scene,
    /// The tree over `scene`.
    pub bvh: &'a Bvh,
    /// What surfaces look like.
    pub surfaces: &'a dyn Surfaces,
    /// Order, colour direction, near end and cut-off.
    pub settings: TraceSettings,
}

/// Queues that rays share one after another, so that a ray allocates nothing.
#[derive(Default)]
pub struct RayScratch {
    nodes: BinaryHeap<Reverse<u64>>,
    events: BinaryHeap<Reverse<Event>>,
}

/// Something met and not yet blended. Ordered by key, ties by kind and index as the reference has it.
#[derive(Clone, Copy)]
struct Event {
    key: f64,
    distance: f64,
    what: Met,
}

#[derive(Clone, Copy)]
enum Met {
    Gaussian { index: u32, alpha: f64 },
    Surface(SurfaceHit),
}

impl Event {
    fn rank(&self) -> (u8, u32) {
        match self.what {
            Met::Gaussian { index, .. } => (0, index),
            Met::Surface(hit) => (1, hit.triangle),
        }
    }
}

impl PartialEq for Event {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}
impl Eq for Event {}
impl PartialOrd for Event {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Event {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.key.total_cmp(&other.key).then_with(|| self.rank().cmp(&other.rank()))
    }
}

impl RayTracer<'_> {
    /// Everything along one ray until its transmittance falls below the cut-off.
    pub fn trace(&self, ray: &Ray, scratch: &mut RayScratch) -> Radiance {
        pulp::Arch::new().dispatch(TraceRay { tracer: self, ray, scratch })
    }

    #[inline(always)]
    fn walk(&self, ray: &Ray, scratch: &mut RayScratch) -> Radiance {
        let slabs = Slabs::new(ray, self.settings.order);
        let cutoff = f64::from(self.settings.t_cutoff);
        let mut blender = Blender::default();
        // Nothing with a larger key can be seen: the nearest surface that is surely opaque.
        let mut horizon = f64::INFINITY;
        scratch.nodes.clear();
        scratch.events.clear();
        if !self.bvh.nodes.is_empty() {
            scratch.nodes.push(Reverse(queue_entry(0.0, 0, 0)));
        }
        while let Some(Reverse(entry)) = scratch.nodes.pop() {
            let (bound, node, lane) = from_queue_entry(entry);
            if !self.blend_below(f64::from(bound), ray, &mut blender, scratch, cutoff) || f64::from(bound) > horizon {
                break;
            }
            let wide = &self.bvh.nodes[node as usize];
            let node = match lane.checked_sub(1) {
                None => node,
                Some(lane) => match wide.child(lane as usize) {
                    Child::Node(child) => child,
                    Child::Gaussians { first, count } => {
                        self.meet_gaussians(ray, first as usize, count as usize, scratch);
                        continue;
                    }
                    Child::Triangles { first, count } => {
                        horizon = self.meet_triangles(ray, first..first + count, horizon, scratch);
                        continue;
                    }
                },
            };
            let (keys, hit) = slabs.meet(&self.bvh.nodes[node as usize]);
            for lane in 0..WIDTH {
                if hit[lane] {
                    scratch.nodes.push(Reverse(queue_entry(keys[lane], node, lane as u32 + 1)));
                }
            }
        }
        self.blend_below(f64::INFINITY, ray, &mut blender, scratch, cutoff);
        blender.finish()
    }

    /// Blends all events with keys below `bound`; false once the ray's transmittance is below the cut-off.
    #[inline(always)]
    fn blend_below(&self, bound: f64, ray: &Ray, blender: &mut Blender, scratch: &mut RayScratch, cutoff: f64) -> bool {
        while let Some(Reverse(event)) = scratch.events.peek().copied() {
            if event.key >= bound {
                break;
            }
            scratch.events.pop();
            match event.what {
                Met::Gaussian { index, alpha } => blender.splat(alpha, self.colour(index, ray), event.distance),
                Met::Surface(hit) => blender.surface(self.surfaces.fragment(ray, &hit), event.distance),
            }
            if blender.transmittance < cutoff || blender.transmittance <= 0.0 {
                scratch.events.clear();
                return false;
            }
        }
        true
    }

    #[inline(always)]
    fn meet_gaussians(&self, ray: &Ray, first: usize, count: usize, scratch: &mut RayScratch) {
        let splats = &self.scene.splats;
        let met = responses(&splats.means[first..first + count], &splats.unit_from_world[first..first + count], ray);
        for k in 0..count {
            if !(met.m2[k] < MAX_SUPPORT) {
                continue;
            }
            let opacity = f64::from(splats.opacities[first + k]);
            let response =
                Response { distance: met.distance[k], alpha: (opacity * (-0.5 * met.m2[k]).exp()).min(ALPHA_MAX) };
            if response.contributes(f64::from(self.settings.t_near)) {
                let key = match self.settings.order {
                    Order::RayHitDistance => response.distance,
                    Order::CameraDistance => (splats.means[first + k].as_dvec3() - ray.origin).length(),
                };
                let what = Met::Gaussian { index: (first + k) as u32, alpha: response.alpha };
                scratch.events.push(Reverse(Event { key, distance: response.distance, what }));
            }
        }
    }

    fn meet_triangles(
        &self,
        ray: &Ray,
        triangles: std::ops::Range<u32>,
        mut horizon: f64,
        scratch: &mut RayScratch,
    ) -> f64 {
        for index in triangles {
            let corners = self.scene.meshes.corners(index as usize).map(|corner| corner.as_dvec3() - ray.origin);
            let Some(met) = triangle::intersect(corners, ray.direction) else { continue };
            let seen = met.front || self.surfaces.is_double_sided(index);
            if !seen || met.distance <= f64::from(self.settings.t_near) || met.distance > horizon {
                continue;
            }
            if self.surfaces.is_opaque(index) {
                horizon = met.distance;
            }
            let distance = met.distance;
            let hit = SurfaceHit { triangle: index, barycentric: met.barycentric, front: met.front, distance };
            scratch.events.push(Reverse(Event { key: distance, distance, what: Met::Surface(hit) }));
        }
        horizon
    }

    #[inline(always)]
    fn colour(&self, index: u32, ray: &Ray) -> DVec3 {
        let splats = &self.scene.splats;
        let direction = match self.settings.sh_direction {
            ShDirection::Mean => (splats.means[index as usize].as_dvec3() - ray.origin).normalize(),
            ShDirection::Ray => ray.direction,
        };
        sh::evaluate(splats.sh_degree, splats.sh_of(index as usize), direction.as_vec3()).as_dvec3()
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

/// One ray at the machine's best instruction level: a closure would be compiled outside of it.
struct TraceRay<'a, 'b> {
    tracer: &'a RayTracer<'b>,
    ray: &'a Ray,
    scratch: &'a mut RayScratch,
}

impl pulp::WithSimd for TraceRay<'_, '_> {
    type Output = Radiance;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Radiance {
        self.tracer.walk(self.ray, self.scratch)
    }
}

/// A queue entry: key, node, and which lane of it (0: the node itself, as only the root is queued). Keys are not
/// negative, so their bit patterns order as they do.
fn queue_entry(key: f32, node: u32, lane: u32) -> u64 {
    // 28 bits of node index: 2^28 nodes hold at least 2^29 primitives, more than fit in memory.
    u64::from(key.to_bits()) << 32 | u64::from(node) << 4 | u64::from(lane)
}

fn from_queue_entry(entry: u64) -> (f32, u32, u32) {
    (f32::from_bits((entry >> 32) as u32), (entry as u32) >> 4, (entry & 15) as u32)
}

/// A ray prepared for testing boxes: eight at a time, in f32, conservatively.
struct Slabs {
    /// The origin rounded down and up to f32, so that differences to it bound the true ones.
    origin_low: Vec3,
    origin_high: Vec3,
    inverse: Vec3,
    order: Order,
}

impl Slabs {
    fn new(ray: &Ray, order: Order) -> Self {
        let rounded = ray.origin.as_vec3();
        let low = |axis: usize| rounded[axis].next_down();
        let high = |axis: usize| rounded[axis].next_up();
        // A component of 1e-20 is as good as 0: over 1e15 m, the end of all boxes, it moves 1e-5 m.
        let inverse = |d: f64| 1.0 / if d.abs() < 1e-20 { 1e-20f32.copysign(d as f32) } else { d as f32 };
        Self {
            origin_low: Vec3::new(low(0), low(1), low(2)),
            origin_high: Vec3::new(high(0), high(1), high(2)),
            inverse: Vec3::new(inverse(ray.direction.x), inverse(ray.direction.y), inverse(ray.direction.z)),
            order,
        }
    }

    /// For each child: a lower bound on the sort keys inside, and whether the ray meets its box.
    #[inline(always)]
    fn meet(&self, node: &WideNode) -> ([f32; WIDTH], [bool; WIDTH]) {
        let mut enter = [0.0f32; WIDTH];
        let mut exit = [f32::INFINITY; WIDTH];
        for axis in 0..3 {
            let (low, high, inverse) = (self.origin_low[axis], self.origin_high[axis], self.inverse[axis]);
            for k in 0..WIDTH {
                let to_min = (node.min[axis][k] - high) * inverse;
                let to_max = (node.max[axis][k] - low) * inverse;
                let (near, far) = if to_min < to_max { (to_min, to_max) } else { (to_max, to_min) };
                enter[k] = if near > enter[k] { near } else { enter[k] };
                exit[k] = if far < exit[k] { far } else { exit[k] };
            }
        }
        let mut hit = [false; WIDTH];
        for k in 0..WIDTH {
            // An absent child's box runs from +inf to -inf: its slabs are inverted along every axis.
            let present = node.min[0][k] <= node.max[0][k];
            hit[k] = present && enter[k] * (1.0 - SLAB_SLACK) <= exit[k] * (1.0 + SLAB_SLACK);
            enter[k] *= 1.0 - SLAB_SLACK;
        }
        match self.order {
            Order::RayHitDistance => (enter, hit),
            Order::CameraDistance => (self.distances(node), hit),
        }
    }

    /// Lower bounds on the distance from the origin to each box.
    fn distances(&self, node: &WideNode) -> [f32; WIDTH] {
        let mut squared = [0.0f32; WIDTH];
        for axis in 0..3 {
            for (k, squared) in squared.iter_mut().enumerate() {
                let outside =
                    (node.min[axis][k] - self.origin_high[axis]).max(self.origin_low[axis] - node.max[axis][k]);
                *squared += outside.max(0.0).powi(2);
            }
        }
        squared.map(|s| s.sqrt() * (1.0 - SLAB_SLACK))
    }
}

/// What up to eight Gaussians do along one ray, before their opacities.
struct Responses {
    distance: [f64; WIDTH],
    m2: [f64; WIDTH],
}

/// [`super::gaussian::response`] for up to eight Gaussians side by side: the same operations in the same order.
#[inline(always)]
fn responses(means: &[Vec3], unit_from_world: &[glam::Mat3], ray: &Ray) -> Responses {
    let mut lanes = [[0.0f64; WIDTH]; 12];
    for (k, (mean, m)) in means.iter().zip(unit_from_world).enumerate().take(WIDTH) {
        for (lane, value) in lanes.iter_mut().zip(mean.to_array().into_iter().chain(m.to_cols_array())) {
            lane[k] = f64::from(value);
        }
    }
    let [mean_x, mean_y, mean_z, m @ ..] = lanes;
    let mut met = Responses { distance: [0.0; WIDTH], m2: [0.0; WIDTH] };
    for k in 0..WIDTH {
        let unit = DMat3::from_cols_array(&m.map(|column| column[k]));
        let g = -(unit * (DVec3::new(mean_x[k], mean_y[k], mean_z[k]) - ray.origin));
        let v = unit * ray.direction;
        let v_squared = v.length_squared();
        met.m2[k] = g.cross(v).length_squared() / v_squared;
        met.distance[k] = -g.dot(v) / v_squared;
    }
    met
}
