//! Surfaces lit by path tracing, against closed forms, quadrature and the reference tracer.

use std::f64::consts::{FRAC_1_PI, PI};

use crate::common::{Gaussian, Random, cloud, splats};
use crate::scenes::{
    add_mesh, add_panel, add_room, add_sphere, directional, emitter, glass, lambert, metal, nearest_hit, ray,
};
use glam::{DQuat, DVec3, Vec2, Vec3, Vec4};
use splatprobe::bvh::Bvh;
use splatprobe::scene::light::{Light, LightKind};
use splatprobe::scene::material::{AlphaMode, ColourMap};
use splatprobe::scene::{EnvironmentMap, LinearRgb, Material, Scene, SplatEncoding, colour};
use splatprobe::shade::bsdf::{Bsdf, Parameters};
use splatprobe::shade::{PathSettings, PathSurfaces};
use splatprobe::trace::{Fragment, Ray, RayTracer, ReferenceTracer, Surfaces, TraceSettings};

const FIXED: fn(u32) -> PathSettings = |max_paths| PathSettings { noise: 0.0, max_paths, ..PathSettings::default() };

/// Builds the tree and hands the surfaces to `test`, with the tracer that they answer.
fn with_surfaces<T>(scene: &mut Scene, settings: PathSettings, test: impl FnOnce(&PathSurfaces, &RayTracer) -> T) -> T {
    let bvh = Bvh::build(scene);
    let trace = TraceSettings { t_cutoff: 0.0, ..TraceSettings::default() };
    let surfaces = PathSurfaces::new(scene, &bvh, trace, settings, &[DVec3::ZERO]);
    test(&surfaces, &RayTracer { scene, bvh: &bvh, surfaces: &surfaces, settings: trace })
}

fn fragment(surfaces: &PathSurfaces, tracer: &RayTracer, ray: &Ray) -> Fragment {
    surfaces.fragment(ray, &nearest_hit(tracer, ray).expect("the ray meets a surface"))
}

/// Light along a ray that starts at `origin` toward `target`.
fn seen(scene: &mut Scene, settings: PathSettings, origin: DVec3, target: DVec3) -> Vec3 {
    with_surfaces(scene, settings, |surfaces, tracer| fragment(surfaces, tracer, &ray(origin, target)).radiance.0)
}

const FLOOR: (Vec3, Vec3, Vec3) = (Vec3::ZERO, Vec3::new(4.0, 0.0, 0.0), Vec3::new(0.0, 0.0, -4.0));

fn floor(material: Material) -> Scene {
    let mut scene = Scene::default();
    add_panel(&mut scene, material, FLOOR.0, FLOOR.1, FLOOR.2);
    scene
}

#[test]
fn a_diffuse_plane_under_a_directional_light_is_lamberts_cosine() {
    let mut scene = floor(lambert(0.5));
    scene.lights.push(directional(3.0));
    let light = seen(&mut scene, FIXED(1), DVec3::new(0.3, 1.0, 0.2), DVec3::ZERO);
    assert!((f64::from(light.x) - 0.5 * FRAC_1_PI * 3.0 * 0.8).abs() < 1e-6, "{light}");
}

#[test]
fn a_gaussian_in_the_way_shades_by_its_transmittance() {
    let mut scene = floor(lambert(0.5));
    scene.lights.push(directional(3.0));
    let in_the_way = Gaussian {
        mean: DVec3::new(0.6, 0.8, 0.0),
        rotation: DQuat::IDENTITY,
        standard_deviations: DVec3::splat(0.1),
        opacity: 0.7,
        colour: Vec3::ZERO,
    };
    scene.splats = splats([in_the_way]);
    let light = seen(&mut scene, FIXED(1), DVec3::new(-0.3, 1.0, 0.2), DVec3::ZERO);
    assert!((f64::from(light.x) - 0.3 * 0.5 * FRAC_1_PI * 3.0 * 0.8).abs() < 1e-6, "{light}");
}

