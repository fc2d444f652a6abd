//! Scenes whose images are known in closed form, from files through the whole bake to the EXR, with every tracer.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use crate::common::gltf::textured_square;
use crate::common::{PatternedSurfaces, Random, add_random_triangles, cloud, hangs_on_rounding};
use glam::{DMat3, DQuat, DVec3, Vec3};
use serde_json::json;
use splatprobe::bake::Silent;
use splatprobe::bvh::Bvh;
use splatprobe::encode::exr::{Image, read_exr};
use splatprobe::job::{Footprint, Frame, Job, MeshInput, Pixel, Placement, SplatInput, Tracer, Transform};
use splatprobe::pipeline;
use splatprobe::scene::{Scene, colour};
use splatprobe::trace::{BeamTracer, Face, Radiance, Ray, RayTracer, ReferenceTracer, Tile, TileTracer, TraceSettings};

const TRACERS: [Tracer; 3] = [Tracer::Reference, Tracer::Ray, Tracer::Beam];

/// A Gaussian as a PLY row: principal axes along x, y, z.
struct Row {
    mean: DVec3,
    deviations: DVec3,
    opacity: f64,
    /// Display colour, the same from everywhere.
    colour: Vec3,
}

/// Writes an ASCII PLY in the canonical frame's axes and returns its input.
fn write_ply(folder: &Path, rows: &[Row]) -> SplatInput {
    let names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let properties: String = names.split(' ').map(|name| format!("property double {name}\n")).collect();
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n{properties}end_header\n", rows.len());
    for row in rows {
        // The constant of band 0 is 1 / (2 sqrt(pi)).
        let dc = (row.colour.as_dvec3() - 0.5) * 2.0 * std::f64::consts::PI.sqrt();
        let logit = (row.opacity / (1.0 - row.opacity)).ln();
        let [x, y, z] = row.mean.to_array();
        let [sx, sy, sz] = row.deviations.to_array().map(f64::ln);
        text += &format!("{x} {y} {z} {} {} {} {logit} {sx} {sy} {sz} 1 0 0 0\n", dc.x, dc.y, dc.z);
    }
    let path = folder.join("scene.ply");
    std::fs::write(&path, text).unwrap();
    SplatInput { frame: Some(Frame::RUB), ..SplatInput::new(path) }
}

/// Bakes one probe with distance, in floats, Gaussians as they are, and reads its image back.
fn bake(job: &Job, folder: &Path, probe: DVec3, face_size: u32, tracer: Tracer) -> Image {
    let output = folder.join("out");
    let placement = Placement { probes: vec![probe.to_array()], ..Placement::default() };
    let job = Job {
        output: Some(output.clone()),
        placement,
        face_size,
        tracer,
        pixel: Pixel::Float,
        distance: true,
        footprint: Footprint::None,
        ..job.clone()
    };
    pipeline::bake(&job, &Silent, &AtomicBool::new(false)).unwrap();
    read_exr(&output.join("probe_000/radiance.exr")).unwrap()
}

/// A texel of a baked strip.
#[derive(Debug, Clone, Copy)]
struct Texel {
    face: Face,
    direction: DVec3,
    rgb: Vec3,
    coverage: f32,
    distance: f32,
}

fn texels(image: &Image) -> impl Iterator<Item = Texel> + '_ {
    let size = image.width;
    (0..image.width * image.height).map(move |i| {
        let face = Face::ALL[i / (size * size)];
        let (x, y) = ((i % size) as f64 + 0.5, (i / size % size) as f64 + 0.5);
        let [r, g, b, a, z] = ["R", "G", "B", "A", "Z"].map(|name| image.channels[name][i]);
        let direction = face.direction(size as u32, x, y).normalize();
        Texel { face, direction, rgb: Vec3::new(r, g, b), coverage: a, distance: z }
    })
}

fn linear(display: Vec3) -> Vec3 {
    Vec3::from_array(display.to_array().map(colour::srgb_to_linear))
}

/// Response of a Gaussian with axes along x, y, z: its alpha and distance along the ray; alpha 0 where it counts as none.
/// The definition, written out by itself: the strongest point of `o exp(-|M (x + t d - mu)|^2 / 2)` along the ray.
fn response(row: &Row, probe: DVec3, direction: DVec3) -> (f64, f64) {
    let (g, v) = ((probe - row.mean) / row.deviations, direction / row.deviations);
    let distance = -g.dot(v) / v.dot(v);
    let alpha = (row.opacity * (-0.5 * (g + distance * v).length_squared()).exp()).min(0.99);
    (if alpha < 1.0 / 255.0 || distance <= 0.0 { 0.0 } else { alpha }, distance)
}

