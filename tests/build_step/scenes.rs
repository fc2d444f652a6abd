//! Small scenes in folders of their own, and runs of the tool on them.

use std::path::Path;
use std::process::Output;

use serde_json::Value;

use crate::cli::{contents, splatprobe};
use crate::common::gltf::{File, png};

/// A folder with `room.ply`, 52 000 Gaussians, and `lamp.glb`.
pub fn demo() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/demo");
    for (name, file) in [("room.ply", "demo.ply"), ("lamp.glb", "lamp.glb")] {
        std::fs::copy(demo.join(file), folder.path().join(name)).unwrap();
    }
    folder
}

/// A folder with `few.ply`, a lattice of Gaussians around the origin, and `square.glb` with its picture `picture.png`.
pub fn few() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let mut rows = String::new();
    let mut count = 0;
    for i in 0..343 {
        let [x, y, z] = [i % 7, i / 7 % 7, i / 49].map(|k| f64::from(k) - 3.0);
        if (x * x + y * y + z * z) > 6.0 {
            let colour = [i % 5, i % 3, i % 4].map(|k| f64::from(k) / 2.0 - 1.0);
            rows += &format!(
                "{x} {y} {z} {} {} {} {} -1.2 -1.4 -1.6 1 0.{} 0 0.2\n",
                colour[0],
                colour[1],
                colour[2],
                i % 4,
                i % 10
            );
            count += 1;
        }
    }
    let properties: String = names.split(' ').map(|name| format!("property float {name}\n")).collect();
    let header = format!("ply\nformat ascii 1.0\nelement vertex {count}\n{properties}end_header\n");
    std::fs::write(folder.path().join("few.ply"), header + &rows).unwrap();
    let mut square = File::square();
    square.json["images"] = serde_json::json!([{"uri": "picture.png"}]);
    square.json["textures"] = serde_json::json!([{"source": 0}]);
    square.push(
        "materials",
        serde_json::json!({"doubleSided": true, "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}),
    );
    square.json["meshes"][0]["primitives"][0]["material"] = serde_json::json!(0);
    std::fs::write(folder.path().join("square.glb"), square.glb()).unwrap();
    write_picture(folder.path(), 200);
    folder
}

/// The square's picture, in a shade of grey.
pub fn write_picture(folder: &Path, shade: u8) {
    std::fs::write(folder.join("picture.png"), png(2, 2, &[[shade, shade, shade, 255]; 4])).unwrap();
}

/// Runs a line that must succeed, in which `%` in a word stands for a space.
pub fn run(folder: &Path, line: &str) -> Output {
    let output = splatprobe(folder, line);
    assert_eq!(output.status.code(), Some(0), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    output
}

/// Runs a line that must fail with `code`, and returns what it says.
pub fn fail(folder: &Path, line: &str, code: i32) -> String {
    let output = splatprobe(folder, line);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{line}: {message}");
    message
}

/// Runs a bake that must succeed, and returns its `--stats`.
pub fn stats(folder: &Path, line: &str) -> Value {
    run(folder, &format!("{line} --stats stats.json"));
    json(&folder.join("stats.json"))
}

/// The content of a JSON file.
pub fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// Whether two folders hold the same files; hidden ones count.
pub fn assert_same(folder: &Path, one: &str, other: &str) {
    let [one_files, other_files] = [one, other].map(|name| contents(&folder.join(name)));
    let names = |files: &[(String, Vec<u8>)]| files.iter().map(|(name, _)| name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&one_files), names(&other_files), "{one} and {other}");
    for ((name, one_bytes), (_, other_bytes)) in one_files.iter().zip(&other_files) {
        assert!(one_bytes == other_bytes, "{name} of {one} and {other} differ");
    }
}