#[test]
fn panes_shade_by_their_alpha_and_cover_by_it() {
    let mut scene = floor(lambert(0.5));
    scene.lights.push(directional(3.0));
    let pane = Material {
        base_colour: Vec4::new(0.0, 0.0, 0.0, 0.25),
        alpha: AlphaMode::Blend,
        double_sided: true,
        ..lambert(0.0)
    };
    add_panel(&mut scene, pane, Vec3::new(0.6, 0.8, 0.0), Vec3::X, Vec3::NEG_Z);
    let light = seen(&mut scene, FIXED(1), DVec3::new(-0.3, 1.0, 0.2), DVec3::ZERO);
    assert!((f64::from(light.x) - 0.75 * 0.5 * FRAC_1_PI * 3.0 * 0.8).abs() < 1e-6, "{light}");
}

#[test]
fn convex_white_things_vanish_before_a_constant_background() {
    for material in [
        lambert(1.0),
        metal(0.0),
        metal(0.4),
        glass(0.0),
        glass(0.3),
        Material { metallic: 0.0.into(), roughness: 0.5.into(), ..Material::default() },
    ] {
        let mut scene = Scene { background: LinearRgb(Vec3::new(0.25, 0.5, 1.0)), ..Scene::default() };
        let name = format!("{material:?}");
        add_sphere(&mut scene, material, Vec3::new(0.0, 0.0, -3.0), 1.0);
        for target in [DVec3::new(0.0, 0.0, -2.0), DVec3::new(0.7, 0.2, -2.4)] {
            let light = seen(&mut scene, FIXED(8192), DVec3::ZERO, target);
            let error = (light / scene.background.0 - 1.0).abs().max_element();
            // Light leaves rough glass after several scatterings, whose tables' errors add up, and with much noise.
            let slack = if name.contains("factor: 0.3") { 0.04 } else { 0.02 };
            assert!(error < slack, "{light} toward {target}: {name}");
        }
    }
}

#[test]
fn a_glowing_room_of_grey_walls_is_the_geometric_series() {
    let mut scene = Scene::default();
    add_room(&mut scene, Material { emissive: LinearRgb(Vec3::splat(0.5)), ..lambert(0.6) }, 2.0);
    let light = seen(&mut scene, FIXED(4096), DVec3::new(0.1, 0.2, 0.3), DVec3::new(1.0, 0.1, -0.4));
    assert!((light.x - 0.5 / (1.0 - 0.6)).abs() < 0.01, "{light}");
}

#[test]
fn a_panel_lights_a_diffuse_plane_by_its_form_factor() {
    // A panel of 2 x 1 m, one metre above a corner of which the point lies.
    let (a, b, height) = (2.0f64, 1.0f64, 1.0f64);
    let mut scene = floor(lambert(0.8));
    add_panel(&mut scene, emitter(5.0), Vec3::new(1.0, 1.0, 0.5), Vec3::X * 2.0, Vec3::Z);
    let light = seen(&mut scene, FIXED(1024), DVec3::new(-1.0, 0.5, 0.1), DVec3::ZERO);
    let (x, y) = (a / height, b / height);
    let part = |x: f64, y: f64| x / (1.0 + x * x).sqrt() * (y / (1.0 + x * x).sqrt()).atan();
    let form_factor = (part(x, y) + part(y, x)) / (2.0 * PI);
    assert!((f64::from(light.x) / (0.8 * 5.0 * form_factor) - 1.0).abs() < 0.005, "{light} {form_factor}");
}

