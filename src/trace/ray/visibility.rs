//! How much light passes along a part of a ray. Transmittances multiply in any order, so nothing is sorted.

use pulp::Simd;

use super::slabs::Slabs;
use super::{RayScratch, RayTracer, bits};
use crate::trace::{Ray, SurfaceHit};

impl RayTracer<'_> {
    /// Share of light that passes everything along `ray` whose sort key is below `limit`. `alpha` says what a surface that
    /// is not opaque holds back. Below the cut-off the share is some number below the cut-off.
    pub fn transmittance(
        &self,
        ray: &Ray,
        limit: f64,
        scratch: &mut RayScratch,
        alpha: &mut dyn FnMut(&SurfaceHit) -> f32,
    ) -> f32 {
        pulp::Arch::new().dispatch(SeeThrough { tracer: self, ray, limit, scratch, alpha })
    }

    #[inline(always)]
    fn see_through<S: Simd>(
        &self,
        simd: S,
        ray: &Ray,
        limit: f64,
        scratch: &mut RayScratch,
        alpha: &mut dyn FnMut(&SurfaceHit) -> f32,
    ) -> f32 {
        let slabs = Slabs::new(ray.origin, std::slice::from_ref(ray), self.settings.order, self.settings.footprint);
        let cutoff = f64::from(self.settings.t_cutoff);
        let window = (limit as f32).next_up();
        let mut transmittance = 1.0;
        scratch.begin(ray.origin);
        if !self.bvh.nodes.is_empty() {
            scratch.open.push(0);
        }
        while let Some(index) = scratch.open.pop() {
            let node = &self.bvh.nodes[index as usize];
            let met = slabs.meet(node, window).now;
            for lane in bits(met & node.triangles) {
                let Some(hit) = self.hit(ray, node.index[lane], limit.next_down()) else { continue };
                if self.surfaces.is_opaque(hit.triangle) {
                    scratch.responses.clear();
                    return 0.0;
                }
                transmittance *= 1.0 - f64::from(alpha(&hit));
            }
            for lane in bits(met & node.gaussians) {
                if scratch.responses.add(&self.scene.splats, node.index[lane], ray.origin) {
                    transmittance *= self.batch_transmittance(simd, ray, limit, scratch);
                }
            }
            if transmittance < cutoff || transmittance <= 0.0 {
                scratch.responses.clear();
                return transmittance as f32;
            }
            for lane in bits(met & node.nodes) {
                scratch.open.push(node.index[lane]);
            }
        }
        (transmittance * self.batch_transmittance(simd, ray, limit, scratch)) as f32
    }

    /// What passes the Gaussians in the batch, which is empty afterwards.
    #[inline(always)]
    fn batch_transmittance<S: Simd>(&self, simd: S, ray: &Ray, limit: f64, scratch: &mut RayScratch) -> f64 {
        let near = f64::from(self.settings.t_near);
        let responses = &mut scratch.responses;
        let mut transmittance = 1.0;
        responses.prepare(simd, self.settings.footprint);
        if responses.evaluate(simd, ray.direction) {
            for lane in 0..responses.len() {
                let met = responses.lane(lane);
                if met.response.contributes(near) && met.key(self.settings.order) < limit {
                    transmittance *= 1.0 - met.response.alpha;
                }
            }
        }
        responses.clear();
        transmittance
    }
}

/// One ray at the machine's best instruction level.
struct SeeThrough<'a, 'b> {
    tracer: &'a RayTracer<'b>,
    ray: &'a Ray,
    limit: f64,
    scratch: &'a mut RayScratch,
    alpha: &'a mut dyn FnMut(&SurfaceHit) -> f32,
}

impl pulp::WithSimd for SeeThrough<'_, '_> {
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f32 {
        self.tracer.see_through(simd, self.ray, self.limit, self.scratch, self.alpha)
    }
}
