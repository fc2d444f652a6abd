//! glTF files of known content, to triangles, materials and light.

use crate::common::gltf::{File, input, load_file, textured_square};
use glam::{DVec3, Vec2, Vec3, Vec4};
use serde_json::json;
use splatprobe::Error;
use splatprobe::ingest::gltf::load;
use splatprobe::ingest::load_scene;
use splatprobe::job::{MeshInput, Transform};
use splatprobe::scene::material::AlphaMode;
use splatprobe::scene::texture::Wrap;
use splatprobe::scene::{LinearRgb, Meshes};
use splatprobe::shade::UnlitSurfaces;
use splatprobe::trace::{Ray, SurfaceHit, Surfaces};

/// Light of the square at the point (x, y) of its plane.
fn seen_at(meshes: &Meshes, x: f32, y: f32) -> splatprobe::trace::Fragment {
    let point = Vec3::new(x, y, 0.0);
    let ray = Ray { origin: point.as_dvec3() + DVec3::Z, direction: DVec3::NEG_Z };
    for triangle in 0..meshes.triangles.len() {
        let [a, b, c] = meshes.corners(triangle);
        let area = (b - a).cross(c - a).z;
        let second = (point - a).cross(c - a).z / area;
        let third = (b - a).cross(point - a).z / area;
        if second >= 0.0 && third >= 0.0 && second + third <= 1.0 {
            let hit = SurfaceHit {
                triangle: triangle as u32,
                barycentric: Vec2::new(second, third),
                front: true,
                distance: 1.0,
            };
            return UnlitSurfaces::new(meshes).fragment(&ray, &hit);
        }
    }
    panic!("({x}, {y}) is beside the square");
}

fn geometric_normal(meshes: &Meshes, triangle: usize) -> Vec3 {
    let [a, b, c] = meshes.corners(triangle);
    (b - a).cross(c - a).normalize()
}

const RED: LinearRgb = LinearRgb(Vec3::X);
const GREEN: LinearRgb = LinearRgb(Vec3::Y);
const BLUE: LinearRgb = LinearRgb(Vec3::Z);
const WHITE: LinearRgb = LinearRgb(Vec3::ONE);

#[test]
fn a_textured_square_shows_its_texels_where_they_are_in_the_image() {
    let (meshes, report) = textured_square(json!({"index": 0}), json!({"magFilter": 9728})).load().unwrap();
    let corners = [(0.1, 0.9, RED), (0.9, 0.9, GREEN), (0.1, 0.1, BLUE), (0.9, 0.1, WHITE)];
    for (x, y, colour) in corners {
        assert_eq!(seen_at(&meshes, x, y).radiance, colour, "({x}, {y})");
    }
    assert_eq!((report.triangles, report.materials, report.textures, report.nodes), (2, 1, 1, 1));
    let bounds = report.bounds.unwrap();
    assert_eq!((bounds.min, bounds.max), (DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0)));
}

#[test]
fn wrap_modes_and_texture_transforms_of_the_file_are_used() {
    let info = json!({"index": 0, "extensions": {"KHR_texture_transform": {"offset": [1.0, 0.0]}}});
    // Moved by a whole texture: repeated, mirrored, or stretched from the right edge.
    for (code, wrap, left) in [(10497, Wrap::Repeat, RED), (33648, Wrap::Mirror, GREEN), (33071, Wrap::Clamp, GREEN)] {
        let file = textured_square(info.clone(), json!({"magFilter": 9728, "wrapS": code, "wrapT": code}));
        let (meshes, _) = file.load().unwrap();
        assert_eq!(meshes.textures[0].wrap, [wrap; 2]);
        assert_eq!(seen_at(&meshes, 0.1, 0.9).radiance, left, "{wrap:?}");
    }
    // texCoord of the extension wins: set 1 is absent, hence (0, 0) everywhere.
    let info = json!({"index": 0, "extensions": {"KHR_texture_transform": {"offset": [0.25, 0.75], "texCoord": 1}}});
    let (meshes, _) = textured_square(info, json!({"magFilter": 9728})).load().unwrap();
    assert_eq!(seen_at(&meshes, 0.9, 0.9).radiance, BLUE);
}

#[test]
fn materials_keep_factors_emission_strength_alpha_and_sides() {
    let mut file = File::square();
    file.push(
        "materials",
        json!({"name": "lamp", "extras": {"any": [1, {"thing": null}]}, "doubleSided": true, "alphaMode": "MASK", "alphaCutoff": 0.25,
            "emissiveFactor": [1.0, 0.5, 0.0], "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 0.4]},
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 8.0}, "KHR_materials_unlit": {}}}),
    );
    file.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    let (meshes, _) = file.load().unwrap();
    let material = &meshes.materials[0];
    assert_eq!(material.name, "lamp");
    assert_eq!(material.base_colour, Vec4::new(0.1, 0.2, 0.3, 0.4));
    assert_eq!(material.emissive, LinearRgb(Vec3::new(8.0, 4.0, 0.0)));
    assert_eq!(material.alpha, AlphaMode::Mask { cutoff: 0.25 });
    assert!(material.double_sided && material.unlit);
}

