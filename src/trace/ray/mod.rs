//! Rays with any origin, each in exact order: in windows of the sort key, nearest first.
//!
//! Everything that may contribute with a key inside the window is visited in any order, a stack deep, and what it
//! contributes is collected; what lies beyond waits. Once a window has been visited, nothing unseen can precede the
//! contributions inside it: they are sorted and blended, and the next window begins. So the order is exact whatever the
//! boxes look like, nothing is kept in order that is not blended, a ray ends within a window of where its transmittance
//! falls below the cut-off, and memory is bounded by what its packet meets.
//!
//! Neighbouring rays from one origin go as a packet: the tree is walked, and Gaussians are gathered, once for all of them.
//! Each ray evaluates, orders, and blends for itself, and so gathers the same as alone, to the last bit.
//
// Tried: two priority queues, one of nodes by their lower bound and one of contributions; as many nodes, and a seventh to
// a half more time. Writing the masked lanes past the lists' ends instead of copying them there, and gathering batches in
// f32: no faster.

mod responses;
mod scratch;
mod slabs;
mod visibility;
mod walk;

use glam::DVec3;
use pulp::Simd;

pub use self::scratch::RayScratch;
use super::{Fragment, Radiance, Ray, SurfaceHit, Surfaces, Tile, TileTracer, TraceSettings, triangle};
use crate::bvh::Bvh;
use crate::scene::Scene;

/// Texels along the edge of a packet. Few enough for its rays to meet much the same, and a divisor of half of all usual
/// face sizes, so that no packet lies across the middle of a face, where directions change sign.
pub(super) const PACKET_EDGE: u32 = 4;

/// Faces with fewer texels along an edge are traced ray by ray: a packet would spread over tens of degrees. Measured on 1.5
/// million Gaussians, packets take half more time at 16 texels and a tenth less at 32.
const SMALLEST_FACE_OF_PACKETS: u32 = 32;

const PACKET: usize = (PACKET_EDGE * PACKET_EDGE) as usize;

/// Traces rays through the tree.
#[derive(Clone, Copy)]
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

/// What a surface looks like, by the ray's number in its packet, the hit, and the transmittance before it. Not a type
/// parameter: the walk is compiled for every instruction level as it is.
type FragmentAt<'a> = &'a mut dyn FnMut(usize, &SurfaceHit, f64) -> Fragment;

impl RayTracer<'_> {
    /// Everything along one ray until its transmittance falls below the cut-off.
    pub fn trace(&self, ray: &Ray, scratch: &mut RayScratch) -> Radiance {
        self.trace_with(ray, scratch, &mut |hit, _| self.surfaces.fragment(ray, hit))
    }

    /// As [`Self::trace`], surfaces as `fragment` gives them. It is told the hit and the transmittance before it, front to
    /// back, and only of hits that light reaches the ray's origin from.
    pub fn trace_with(
        &self,
        ray: &Ray,
        scratch: &mut RayScratch,
        fragment: &mut dyn FnMut(&SurfaceHit, f64) -> Fragment,
    ) -> Radiance {
        let mut radiance = [Radiance::default()];
        let fragment: FragmentAt = &mut |_, hit, transmittance| fragment(hit, transmittance);
        self.dispatch(std::slice::from_ref(ray), scratch, fragment, &mut radiance);
        radiance[0]
    }

    /// Traces the square of [`PACKET_EDGE`] texels of `tile` whose first is (x, y), as far as the tile reaches.
    pub(super) fn trace_square(
        &self,
        origin: DVec3,
        tile: &Tile,
        [x, y]: [u32; 2],
        scratch: &mut RayScratch,
        texels: &mut [Radiance],
    ) {
        let (rows, columns) = (y..tile.height.min(y + PACKET_EDGE), x..tile.width.min(x + PACKET_EDGE));
        let mut rays = [Ray { origin, direction: DVec3::ZERO }; PACKET];
        let mut radiances = [Radiance::default(); PACKET];
        let mut count = 0;
        for y in rows.clone() {
            for x in columns.clone() {
                rays[count].direction = tile.direction(x, y);
                count += 1;
            }
        }
        let together = if tile.face_size < SMALLEST_FACE_OF_PACKETS { 1 } else { PACKET };
        for (rays, radiances) in rays[..count].chunks(together).zip(radiances.chunks_mut(together)) {
            let fragment: FragmentAt = &mut |number, hit, _| self.surfaces.fragment(&rays[number], hit);
            self.dispatch(rays, scratch, fragment, radiances);
        }
        for (y, row) in rows.zip(radiances.chunks(columns.len())) {
            let first = (y * tile.width + x) as usize;
            texels[first..first + row.len()].copy_from_slice(row);
        }
    }

    /// Everything along rays of one origin and much the same direction: `radiances[i]` is that of `rays[i]`.
    fn dispatch(&self, rays: &[Ray], scratch: &mut RayScratch, fragment: FragmentAt, radiances: &mut [Radiance]) {
        pulp::Arch::new().dispatch(TracePacket { tracer: self, rays, scratch, fragment, radiances });
    }

    /// Where the ray meets the triangle, if it sees that side and no farther than `horizon`.
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
}

impl TileTracer for RayTracer<'_> {
    fn trace_tile(&self, origin: DVec3, tile: &Tile, texels: &mut [Radiance]) {
        let mut scratch = RayScratch::default();
        for y in (0..tile.height).step_by(PACKET_EDGE as usize) {
            for x in (0..tile.width).step_by(PACKET_EDGE as usize) {
                self.trace_square(origin, tile, [x, y], &mut scratch, texels);
            }
        }
    }
}

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

/// A packet at the machine's best instruction level: a closure would be compiled outside of it.
struct TracePacket<'a, 'b> {
    tracer: &'a RayTracer<'b>,
    rays: &'a [Ray],
    scratch: &'a mut RayScratch,
    fragment: FragmentAt<'a>,
    radiances: &'a mut [Radiance],
}

impl pulp::WithSimd for TracePacket<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        self.tracer.walk(simd, self.rays, self.scratch, self.fragment, self.radiances);
    }
}