#[test]
fn a_panel_in_a_rough_metal_is_the_integral_of_its_bsdf() {
    for roughness in [0.15, 0.4, 0.9] {
        let mut scene = floor(metal(roughness));
        add_panel(&mut scene, emitter(5.0), Vec3::new(1.0, 1.0, 0.0), Vec3::X, Vec3::Z);
        let eye = DVec3::new(-1.0, 1.0, 0.1);
        let light = seen(&mut scene, FIXED(4096), eye, DVec3::ZERO);
        let bsdf = Bsdf::new(
            &Parameters { roughness, ..Parameters::default() },
            // The floor's normal is y; its plane's other axes are of no matter.
            Vec3::new(-1.0, 0.1, 1.0).normalize(),
            false,
        );
        let (mut expected, steps) = (0.0, 400);
        for i in 0..steps * steps {
            let along = |k: i32| (f64::from(k) + 0.5) / f64::from(steps) - 0.5;
            let point = DVec3::new(1.0 + along(i % steps), along(i / steps), 1.0);
            let solid_angle = point.normalize().z / point.length_squared() / f64::from(steps * steps);
            expected += 5.0 * f64::from(bsdf.evaluate(point.normalize().as_vec3()).value.x) * solid_angle;
        }
        assert!((f64::from(light.x) / expected - 1.0).abs() < 0.01, "roughness {roughness}: {light} {expected}");
    }
}

fn display(light: Vec3) -> Vec3 {
    light.map(colour::linear_to_srgb)
}

#[test]
fn a_mirror_in_splats_shows_what_the_reference_sees_along_each_reflected_ray() {
    let mut scene = Scene { splats: cloud(4000, [0.02, 0.4], 2, 3), ..Scene::default() };
    let surroundings = scene.clone();
    add_sphere(&mut scene, metal(0.0), Vec3::new(0.0, 0.0, -1.0), 0.5);
    with_surfaces(&mut scene, FIXED(1), |surfaces, tracer| {
        let settings = TraceSettings { t_cutoff: 0.0, ..TraceSettings::default() };
        let reference = ReferenceTracer { scene: &surroundings, surfaces: &crate::common::NoSurfaces, settings };
        let mut random = Random(9);
        let (mut squares, mut count) = (0.0, 0.0);
        while count < 300.0 {
            let target = DVec3::new(random.uniform(-0.5, 0.5), random.uniform(-0.5, 0.5), -1.0);
            let ray = ray(DVec3::ZERO, target);
            let Some(hit) = nearest_hit(tracer, &ray) else { continue };
            let meshes = &tracer.scene.meshes;
            let [a, b, c] = meshes.triangles[hit.triangle as usize].map(|v| meshes.attributes[v as usize].normal);
            let Vec2 { x, y } = hit.barycentric;
            let normal = (a * (1.0 - x - y) + b * x + c * y).as_dvec3().normalize();
            let position = ray.origin + ray.direction * hit.distance;
            let mirrored = ray.direction.reflect(normal);
            let seen = reference.trace(&Ray { origin: position, direction: mirrored });
            let expected = seen.to_linear(SplatEncoding::SrgbDisplay, LinearRgb::default()).0;
            let found = surfaces.fragment(&ray, &hit).radiance.0;
            // At the rim facets hide behind their own smooth normals.
            if ray.direction.dot(normal) < -0.15 {
                squares += f64::from((display(found) - display(expected)).length_squared() / 3.0);
                count += 1.0;
            }
        }
        let rms = (squares / count).sqrt();
        assert!(rms <= 1.0 / 255.0, "{}", rms * 255.0);
    });
}

