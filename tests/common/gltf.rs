//! Small glTF files made in the test, and the folder of real ones.
#![allow(dead_code, reason = "each test binary uses a part of it")]

use std::path::{Path, PathBuf};

use glam::DVec3;
use serde_json::{Value, json};
use splatprobe::Result;
use splatprobe::ingest::gltf::{MeshReport, load};
use splatprobe::job::MeshInput;
use splatprobe::scene::{Light, Meshes};

/// The folder of real data, or `None` (and a printed reason) where it is absent.
pub fn data_folder() -> Option<PathBuf> {
    let folder = std::env::var_os("SPLATPROBE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: no data folder at {}; set SPLATPROBE_DATA", folder.display());
    None
}

/// An input without transform or scene.
pub fn input(path: impl Into<PathBuf>) -> MeshInput {
    MeshInput::new(path)
}

/// Loads a file relative to the world's origin.
pub fn load_file(path: impl Into<PathBuf>) -> Result<(Meshes, MeshReport)> {
    let mut meshes = Meshes::default();
    let report = load(&input(path), DVec3::ZERO, &mut meshes, &mut Vec::new())?;
    Ok((meshes, report))
}

/// Writes a GLB to a file and loads it.
pub fn load_glb(path: &Path, glb: &[u8]) -> Result<(Meshes, MeshReport)> {
    std::fs::write(path, glb).expect("a temporary file");
    load_file(path)
}

/// A glTF file in the making: JSON and its one buffer.
pub struct File {
    /// The JSON, without the buffer's length.
    pub json: Value,
    /// The buffer.
    pub bin: Vec<u8>,
}

impl File {
    /// An empty file with one scene of node 0.
    pub fn new() -> Self {
        let json = json!({"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [], "materials": [], "accessors": [], "bufferViews": [], "buffers": [{}]});
        Self { json, bin: Vec::new() }
    }

    /// Appends to the array `kind` of the JSON; gives the index.
    pub fn push(&mut self, kind: &str, value: Value) -> usize {
        let array = self.json[kind].as_array_mut().expect("an array");
        array.push(value);
        array.len() - 1
    }

    /// Appends bytes as a buffer view.
    pub fn view(&mut self, bytes: &[u8]) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let view = json!({"buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len()});
        self.bin.extend(bytes);
        self.push("bufferViews", view)
    }

    /// Appends floats as an accessor of type `kind` with `N` components.
    pub fn floats<const N: usize>(&mut self, kind: &str, values: &[[f32; N]]) -> usize {
        let bytes: Vec<u8> = values.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
        let view = self.view(&bytes);
        self.push("accessors", json!({"bufferView": view, "componentType": 5126, "count": values.len(), "type": kind}))
    }

    /// Appends 16-bit indices as an accessor.
    pub fn indices(&mut self, values: &[u16]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let view = self.view(&bytes);
        self.push(
            "accessors",
            json!({"bufferView": view, "componentType": 5123, "count": values.len(), "type": "SCALAR"}),
        )
    }

    /// The unit square in z = 0 that faces +Z, uv (0, 0) at its top left corner, as mesh 0: indexed, with normals.
    pub fn square() -> Self {
        let mut file = Self::new();
        let position = file.floats("VEC3", &[[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]]);
        let normal = file.floats("VEC3", &[[0., 0., 1.]; 4]);
        let uv = file.floats("VEC2", &[[0., 1.], [1., 1.], [1., 0.], [0., 0.]]);
        let indices = file.indices(&[0, 1, 2, 0, 2, 3]);
        let primitive = json!({"attributes": {"POSITION": position, "NORMAL": normal, "TEXCOORD_0": uv},
            "indices": indices});
        file.push("meshes", json!({"primitives": [primitive]}));
        file
    }

    /// The whole as a GLB.
    pub fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        if json["buffers"][0].as_object().is_some_and(|buffer| buffer.is_empty()) {
            json["buffers"][0] = json!({"byteLength": self.bin.len()});
        }
        let mut text = serde_json::to_vec(&json).expect("JSON");
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bin = self.bin.clone();
        bin.resize(bin.len().next_multiple_of(4), 0);
        let mut glb = Vec::new();
        let word = |value: usize| (value as u32).to_le_bytes();
        glb.extend([*b"glTF", word(2), word(28 + text.len() + bin.len())].concat());
        glb.extend([word(text.len()), *b"JSON"].concat());
        glb.extend(text);
        glb.extend([word(bin.len()), *b"BIN\0"].concat());
        glb.extend(bin);
        glb
    }

    /// Loads it as a GLB.
    pub fn load(&self) -> Result<(Meshes, MeshReport)> {
        self.load_with(|_| ())
    }

    /// Loads it as a GLB, the input changed by `change`.
    pub fn load_with(&self, change: impl FnOnce(&mut MeshInput)) -> Result<(Meshes, MeshReport)> {
        let mut lights = Vec::new();
        self.load_all(change, &mut lights)
    }

    /// Loads it as a GLB with its lights.
    pub fn load_all(
        &self,
        change: impl FnOnce(&mut MeshInput),
        lights: &mut Vec<Light>,
    ) -> Result<(Meshes, MeshReport)> {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut input = input(folder.path().join("test.glb"));
        std::fs::write(&input.path, self.glb()).expect("a temporary file");
        change(&mut input);
        let mut meshes = Meshes::default();
        let report = load(&input, DVec3::ZERO, &mut meshes, lights)?;
        Ok((meshes, report))
    }

    /// Loads it as a GLB and gives the error's message.
    pub fn error(&self) -> String {
        self.load().expect_err("this file is broken").to_string()
    }
}

/// A PNG of RGBA pixels.
pub fn png(width: u32, height: u32, rgba: &[[u8; 4]]) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::write_buffer_with_format(
        &mut bytes,
        rgba.as_flattened(),
        width,
        height,
        image::ColorType::Rgba8,
        image::ImageFormat::Png,
    )
    .expect("a PNG");
    bytes.into_inner()
}

/// The square with a 2 x 2 texture: top row red, green; bottom row blue, white; nearest, with this texture info.
pub fn textured_square(info: Value, sampler: Value) -> File {
    let mut file = File::square();
    let pixels = [[255, 0, 0, 255], [0, 255, 0, 128], [0, 0, 255, 64], [255, 255, 255, 0]];
    let view = file.view(&png(2, 2, &pixels));
    file.json["images"] = json!([{"bufferView": view, "mimeType": "image/png"}]);
    file.json["samplers"] = json!([sampler]);
    file.json["textures"] = json!([{"source": 0, "sampler": 0}]);
    file.push("materials", json!({"pbrMetallicRoughness": {"baseColorTexture": info}}));
    file.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    file
}
