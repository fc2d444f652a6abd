//! KHR_gaussian_splatting: what every attribute means, node transforms, files that hold splats and meshes, broken files.

use std::path::PathBuf;

use crate::common::Random;
use crate::common::gltf::File;
use crate::packed_files::{Known, spz};
use glam::{DQuat, DVec3, Vec3};
use serde_json::{Value, json};
use splatprobe::Error;
use splatprobe::ingest::{SceneReport, inspect, load_scene};
use splatprobe::job::{MeshInput, Order, SplatInput, Transform};
use splatprobe::scene::{Scene, SplatEncoding, sh};

const EXTENSION: &str = "KHR_gaussian_splatting";

/// Two Gaussians with a band of colour as mesh 0, on node 0.
fn splats() -> File {
    let mut file = File::new();
    let position = file.floats("VEC3", &[[1.0, 2.0, 3.0], [-1.0, 0.5, -0.25]]);
    let quarter_turn = std::f32::consts::FRAC_1_SQRT_2;
    let rotation = file.floats("VEC4", &[[0.0, 0.0, quarter_turn, quarter_turn], [0.0, 0.0, 0.0, 1.0]]);
    let scale = file.floats("VEC3", &[[0.1, 0.2, 0.4], [1.0, 1.0, 2.0]]);
    let opacity = file.floats("SCALAR", &[[0.25], [1.0]]);
    let mut attributes = json!({"POSITION": position});
    for (name, accessor) in [("ROTATION", rotation), ("SCALE", scale), ("OPACITY", opacity)] {
        attributes[format!("{EXTENSION}:{name}")] = json!(accessor);
    }
    for (k, name) in ["0_COEF_0", "1_COEF_0", "1_COEF_1", "1_COEF_2"].into_iter().enumerate() {
        let k = k as f32;
        let accessor = file.floats("VEC3", &[[k, k + 0.25, k + 0.5], [-k, 0.0, 0.125]]);
        attributes[format!("{EXTENSION}:SH_DEGREE_{name}")] = json!(accessor);
    }
    let extension = json!({"kernel": "ellipse", "colorSpace": "srgb_rec709_display"});
    let primitive = json!({"attributes": attributes, "mode": 0, "extensions": {EXTENSION: extension}});
    file.push("meshes", json!({"primitives": [primitive]}));
    file.json["extensionsUsed"] = json!([EXTENSION]);
    file
}

fn primitive(file: &mut File) -> &mut Value {
    &mut file.json["meshes"][0]["primitives"][0]
}

/// The accessor of attribute `name` of the extension.
fn accessor<'a>(file: &'a mut File, name: &str) -> &'a mut Value {
    let index = primitive(file)["attributes"][format!("{EXTENSION}:{name}")].as_u64().unwrap();
    &mut file.json["accessors"][index as usize]
}

/// Makes the attribute's data `bytes` of another component type.
fn retype(file: &mut File, name: &str, code: u32, normalized: bool, bytes: &[u8]) {
    let view = file.view(bytes);
    let accessor = accessor(file, name);
    accessor["bufferView"] = json!(view);
    accessor["componentType"] = json!(code);
    accessor["normalized"] = json!(normalized);
}

fn written(bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.glb");
    std::fs::write(&path, bytes).unwrap();
    (folder, path)
}

fn load_bytes(bytes: &[u8]) -> splatprobe::Result<(Scene, SceneReport)> {
    let (_folder, path) = written(bytes);
    load_scene(&[SplatInput::new(path)], &[])
}

fn load(file: &File) -> splatprobe::Result<(Scene, SceneReport)> {
    load_bytes(&file.glb())
}

fn error(file: &File) -> Error {
    load(file).expect_err("this file is broken")
}

