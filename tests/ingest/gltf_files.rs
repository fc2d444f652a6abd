//! Real glTF files. Set SPLATPROBE_DATA to the folder that holds them.

use std::path::Path;

use crate::common::gltf::data_folder;
use glam::{DVec3, Vec3};
use serde_json::Value;
use splatprobe::ingest::gltf::{MeshReport, load};
use splatprobe::job::{MeshInput, MissingTexture};
use splatprobe::scene::Meshes;

fn json_of(path: &Path) -> Value {
    let bytes = std::fs::read(path).unwrap();
    let json = if bytes.starts_with(b"glTF") {
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        &bytes[20..20 + length]
    } else {
        &bytes[..]
    };
    serde_json::from_slice(json).unwrap()
}

/// Triangles of all nodes of the default scene, by the counts in the JSON alone.
fn triangles_by_json(json: &Value) -> usize {
    let mut pending: Vec<u64> = match json["scenes"][json["scene"].as_u64().unwrap_or(0) as usize]["nodes"].as_array() {
        Some(roots) => roots.iter().filter_map(Value::as_u64).collect(),
        None => Vec::new(),
    };
    let mut triangles = 0;
    while let Some(node) = pending.pop() {
        let node = &json["nodes"][node as usize];
        pending.extend(node["children"].as_array().into_iter().flatten().filter_map(Value::as_u64));
        let instances = &node["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["TRANSLATION"];
        let instances = instances.as_u64().map_or(1, |i| json["accessors"][i as usize]["count"].as_u64().unwrap());
        let Some(mesh) = node["mesh"].as_u64() else { continue };
        for primitive in json["meshes"][mesh as usize]["primitives"].as_array().unwrap() {
            let corners = primitive["indices"].as_u64().or(primitive["attributes"]["POSITION"].as_u64()).unwrap();
            let corners = json["accessors"][corners as usize]["count"].as_u64().unwrap();
            triangles += instances
                * match primitive["mode"].as_u64().unwrap_or(4) {
                    4 => corners / 3,
                    5 | 6 => corners - 2,
                    _ => 0,
                };
        }
    }
    triangles as usize
}

/// Textures that materials use, by the JSON alone; in these files each has its own image or sampler, and one encoding.
fn textures_by_json(json: &Value) -> usize {
    fn infos<'a>(value: &'a Value, found: &mut Vec<&'a Value>) {
        for (name, value) in value.as_object().into_iter().flatten() {
            if name.ends_with("Texture") {
                found.push(&value["index"]);
            }
            infos(value, found);
        }
    }
    let mut found = Vec::new();
    json["materials"].as_array().into_iter().flatten().for_each(|material| infos(material, &mut found));
    found.into_iter().filter_map(Value::as_u64).collect::<std::collections::BTreeSet<_>>().len()
}

fn load_and_check(path: &Path) -> (Meshes, MeshReport) {
    let mut meshes = Meshes::default();
    // The folder holds not all images that the asset generator's nodes name.
    let input = MeshInput { missing_texture: MissingTexture::Magenta, ..MeshInput::new(path) };
    let report = load(&input, DVec3::ZERO, &mut meshes, &mut Vec::new()).unwrap_or_else(|e| panic!("{e}"));
    let are_missing = report.replaced_images.iter().all(|what| what.contains("_Nodes.png' cannot be read"));
    assert!(are_missing, "{:?}", report.replaced_images);
    let dropped = report.dropped_triangles;
    let found = report.triangles + dropped.zero_area + dropped.non_finite;
    assert_eq!(found, triangles_by_json(&json_of(path)), "{}: {report:?}", path.display());
    assert_eq!(dropped.non_finite, 0, "{}", path.display());
    assert_eq!(meshes.triangles.len(), report.triangles);
    (meshes, report)
}

#[test]
fn real_glbs_load_with_all_their_triangles() {
    let Some(data) = data_folder() else { return };
    for name in [
        "PBR_Spheres",
        "house",
        "TwoSidedPlane",
        "Fox",
        "Lights",
        "simple-instancing",
        "glass-table",
        "NormalTangentTest",
        "SpecularTest",
        "cat",
        "chess-board",
        "heart_draco",
        "carbon-sphere",
    ] {
        let path = data.join(format!("meshes/{name}.glb"));
        let (_, report) = load_and_check(&path);
        assert!(report.triangles > 0, "{name}");
        assert_eq!(report.textures, textures_by_json(&json_of(&path)), "{name}");
    }
}

