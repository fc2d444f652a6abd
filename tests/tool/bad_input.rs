//! What a bake makes of broken, hostile and impossible requests: one message, the right exit code, earlier output intact.

use std::path::Path;
use std::process::{Command, Output};

use crate::cli::{contents, splatprobe};
use crate::common::gltf::File;
use serde_json::{Value, json};

const SPLAT: &str = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";

fn ply(properties: &str, count: u64, rows: &str) -> String {
    let properties: String = properties.split(' ').map(|name| format!("property float {name}\n")).collect();
    format!("ply\nformat ascii 1.0\nelement vertex {count}\n{properties}end_header\n{rows}")
}

/// A folder with a good scene in `one.ply` and its bake in `out`.
fn baked() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("one.ply"), ply(SPLAT, 1, "0 0 2 0 0 0 4 0 0 0 1 0 0 0\n")).unwrap();
    let output = splatprobe(folder.path(), "bake --splats one.ply --probe 0,0,0 --face-size 8 -o out");
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    folder
}

/// Checks that `output` is a failure with one message that holds all of `said`, and that the folder is as it was.
fn assert_refused(output: &Output, code: i32, said: &[&str], label: &str) {
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{label}: {message}");
    assert!(!message.contains("panicked"), "{label}: {message}");
    let errors: Vec<&str> = message.lines().filter(|line| line.starts_with("splatprobe: ")).collect();
    assert_eq!(errors.len(), 1, "{label}: {message}");
    for word in said {
        assert!(message.contains(word), "{label}: '{word}' is not in: {message}");
    }
    assert!(output.stdout.is_empty(), "{label}");
}

/// Runs a line that must be refused and must change nothing.
fn refused(folder: &Path, line: &str, code: i32, said: &[&str]) {
    let before = contents(folder);
    assert_refused(&splatprobe(folder, line), code, said, line);
    assert!(contents(folder) == before, "{line}: files have changed");
}

#[test]
fn what_memory_does_not_hold_is_refused() {
    let folder = baked();
    let bake = "bake --splats one.ply --probe 0,0,0 -o out";
    refused(folder.path(), &format!("{bake} --max-memory 100"), 2, &["--max-memory", "1 Gaussians", "100 B"]);
    // 6 x 512 x 512 texels of 120 bytes are 180 MiB.
    let big = format!("{bake} --face-size 512 --max-memory 64MiB");
    refused(folder.path(), &big, 2, &["--max-memory", "512 texels", "64.0 MiB", "smaller faces"]);
}

#[test]
fn broken_splat_files_are_refused_by_name_and_place() {
    let folder = baked();
    let row = "0 0 2 0 0 0 4 0 0 0 1 0 0 0\n";
    let cases = [
        ("truncated", ply(SPLAT, 3, &row.repeat(2)), "vertex"),
        ("truncated_header", ply(SPLAT, 1, row)[..60].to_owned(), "header"),
        ("oversized", ply(SPLAT, u64::from(u32::MAX) * 8, row), "vertex"),
        ("points", ply("x y z red green blue", 1, "0 0 0 1 1 1\n"), "scale_0"),
        ("zero", ply(SPLAT, 0, ""), "vert"),
        ("nothing_visible", ply(SPLAT, 1, "0 0 2 0 0 0 -20 0 0 0 1 0 0 0\n"), "none can be used"),
        ("not_a_number", ply(SPLAT, 1, "nan 0 2 0 0 0 4 0 0 0 1 0 0 0\n"), "none can be used"),
        ("no_splats_at_all", "hello".into(), "unknown format"),
    ];
    for (name, content, said) in cases {
        std::fs::write(folder.path().join(format!("{name}.ply")), content).unwrap();
        let line = format!("bake --splats {name}.ply --probe 0,0,0 --face-size 8 -o out");
        refused(folder.path(), &line, 2, &[name, said]);
    }
}

#[test]
fn broken_meshes_are_refused_by_name_and_place() {
    let folder = baked();
    let changed = |change: fn(&mut Value)| {
        let mut file = File::square();
        change(&mut file.json);
        file
    };
    let mut wrong_indices = File::square();
    let indices = wrong_indices.indices(&[0, 1, 9]);
    wrong_indices.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
    let cases = [
        ("indices", wrong_indices, "/meshes/0/primitives/0"),
        ("missing", changed(|j| j["buffers"][0] = json!({"byteLength": 200, "uri": "gone.bin"})), "gone.bin"),
        ("matrix", changed(|j| j["nodes"][0]["matrix"] = json!(vec![1e39; 16])), "/nodes/0"),
        ("cycle", changed(|j| j["nodes"] = json!([{"children": [1], "mesh": 0}, {"children": [0]}])), "reached twice"),
        ("escape", changed(|j| j["buffers"][0] = json!({"byteLength": 200, "uri": "../secret.bin"})), "../secret.bin"),
        (
            "encoded",
            changed(|j| j["buffers"][0] = json!({"byteLength": 200, "uri": "%2e%2e/secret.bin"})),
            "secret.bin",
        ),
        ("required", changed(|j| j["extensionsRequired"] = json!(["EXT_unheard_of"])), "EXT_unheard_of"),
    ];
    for (name, file, said) in cases {
        std::fs::write(folder.path().join(format!("{name}.glb")), file.glb()).unwrap();
        let line = format!("bake --splats one.ply --mesh {name}.glb --probe 0,0,0 --face-size 8 -o out");
        refused(folder.path(), &line, 2, &[name, said]);
    }
    // JSON knows no NaN, but a file may hold it all the same.
    let mut text = File::square().json;
    text["nodes"][0]["translation"] = json!(["NaN", 0, 0]);
    std::fs::write(folder.path().join("nan.gltf"), text.to_string().replace("\"NaN\"", "NaN")).unwrap();
    refused(folder.path(), "bake --mesh nan.gltf --probe 0,0,0 --face-size 8 -o out", 2, &["nan.gltf"]);
}

