//! Broken and hostile glTF files: one clear error each, never a panic.

use crate::common::gltf::{File, load_file, load_glb, png};
use serde_json::{Value, json};
use splatprobe::Error;
use splatprobe::job::MissingTexture;

/// The square after `change` of its JSON.
fn changed(change: impl FnOnce(&mut Value)) -> File {
    let mut file = File::square();
    change(&mut file.json);
    file
}

#[test]
fn broken_files_are_errors_that_say_where_and_what() {
    let primitive = |json: &mut Value, change: Value| {
        let primitive = json["meshes"][0]["primitives"][0].as_object_mut().unwrap();
        primitive.extend(change.as_object().unwrap().clone());
    };
    let cases: Vec<(File, &str)> = vec![
        (changed(|j| j["nodes"] = json!([{"children": [0]}])), "/nodes/0: it is reached twice"),
        (
            changed(|j| j["nodes"] = json!([{"children": [1]}, {"children": [2], "name": "b"}, {"children": [1]}])),
            "/nodes/1 ('b'): it is reached twice",
        ),
        (
            changed(|j| {
                j["nodes"] = json!([{"children": [1]}, {"children": [0]}]);
                j.as_object_mut().unwrap().remove("scenes");
            }),
            "the hierarchy has a cycle",
        ),
        (changed(|j| j["scenes"][0]["nodes"] = json!([0, 0])), "it is reached twice"),
        (changed(|j| j["scenes"][0]["nodes"] = json!([7])), "index 7 is out of range"),
        (changed(|j| j["scene"] = json!(3)), "/scene: index 3 is out of range"),
        (changed(|j| j["nodes"][0]["mesh"] = json!(5)), "/nodes/0: index 5 is out of range"),
        (changed(|j| j["nodes"][0]["rotation"] = json!([0, 0, 0, 0])), "/nodes/0: its transform is not finite"),
        (
            changed(|j| {
                j["nodes"] = json!([{"children": [1], "scale": [1e200, 1, 1]}, {"name": "far", "scale": [1e200, 1, 1]}])
            }),
            "/nodes/1 ('far'): its transform is not finite",
        ),
        (
            changed(|j| j["nodes"][0]["matrix"] = json!([1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])),
            "/nodes/0: its matrix is not affine",
        ),
        (changed(|j| primitive(j, json!({"material": 4}))), "/meshes/0/primitives/0: index 4 is out of range"),
        (changed(|j| primitive(j, json!({"indices": 40}))), "/meshes/0/primitives/0 indices: index 40 is out of range"),
        (changed(|j| primitive(j, json!({"indices": 0}))), "must be plain unsigned SCALAR"),
        (changed(|j| primitive(j, json!({"mode": 9}))), "/meshes/0/primitives/0: its mode is none"),
        (changed(|j| primitive(j, json!({"attributes": {}}))), "/meshes/0/primitives/0: it has no POSITION"),
        (
            changed(|j| j["accessors"][0]["count"] = json!(3)),
            "/meshes/0/primitives/0 NORMAL: it has 4 elements for 3 positions",
        ),
        (
            changed(|j| {
                j["accessors"][0]["count"] = json!(3);
                j["accessors"][1]["count"] = json!(3);
                j["accessors"][2]["count"] = json!(3);
            }),
            "index 3 is out of range: it has 3 vertices",
        ),
        (
            changed(|j| j["buffers"] = json!([{"byteLength": 8, "uri": "gone.bin"}])),
            "/buffers/0: uri 'gone.bin' cannot be read",
        ),
        (changed(|j| j["buffers"] = json!([{"byteLength": 1u64 << 40}])), "/buffers/0: byteLength is 1099511627776"),
        (changed(|j| j["buffers"] = json!([{"byteLength": 0}, {"byteLength": 8}])), "/buffers/1: it has neither"),
        (changed(|j| j["buffers"] = json!([{"uri": "data:;base64,*", "byteLength": 1}])), "data URI is broken"),
        (changed(|j| j["asset"] = json!({"version": "1.0"})), "not supported: glTF version 1.0"),
        (
            changed(|j| j["asset"] = json!({"version": "2.1", "minVersion": "2.1"})),
            "not supported: glTF minVersion 2.1",
        ),
        (changed(|j| j["asset"] = Value::Null), "not glTF"),
        (changed(|j| j["nodes"] = json!([{"skin": 0, "mesh": 0}])), "/nodes/0: index 0 is out of range"),
        (
            changed(|j| {
                j["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": {"attributes": {"SCALE": -1}}})
            }),
            "/nodes/0: instance attribute SCALE is not an index",
        ),
        (
            changed(|j| j["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": {}})),
            "/nodes/0: EXT_mesh_gpu_instancing has none of",
        ),
    ];
    for (file, message) in cases {
        let error = file.error();
        assert!(error.contains(message), "'{error}' does not say '{message}'");
    }
}