#[test]
fn vertex_colours_of_three_normalised_bytes_have_full_alpha() {
    let mut file = File::square();
    let view = file.view(&[255, 0, 51, 0].repeat(4));
    file.json["bufferViews"][view]["byteStride"] = json!(4);
    let accessor = json!({"bufferView": view, "componentType": 5121, "normalized": true, "count": 4, "type": "VEC3"});
    let colour = file.push("accessors", accessor);
    file.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(colour);
    let (meshes, _) = file.load().unwrap();
    assert!(meshes.attributes.iter().all(|a| a.colour == Vec4::new(1.0, 0.0, 0.2, 1.0)));
}

#[test]
fn mirrored_transforms_keep_fronts_and_normals_on_the_same_side() {
    let signs = [1.0, -1.0];
    for (x, y, z) in signs.iter().flat_map(|&x| signs.map(|y| (x, y))).flat_map(|(x, y)| signs.map(|z| (x, y, z))) {
        // Half of each mirror in the node, all of it once more in the job.
        for job_scale in [[1.0; 3], [x, y, z]] {
            let mut file = File::square();
            file.json["nodes"][0]["scale"] = json!([2.0 * x, 3.0 * y, 5.0 * z]);
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("square.glb");
            std::fs::write(&path, file.glb()).unwrap();
            let mut input = input(path);
            input.transform = Transform { scale: job_scale, ..Transform::default() };
            let mut meshes = Meshes::default();
            load(&input, DVec3::ZERO, &mut meshes, &mut Vec::new()).unwrap();
            let facing = Vec3::Z * (z * job_scale[2]) as f32;
            for triangle in 0..2 {
                assert_eq!(geometric_normal(&meshes, triangle), facing, "scale {x} {y} {z}, job {job_scale:?}");
            }
            assert!(meshes.attributes.iter().all(|a| a.normal == facing));
        }
    }
}

#[test]
fn strips_and_fans_face_the_way_their_first_triangle_does() {
    for (mode, corners) in [(5, [0u16, 1, 3, 2]), (6, [0, 1, 2, 3])] {
        let mut file = File::square();
        let indices = file.indices(&corners);
        file.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
        file.json["meshes"][0]["primitives"][0]["mode"] = json!(mode);
        let (meshes, report) = file.load().unwrap();
        assert_eq!(report.triangles, 2);
        assert!((0..2).all(|triangle| geometric_normal(&meshes, triangle) == Vec3::Z), "mode {mode}");
    }
}

#[test]
fn points_and_lines_are_counted_and_skipped_and_unused_vertices_are_not_stored() {
    let mut file = File::square();
    let triangle = file.indices(&[1, 2, 3]);
    let attributes = file.json["meshes"][0]["primitives"][0]["attributes"].clone();
    file.json["meshes"][0]["primitives"] = json!([
        {"attributes": attributes, "mode": 0},
        {"attributes": attributes, "mode": 3},
        {"attributes": attributes, "indices": triangle}
    ]);
    let (meshes, report) = file.load().unwrap();
    assert_eq!((report.skipped_primitives, report.triangles), (2, 1));
    assert_eq!(meshes.positions, [Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y]);
}

#[test]
fn triangles_without_area_or_with_infinite_corners_are_dropped_by_reason() {
    let mut file = File::new();
    let position = file.floats("VEC3", &[[0., 0., 0.], [1., 0., 0.], [2., 0., 0.], [0., 1., 0.], [f32::NAN, 0., 0.]]);
    let indices = file.indices(&[0, 1, 3, 0, 1, 2, 0, 0, 3, 0, 1, 4]);
    file.push("meshes", json!({"primitives": [{"attributes": {"POSITION": position}, "indices": indices}]}));
    let (meshes, report) = file.load().unwrap();
    assert_eq!((report.triangles, report.dropped_triangles.zero_area, report.dropped_triangles.non_finite), (1, 2, 1));
    assert!(meshes.positions.iter().all(|p| p.is_finite()));
    assert_eq!(meshes.attributes[0].normal, Vec3::ZERO, "a file without normals stores none");
}

#[test]
fn parents_and_matrices_compose_in_f64() {
    let mut file = File::square();
    // 2^24 + 0.25 is no f32; the child's matrix brings the square back to the origin.
    let far = 16_777_216.25;
    let back = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -16_777_216.0, 0.0, 0.0, 1.0];
    file.json["nodes"] = json!([{"children": [1], "translation": [far, 0, 0]}, {"mesh": 0, "matrix": back}]);
    let (meshes, report) = file.load().unwrap();
    assert_eq!(meshes.positions[0], Vec3::new(0.25, 0.0, 0.0));
    assert_eq!(report.nodes, 2);
}

