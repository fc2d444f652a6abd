//! One ray with any origin, in exact order: best-first through the tree.
//!
//! Nodes leave a queue in the order of a lower bound on the sort keys of everything below them. What a leaf's members
//! contribute waits in a second queue until its key lies below that bound; then nothing unseen can precede it, and it
//! is blended. So the order is exact whatever the boxes look like, a ray ends as soon as its transmittance is below the
//! cut-off, and memory is bounded by what the ray meets.
//!
//! Responses are formed in f64: per-ray tracing is bound by the tree, not by arithmetic, and thin Gaussians (1e-5 m seen
//! from 10 m) lose up to 0.2 standard deviations in f32.
//
// Tried: leaves of up to eight Gaussians, their responses side by side in f64 lanes. Fetching the lanes cost more than
// it saved, and most of a leaf's members are missed by their own boxes.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::{DVec3, Vec3};

use super::composite::Blender;
use super::{Radiance, Ray, SurfaceHit, Surfaces, Tile, TileTracer, TraceSettings, gaussian, triangle};
use crate::bvh::{Bvh, Child, Viewpoint, WIDTH, WideNode};
use crate::job::{Order, ShDirection};
use crate::scene::{Scene, sh};

/// Slab distances in f32 carry a few roundings of relative size 6e-8 each; this covers them with room to spare.
const SLAB_SLACK: f32 = 1e-6;

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

/// Queues that rays use one after another, so that a ray allocates nothing, and colours seen from the last origin.
pub struct RayScratch {
    nodes: BinaryHeap<Reverse<u64>>,
    met: Vec<Met>,
    unblended: BinaryHeap<Reverse<EventEntry>>,
    origin: DVec3,
    /// By index modulo [`COLOURS`]: which Gaussian, and its colour as seen from `origin`.
    colours: Vec<(u32, Vec3)>,
}

/// Colours kept between rays: what a tile of rays sees of a captured room fits several times.
const COLOURS: usize = 1 << 13;

impl Default for RayScratch {
    fn default() -> Self {
        Self {
            nodes: BinaryHeap::new(),
            met: Vec::new(),
            unblended: BinaryHeap::new(),
            origin: DVec3::NAN,
            colours: vec![(u32::MAX, Vec3::ZERO); COLOURS],
        }
    }
}

impl RayScratch {
    fn begin(&mut self, origin: DVec3) {
        self.nodes.clear();
        self.met.clear();
        self.unblended.clear();
        if self.origin != origin {
            self.origin = origin;
            self.colours.fill((u32::MAX, Vec3::ZERO));
        }
    }

    #[inline(always)]
    fn meet(&mut self, key: f64, rank: u32, met: Met) {
        self.unblended.push(Reverse((key.to_bits(), rank, self.met.len() as u32)));
        self.met.push(met);
    }
}

/// Something met along a ray.
#[derive(Clone, Copy)]
enum Met {
    Gaussian { index: u32, alpha: f64, distance: f64 },
    Surface(SurfaceHit),
}

/// A key's bits, a rank for equal keys (Gaussians before triangles, lower indices first, as the reference has it), and
/// which of the ray's events it is. Keys are not negative, so their bit patterns order as they do.
type EventEntry = (u64, u32, u32);

/// Ranks of triangles start here; scenes of 2^31 primitives do not fit in memory.
const TRIANGLE_RANK: u32 = 1 << 31;

