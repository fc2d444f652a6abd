//! Probes inside of closed meshes.

use crate::scenes::{add_room, add_sphere, lambert};
use glam::{DVec3, Vec3};
use splatprobe::bvh::Bvh;
use splatprobe::place::free_space::Space;
use splatprobe::scene::{Material, Scene};
use splatprobe::shade::UnlitSurfaces;
use splatprobe::trace::ray::RayScratch;
use splatprobe::trace::{RayTracer, TraceSettings};

fn hidden_backs(mut scene: Scene, point: DVec3) -> f64 {
    let bvh = Bvh::build(&mut scene);
    let surfaces = UnlitSurfaces::new(&scene.meshes);
    let settings = TraceSettings::default();
    let tracer = RayTracer { scene: &scene, bvh: &bvh, surfaces: &surfaces, settings };
    Space { tracer }.hidden_backs(point, &mut RayScratch::default())
}

fn ball(material: Material) -> Scene {
    let mut scene = Scene::default();
    add_sphere(&mut scene, material, Vec3::ZERO, 1.0);
    scene
}

#[test]
fn all_around_a_probe_in_a_closed_mesh_there_are_backs_that_it_cannot_see() {
    assert_eq!(hidden_backs(ball(lambert(1.0)), DVec3::new(0.2, 0.1, 0.0)), 1.0);
    assert_eq!(hidden_backs(ball(lambert(1.0)), DVec3::new(2.0, 0.0, 0.0)), 0.0);
    assert_eq!(hidden_backs(ball(Material { double_sided: true, ..lambert(1.0) }), DVec3::ZERO), 0.0);
    assert_eq!(hidden_backs(Scene::default(), DVec3::ZERO), 0.0);
    let mut room = Scene::default();
    add_room(&mut room, lambert(1.0), 3.0);
    assert_eq!(hidden_backs(room, DVec3::ZERO), 0.0);
}