#[test]
fn instances_of_a_real_file_are_counted() {
    let Some(data) = data_folder() else { return };
    let path = data.join("meshes/simple-instancing.glb");
    let (_, report) = load_and_check(&path);
    assert_eq!(report.extensions_used, ["EXT_mesh_gpu_instancing"]);
    assert!(report.extensions_ignored.is_empty());
}

#[test]
fn the_fox_stands_upright_in_its_rest_pose() {
    let Some(data) = data_folder() else { return };
    let (_, report) = load_and_check(&data.join("meshes/Fox.glb"));
    let bounds = report.bounds.unwrap();
    let size: Vec<f64> = (0..3).map(|axis| bounds.max[axis] - bounds.min[axis]).collect();
    assert!(size[2] > size[1] && size[1] > size[0], "a fox is longer than high and higher than wide: {size:?}");
    assert!(bounds.min[1].abs() < 0.05 * size[1], "its paws are on the ground: {bounds:?}");
}

#[test]
fn every_positive_file_of_the_asset_generator_loads() {
    let Some(data) = data_folder() else { return };
    let mut files = 0;
    for set in std::fs::read_dir(data.join("meshes/AssetGenerator")).unwrap() {
        for file in std::fs::read_dir(set.unwrap().path()).unwrap() {
            let path = file.unwrap().path();
            if path.extension().is_some_and(|extension| extension == "gltf") {
                load_and_check(&path);
                files += 1;
            }
        }
    }
    assert!(files > 60, "{files} files");
}

#[test]
fn negative_scales_of_the_asset_generator_keep_normals_on_the_front() {
    let Some(data) = data_folder() else { return };
    for i in 0..=12 {
        let path = data.join(format!("meshes/AssetGenerator/Node_NegativeScale/Node_NegativeScale_{i:02}.gltf"));
        let (meshes, _) = load_and_check(&path);
        for (triangle, corners) in meshes.triangles.iter().enumerate() {
            let [a, b, c] = meshes.corners(triangle);
            let stored: Vec3 = corners.iter().map(|&v| meshes.attributes[v as usize].normal).sum();
            let facing = (b - a).cross(c - a).dot(stored);
            assert!(facing > 0.0 || stored == Vec3::ZERO, "{}: triangle {triangle}", path.display());
        }
    }
}

#[test]
fn triangle_modes_of_the_asset_generator_cover_the_same_square() {
    let Some(data) = data_folder() else { return };
    for i in 0..=15 {
        let path = data.join(format!("meshes/AssetGenerator/Mesh_PrimitiveMode/Mesh_PrimitiveMode_{i:02}.gltf"));
        let (meshes, report) = load_and_check(&path);
        let mode = json_of(&path)["meshes"][0]["primitives"][0]["mode"].as_u64().unwrap_or(4);
        if mode < 4 {
            assert_eq!((report.skipped_primitives, report.triangles), (1, 0), "{}", path.display());
            continue;
        }
        let area: f32 = (0..meshes.triangles.len())
            .map(|t| {
                let [a, b, c] = meshes.corners(t);
                (b - a).cross(c - a).z / 2.0
            })
            .sum();
        assert!((area - 1.0).abs() < 1e-5, "{}: signed area {area}", path.display());
    }
}

#[test]
fn the_texture_transform_test_loads_its_external_images() {
    let Some(data) = data_folder() else { return };
    let (meshes, report) = load_and_check(&data.join("meshes/TextureTransform/TextureTransformTest.gltf"));
    assert_eq!((report.nodes, report.textures), (12, 5));
    assert!(report.extensions_ignored.is_empty());
    let rotation = meshes.materials.iter().find(|m| m.name == "Rotation").unwrap();
    let moved = rotation.base_colour_texture.unwrap().uv_from_uv.transform_point2(glam::Vec2::new(0.421, 1.016));
    assert!(moved.abs_diff_eq(glam::Vec2::splat(0.778), 0.001), "the arrow's tip is not at the marker: {moved}");
}
