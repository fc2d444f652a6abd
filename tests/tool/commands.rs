//! The command line tool as scripts use it: exit codes, streams, and a whole bake.

use std::path::Path;
use std::process::{Command, Output, Stdio};

use crate::cli::{contents, splatprobe};
use serde_json::{Value, json};

fn code(output: &Output) -> Option<i32> {
    output.status.code()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Runs a line that must succeed; the answer is its stdout.
fn data(folder: &Path, line: &str) -> String {
    let output = splatprobe(folder, line);
    assert_eq!(code(&output), Some(0), "{line}: {}", stderr(&output));
    String::from_utf8(output.stdout).unwrap()
}

/// A PLY of one large grey Gaussian, 2 m down the -Z axis of the canonical frame, in a folder of its own.
fn scene() -> tempfile::TempDir {
    let properties = [
        "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1",
        "rot_2", "rot_3",
    ];
    let header: String = properties.iter().map(|name| format!("property float {name}\n")).collect();
    let values = "0 0 2 0 0 0 4 0 0 0 1 0 0 0\n";
    let ply = format!("ply\nformat ascii 1.0\nelement vertex 1\n{header}end_header\n{values}");
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("one.ply"), ply).unwrap();
    folder
}

const BAKE: &str = "bake --splats one.ply --bounds -1,-1,-1,1,1,1 --grid 2,1,1 --face-size 8";

#[test]
fn a_bake_is_the_files_that_its_manifest_lists_and_verifies() {
    let folder = scene();
    let manifest = data(folder.path(), &format!("{BAKE} -o out --distance --stats stats.json"));
    assert_eq!(Path::new(manifest.trim_end()), Path::new("out/manifest.json"));
    let names: Vec<String> = contents(&folder.path().join("out")).into_iter().map(|(name, _)| name).collect();
    let probes = ["probe_000/preview.png", "probe_000/radiance.exr", "probe_001/preview.png", "probe_001/radiance.exr"];
    assert_eq!(names, [&["manifest.json", "preview.png"], &probes[..]].concat());
    assert_eq!(data(folder.path(), "verify out"), "");

    let manifest = std::fs::read_to_string(folder.path().join("out/manifest.json")).unwrap();
    let manifest: Value = serde_json::from_str(&manifest).unwrap();
    let schema: Value = serde_json::from_str(&data(folder.path(), "schema manifest")).unwrap();
    jsonschema::validator_for(&schema).unwrap().validate(&manifest).unwrap();
    assert_eq!(manifest["probes"][0]["position"], json!([-0.5, 0.0, 0.0]));
    assert_eq!(manifest["probes"][0]["files"][0]["channels"], json!(["A", "B", "G", "R", "Z"]));
    assert_eq!(manifest["inputs"][0]["path"], "one.ply");
    let coverage = manifest["probes"][0]["statistics"]["meanCoverage"].as_f64().unwrap();
    assert!(coverage > 0.05 && coverage < 0.95, "one Gaussian covers a part: {coverage}");

    let stats: Value =
        serde_json::from_str(&std::fs::read_to_string(folder.path().join("stats.json")).unwrap()).unwrap();
    assert_eq!(stats["rays"], 2 * 6 * 8 * 8);
    assert!(stats["seconds"]["bake"].as_f64().unwrap() > 0.0);
}

/// A PLY of a room of 2 x 2.4 x 2 m, its floor at y = 0, each side a lattice of flat Gaussians in a colour of its own.
fn write_room(path: &Path) {
    let properties = [
        "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1",
        "rot_2", "rot_3",
    ];
    let size = [2.0, 2.4, 2.0];
    let mut rows = String::new();
    for side in 0..6 {
        let axis = side / 2;
        for i in 0..144 {
            let mut mean = [0.0; 3];
            let mut scale = [0.12_f64.ln(); 3];
            mean[axis] = size[axis] * (side % 2) as f64;
            scale[axis] = 0.004_f64.ln();
            for (share, other) in [(i % 12, (axis + 1) % 3), (i / 12, (axis + 2) % 3)] {
                mean[other] = size[other] * (f64::from(share) + 0.5) / 12.0;
            }
            let colour = [side, (side + 2) % 6, (side + 4) % 6].map(|value| value as f64 / 3.0 - 0.8);
            let values = mean.into_iter().chain(colour).chain([6.0]).chain(scale).chain([1.0, 0.0, 0.0, 0.0]);
            rows += &values.map(|value| value.to_string()).collect::<Vec<_>>().join(" ");
            rows += "\n";
        }
    }
    let header: String = properties.iter().map(|name| format!("property float {name}\n")).collect();
    std::fs::write(path, format!("ply\nformat ascii 1.0\nelement vertex 864\n{header}end_header\n{rows}")).unwrap();
}