#[test]
fn required_extensions_that_change_the_picture_are_named_and_others_pass() {
    let requiring = |name: &str| changed(|j| j["extensionsRequired"] = json!([name])).load();
    for name in ["VENDOR_unknown", "KHR_mystery"] {
        let error = requiring(name).unwrap_err();
        assert!(matches!(error, Error::Unsupported { .. }) && error.to_string().contains(name), "{error}");
    }
    for name in ["KHR_materials_unlit", "KHR_texture_transform", "KHR_lights_punctual", "KHR_materials_specular"] {
        assert!(requiring(name).is_ok(), "{name}");
    }
}

#[test]
fn a_hierarchy_a_hundred_thousand_deep_costs_no_stack() {
    let file = changed(|j| {
        let nodes: Vec<Value> = (1..100_000).map(|child| json!({"children": [child]})).collect();
        j["nodes"] = json!(nodes);
        j["nodes"].as_array_mut().unwrap().push(json!({"mesh": 0}));
    });
    assert_eq!(file.load().unwrap().1.nodes, 100_000);
}

#[test]
fn instances_past_the_limit_are_refused_before_they_are_stored() {
    let mut file = File::square();
    let scale = file.floats("VEC3", &vec![[1.0; 3]; 1 << 14]);
    let extensions = json!({"EXT_mesh_gpu_instancing": {"attributes": {"SCALE": scale}}});
    let position = file.floats("VEC3", &vec![[0.0; 3]; 1 << 14]);
    file.json["meshes"][0]["primitives"] = json!([{"attributes": {"POSITION": position}}]);
    file.json["nodes"][0]["extensions"] = extensions;
    assert!(file.error().contains("more than 134217728 vertices or triangles"), "{}", file.error());
}

#[test]
fn uris_never_leave_the_assets_folder() {
    let outside = tempfile::tempdir().unwrap();
    let folder = outside.path().join("asset");
    std::fs::create_dir(&folder).unwrap();
    let file = File::square();
    let secret = outside.path().join("secret.bin");
    std::fs::write(&secret, &file.bin).unwrap();
    let absolute = secret.to_str().unwrap().to_string();
    let mut uris = vec![
        "../secret.bin".to_string(),
        "%2e%2e/secret.bin".to_string(),
        "a/../../secret.bin".to_string(),
        "..\\secret.bin".to_string(),
        format!("file://{absolute}"),
        absolute,
    ];
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(&secret, folder.join("link.bin")).unwrap();
        uris.push("link.bin".to_string());
    }
    for uri in uris {
        let mut json = file.json.clone();
        json["buffers"] = json!([{"byteLength": file.bin.len(), "uri": uri}]);
        let path = folder.join("a.gltf");
        std::fs::write(&path, json.to_string()).unwrap();
        let error = load_file(&path).unwrap_err().to_string();
        let refused = error.contains("leads out of the asset's folder") || error.contains("has a scheme");
        assert!(error.contains("/buffers/0") && refused, "{uri}: {error}");
    }
}

/// The square with an image of these bytes on it.
fn with_image(bytes: &[u8]) -> File {
    let mut file = File::square();
    let view = file.view(bytes);
    file.json["images"] = json!([{"name": "photo", "bufferView": view}]);
    file.json["textures"] = json!([{"source": 0}]);
    file.push("materials", json!({"name": "wall", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}));
    file.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    file
}

