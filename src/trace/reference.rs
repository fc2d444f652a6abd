//! The truth: every primitive, f64, no tree, no cut-off. Slow and short; tests and benches measure against it.

use glam::DVec3;

use super::composite::Blender;
use super::{Fragment, Radiance, Ray, SurfaceHit, Surfaces, Tile, TileTracer, TraceSettings, gaussian, triangle};
use crate::job::{Order, ShDirection};
use crate::scene::{Scene, sh};

/// Traces by testing every primitive of the scene. [`TraceSettings::t_cutoff`] is ignored.
pub struct ReferenceTracer<'a> {
    /// What is traced.
    pub scene: &'a Scene,
    /// What surfaces look like.
    pub surfaces: &'a dyn Surfaces,
    /// Order, colour direction, near end and footprint.
    pub settings: TraceSettings,
}

/// Something a ray meets, before blending.
struct Event {
    /// Sort key: the distance that the blending order asks for.
    key: f64,
    distance: f64,
    what: Met,
}

enum Met {
    Gaussian { index: usize, alpha: f64 },
    Surface(Fragment),
}

impl ReferenceTracer<'_> {
    /// Everything along one ray.
    pub fn trace(&self, ray: &Ray) -> Radiance {
        let mut events = self.gaussians(ray);
        events.extend(self.triangles(ray));
        events.sort_by(|a, b| a.key.total_cmp(&b.key));
        let mut blender = Blender::default();
        for event in &events {
            match event.what {
                Met::Gaussian { index, alpha } if self.scene.splats.is_linear(index) => {
                    blender.linear_splat(alpha, self.colour(index, ray), event.distance);
                }
                Met::Gaussian { index, alpha } => blender.splat(alpha, self.colour(index, ray), event.distance),
                Met::Surface(fragment) => blender.surface(fragment, event.distance),
            }
        }
        blender.finish()
    }

    fn gaussians(&self, ray: &Ray) -> Vec<Event> {
        let splats = &self.scene.splats;
        let t_near = f64::from(self.settings.t_near);
        (0..splats.len())
            .filter_map(|index| {
                let mean_from_origin = splats.means[index].as_dvec3() - ray.origin;
                let unit_from_world = splats.unit_from_world[index].as_dmat3();
                let opacity = f64::from(splats.opacities[index]);
                let (unit_from_world, opacity) =
                    self.settings.footprint.widened(&unit_from_world, opacity, mean_from_origin);
                let met = gaussian::response(&unit_from_world, opacity, mean_from_origin, ray.direction);
                met.contributes(t_near).then(|| Event {
                    key: match self.settings.order {
                        Order::RayHitDistance => met.distance,
                        Order::CameraDistance => mean_from_origin.length(),
                    },
                    distance: met.distance,
                    what: Met::Gaussian { index, alpha: met.alpha },
                })
            })
            .collect()
    }

    fn triangles(&self, ray: &Ray) -> Vec<Event> {
        let meshes = &self.scene.meshes;
        (0..meshes.triangles.len())
            .filter_map(|index| {
                let corners = meshes.corners(index).map(|corner| corner.as_dvec3() - ray.origin);
                let met = triangle::intersect(corners, ray.direction)?;
                let hit = SurfaceHit {
                    triangle: index as u32,
                    barycentric: met.barycentric,
                    front: met.front,
                    distance: met.distance,
                };
                let fragment = self.surfaces.fragment(ray, &hit);
                let visible = met.distance > f64::from(self.settings.t_near) && fragment.alpha > 0.0;
                visible.then_some(Event { key: met.distance, distance: met.distance, what: Met::Surface(fragment) })
            })
            .collect()
    }

    fn colour(&self, index: usize, ray: &Ray) -> DVec3 {
        let splats = &self.scene.splats;
        let direction = match self.settings.sh_direction {
            ShDirection::Mean => (splats.means[index].as_dvec3() - ray.origin).normalize(),
            ShDirection::Ray => ray.direction,
        };
        let count = sh::coefficient_count(splats.sh_degree);
        let mut basis = [0.0; sh::coefficient_count(sh::MAX_DEGREE)];
        sh::basis_f64(splats.sh_degree, direction, &mut basis);
        let coefficients = splats.sh_of(index);
        let channel = |c: usize| {
            let sum: f64 = (0..count).map(|k| f64::from(coefficients[c * count + k]) * basis[k]).sum();
            (sum + 0.5).max(0.0)
        };
        DVec3::new(channel(0), channel(1), channel(2))
    }
}

impl TileTracer for ReferenceTracer<'_> {
    fn trace_tile(&self, origin: DVec3, tile: &Tile, texels: &mut [Radiance]) {
        for (texel, direction) in texels.iter_mut().zip(tile.directions()) {
            *texel = self.trace(&Ray { origin, direction });
        }
    }
}