impl RayTracer<'_> {
    /// Everything along one ray until its transmittance falls below the cut-off.
    pub fn trace(&self, ray: &Ray, scratch: &mut RayScratch) -> Radiance {
        pulp::Arch::new().dispatch(TraceRay { tracer: self, ray, scratch })
    }

    #[inline(always)]
    fn walk(&self, ray: &Ray, scratch: &mut RayScratch) -> Radiance {
        let slabs = Slabs::new(ray, self.settings.order);
        let mut blender = Blender::default();
        // Nothing with a larger key can be seen: the nearest surface that is surely opaque.
        let mut horizon = f64::INFINITY;
        scratch.begin(ray.origin);
        if !self.bvh.nodes.is_empty() {
            scratch.nodes.push(Reverse(queue_entry(0.0, 0)));
        }
        while let Some(Reverse(entry)) = scratch.nodes.pop() {
            let (bound, index) = from_queue_entry(entry);
            if f64::from(bound) > horizon || !self.blend_below(f64::from(bound), ray, &mut blender, scratch) {
                break;
            }
            let node = &self.bvh.nodes[index as usize];
            let (keys, mut hits) = slabs.meet(node);
            while hits != 0 {
                let lane = hits.trailing_zeros() as usize;
                hits &= hits - 1;
                match node.child(lane) {
                    Child::Node(child) => scratch.nodes.push(Reverse(queue_entry(keys[lane], child))),
                    Child::Gaussian(index) => self.meet_gaussian(ray, index, scratch),
                    Child::Triangle(index) => horizon = self.meet_triangle(ray, index, horizon, scratch),
                }
            }
        }
        self.blend_below(f64::INFINITY, ray, &mut blender, scratch);
        blender.finish()
    }

    /// Blends all events with keys below `bound`; false once the ray's transmittance is below the cut-off.
    #[inline(always)]
    fn blend_below(&self, bound: f64, ray: &Ray, blender: &mut Blender, scratch: &mut RayScratch) -> bool {
        let cutoff = f64::from(self.settings.t_cutoff);
        while let Some(Reverse((key, _, event))) = scratch.unblended.peek().copied() {
            if f64::from_bits(key) >= bound {
                break;
            }
            scratch.unblended.pop();
            match scratch.met[event as usize] {
                Met::Gaussian { index, alpha, distance } => {
                    let colour = self.colour(index, ray, scratch);
                    if self.scene.splats.is_linear(index as usize) {
                        blender.linear_splat(alpha, colour, distance);
                    } else {
                        blender.splat(alpha, colour, distance);
                    }
                }
                Met::Surface(hit) => blender.surface(self.surfaces.fragment(ray, &hit), hit.distance),
            }
            if blender.transmittance < cutoff || blender.transmittance <= 0.0 {
                scratch.unblended.clear();
                return false;
            }
        }
        true
    }

    #[inline(always)]
    fn meet_gaussian(&self, ray: &Ray, index: u32, scratch: &mut RayScratch) {
        let splats = &self.scene.splats;
        let i = index as usize;
        let mean_from_origin = splats.means[i].as_dvec3() - ray.origin;
        let (unit_from_world, opacity) = (splats.unit_from_world[i].as_dmat3(), f64::from(splats.opacities[i]));
        let met = gaussian::response(&unit_from_world, opacity, mean_from_origin, ray.direction);
        if met.contributes(f64::from(self.settings.t_near)) {
            let key = match self.settings.order {
                Order::RayHitDistance => met.distance,
                Order::CameraDistance => mean_from_origin.length(),
            };
            scratch.meet(key, index, Met::Gaussian { index, alpha: met.alpha, distance: met.distance });
        }
    }

    /// Returns the horizon, nearer if the triangle is opaque.
    fn meet_triangle(&self, ray: &Ray, index: u32, horizon: f64, scratch: &mut RayScratch) -> f64 {
        let corners = self.scene.meshes.corners(index as usize).map(|corner| corner.as_dvec3() - ray.origin);
        let Some(met) = triangle::intersect(corners, ray.direction) else { return horizon };
        let seen = met.front || self.surfaces.is_double_sided(index);
        let distance = met.distance;
        if !seen || distance <= f64::from(self.settings.t_near) || distance > horizon {
            return horizon;
        }
        let hit = SurfaceHit { triangle: index, barycentric: met.barycentric, front: met.front, distance };
        scratch.meet(distance, TRIANGLE_RANK | index, Met::Surface(hit));
        if self.surfaces.is_opaque(index) { distance } else { horizon }
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
        if cached.0 != index {
            let direction = (splats.means[index as usize].as_dvec3() - ray.origin).normalize();
            *cached = (index, evaluate(direction));
        }
        cached.1.as_dvec3()
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

/// A queue entry: key above, node below. Keys are not negative, so their bit patterns order as they do.
fn queue_entry(key: f32, node: u32) -> u64 {
    u64::from(key.to_bits()) << 32 | u64::from(node)
}

fn from_queue_entry(entry: u64) -> (f32, u32) {
    (f32::from_bits((entry >> 32) as u32), entry as u32)
}

/// A ray prepared for testing boxes: eight at a time, in f32, conservatively.
struct Slabs {
    viewpoint: Viewpoint,
    inverse: Vec3,
    order: Order,
}

impl Slabs {
    fn new(ray: &Ray, order: Order) -> Self {
        // A component of 1e-20 is as good as 0: over 1e15 m, the end of all boxes, it moves 1e-5 m.
        let inverse = |d: f64| 1.0 / if d.abs() < 1e-20 { 1e-20f32.copysign(d as f32) } else { d as f32 };
        Self {
            viewpoint: Viewpoint::new(ray.origin),
            inverse: Vec3::new(inverse(ray.direction.x), inverse(ray.direction.y), inverse(ray.direction.z)),
            order,
        }
    }

    /// For each child: a lower bound on the sort keys inside, and, as a bit, whether the ray meets its box.
    #[inline(always)]
    fn meet(&self, node: &WideNode) -> ([f32; WIDTH], u32) {
        let mut enter = [0.0f32; WIDTH];
        let mut exit = [f32::INFINITY; WIDTH];
        for axis in 0..3 {
            let (low, high, inverse) = (self.viewpoint.low[axis], self.viewpoint.high[axis], self.inverse[axis]);
            for k in 0..WIDTH {
                let to_min = (node.min[axis][k] - high) * inverse;
                let to_max = (node.max[axis][k] - low) * inverse;
                let (near, far) = if to_min < to_max { (to_min, to_max) } else { (to_max, to_min) };
                enter[k] = if near > enter[k] { near } else { enter[k] };
                exit[k] = if far < exit[k] { far } else { exit[k] };
            }
        }
        let mut hits = 0;
        for k in 0..WIDTH {
            // An absent child's box runs from +inf to -inf: its slabs are inverted along every axis.
            let present = node.min[0][k] <= node.max[0][k];
            let hit = present & (enter[k] * (1.0 - SLAB_SLACK) <= exit[k] * (1.0 + SLAB_SLACK));
            hits |= u32::from(hit) << k;
            enter[k] *= 1.0 - SLAB_SLACK;
        }
        match self.order {
            Order::RayHitDistance => (enter, hits),
            Order::CameraDistance => {
                (self.viewpoint.distances(node).map(|distance| distance * (1.0 - SLAB_SLACK)), hits)
            }
        }
    }
}