#[test]
fn values_mean_what_the_extension_says() {
    let (scene, report) = load(&splats()).unwrap();
    let splats = &scene.splats;
    assert_eq!(splats.means, [Vec3::new(1.0, 2.0, 3.0), Vec3::new(-1.0, 0.5, -0.25)]);
    assert_eq!(splats.opacities, [0.25, 1.0]);
    // A quarter turn about z: the first axis (0.1 m) points along y, the second (0.2 m) along -x.
    let covariance = splats.covariance(0);
    for (i, expected) in [0.04, 0.01, 0.16].into_iter().enumerate() {
        assert!((covariance.col(i)[i] - expected).abs() < 1e-7, "{covariance}");
    }
    let channel = |c: f32| (0..4).map(move |k| k as f32 + c);
    let expected: Vec<f32> = [0.0, 0.25, 0.5].into_iter().flat_map(channel).collect();
    assert_eq!((splats.sh_degree, splats.sh_of(0)), (1, &expected[..]));
    let report = &report.splats[0];
    assert_eq!((report.count, report.kept, report.encoding), (2, 2, SplatEncoding::SrgbDisplay));
    // The extension's default.
    assert_eq!(report.order, Some(Order::CameraDistance));
    assert!(report.format.contains("glTF") && report.format.contains(EXTENSION));
}

#[test]
fn colour_space_and_sorting_method_decide_what_the_job_leaves_open() {
    let mut file = splats();
    let extension = &mut primitive(&mut file)["extensions"][EXTENSION];
    extension["colorSpace"] = json!("lin_rec709_display");
    extension["sortingMethod"] = json!("rayHitDistance");
    let (scene, report) = load(&file).unwrap();
    assert_eq!(scene.encoding, SplatEncoding::LinDisplay);
    assert_eq!((report.splats[0].order, report.order()), (Some(Order::RayHitDistance), Some(Order::RayHitDistance)));
    primitive(&mut file)["extensions"][EXTENSION]["sortingMethod"] = json!("zDepth");
    assert_eq!(load(&file).unwrap().1.order(), None);
}

#[test]
fn every_component_type_of_the_extension_decodes() {
    for (code, normalized, size, largest) in
        [(5121, true, 1, 255.0), (5121, false, 1, 1.0), (5123, true, 2, 65535.0), (5123, false, 2, 1.0)]
    {
        let integers = [3u16, 100, 200, 1, 1, 2];
        let bytes: Vec<u8> = integers.iter().flat_map(|v| v.to_le_bytes()[..size].to_vec()).collect();
        let mut file = splats();
        retype(&mut file, "SCALE", code, normalized, &bytes);
        let (scene, _) = load(&file).unwrap();
        for (k, bits) in [3.0, 100.0, 200.0].into_iter().enumerate() {
            let expected = bits / largest;
            let found = scene.splats.standard_deviations(0)[k];
            assert!((found / expected - 1.0).abs() < 1e-5, "{code} {normalized}: {found} is not {expected}");
        }
    }
    for (code, size, integers) in [(5121, 1, [51u16, 255]), (5123, 2, [13107, 65535])] {
        let bytes: Vec<u8> = integers.iter().flat_map(|v| v.to_le_bytes()[..size].to_vec()).collect();
        let mut file = splats();
        retype(&mut file, "OPACITY", code, true, &bytes);
        assert_eq!(load(&file).unwrap().0.splats.opacities, [0.2, 1.0]);
    }
    for (code, size) in [(5120, 1), (5122, 2)] {
        // A half turn about x, in both types as large as the type allows.
        let largest: i16 = if size == 1 { 127 } else { 32767 };
        let bytes: Vec<u8> =
            [-largest, 0, 0, 0, 0, 0, 0, largest].iter().flat_map(|v| v.to_le_bytes()[..size].to_vec()).collect();
        let mut file = splats();
        retype(&mut file, "ROTATION", code, true, &bytes);
        let (scene, _) = load(&file).unwrap();
        let covariance = scene.splats.covariance(0);
        for (i, expected) in [0.01, 0.04, 0.16].into_iter().enumerate() {
            assert!((covariance.col(i)[i] - expected).abs() < 1e-7, "{code}: {covariance}");
        }
    }
}

