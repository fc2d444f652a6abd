//! A packet's way through the tree, window by window.

use glam::DVec3;
use pulp::Simd;

use super::scratch::{Gathered, Met, TRIANGLE_RANK};
use super::slabs::Slabs;
use super::{FragmentAt, RayScratch, RayTracer, bits};
use crate::bvh::{Child, WIDTH};
use crate::job::ShDirection;
use crate::scene::sh;
use crate::trace::batch::BATCH;
use crate::trace::gaussian::Response;
use crate::trace::{Radiance, Ray};

/// A window ends this much farther than the one before it: more would visit what is never seen, less would begin
/// windows for a handful of boxes.
const WINDOW_GROWTH: f32 = 1.12;

/// Where the first window ends, as a share of the last packet's end.
const FIRST_WINDOW: f32 = 0.9;

impl RayTracer<'_> {
    /// Everything along each of `rays`, which share their origin.
    #[inline(always)]
    pub(super) fn walk<S: Simd>(
        &self,
        simd: S,
        rays: &[Ray],
        scratch: &mut RayScratch,
        fragment: FragmentAt,
        radiances: &mut [Radiance],
    ) {
        let Some(&Ray { origin, .. }) = rays.first() else { return };
        let slabs = Slabs::new(origin, rays, self.settings.order, self.settings.footprint);
        scratch.begin(origin);
        let mut gathered = std::mem::take(&mut scratch.gathered);
        gathered.resize_with(gathered.len().max(rays.len()), Gathered::default);
        let own = &mut gathered[..rays.len()];
        own.iter_mut().for_each(Gathered::begin);
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
                    self.meet_triangle(rays, node.index[lane], own);
                }
                for lane in bits(met.later) {
                    scratch.later.push((met.keys[lane], node.child(lane)));
                }
            }
            self.meet_gaussians(simd, rays, scratch, own);
            let nearest = scratch.later.iter().fold(f32::INFINITY, |nearest, &(key, _)| nearest.min(key));
            let mut all_ended = true;
            for (i, (ray, gathered)) in rays.iter().zip(&mut *own).enumerate() {
                if gathered.ended {
                    continue;
                }
                // Nothing waits, or nothing of it can be seen.
                let last = nearest == f32::INFINITY || f64::from(nearest) > gathered.horizon;
                let end = if last { f64::INFINITY } else { f64::from(window) };
                self.blend_below(end, i, ray, gathered, scratch, fragment);
                gathered.ended |= last;
                all_ended &= gathered.ended;
            }
            if all_ended {
                break;
            }
            // At least one box more, even if its key is 0 or cannot be told from the window's end.
            window = (window.max(nearest) * WINDOW_GROWTH).max(f32::MIN_POSITIVE);
            self.begin_window(window, rays, scratch, own);
        }
        for (radiance, gathered) in radiances.iter_mut().zip(&*own) {
            *radiance = gathered.blender.finish();
        }
        scratch.gathered = gathered;
    }

    /// Visits what waited and begins before `window`.
    #[inline(always)]
    fn begin_window(&self, window: f32, rays: &[Ray], scratch: &mut RayScratch, gathered: &mut [Gathered]) {
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
                Child::Triangle(index) => self.meet_triangle(rays, index, gathered),
            }
        }
        scratch.later.truncate(waiting);
    }

    /// Blends all that a ray met with keys certainly below `end`, until its transmittance is below the cut-off.
    #[inline(always)]
    fn blend_below(
        &self,
        end: f64,
        number: usize,
        ray: &Ray,
        gathered: &mut Gathered,
        scratch: &mut RayScratch,
        fragment: FragmentAt,
    ) {
        let cutoff = f64::from(self.settings.t_cutoff);
        let first = gathered.sort_below(end);
        let Gathered { met, waiting, surfaces, blender, ended, .. } = gathered;
        for &event in &waiting[first..] {
            let Met { key, distance, alpha, rank, surface } = met[event as u32 as usize];
            if rank >= TRIANGLE_RANK {
                let hit = &surfaces[surface as usize];
                blender.surface(fragment(number, hit, blender.transmittance), distance);
            } else {
                let colour = self.colour(rank, ray, scratch);
                if self.scene.splats.is_linear(rank as usize) {
                    blender.linear_splat(alpha, colour, distance);
                } else {
                    blender.splat(alpha, colour, distance);
                }
            }
            if blender.transmittance < cutoff || blender.transmittance <= 0.0 {
                scratch.last_end = key as f32;
                *ended = true;
                return;
            }
        }
        waiting.truncate(first);
    }

    /// Collects what the Gaussians met in this window contribute.
    #[inline(always)]
    fn meet_gaussians<S: Simd>(&self, simd: S, rays: &[Ray], scratch: &mut RayScratch, gathered: &mut [Gathered]) {
        let near = f64::from(self.settings.t_near);
        let RayScratch { gaussians, responses, .. } = scratch;
        for indices in gaussians.chunks(BATCH) {
            for &index in indices {
                responses.add(&self.scene.splats, index, rays[0].origin);
            }
            responses.prepare(simd, self.settings.footprint);
            for (ray, gathered) in rays.iter().zip(&mut *gathered) {
                if gathered.ended || !responses.evaluate(simd, ray.direction) {
                    continue;
                }
                let mut met = [Met::NOTHING; BATCH];
                let mut count = 0;
                for lane in 0..indices.len() {
                    let met_by_lane = responses.lane(lane);
                    let (key, Response { distance, alpha }) =
                        (met_by_lane.key(self.settings.order), met_by_lane.response);
                    // Written always and kept by the count: whether one contributes cannot be predicted either.
                    met[count] = Met { key, distance, alpha, rank: met_by_lane.index, surface: 0 };
                    count += usize::from(met_by_lane.response.contributes(near));
                }
                gathered.meet(&met, count);
            }
            responses.clear();
        }
        gaussians.clear();
    }

    /// Lets the rays that have not ended meet a triangle; one that is opaque moves their horizons nearer.
    fn meet_triangle(&self, rays: &[Ray], index: u32, gathered: &mut [Gathered]) {
        for (ray, gathered) in rays.iter().zip(gathered) {
            if gathered.ended {
                continue;
            }
            let Some(hit) = self.hit(ray, index, gathered.horizon) else { continue };
            gathered.meet_surface(hit);
            if self.surfaces.is_opaque(index) {
                gathered.horizon = hit.distance;
            }
        }
    }

    /// The Gaussian's colour along the ray. Rays of one probe ask for the same ones again and again.
    #[inline(always)]
    fn colour(&self, index: u32, ray: &Ray, scratch: &mut RayScratch) -> DVec3 {
        let splats = &self.scene.splats;
        let evaluate =
            |direction: DVec3| sh::evaluate(splats.sh_degree, splats.sh_of(index as usize), direction.as_vec3());
        let colour = match self.settings.sh_direction {
            ShDirection::Ray => evaluate(ray.direction),
            ShDirection::Mean => {
                scratch.colour(index, || evaluate((splats.means[index as usize].as_dvec3() - ray.origin).normalize()))
            }
        };
        colour.as_dvec3()
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
