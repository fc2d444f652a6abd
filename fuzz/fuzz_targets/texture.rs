//! The picture of a glTF material: PNG, JPEG, WebP, TGA, KTX2.
#![no_main]

use splatprobe_fuzz::{file, load_meshes};

/// A triangle around the view, whose base colour is the picture.
const JSON: &str = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
"meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}],
"materials": [{"doubleSided": true, "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
"textures": [{"source": 0}], "images": [{"bufferView": 1}],
"accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [-9, -9, -1], "max": [9, 9, -1]},
{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC2"}],
"buffers": [{"uri": "picture.bin", "byteLength": LENGTH}],
"bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": PICTURE}]}"#;

const CORNERS: [[f32; 3]; 3] = [[-9.0, -9.0, -1.0], [9.0, -9.0, -1.0], [0.0, 9.0, -1.0]];

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let mut buffer: Vec<u8> = CORNERS.as_flattened().iter().flat_map(|value| value.to_le_bytes()).collect();
    buffer.extend(bytes);
    file("picture.bin", &buffer);
    let json = JSON.replace("LENGTH", &buffer.len().to_string()).replace("PICTURE", &bytes.len().to_string());
    load_meshes(&file("scene.gltf", json.as_bytes()));
});