#[test]
fn one_gaussian_from_outside_and_inside_is_its_closed_form() {
    let folder = tempfile::tempdir().unwrap();
    let row = Row {
        mean: DVec3::new(0.3, -0.2, -3.0),
        deviations: DVec3::new(0.7, 0.4, 0.2),
        opacity: 0.8,
        colour: Vec3::new(0.9, 0.5, 0.2),
    };
    let job = Job { splats: vec![write_ply(folder.path(), std::slice::from_ref(&row))], ..Job::default() };
    for probe in [DVec3::ZERO, DVec3::new(0.5, -0.1, -2.9), row.mean + DVec3::new(0.0, 0.0, 0.01)] {
        for tracer in TRACERS {
            let image = bake(&job, folder.path(), probe, 21, tracer);
            let mut seen = 0;
            for texel in texels(&image) {
                let (alpha, distance) = response(&row, probe, texel.direction);
                if (alpha * 255.0 - 1.0).abs() < 1e-3 || distance.abs() < 1e-6 {
                    continue; // within rounding of the threshold
                }
                assert!((f64::from(texel.coverage) - alpha).abs() < 2e-6, "{tracer:?} {probe} {texel:?}: {alpha}");
                assert!((texel.rgb - linear(row.colour) * alpha as f32).abs().max_element() < 2e-6, "{texel:?}");
                if alpha > 0.0 {
                    assert!((f64::from(texel.distance) - distance).abs() < 1e-5 * distance.max(1.0), "{texel:?}");
                    seen += 1;
                }
            }
            assert!(seen > 20, "{tracer:?} {probe}: {seen} texels");
        }
    }
}

#[test]
fn a_wall_of_gaussians_lets_through_the_product_of_its_layers() {
    let folder = tempfile::tempdir().unwrap();
    let opacities = [0.5, 0.2, 0.9, 0.05];
    let rows: Vec<Row> = opacities
        .iter()
        .enumerate()
        .map(|(i, &opacity)| Row {
            mean: DVec3::new(0.0, 0.0, -2.0 - i as f64),
            deviations: DVec3::new(1e4, 1e4, 0.01),
            opacity,
            colour: Vec3::splat(0.25 * i as f32),
        })
        .collect();
    let background = [0.5, 1.0, 2.0];
    let job = Job {
        splats: vec![write_ply(folder.path(), &rows)],
        background: background.into(),
        t_cutoff: 0.0,
        ..Job::default()
    };
    // Blended in display space, converted once.
    let (mut blended, mut transmittance) = (0.0, 1.0);
    for (i, opacity) in opacities.iter().enumerate() {
        blended += transmittance * opacity * 0.25 * i as f64;
        transmittance *= 1.0 - opacity;
    }
    let coverage = 1.0 - transmittance;
    let light = linear(Vec3::splat((blended / coverage) as f32)) * coverage as f32;
    let expected = light + Vec3::from(background) * transmittance as f32;
    for tracer in TRACERS {
        let image = bake(&job, folder.path(), DVec3::ZERO, 9, tracer);
        let ahead: Vec<Texel> = texels(&image).filter(|texel| texel.face == Face::NegZ).collect();
        assert_eq!(ahead.len(), 81);
        for texel in ahead {
            assert!((f64::from(texel.coverage) - coverage).abs() < 1e-5, "{tracer:?} {texel:?}: {coverage}");
            assert!((texel.rgb - expected).abs().max_element() < 1e-5, "{tracer:?} {texel:?}: {expected}");
        }
    }
}

#[test]
fn in_a_furnace_every_texel_has_its_colour() {
    let folder = tempfile::tempdir().unwrap();
    let colour = Vec3::new(0.8, 0.5, 0.3);
    let mut random = Random(3);
    let rows: Vec<Row> = (0..3000)
        .map(|_| Row {
            mean: random.direction() * random.uniform(0.5, 4.0),
            deviations: DVec3::new(random.uniform(0.01, 0.4), random.uniform(0.01, 0.4), random.uniform(0.01, 0.4)),
            opacity: random.uniform(0.01, 0.99),
            colour,
        })
        .collect();
    // A pane of the same light among them, blended and seen from both sides.
    let mut pane = crate::common::gltf::File::square();
    let light = linear(colour);
    let material = json!({"pbrMetallicRoughness": {"baseColorFactor": [light.x, light.y, light.z, 0.4]},
        "alphaMode": "BLEND", "doubleSided": true});
    pane.push("materials", material);
    pane.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    let path = folder.path().join("pane.glb");
    std::fs::write(&path, pane.glb()).unwrap();
    let job = Job {
        splats: vec![write_ply(folder.path(), &rows)],
        meshes: vec![MeshInput {
            transform: Transform { translation: [-0.5, -0.5, -1.0], ..Transform::default() },
            ..MeshInput::new(path)
        }],
        background: light.to_array().into(),
        ..Job::default()
    };
    for tracer in TRACERS {
        let image = bake(&job, folder.path(), DVec3::ZERO, 33, tracer);
        for texel in texels(&image) {
            assert!((texel.rgb - light).abs().max_element() < 5e-6, "{tracer:?} {texel:?}");
        }
    }
}