#[test]
fn positions_are_relative_to_the_scenes_origin_and_bounds_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("square.glb");
    std::fs::write(&path, File::square().glb()).unwrap();
    let mut input = input(path);
    input.transform.translation = [1.0e7, 0.5, 0.0];
    let mut meshes = Meshes::default();
    let report = load(&input, DVec3::new(1.0e7, 0.0, 0.0), &mut meshes, &mut Vec::new()).unwrap();
    assert_eq!(meshes.positions[0], Vec3::new(0.0, 0.5, 0.0));
    assert_eq!(report.bounds.unwrap().max, DVec3::new(1.0e7 + 1.0, 1.5, 0.0));
}

#[test]
fn a_scene_of_meshes_far_from_zero_has_an_origin_near_it_wherever_its_distance_comes_from() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("square.glb");
    let mut far_node = File::square();
    far_node.json["nodes"][0]["translation"] = json!([4.0e6, 0.0, 0.0]);
    let far_input =
        |translation| MeshInput { transform: Transform { translation, ..Transform::default() }, ..input(&path) };
    for (file, input, first_corner) in [
        (File::square(), far_input([1.0e7, 0.25, -3.0e6]), DVec3::new(1.0e7, 0.25, -3.0e6)),
        (far_node, far_input([0.0; 3]), DVec3::new(4.0e6, 0.0, 0.0)),
        (File::square(), far_input([9.0, 0.0, 0.0]), DVec3::new(9.0, 0.0, 0.0)),
    ] {
        std::fs::write(&path, file.glb()).unwrap();
        let (scene, report) = load_scene(&[], &[input]).unwrap();
        assert_eq!(scene.origin == DVec3::ZERO, first_corner.x < 10.0, "{}", scene.origin);
        assert_eq!(scene.origin + scene.meshes.positions[0].as_dvec3(), first_corner);
        assert!(scene.meshes.positions.iter().all(|position| position.length() < 12.0));
        assert_eq!(report.meshes[0].bounds.unwrap().min, first_corner);
    }
}

#[test]
fn instances_multiply_a_mesh_with_normalised_rotations() {
    let mut file = File::square();
    let translation = file.floats("VEC3", &[[0., 0., 0.], [10., 0., 0.]]);
    let scale = file.floats("VEC3", &[[1., 1., 1.], [2., 2., 2.]]);
    // Half a turn about y as normalised bytes: (0, 1, 0, 0); and none.
    let view = file.view(&[0, 0, 0, 127, 0, 127, 0, 0]);
    let rotation = json!({"bufferView": view, "componentType": 5120, "normalized": true, "count": 2, "type": "VEC4"});
    let rotation = file.push("accessors", rotation);
    file.json["extensionsUsed"] = json!(["EXT_mesh_gpu_instancing"]);
    file.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"] =
        json!({"TRANSLATION": translation, "SCALE": scale, "ROTATION": rotation});
    let (meshes, report) = file.load().unwrap();
    assert_eq!((report.triangles, meshes.positions.len()), (4, 8));
    assert!(report.extensions_ignored.is_empty());
    assert!(meshes.corners(2)[1].abs_diff_eq(Vec3::new(8.0, 0.0, 0.0), 1e-6));
    assert!(geometric_normal(&meshes, 2).abs_diff_eq(Vec3::NEG_Z, 1e-6));
}

#[test]
fn skins_stand_as_their_joints_do_and_ignore_their_nodes_transform() {
    let mut file = File::square();
    let joints = file.floats("VEC4", &[[0., 1., 0., 0.]; 4]);
    let weights = file.floats("VEC4", &[[0.5, 0.5, 0., 0.]; 4]);
    let attributes = &mut file.json["meshes"][0]["primitives"][0]["attributes"];
    attributes["JOINTS_0"] = json!(joints);
    attributes["WEIGHTS_0"] = json!(weights);
    let identity_moved_back = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., -1., 0., 1.];
    let inverse_bind = file.floats("MAT4", &[identity_moved_back; 2]);
    file.json["skins"] = json!([{"joints": [1, 2], "inverseBindMatrices": inverse_bind}]);
    file.json["scenes"][0]["nodes"] = json!([0, 1, 2]);
    file.json["nodes"] = json!([
        {"mesh": 0, "skin": 0, "translation": [99, 99, 99]},
        {"translation": [4, 1, 0]},
        {"translation": [0, 1, 2]}
    ]);
    let (meshes, _) = file.load().unwrap();
    assert_eq!(meshes.positions[0], Vec3::new(2.0, 0.0, 1.0));
    assert_eq!(meshes.attributes[0].normal, Vec3::Z);
}