#[test]
fn broken_images_are_errors_that_name_image_and_material() {
    let good = png(8, 8, &[[1, 2, 3, 4]; 64]);
    assert!(with_image(&good).load().is_ok());
    // Width and height of the header as large as PNG allows; the CRC of the chunk is made to fit.
    let mut bomb = good.clone();
    bomb[16..24].copy_from_slice(&[0, 0, 0x40, 0, 0, 0, 0x40, 0]);
    let crc = crc32(&bomb[12..29]).to_be_bytes();
    bomb[29..33].copy_from_slice(&crc);
    let place = "/images/0 ('photo') of /materials/0 ('wall') baseColorTexture";
    let cases: [(&[u8], &str); 6] = [
        (&good[..20], "cannot be decoded"),
        (&bomb, "its header promises 268435456 pixels"),
        (b"nothing known", "it is neither PNG, JPEG, WebP, TGA nor KTX2"),
        (b"", "it is neither PNG, JPEG, WebP, TGA nor KTX2"),
        (b"RIFF\x10\0\0\0WEBPVP8L", "cannot be decoded"),
        (b"GIF89a", "is Gif; convert it to PNG, JPEG or WebP"),
    ];
    for (bytes, message) in cases {
        let error = with_image(bytes).error();
        assert!(error.contains(place) && error.contains(message), "'{error}' does not say '{message}'");
        let mut asked = with_image(bytes);
        asked.json["images"][0]["name"] = json!("gone");
        let (meshes, report) = asked.load_with(|input| input.missing_texture = MissingTexture::Magenta).unwrap();
        assert_eq!(meshes.textures[0].image.levels().unwrap()[0].texels, [[255, 0, 255, 255]]);
        assert!(report.replaced_images[0].contains(message) && report.replaced_images[0].contains("'gone'"));
    }
    // What is broken behind the header shows when a ray asks for it.
    let cut = with_image(&good[..good.len() / 2]);
    let (meshes, _) = cut.load().unwrap();
    meshes.check_textures().unwrap();
    assert!(meshes.textures[0].image.levels().is_err());
    let error = meshes.check_textures().unwrap_err().to_string();
    assert!(error.contains(place) && error.contains("cannot be decoded"), "{error}");
    let (meshes, _) = cut.load_with(|input| input.missing_texture = MissingTexture::Magenta).unwrap();
    assert_eq!(meshes.textures[0].image.levels().unwrap()[0].texels, [[255, 0, 255, 255]; 64]);
    let mut missing = with_image(&good);
    missing.json["images"] = json!([{"uri": "gone.png"}]);
    let error = missing.error();
    assert!(error.contains("/images/0 of /materials/0 ('wall')") && error.contains("'gone.png'"), "{error}");
}

#[test]
fn broken_basis_images_are_errors_and_never_panics() {
    for good in [&include_bytes!("../common/uastc.ktx2")[..], include_bytes!("../common/etc1s.ktx2")] {
        let decoded = |bytes: &[u8]| {
            let (meshes, _) = with_image(bytes).load()?;
            meshes.textures[0].image.levels().map(|_| ()).map_err(|broken| broken.to_error())
        };
        decoded(good).unwrap();
        assert!(decoded(&good[..good.len() - 20]).is_err());
        // One bit of every byte, each time another.
        let mut refused = 0;
        for at in 0..good.len() {
            let mut broken = good.to_vec();
            broken[at] ^= 1 << (at % 8);
            refused += usize::from(decoded(&broken).is_err());
        }
        assert!(refused > 0);
    }
}

#[test]
fn images_of_materials_that_no_triangle_uses_are_not_decoded() {
    let mut file = with_image(b"broken");
    file.json["meshes"][0]["primitives"][0].as_object_mut().unwrap().remove("material");
    assert_eq!(file.load().unwrap().1.textures, 0);
}

#[test]
fn a_glb_truncated_at_any_length_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("test.glb");
    let glb = with_image(&png(2, 2, &[[9; 4]; 4])).glb();
    assert!(load_glb(&path, &glb).is_ok());
    for length in 0..glb.len() {
        let error = load_glb(&path, &glb[..length]).expect_err("a truncated file");
        assert!(matches!(error, Error::Invalid { .. }), "{length}: {error}");
    }
}

#[test]
fn random_byte_flips_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("test.glb");
    let mut file = with_image(&png(4, 4, &[[200; 4]; 16]));
    let scale = file.floats("VEC3", &[[1.0; 3]; 3]);
    file.json["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": {"attributes": {"SCALE": scale}}});
    let glb = file.glb();
    assert!(load_glb(&path, &glb).is_ok());
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let mut random = |below: usize| {
        // xorshift64*, so that a failure can be repeated.
        state ^= state >> 12;
        state ^= state << 25;
        state ^= state >> 27;
        (state.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 33) as usize % below
    };
    let mut refused = 0;
    for _ in 0..2000 {
        let mut broken = glb.clone();
        for _ in 0..1 + random(3) {
            let at = random(broken.len());
            broken[at] ^= 1 << random(8);
        }
        refused += usize::from(load_glb(&path, &broken).is_err());
    }
    assert!((1..2000).contains(&refused), "{refused} of 2000 refused: the flips test nothing");
}

/// CRC-32 as PNG uses it.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 })
    })
}