#[test]
fn a_textured_quad_has_its_texels_coverage_and_distance() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("quad.glb");
    std::fs::write(&path, textured_square(json!({"index": 0}), json!({"magFilter": 9728})).glb()).unwrap();
    // 2 m wide, 2 m ahead: it covers the middle half of the face.
    let transform = Transform { translation: [-1.0, -1.0, -2.0], scale: [2.0; 3], ..Transform::default() };
    let job = Job { meshes: vec![MeshInput { transform, ..MeshInput::new(path) }], ..Job::default() };
    let [red, green, blue, white] = [Vec3::X, Vec3::Y, Vec3::Z, Vec3::ONE];
    for tracer in TRACERS {
        let image = bake(&job, folder.path(), DVec3::ZERO, 8, tracer);
        let mut met = 0;
        for (i, texel) in texels(&image).enumerate() {
            let (x, y) = (i % 8, i / 8 % 8);
            let on_quad = texel.face == Face::NegZ && (2..6).contains(&x) && (2..6).contains(&y);
            if !on_quad {
                assert_eq!((texel.rgb, texel.coverage, texel.distance), (Vec3::ZERO, 0.0, 0.0), "{tracer:?} {texel:?}");
                continue;
            }
            let expected = [[red, green], [blue, white]][usize::from(y >= 4)][usize::from(x >= 4)];
            assert_eq!((texel.rgb, texel.coverage), (expected, 1.0), "{tracer:?} ({x}, {y})");
            let distance = 2.0 / texel.direction.dot(DVec3::NEG_Z);
            assert!((f64::from(texel.distance) - distance).abs() < 1e-6, "{tracer:?} {}: {distance}", texel.distance);
            met += 1;
        }
        assert_eq!(met, 16);
    }
}

#[test]
fn half_a_world_of_splats_only_or_meshes_only_leaves_the_other_half_empty() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = Random(11);
    let rows: Vec<Row> = (0..500)
        .map(|_| Row {
            mean: DVec3::new(random.uniform(-3.0, 3.0), random.uniform(-3.0, 3.0), random.uniform(-4.0, -2.0)),
            deviations: DVec3::splat(random.uniform(0.02, 0.2)),
            opacity: 0.9,
            colour: Vec3::splat(0.7),
        })
        .collect();
    let splats = Job { splats: vec![write_ply(folder.path(), &rows)], ..Job::default() };
    let path: PathBuf = folder.path().join("quad.glb");
    std::fs::write(&path, crate::common::gltf::File::square().glb()).unwrap();
    let transform = Transform { translation: [-0.5, -0.5, -0.7], ..Transform::default() };
    let meshes = Job { meshes: vec![MeshInput { transform, ..MeshInput::new(path) }], ..Job::default() };
    for job in [splats, meshes] {
        for tracer in TRACERS {
            let image = bake(&job, folder.path(), DVec3::ZERO, 16, tracer);
            let behind = texels(&image).filter(|texel| texel.direction.z > 0.0);
            assert!(behind.fold(0.0, |sum: f32, texel| sum + texel.coverage + texel.rgb.element_sum()) == 0.0);
            let ahead = texels(&image).filter(|texel| texel.face == Face::NegZ && texel.coverage > 0.5).count();
            assert!(ahead > 50, "{tracer:?}: {ahead}");
        }
    }
}