#[test]
fn morph_targets_apply_at_their_default_weights() {
    let mut file = File::square();
    let up = file.floats("VEC3", &[[0., 0., 4.]; 4]);
    file.json["meshes"][0]["primitives"][0]["targets"] = json!([{"POSITION": up}, {"POSITION": up}]);
    file.json["meshes"][0]["weights"] = json!([0.25, 0.0]);
    assert_eq!(file.load().unwrap().0.positions[0].z, 1.0);
    file.json["nodes"][0]["weights"] = json!([0.25, 0.5]);
    assert_eq!(file.load().unwrap().0.positions[0].z, 3.0);
}

#[test]
fn quantised_positions_are_read_as_the_numbers_they_are() {
    let mut file = File::square();
    let corners: [[i16; 4]; 4] = [[0, 0, 0, 0], [1000, 0, 0, 0], [1000, -500, 0, 0], [0, -500, 0, 0]];
    let bytes: Vec<u8> = corners.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
    let view = file.view(&bytes);
    file.json["bufferViews"][view]["byteStride"] = json!(8);
    let accessor = json!({"bufferView": view, "componentType": 5122, "count": 4, "type": "VEC3"});
    let position = file.push("accessors", accessor);
    file.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(position);
    file.json["nodes"][0]["scale"] = json!([0.001, 0.001, 0.001]);
    file.json["extensionsUsed"] = json!(["KHR_mesh_quantization"]);
    file.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    let bounds = file.load().unwrap().1.bounds.unwrap();
    assert_eq!((bounds.min, bounds.max), (DVec3::new(0.0, -0.5, 0.0), DVec3::X));
}

#[test]
fn external_and_embedded_buffers_and_images_give_what_a_glb_gives() {
    use base64::Engine;
    let file = textured_square(json!({"index": 0}), json!({}));
    let (expected, _) = file.load().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.gltf");
    std::fs::create_dir(folder.path().join("sub folder")).unwrap();
    std::fs::write(folder.path().join("sub folder/é.bin"), &file.bin).unwrap();
    let embedded = base64::engine::general_purpose::STANDARD.encode(&file.bin);
    for uri in ["sub%20folder/%C3%A9.bin".to_string(), format!("data:application/octet-stream;base64,{embedded}")] {
        let mut json = file.json.clone();
        json["buffers"] = json!([{"byteLength": file.bin.len(), "uri": uri}]);
        std::fs::write(&path, json.to_string()).unwrap();
        let (meshes, _) = load_file(&path).unwrap();
        assert_eq!(meshes.positions, expected.positions);
        let pixels = |meshes: &Meshes| meshes.textures[0].image.levels().unwrap().to_vec();
        assert_eq!(pixels(&meshes), pixels(&expected));
    }
}

#[test]
fn scenes_are_chosen_by_name_then_index_then_default_then_first_then_roots() {
    let mut file = File::square();
    file.json["nodes"] = json!([{"mesh": 0}, {"mesh": 0, "children": [2]}, {"mesh": 0}]);
    file.json["scenes"] = json!([{"nodes": [0]}, {"name": "pair", "nodes": [1]}]);
    file.json["scene"] = json!(1);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    let triangles = |file: &File, scene: Option<&str>| {
        std::fs::write(&path, file.glb()).unwrap();
        let mut input = input(&path);
        input.scene = scene.map(str::to_string);
        load(&input, DVec3::ZERO, &mut Meshes::default(), &mut Vec::new()).map(|report| report.triangles)
    };
    assert_eq!(triangles(&file, Some("pair")).unwrap(), 4);
    assert_eq!(triangles(&file, Some("0")).unwrap(), 2);
    assert_eq!(triangles(&file, None).unwrap(), 4);
    file.json.as_object_mut().unwrap().remove("scene");
    assert_eq!(triangles(&file, None).unwrap(), 2);
    let error = triangles(&file, Some("trio")).unwrap_err();
    assert!(matches!(error, Error::Request { .. }));
    assert!(error.to_string().contains("'trio'; it has 0 (''), 1 ('pair')"), "{error}");
    file.json.as_object_mut().unwrap().remove("scenes");
    assert_eq!(triangles(&file, None).unwrap(), 6);
}

#[test]
fn a_second_file_is_appended_behind_the_first() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    std::fs::write(&path, textured_square(json!({"index": 0}), json!({})).glb()).unwrap();
    let mut meshes = Meshes::default();
    for _ in 0..2 {
        load(&input(&path), DVec3::ZERO, &mut meshes, &mut Vec::new()).unwrap();
    }
    assert_eq!(meshes.triangles[2], meshes.triangles[0].map(|v| v + 4));
    assert_eq!(meshes.triangle_materials, [0, 0, 1, 1]);
    assert_eq!(meshes.materials[1].base_colour_texture.unwrap().texture, 1);
}