#[test]
fn place_writes_the_probes_of_an_adaptive_bake_and_a_plan_but_no_images() {
    let folder = tempfile::tempdir().unwrap();
    write_room(&folder.path().join("room.ply"));
    let flags = "--splats room.ply --splat-frame rub --max-probes 3 --held-out 4 --error 0";
    data(folder.path(), &format!("place {flags} -o plan"));
    let names: Vec<String> = contents(&folder.path().join("plan")).into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["manifest.json", "plan.png", "plan.svg"]);
    data(folder.path(), &format!("bake {flags} --adaptive --face-size 8 -o out"));
    assert_eq!(data(folder.path(), "verify out"), "");
    let [placed, baked] = ["plan", "out"].map(|out| -> Value {
        let text = std::fs::read_to_string(folder.path().join(out).join("manifest.json")).unwrap();
        serde_json::from_str(&text).unwrap()
    });
    let schema: Value = serde_json::from_str(&data(folder.path(), "schema manifest")).unwrap();
    jsonschema::validator_for(&schema).unwrap().validate(&placed).unwrap();
    assert_eq!(placed["placement"], baked["placement"]);
    assert_eq!(placed["probes"].as_array().unwrap().len(), 3);
    assert_eq!(placed["probes"][0]["files"], json!([]));
    data(folder.path(), "verify plan");
    for (placed, baked) in placed["probes"].as_array().unwrap().iter().zip(baked["probes"].as_array().unwrap()) {
        for field in ["id", "position", "influence", "proxy", "estimatedError"] {
            assert_eq!(placed[field], baked[field]);
        }
    }
    assert!(placed["placement"]["levels"][0]["triangles"].as_array().unwrap().len() > 3);
    assert_eq!(placed["placement"]["heldOut"]["positions"], 4);
    let proxy = &placed["probes"][0]["proxy"];
    assert!((proxy["max"][0].as_f64().unwrap() - 2.0).abs() < 0.1, "{proxy}");
}

#[test]
fn output_is_the_same_for_any_threads_folder_and_way_to_say_it() {
    let folder = scene();
    data(folder.path(), &format!("{BAKE} -o one --threads 1"));
    data(folder.path(), &format!("{BAKE} -o deeper/three --threads 3"));
    let job = json!({
        "splats": [{"path": "../one.ply"}], "output": "out", "faceSize": 99, "progress": "none",
        "placement": {"bounds": [-1, -1, -1, 1, 1, 1], "grid": [2, 1, 1]}
    });
    std::fs::create_dir(folder.path().join("jobs")).unwrap();
    std::fs::write(folder.path().join("jobs/job.json"), job.to_string()).unwrap();
    data(folder.path(), "bake jobs/job.json --face-size 8");
    let [one, three, by_job] = ["one", "deeper/three", "jobs/out"].map(|out| contents(&folder.path().join(out)));
    assert!(one == three);
    assert!(one == by_job);
    let compared: Value = serde_json::from_str(&data(folder.path(), "compare one jobs/out")).unwrap();
    assert_eq!(compared["overall"]["linear"]["rmse"], 0.0);
}

#[test]
fn the_tracers_agree_with_the_reference() {
    let folder = scene();
    data(folder.path(), &format!("{BAKE} -o reference --pixel float --tracer reference"));
    for tracer in ["ray", "beam"] {
        data(folder.path(), &format!("{BAKE} -o {tracer} --pixel float --t-cutoff 0 --tracer {tracer}"));
        let compared = data(folder.path(), &format!("compare reference {tracer}"));
        let compared: Value = serde_json::from_str(&compared).unwrap();
        let error = compared["overall"]["linear"]["maxAbs"].as_f64().unwrap();
        assert!(error < 1e-4, "{tracer}: {error}");
    }
}

#[test]
fn without_bounds_a_grid_stands_where_most_of_the_scene_is() {
    let folder = tempfile::tempdir().unwrap();
    // The demo's rooms are 10 x 2.7 x 4.2 m, with Gaussians far outside of them.
    std::fs::copy(
        Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/demo/demo.ply"),
        folder.path().join("demo.ply"),
    )
    .unwrap();
    data(folder.path(), "bake --splats demo.ply --grid 2,1,1 --face-size 2 -o out");
    let manifest = std::fs::read(folder.path().join("out/manifest.json")).unwrap();
    let manifest: Value = serde_json::from_slice(&manifest).unwrap();
    for (probe, expected) in [(0, [2.5, 1.35, 2.1]), (1, [7.5, 1.35, 2.1])] {
        for (axis, expected) in expected.into_iter().enumerate() {
            let at = manifest["probes"][probe]["position"][axis].as_f64().unwrap();
            assert!((at - expected).abs() < 0.5, "probe {probe}, axis {axis}: {at}");
        }
    }
}