#[test]
fn a_direction_on_an_edge_is_the_same_from_both_faces() {
    let mut scene = Scene { splats: cloud(3000, [0.03, 0.5], 2, 21), ..Scene::default() };
    add_random_triangles(&mut scene, 30, 22);
    let bvh = Bvh::build(&mut scene);
    let surfaces = &PatternedSurfaces(&scene);
    let scene = &scene;
    let settings = TraceSettings::default();
    let tracers: [&dyn TileTracer; 3] = [
        &ReferenceTracer { scene, surfaces, settings },
        &RayTracer { scene, bvh: &bvh, surfaces, settings },
        &BeamTracer::new(scene, &bvh, surfaces, settings),
    ];
    // The outermost texel centres of faces so large lie 5e-10 from the edge, and as far from each other along it.
    const FACE_SIZE: u32 = 1 << 30;
    let tile = |face: Face, direction: DVec3| {
        let [right, up, look] = face.axes();
        let texel =
            |along: f64| (((along / look.dot(direction) + 1.0) / 2.0 * f64::from(FACE_SIZE)) as u32).min(FACE_SIZE - 1);
        let (x, y) = (texel(right.dot(direction)) as i32, texel(-up.dot(direction)) as i32);
        Tile { face, face_size: FACE_SIZE, x, y, width: 1, height: 1 }
    };
    let mut random = Random(23);
    let (mut pairs, mut jumps) = (0, 0);
    while pairs < 1000 {
        let [a, b] = [Face::ALL[random.below(6)], Face::ALL[random.below(6)]];
        let [look_a, look_b] = [a, b].map(|face| face.axes()[2]);
        if look_a.dot(look_b) != 0.0 {
            continue;
        }
        pairs += 1;
        let direction = (look_a + look_b + look_a.cross(look_b) * random.uniform(-1.0, 1.0)).normalize();
        if hangs_on_rounding(scene, &Ray { origin: DVec3::ZERO, direction }) {
            jumps += 1;
            continue;
        }
        for (number, tracer) in tracers.iter().enumerate() {
            let [from_a, from_b] = [a, b].map(|face| {
                let mut texel = [Radiance::default()];
                tracer.trace_tile(DVec3::ZERO, &tile(face, direction), &mut texel);
                texel[0]
            });
            let difference = (from_a.splat_sum - from_b.splat_sum)
                .abs()
                .max((from_a.surface_sum - from_b.surface_sum).abs())
                .max_element()
                .max((from_a.transmittance - from_b.transmittance).abs());
            assert!(difference < 1e-6, "tracer {number}, {a:?} {b:?} {direction}: {difference:e}");
        }
    }
    assert!(jumps < 20, "{jumps}");
}

/// A PLY with view-dependent colours up to degree 3 and any rotation, without symmetry.
fn write_cloud(folder: &Path) -> SplatInput {
    let mut names: Vec<String> = "x y z opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 f_dc_0 f_dc_1 f_dc_2"
        .split(' ')
        .map(String::from)
        .collect();
    names.extend((0..45).map(|i| format!("f_rest_{i}")));
    let properties: String = names.iter().map(|name| format!("property float {name}\n")).collect();
    let count = 400;
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {count}\n{properties}end_header\n");
    let mut random = Random(31);
    for _ in 0..count {
        let mean = random.direction() * random.uniform(0.5, 3.0);
        let DQuat { x, y, z, w } = random.rotation();
        let mut values = vec![mean.x, mean.y, mean.z, random.uniform(-1.0, 3.0)];
        values.extend((0..3).map(|_| random.uniform(0.02f64.ln(), 0.5f64.ln())));
        values.extend([w, x, y, z]);
        values.extend((0..48).map(|_| random.uniform(-0.4, 0.4)));
        text += &values.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
        text += "\n";
    }
    let path = folder.join("cloud.ply");
    std::fs::write(&path, text).unwrap();
    SplatInput { frame: Some(Frame::RUB), ..SplatInput::new(path) }
}

#[test]
fn a_turned_or_mirrored_scene_is_the_same_image_with_its_texels_moved() {
    const SIZE: u32 = 24;
    let folder = tempfile::tempdir().unwrap();
    let input = write_cloud(folder.path());
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let turned = |rotation| Transform { rotation, ..Transform::default() };
    let scaled = |scale| Transform { scale, ..Transform::default() };
    let moves = [
        (turned([0.0, half, 0.0, half]), DMat3::from_cols(DVec3::NEG_Z, DVec3::Y, DVec3::X)),
        (turned([half, 0.0, 0.0, half]), DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y)),
        (scaled([-1.0, 1.0, 1.0]), DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0))),
        (scaled([1.0, 1.0, -1.0]), DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0))),
    ];
    for tracer in [Tracer::Ray, Tracer::Beam] {
        let seen = |transform: Transform| {
            let splats = vec![SplatInput { transform, ..input.clone() }];
            bake(&Job { splats, t_cutoff: 0.0, ..Job::default() }, folder.path(), DVec3::ZERO, SIZE, tracer)
        };
        let before: Vec<Texel> = texels(&seen(Transform::default())).collect();
        for (transform, world_from_scene) in moves {
            let after: Vec<Texel> = texels(&seen(transform)).collect();
            let mut differing = 0;
            for texel in &before {
                let (face, [u, v]) = Face::of_direction(world_from_scene * texel.direction);
                let [x, y] = [u, v].map(|along| (along * f64::from(SIZE)) as usize);
                let moved = &after[(face as usize * SIZE as usize + y) * SIZE as usize + x];
                assert!(moved.direction.distance(world_from_scene * texel.direction) < 1e-12);
                let difference = (moved.rgb - texel.rgb).abs().max_element();
                // A response at its threshold may round to either side.
                assert!(difference < 5e-3, "{tracer:?} {transform:?} {texel:?} {moved:?}");
                differing += usize::from(difference > 5e-5);
            }
            assert!(differing * 200 < before.len(), "{tracer:?} {transform:?}: {differing} of {}", before.len());
        }
    }
}