#[test]
fn a_white_diffuse_sphere_in_splats_is_the_integral_over_the_hemisphere() {
    let mut scene = Scene { splats: cloud(1500, [0.05, 0.6], 1, 4), ..Scene::default() };
    let mut surroundings = scene.clone();
    let tree = Bvh::build(&mut surroundings);
    add_sphere(&mut scene, lambert(1.0), Vec3::new(0.0, 0.0, -1.0), 0.5);
    with_surfaces(&mut scene, FIXED(8192), |surfaces, tracer| {
        let settings = TraceSettings { t_cutoff: 0.0, ..TraceSettings::default() };
        let exact = RayTracer { scene: &surroundings, bvh: &tree, surfaces: &crate::common::NoSurfaces, settings };
        let mut scratch = Default::default();
        for target in [DVec3::new(0.1, 0.2, -1.0), DVec3::new(-0.2, 0.0, -1.0), DVec3::new(0.0, -0.3, -1.0)] {
            let ray = ray(DVec3::ZERO, target);
            let hit = nearest_hit(tracer, &ray).unwrap();
            let position = ray.origin + ray.direction * hit.distance;
            let normal = {
                let meshes = &tracer.scene.meshes;
                let [a, b, c] = meshes.triangles[hit.triangle as usize].map(|v| meshes.attributes[v as usize].normal);
                let Vec2 { x, y } = hit.barycentric;
                (a * (1.0 - x - y) + b * x + c * y).as_dvec3().normalize()
            };
            let (tangent, bitangent) = normal.any_orthonormal_pair();
            let (mut sum, edge) = (DVec3::ZERO, 128);
            for i in 0..edge * edge {
                let (u, v) =
                    ((f64::from(i / edge) + 0.5) / f64::from(edge), (f64::from(i % edge) + 0.5) / f64::from(edge));
                let (sine, azimuth) = (u.sqrt(), v * 2.0 * PI);
                let up = tangent * azimuth.cos() * sine + bitangent * azimuth.sin() * sine + normal * (1.0 - u).sqrt();
                let light = exact.trace(&Ray { origin: position, direction: up }, &mut scratch);
                sum += light.to_linear(SplatEncoding::SrgbDisplay, LinearRgb::default()).0.as_dvec3();
            }
            let expected = (sum / f64::from(edge * edge)).as_vec3();
            let found = surfaces.fragment(&ray, &hit).radiance.0;
            let error = (found / expected - 1.0).abs().max_element();
            assert!(error < 0.01, "{found} {expected}");
        }
    });
}

#[test]
fn refinement_ends_at_the_noise_asked_for_and_says_how_far_it_came() {
    let mut scene = Scene { splats: cloud(500, [0.1, 0.6], 0, 5), ..Scene::default() };
    add_sphere(&mut scene, lambert(0.8), Vec3::new(0.0, 0.0, -1.0), 0.5);
    let paths = |noise: f32, scene: &mut Scene| {
        let settings = PathSettings { noise, max_paths: 1 << 14, ..PathSettings::default() };
        with_surfaces(scene, settings, |surfaces, tracer| {
            fragment(surfaces, tracer, &ray(DVec3::ZERO, DVec3::NEG_Z));
            let noise = surfaces.noise_of(DVec3::ZERO).unwrap();
            // Of a single hit they are the same, but for the steps that squares are summed in.
            assert!((noise.standard_error - noise.max_standard_error).abs() < 1e-6, "{noise:?}");
            noise
        })
    };
    let (coarse, fine) = (paths(0.05, &mut scene), paths(0.01, &mut scene));
    assert!(coarse.standard_error <= 0.05 && fine.standard_error <= 0.01, "{coarse:?} {fine:?}");
    assert!(coarse.paths < fine.paths && fine.paths < 1 << 14, "{coarse:?} {fine:?}");
}

#[test]
fn black_and_unlit_surfaces_ask_for_no_paths() {
    let unlit = Material { unlit: true, base_colour: Vec4::new(0.1, 0.2, 0.3, 1.0), ..Material::default() };
    for (material, expected) in [(unlit, Vec3::new(0.1, 0.2, 0.3)), (emitter(2.0), Vec3::splat(2.0))] {
        let mut scene = Scene { lights: vec![directional(3.0)], ..Scene::default() };
        add_panel(&mut scene, material, Vec3::NEG_Y, FLOOR.1, FLOOR.2);
        with_surfaces(&mut scene, FIXED(64), |surfaces, tracer| {
            let ray = ray(DVec3::ZERO, DVec3::new(0.1, -1.0, 0.1));
            assert_eq!(fragment(surfaces, tracer, &ray).radiance.0, expected);
            assert!(surfaces.noise_of(ray.origin).is_none());
        });
    }
}