#[test]
fn an_empty_scene_is_refused_or_black() {
    let folder = baked();
    refused(folder.path(), "bake --probe 0,0,0 -o out", 2, &["--splats"]);
    let mut empty = File::new();
    empty.json["nodes"] = json!([{}]);
    std::fs::write(folder.path().join("empty.glb"), empty.glb()).unwrap();
    refused(folder.path(), "bake --mesh empty.glb --grid 2,1,1 --face-size 8 -o out", 2, &["--bounds"]);
    let output = splatprobe(folder.path(), "bake --mesh empty.glb --probe 0,0,0 --face-size 8 -o black");
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn a_probe_in_the_middle_of_nothing_is_covered_by_nothing() {
    let folder = baked();
    let output = splatprobe(folder.path(), "bake --splats one.ply --probe 1e6,1e6,-1e6 --face-size 8 -o far");
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let manifest = std::fs::read(folder.path().join("far/manifest.json")).unwrap();
    let manifest: Value = serde_json::from_slice(&manifest).unwrap();
    assert_eq!(manifest["probes"][0]["statistics"]["meanCoverage"], 0.0);
    assert_eq!(splatprobe(folder.path(), "verify far").status.code(), Some(0));
}

#[test]
fn impossible_sizes_are_refused_by_their_flag() {
    let folder = baked();
    for (flag, value) in [
        ("--face-size", "0"),
        ("--face-size", "1000000000"),
        ("--samples", "0"),
        ("--grid", "0,1,1"),
        ("--grid", "4000000000,4000000000,4000000000"),
        ("--bounds", "0,0,0,0,1,1"),
        ("--splat-transform", "s=0"),
    ] {
        let probes = if flag == "--grid" || flag == "--bounds" { "" } else { "--probe 0,0,0" };
        let grid = if flag == "--bounds" { "--grid 1,1,1" } else { "" };
        let line = format!("bake --splats one.ply {probes} {grid} -o out {flag} {value}");
        refused(folder.path(), &line, 2, &[flag]);
    }
}

#[test]
fn an_output_that_cannot_be_written_is_told_by_its_path() {
    let folder = baked();
    refused(folder.path(), "bake --splats one.ply --probe 0,0,0 --face-size 8 -o one.ply", 1, &["one.ply"]);
    refused(folder.path(), "bake --splats one.ply --probe 0,0,0 --face-size 8 -o one.ply/deep", 1, &["one.ply"]);
    // A folder where a probe's image has to go.
    std::fs::remove_file(folder.path().join("out/probe_000/radiance.exr")).unwrap();
    std::fs::create_dir_all(folder.path().join("out/probe_000/radiance.exr/taken")).unwrap();
    let output = splatprobe(folder.path(), "bake --splats one.ply --probe 0,0,0 --face-size 8 -o out");
    assert_refused(&output, 1, &["radiance.exr"], "folder in place of a file");
}

#[cfg(unix)]
#[test]
fn a_folder_without_write_permission_is_told_by_its_path() {
    use std::os::unix::fs::PermissionsExt;

    let folder = baked();
    let out = folder.path().join("out");
    let set = |mode| std::fs::set_permissions(&out, std::fs::Permissions::from_mode(mode)).unwrap();
    set(0o555);
    if std::fs::write(out.join("probe"), "").is_ok() {
        println!("skipped: this user may write anywhere");
        return;
    }
    refused(folder.path(), "bake --splats one.ply --probe 0,0,0 --face-size 8 -o out", 1, &["out"]);
    set(0o755);
}

#[cfg(unix)]
#[test]
fn a_disk_that_fills_up_leaves_earlier_output_and_no_rest() {
    let folder = baked();
    let before = contents(folder.path());
    // A limit on the size of files, its signal ignored, fails writes half-way as a full disk does.
    let line = "trap '' XFSZ; ulimit -f 8; exec \"$0\" bake --splats one.ply --probe 0,0,0 --face-size 128 -o out";
    let mut shell = Command::new("sh");
    shell.args(["-c", line, env!("CARGO_BIN_EXE_splatprobe")]).current_dir(folder.path());
    assert_refused(&shell.output().unwrap(), 1, &["cannot be written"], "full disk");
    assert!(contents(folder.path()) == before);
    let names = std::fs::read_dir(folder.path().join("out")).unwrap().count();
    assert_eq!(names, 3, "manifest, preview, probe and nothing else");
}