#[test]
fn a_damaged_bake_fails_to_verify_with_its_file_named() {
    let folder = scene();
    data(folder.path(), &format!("{BAKE} -o out"));
    let file = folder.path().join("out/probe_001/radiance.exr");
    let mut content = std::fs::read(&file).unwrap();
    *content.last_mut().unwrap() ^= 1;
    std::fs::write(&file, content).unwrap();
    let output = splatprobe(folder.path(), "verify out/manifest.json");
    assert_eq!(code(&output), Some(2));
    assert!(stderr(&output).contains("probe_001"), "{}", stderr(&output));
    assert!(!stderr(&output).contains("probe_000"), "{}", stderr(&output));
}

#[test]
fn a_failed_bake_leaves_earlier_output_and_no_rest() {
    let folder = scene();
    data(folder.path(), &format!("{BAKE} -o out"));
    let before = contents(folder.path());
    let output = splatprobe(folder.path(), &format!("{BAKE} -o out --splats absent.ply"));
    assert_eq!(code(&output), Some(2));
    assert!(stderr(&output).contains("absent.ply"), "{}", stderr(&output));
    assert!(contents(folder.path()) == before);
}

#[test]
fn a_smaller_bake_removes_the_probes_of_an_earlier_one_and_nothing_else() {
    let folder = scene();
    data(folder.path(), &format!("{BAKE} -o out"));
    std::fs::write(folder.path().join("out/mine.txt"), "").unwrap();
    data(folder.path(), "bake --splats one.ply --probe 0,0,0 --face-size 8 -o out");
    let names: Vec<String> = contents(&folder.path().join("out")).into_iter().map(|(name, _)| name).collect();
    let probe = ["probe_000/preview.png", "probe_000/radiance.exr"];
    assert_eq!(names, [&["manifest.json", "mine.txt", "preview.png"], &probe[..]].concat());
    assert!(!folder.path().join("out/probe_001").exists());
}

#[test]
fn wrong_requests_exit_with_2_and_name_the_flag() {
    let folder = scene();
    for (line, named) in [
        ("bake --splats one.ply -o out", "--grid"),
        ("bake --splats one.ply --probe 0,0,0", "-o"),
        ("bake --probe 0,0,0 -o out", "--splats"),
        ("bake --splats one.ply --probe 0,0,0 -o out --face-size 0", "--face-size"),
        ("bake --splats one.ply --probe 0,0 -o out", "--probe"),
        ("bake --splats one.ply --tracer guess -o out", "--tracer"),
        ("bake --splats one.ply --splat-frame right -o out", "--splat-frame"),
        ("bake --unknown", "--unknown"),
        ("bake absent.json", "absent.json"),
        ("verify absent", "absent"),
        ("inspect absent.ply", "absent.ply"),
        ("compare absent.exr absent.exr", "absent.exr"),
        ("", "Usage"),
    ] {
        let output = splatprobe(folder.path(), line);
        assert_eq!(code(&output), Some(2), "{line}: {}", stderr(&output));
        assert!(stderr(&output).contains(named), "{line}: {}", stderr(&output));
        assert!(output.stdout.is_empty(), "{line}");
    }
    assert!(!folder.path().join("out").exists());
}

#[test]
fn an_output_that_cannot_be_written_exits_with_1() {
    let folder = scene();
    let output = splatprobe(folder.path(), &format!("{BAKE} -o one.ply/out"));
    assert_eq!(code(&output), Some(1), "{}", stderr(&output));
}

#[test]
fn json_progress_is_one_event_per_line_from_begin_to_finish() {
    let folder = scene();
    let output = splatprobe(folder.path(), &format!("{BAKE} -o out --progress json"));
    let events: Vec<Value> = stderr(&output).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(events.first().unwrap()["event"], "begin");
    let last = events.last().unwrap();
    assert_eq!((&last["event"], &last["probesDone"], &last["raysDone"]), (&json!("finish"), &json!(2), &last["rays"]));
}

#[test]
fn inspect_prints_a_json_list() {
    let folder = scene();
    let reports: Value = serde_json::from_str(&data(folder.path(), "inspect one.ply one.ply")).unwrap();
    assert_eq!(reports.as_array().unwrap().len(), 2);
    assert_eq!(reports[0]["count"], 1);
}

#[test]
fn readers_that_close_early_are_no_failure() {
    let folder = scene();
    for line in ["schema manifest".to_owned(), format!("{BAKE} -o out --progress plain")] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_splatprobe"))
            .args(line.split_whitespace())
            .current_dir(folder.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop((child.stdout.take(), child.stderr.take()));
        assert_eq!(child.wait().unwrap().code(), Some(0), "{line}");
    }
}