#[test]
fn broken_lights_and_normals_give_finite_images() {
    let mut scene = floor(lambert(0.5));
    for attributes in &mut scene.meshes.attributes {
        attributes.normal = Vec3::splat(f32::NAN);
    }
    add_sphere(&mut scene, metal(0.2), Vec3::new(0.0, 0.5, 0.0), 0.3);
    for intensity in [0.0, f32::INFINITY, f32::NAN, f32::MAX] {
        let position = Vec3::new(0.0, 1.0, 0.0);
        let kind = LightKind::Point { position, range: f32::INFINITY };
        scene.lights.push(Light { name: String::new(), kind, intensity: LinearRgb(Vec3::splat(intensity)) });
    }
    add_panel(&mut scene, emitter(f32::INFINITY), Vec3::new(0.0, 2.0, 0.0), Vec3::X, Vec3::Z);
    add_mesh(&mut scene, emitter(1.0), &[(Vec3::NAN, Vec3::NAN); 3], &[[0, 1, 2]]);
    add_mesh(&mut scene, emitter(1.0), &[(Vec3::ONE, Vec3::ZERO); 3], &[[0, 1, 2]]);
    with_surfaces(&mut scene, FIXED(32), |surfaces, tracer| {
        for target in [DVec3::new(1.0, 0.0, 1.0), DVec3::new(0.0, 0.5, 0.0), DVec3::new(0.1, 2.0, 0.1)] {
            let light = fragment(surfaces, tracer, &ray(DVec3::new(0.5, 1.2, 1.5), target));
            assert!(light.alpha.is_finite(), "{light:?}");
            let reflected = light.radiance.0;
            assert!(reflected.is_finite() || target.y == 2.0, "{light:?} toward {target}");
        }
    });
}

#[test]
fn a_coloured_sheen_and_coat_are_reached_through_the_material() {
    let mut coated = lambert(0.5);
    coated.clearcoat.factor = 1.0.into();
    coated.sheen.colour = ColourMap::new(Vec3::X);
    let mut scene = Scene { background: LinearRgb(Vec3::ONE), ..floor(coated) };
    let coated = seen(&mut scene, FIXED(256), DVec3::new(2.0, 0.2, 0.0), DVec3::ZERO);
    let mut scene = Scene { background: LinearRgb(Vec3::ONE), ..floor(lambert(0.5)) };
    let bare = seen(&mut scene, FIXED(256), DVec3::new(2.0, 0.2, 0.0), DVec3::ZERO);
    assert!((bare - 0.5).abs().max_element() < 1e-3, "{bare}");
    assert!(coated.z > bare.z + 0.1 && coated.x >= coated.z, "{coated}");
}

#[test]
fn a_small_bright_sun_in_the_background_lights_as_its_irradiance_says() {
    let mut texels = vec![Vec3::ZERO; 128 * 64];
    // Toward +X, 30 to 33 degrees above the horizon.
    let (row, column) = (20, 32);
    texels[row * 128 + column] = Vec3::splat(1000.0);
    let map = EnvironmentMap::new(128, 64, texels).unwrap();
    // Its irradiance on the floor, by quadrature of what the map itself says.
    let (mut irradiance, edge) = (0.0, 600);
    for i in 0..edge * edge {
        let (u, v) = (f64::from(i % edge) / f64::from(edge), f64::from(i / edge) / f64::from(edge));
        let longitude = PI / 2.0 - 0.1 + 0.2 * u - PI / 128.0;
        let latitude = PI * (0.5 - 20.5 / 64.0) + 0.2 * (v - 0.5);
        let direction = DVec3::new(longitude.sin() * latitude.cos(), latitude.sin(), longitude.cos() * latitude.cos());
        let radiance = f64::from(map.radiance(direction).0.x);
        irradiance += radiance * direction.y * latitude.cos() * 0.2 * 0.2 / f64::from(edge * edge);
    }
    let mut scene = Scene { environment: Some(map), ..floor(lambert(0.5)) };
    let light = seen(&mut scene, FIXED(8192), DVec3::new(0.3, 1.0, 0.2), DVec3::ZERO);
    assert!((f64::from(light.x) / (0.5 * FRAC_1_PI * irradiance) - 1.0).abs() < 0.02, "{light} {irradiance}");
}