#[test]
fn wrong_component_types_and_shapes_are_errors_that_name_attribute_and_accessor() {
    for (name, code, normalized, kind) in [
        ("SCALE", 5120, true, "VEC3"),
        ("SCALE", 5126, true, "VEC3"),
        ("SCALE", 5126, false, "VEC4"),
        ("ROTATION", 5121, true, "VEC4"),
        ("ROTATION", 5122, false, "VEC4"),
        ("OPACITY", 5121, false, "SCALAR"),
        ("OPACITY", 5126, false, "VEC2"),
        ("SH_DEGREE_0_COEF_0", 5122, true, "VEC3"),
        ("SH_DEGREE_1_COEF_2", 5125, false, "VEC3"),
    ] {
        let mut file = splats();
        let accessor = accessor(&mut file, name);
        accessor["componentType"] = json!(code);
        accessor["normalized"] = json!(normalized);
        accessor["type"] = json!(kind);
        let error = error(&file);
        let message = error.to_string();
        assert!(matches!(error, Error::Invalid { .. }), "{message}");
        assert!(message.contains(name) && message.contains("/accessors/"), "{message}");
    }
}

#[test]
fn faults_are_errors_that_name_what_is_wrong() {
    type Spoil = fn(&mut File);
    let faults: [(&str, Spoil); 15] = [
        ("kernel 'cube'", |file| primitive(file)["extensions"][EXTENSION]["kernel"] = json!("cube")),
        ("bt2020", |file| primitive(file)["extensions"][EXTENSION]["colorSpace"] = json!("bt2020")),
        ("sortingMethod", |file| primitive(file)["extensions"][EXTENSION]["sortingMethod"] = json!(3)),
        ("not an object", |file| primitive(file)["extensions"][EXTENSION] = json!("yes")),
        ("POINTS", |file| primitive(file)["mode"] = json!(4)),
        ("POINTS", |file| drop(primitive(file).as_object_mut().unwrap().remove("mode"))),
        ("indices", |file| primitive(file)["indices"] = json!(0)),
        ("attribute SCALE", |file| {
            drop(primitive(file)["attributes"].as_object_mut().unwrap().remove("KHR_gaussian_splatting:SCALE"));
        }),
        ("SH_DEGREE_1_COEF_1", |file| {
            let name = "KHR_gaussian_splatting:SH_DEGREE_1_COEF_1";
            drop(primitive(file)["attributes"].as_object_mut().unwrap().remove(name));
        }),
        ("out of range", |file| primitive(file)["attributes"]["KHR_gaussian_splatting:OPACITY"] = json!(99)),
        ("not an index", |file| primitive(file)["attributes"]["KHR_gaussian_splatting:OPACITY"] = json!(-1)),
        ("do not fit", |file| accessor(file, "OPACITY")["count"] = json!(u32::MAX)),
        ("as many elements", |file| accessor(file, "OPACITY")["count"] = json!(1)),
        ("bufferView", |file| drop(accessor(file, "SCALE").as_object_mut().unwrap().remove("bufferView"))),
        ("EXT_unknown", |file| file.json["extensionsRequired"] = json!(["EXT_unknown"])),
    ];
    for (words, spoil) in faults {
        let mut file = splats();
        spoil(&mut file);
        let message = error(&file).to_string();
        assert!(message.contains(words), "'{words}' is not in: {message}");
    }
}

/// Puts SPZ data in the primitive's place of its attributes.
fn compressed(name: &str, spz: &[u8]) -> File {
    let mut file = splats();
    let view = file.view(spz);
    file.json["extensionsRequired"] = json!([EXTENSION, name]);
    primitive(&mut file)["extensions"][EXTENSION]["extensions"] = json!({name: {"bufferView": view}});
    file
}

