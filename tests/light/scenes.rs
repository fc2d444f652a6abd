//! Materials and shapes that surfaces are lit in, and the rays that look at them.

use glam::{DVec3, Vec3};
use splatprobe::scene::light::{Light, LightKind};
use splatprobe::scene::mesh::VertexAttributes;
use splatprobe::scene::{LinearRgb, Material, Scene};
use splatprobe::trace::{Ray, RayTracer, SurfaceHit};

/// A dielectric that only scatters: no reflection at its surface.
pub fn lambert(albedo: f32) -> Material {
    Material {
        base_colour: Vec3::splat(albedo).extend(1.0),
        metallic: 0.0.into(),
        specular: 0.0.into(),
        ..Material::default()
    }
}

pub fn metal(roughness: f32) -> Material {
    Material { roughness: roughness.into(), ..Material::default() }
}

pub fn glass(roughness: f32) -> Material {
    let mut glass = Material { metallic: 0.0.into(), transmission: 1.0.into(), ..metal(roughness) };
    glass.volume.thickness = 1.0.into();
    glass
}

pub fn emitter(radiance: f32) -> Material {
    Material { emissive: LinearRgb(Vec3::splat(radiance)), ..lambert(0.0) }
}

pub fn add_mesh(scene: &mut Scene, material: Material, vertices: &[(Vec3, Vec3)], triangles: &[[u32; 3]]) {
    let meshes = &mut scene.meshes;
    meshes.part_starts.push(meshes.positions.len() as u32);
    let first = meshes.positions.len() as u32;
    meshes.positions.extend(vertices.iter().map(|(position, _)| *position));
    meshes
        .attributes
        .extend(vertices.iter().map(|(_, normal)| VertexAttributes { normal: *normal, ..VertexAttributes::default() }));
    meshes.triangles.extend(triangles.iter().map(|triangle| triangle.map(|v| v + first)));
    meshes.triangle_materials.extend(triangles.iter().map(|_| meshes.materials.len() as u32));
    meshes.materials.push(material);
}

/// A parallelogram that faces `across x up`.
pub fn add_panel(scene: &mut Scene, material: Material, centre: Vec3, across: Vec3, up: Vec3) {
    let corner = |x: f32, y: f32| (centre + across * (x - 0.5) + up * (y - 0.5), Vec3::ZERO);
    let corners = [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)];
    add_mesh(scene, material, &corners, &[[0, 1, 2], [0, 2, 3]]);
}

/// A sphere with smooth normals.
pub fn add_sphere(scene: &mut Scene, material: Material, centre: Vec3, radius: f32) {
    const ROWS: u32 = 48;
    let vertex = |row: u32, column: u32| {
        let (polar, azimuth) = (row as f32 / ROWS as f32, column as f32 / ROWS as f32);
        let (ring, y) = (std::f32::consts::PI * polar).sin_cos();
        let (z, x) = (std::f32::consts::PI * azimuth).sin_cos();
        let normal = Vec3::new(ring * x, y, ring * -z);
        (centre + normal * radius, normal)
    };
    let vertices: Vec<_> = (0..=ROWS).flat_map(|row| (0..2 * ROWS).map(move |column| vertex(row, column))).collect();
    let triangles: Vec<_> = (0..ROWS)
        .flat_map(|row| (0..2 * ROWS).map(move |column| (row, column)))
        .flat_map(|(row, column)| {
            let at = |row: u32, column: u32| row * 2 * ROWS + column % (2 * ROWS);
            let (a, b, c, d) = (at(row, column), at(row + 1, column), at(row + 1, column + 1), at(row, column + 1));
            [[a, b, c], [a, c, d]]
        })
        .collect();
    add_mesh(scene, material, &vertices, &triangles);
}

/// A closed box around the origin whose faces look inward.
pub fn add_room(scene: &mut Scene, material: Material, edge: f32) {
    for axis in 0..3 {
        for side in [1.0, -1.0] {
            let outward = Vec3::AXES[axis] * side;
            let across = Vec3::AXES[(axis + 1) % 3];
            let up = across.cross(outward);
            add_panel(scene, material.clone(), outward * edge / 2.0, across * edge, up * edge);
        }
    }
}

pub fn ray(origin: DVec3, target: DVec3) -> Ray {
    Ray { origin, direction: (target - origin).normalize() }
}

pub fn nearest_hit(tracer: &RayTracer, ray: &Ray) -> Option<SurfaceHit> {
    let hits = (0..tracer.scene.meshes.triangles.len() as u32).filter_map(|i| tracer.hit(ray, i, f64::INFINITY));
    hits.min_by(|a, b| a.distance.total_cmp(&b.distance))
}

pub fn directional(irradiance: f32) -> Light {
    let direction = Vec3::new(-0.6, -0.8, 0.0);
    let intensity = LinearRgb(Vec3::splat(irradiance));
    Light { name: String::new(), kind: LightKind::Directional { direction }, intensity }
}
