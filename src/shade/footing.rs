//! Where light leaves a lit surface: the point, its axes and its BSDF.

use glam::{DVec3, Vec3};

use super::bsdf::{Bsdf, Parameters, Response};
use super::material::{MaterialPoint, SurfacePoint};
use crate::scene::material::{AlphaMode, Material};
use crate::scene::{LinearRgb, Meshes};
use crate::trace::ray::RayScratch;
use crate::trace::{Fragment, Ray, RayTracer, SurfaceHit};

/// A ray that leaves a surface starts this share of the numbers at hand away from it: f64 places a hit a thousand times
/// better, and nothing that a file can hold in f32 is finer.
pub(super) const LIFT: f64 = 1e-10;

/// A point of a surface, with what light that leaves it toward the eye depends on.
pub(super) struct Footing {
    /// Metres relative to the scene origin.
    pub position: DVec3,
    geometric_normal: DVec3,
    /// Tangent, bitangent, normal.
    axes: [Vec3; 3],
    /// Toward where the path came from, in those axes.
    view: Vec3,
    pub parameters: Parameters,
    /// Whether the eye sees the front.
    pub front: bool,
    /// Metres of the path so far.
    pub length: f32,
}

impl Footing {
    pub fn new(ray: &Ray, hit: &SurfaceHit, material: &MaterialPoint, length: f32) -> Self {
        let axes = [material.tangent, material.bitangent, material.normal];
        let toward = -ray.direction.as_vec3();
        Self {
            position: ray.origin + ray.direction * hit.distance,
            geometric_normal: material.geometric_normal.as_dvec3(),
            axes,
            view: Vec3::from_array(axes.map(|axis| axis.dot(toward))),
            parameters: material.parameters,
            front: material.front,
            length,
        }
    }

    pub fn is_black(&self) -> bool {
        self.bsdf(&self.parameters).is_black()
    }

    pub fn bsdf(&self, parameters: &Parameters) -> Bsdf {
        Bsdf::new(parameters, self.view, !self.front)
    }

    pub fn local(&self, direction: DVec3) -> Vec3 {
        let direction = direction.as_vec3();
        Vec3::from_array(self.axes.map(|axis| axis.dot(direction)))
    }

    pub fn world(&self, local: Vec3) -> DVec3 {
        let [tangent, bitangent, normal] = self.axes.map(|axis| axis.as_dvec3());
        let local = local.as_dvec3();
        (tangent * local.x + bitangent * local.y + normal * local.z).normalize()
    }

    /// Whether the surface itself and its shading normal agree on which side `direction` points to.
    pub fn is_consistent(&self, direction: DVec3, local: Vec3) -> bool {
        (direction.dot(self.geometric_normal) > 0.0) == (local.z > 0.0)
    }

    /// What the surface answers to light from `direction`; nothing from the side that only one of its normals sees.
    pub fn response(&self, bsdf: &Bsdf, direction: DVec3) -> Response {
        let local = self.local(direction);
        if self.is_consistent(direction, local) {
            bsdf.evaluate(local)
        } else {
            Response { value: Vec3::ZERO, density: 0.0 }
        }
    }

    /// A ray from here.
    pub fn leave(&self, direction: DVec3) -> Ray {
        let side = self.geometric_normal * direction.dot(self.geometric_normal).signum();
        let lift = LIFT * (self.position.abs().max_element() + f64::from(self.length));
        Ray { origin: self.position + side * lift, direction }
    }
}

/// Whether a triangle hides all that is behind it.
pub(super) fn is_opaque(meshes: &Meshes, triangle: u32) -> bool {
    meshes.material_of(triangle as usize).alpha == AlphaMode::Opaque
}

/// Whether the back of a lit triangle is seen: also where it bounds a volume that light enters.
pub(super) fn is_double_sided(meshes: &Meshes, triangle: u32) -> bool {
    let material = meshes.material_of(triangle as usize);
    material.double_sided || bounds_volume(material)
}

fn bounds_volume(material: &Material) -> bool {
    material.volume.thickness.factor > 0.0 && material.transmission.factor > 0.0
}

/// Share of light that arrives along `ray` from `distance` metres away.
pub(super) fn visibility(tracer: &RayTracer, ray: &Ray, distance: f64, scratch: &mut RayScratch) -> f32 {
    tracer.transmittance(ray, distance, scratch, &mut |hit| coverage(&tracer.scene.meshes, ray, hit))
}

/// How much of `ray` the surface that it meets covers.
pub(super) fn coverage(meshes: &Meshes, ray: &Ray, hit: &SurfaceHit) -> f32 {
    SurfacePoint::new(meshes, ray, hit, 0.0).base_colour_and_coverage().1
}

/// What a surface of `meshes` sends back along `ray`, which widens by `ray_angle` radians: its emission, and what `reflect`
/// says that it reflects.
pub(super) fn lit_fragment(
    meshes: &Meshes,
    ray: &Ray,
    hit: &SurfaceHit,
    ray_angle: f32,
    reflect: impl FnOnce(&Footing, &MaterialPoint) -> Vec3,
) -> Fragment {
    let nothing = Fragment { alpha: 0.0, radiance: LinearRgb(Vec3::ZERO) };
    if !hit.front && !is_double_sided(meshes, hit.triangle) {
        return nothing;
    }
    let point = SurfacePoint::new(meshes, ray, hit, ray_angle * hit.distance as f32);
    if point.material.unlit {
        let (base_colour, alpha) = point.base_colour_and_coverage();
        return Fragment { alpha, radiance: LinearRgb(base_colour) };
    }
    let material = point.evaluate();
    if material.coverage == 0.0 {
        return nothing;
    }
    let footing = Footing::new(ray, hit, &material, hit.distance as f32);
    let reflected = if footing.is_black() { Vec3::ZERO } else { reflect(&footing, &material) };
    Fragment { alpha: material.coverage, radiance: LinearRgb(material.emission.0 + reflected) }
}