#[test]
fn spz_inside_is_left_up_front_and_in_drafts_without_a_kernel_as_it_stands() {
    let mean = DVec3::new(0.5, 1.25, -2.0);
    let sh = vec![0.0; 3];
    let deviations = DVec3::splat(0.125);
    let spz = spz::file(2, &[Known { mean, rotation: DQuat::IDENTITY, deviations, opacity: 0.8, sh }]);
    for name in ["KHR_gaussian_splatting_compression_spz", "KHR_gaussian_splatting_compression_spz_2"] {
        let mut file = compressed(name, &spz);
        let place = |file: &File| load(file).unwrap().0.splats.means[0];
        assert_eq!(place(&file), Vec3::new(-0.5, 1.25, 2.0));
        primitive(&mut file)["extensions"][EXTENSION].as_object_mut().unwrap().remove("kernel");
        assert_eq!(place(&file), Vec3::new(0.5, 1.25, -2.0));
    }
}

#[test]
fn broken_spz_inside_is_an_error_that_tells_what_it_was() {
    let name = "KHR_gaussian_splatting_compression_spz_2";
    let mut file = compressed(name, b"not SPZ, whatever it may be");
    assert!(error(&file).to_string().contains(name), "{}", error(&file));
    primitive(&mut file)["extensions"][EXTENSION]["extensions"] = json!({name: {"bufferView": 99}});
    assert!(error(&file).to_string().contains("out of range"));
}

#[test]
fn several_primitives_stand_under_their_nodes_transforms() {
    let mut file = splats();
    file.json["scenes"] = json!([{"nodes": [0]}]);
    file.json["nodes"] = json!([
        {"children": [1, 2], "translation": [0, 10, 0]},
        {"mesh": 0, "scale": [2, 2, 2]},
        {"mesh": 0, "rotation": [0, 1, 0, 0]},
    ]);
    let (scene, report) = load(&file).unwrap();
    let splats = &scene.splats;
    assert_eq!((splats.len(), report.splats[0].count), (4, 4));
    let expected = [[2.0, 14.0, 6.0], [-2.0, 11.0, -0.5], [-1.0, 12.0, -3.0], [1.0, 10.5, 0.25]];
    for (mean, expected) in splats.means.iter().zip(expected) {
        assert!((*mean - Vec3::from(expected)).length() < 1e-5, "{mean}");
    }
    let deviations = splats.standard_deviations(0);
    assert!((deviations - DVec3::new(0.2, 0.4, 0.8)).length() < 1e-6, "{deviations}");
    // The half turn about y turns colours along.
    for direction in [Vec3::X, Vec3::Z, Vec3::new(0.6, -0.48, 0.64)] {
        let turned = Vec3::new(-direction.x, direction.y, -direction.z);
        let [before, after] = [(0, direction), (2, turned)].map(|(i, d)| sh::evaluate(1, splats.sh_of(i), d));
        assert!((before - after).abs().max_element() < 1e-5, "{direction}");
    }
}

/// The splats and, on a node of its own, the unit square.
fn splats_and_square() -> File {
    let mut file = splats();
    let square = file.floats("VEC3", &[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]);
    let mesh = file.push("meshes", json!({"primitives": [{"attributes": {"POSITION": square}}]}));
    file.json["nodes"] = json!([{"mesh": 0}, {"mesh": mesh}]);
    file.json["scenes"] = json!([{"nodes": [0, 1]}]);
    file
}

#[test]
fn a_file_of_both_kinds_brings_both_whichever_list_names_it() {
    let (_folder, path) = written(&splats_and_square().glb());
    let moved = Transform { translation: [5.0, 0.0, 0.0], ..Transform::default() };
    let as_splats = SplatInput { transform: moved, ..SplatInput::new(&path) };
    let as_mesh = MeshInput { transform: moved, ..MeshInput::new(&path) };
    let check = |splats: &[SplatInput], meshes: &[MeshInput], splat_x: f32, mesh_x: f32| {
        let (scene, report) = load_scene(splats, meshes).unwrap();
        assert_eq!((scene.splats.len(), scene.meshes.triangles.len()), (2, 1));
        assert_eq!((report.splats.len(), report.meshes.len()), (1, 1));
        assert_eq!(report.meshes[0].skipped_primitives, 0, "splats are no points that were passed over");
        assert_eq!((scene.splats.means[0].x, scene.meshes.positions[0].x), (splat_x, mesh_x));
    };
    check(std::slice::from_ref(&as_splats), &[], 6.0, 5.0);
    check(&[], std::slice::from_ref(&as_mesh), 6.0, 5.0);
    check(&[as_splats], &[MeshInput::new(&path)], 6.0, 0.0);
    check(&[SplatInput::new(&path)], &[as_mesh], 1.0, 5.0);
    let report = inspect(&path).unwrap();
    assert_eq!((report.splats.len(), report.meshes.len()), (1, 1));
}

#[test]
fn a_file_of_splats_alone_brings_no_meshes_and_one_of_meshes_alone_is_no_splat_file() {
    let (_folder, path) = written(&splats().glb());
    let report = inspect(&path).unwrap();
    assert_eq!((report.splats.len(), report.meshes.len()), (1, 0));
    let error = error(&File::square());
    assert!(error.to_string().contains("--mesh"), "{error}");
}

#[test]
fn instances_beyond_what_the_file_justifies_are_refused() {
    let mut file = splats();
    // 600,000 nodes of two Gaussians each in a file of a few megabytes of JSON, whose buffer is tiny.
    file.json["nodes"] = Value::Array(vec![json!({"mesh": 0}); 600_000]);
    file.json["scenes"] = json!([{"nodes": (0..600_000).collect::<Vec<_>>()}]);
    let error = error(&file);
    assert!(matches!(&error, Error::Unsupported { what, .. } if what.contains("Gaussians")), "{error}");
}

#[test]
fn a_flattening_node_is_an_error_that_names_it() {
    let mut file = splats();
    file.json["nodes"] = json!([{"mesh": 0, "name": "Flat", "scale": [1, 0, 1]}]);
    let error = error(&file);
    assert!(error.to_string().contains("Flat"), "{error}");
}

#[test]
fn values_that_are_not_numbers_are_dropped_and_counted() {
    let mut file = splats();
    let start = file.json["bufferViews"][0]["byteOffset"].as_u64().unwrap() as usize;
    file.bin[start..start + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    let (scene, report) = load(&file).unwrap();
    assert_eq!((scene.splats.len(), report.splats[0].dropped.non_finite), (1, 1));
}

#[test]
fn every_truncation_is_an_error() {
    let glb = splats().glb();
    let (_folder, path) = written(&glb);
    for length in 0..glb.len() {
        std::fs::write(&path, &glb[..length]).unwrap();
        assert!(load_scene(&[SplatInput::new(&path)], &[]).is_err(), "{length} of {} bytes load", glb.len());
    }
}

#[test]
fn flipped_bytes_never_panic_and_never_give_numbers_that_are_none() {
    let glb = splats_and_square().glb();
    let (_folder, path) = written(&glb);
    let mut random = Random(4);
    let mut loaded = 0;
    for _ in 0..10_000 {
        let mut broken = glb.clone();
        for _ in 0..1 + random.below(3) {
            let at = random.below(broken.len());
            broken[at] = random.bits() as u8;
        }
        std::fs::write(&path, &broken).unwrap();
        if let Ok((scene, _)) = load_scene(&[SplatInput::new(&path)], &[]) {
            loaded += 1;
            assert!(scene.splats.means.iter().all(|mean| mean.is_finite()));
            assert!(scene.splats.unit_from_world.iter().all(|matrix| matrix.is_finite()));
        }
    }
    assert!((500..9500).contains(&loaded), "{loaded} of 10000 loaded: the changes test only one side");
}
