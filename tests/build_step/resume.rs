//! A bake that ends early goes on where it was; a folder belongs to one bake at a time.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::cli::contents;
use crate::scenes::{assert_same, demo, fail, few, json, run, stats};

/// Long enough to be caught in the middle: seconds of rays, one at a time.
const SLOW: &str = "bake --splats room.ply --grid 6,1,1 --face-size 66 --tracer ray --threads 1 --progress none";

fn start(folder: &Path, line: &str) -> Child {
    Command::new(env!("CARGO_BIN_EXE_splatprobe"))
        .args(line.split_whitespace())
        .current_dir(folder)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// Waits until `holds`, for at most a minute.
fn wait_until(holds: impl Fn() -> bool) {
    let begun = Instant::now();
    while !holds() {
        assert!(begun.elapsed() < Duration::from_secs(60), "waited for a minute");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Bytes of what is done of a bake to `out`.
fn done(folder: &Path) -> usize {
    let journal = folder.join("out/.splatprobe/done");
    if !journal.is_dir() {
        return 0;
    }
    // Files come and go while it is looked at.
    let entries = std::fs::read_dir(journal).into_iter().flatten().flatten();
    let files = entries.flat_map(|entry| std::fs::read_dir(entry.path()).into_iter().flatten().flatten());
    files.filter_map(|file| file.metadata().ok()).map(|metadata| metadata.len() as usize).sum()
}

#[test]
fn a_killed_bake_goes_on_from_its_last_probe_and_ends_in_the_same_bytes() {
    let folder = demo();
    run(folder.path(), &format!("{SLOW} -o whole"));
    let mut bake = start(folder.path(), &format!("{SLOW} -o out"));
    // More than the plan and the digests: a probe.
    wait_until(|| done(folder.path()) > 60_000);
    bake.kill().unwrap();
    bake.wait().unwrap();
    assert!(!folder.path().join("out/manifest.json").exists());
    let rest = stats(folder.path(), &format!("{SLOW} -o out"));
    let kept = rest["keptProbes"].as_u64().unwrap();
    assert!((1..6).contains(&kept), "{kept}");
    assert_eq!(rest["rays"], (6 - kept) * 6 * 66 * 66);
    assert_same(folder.path(), "whole", "out");
}

#[test]
fn a_second_bake_to_the_folder_is_refused_and_the_first_ends_well() {
    let folder = demo();
    let mut first = start(folder.path(), &format!("{SLOW} -o out"));
    wait_until(|| folder.path().join("out/.splatprobe/staging").exists());
    let message = fail(folder.path(), "bake --splats room.ply --probe 5,1,2 --face-size 8 -o out", 1);
    assert!(message.contains("another bake writes to this folder"), "{message}");
    assert_eq!(first.wait().unwrap().code(), Some(0));
    run(folder.path(), "verify out");
    assert_eq!(json(&folder.path().join("out/manifest.json"))["probes"].as_array().unwrap().len(), 6);
}

#[test]
fn foreign_files_in_the_output_folder_stay() {
    let folder = few();
    let foreign =
        ["out/mine.txt", "out/probe_000/mine.txt", "out/.splatprobe/mine.txt", "out/.splatprobe/done/ab/mine"];
    for name in foreign {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, "mine").unwrap();
    }
    run(folder.path(), "bake --splats few.ply --probe 0,0,0 --face-size 8 -o out");
    run(folder.path(), "bake --splats few.ply --grid 2,1,1 --face-size 8 -o out");
    for name in foreign {
        assert_eq!(std::fs::read_to_string(folder.path().join(name)).unwrap(), "mine", "{name}");
    }
}

/// What a kill at that moment leaves, made by a file that cannot be moved to its place.
#[test]
fn a_bake_that_ends_while_it_replaces_another_leaves_no_manifest_that_is_not_true() {
    let folder = few();
    let bake = "bake --splats few.ply --face-size 8 -o out";
    run(folder.path(), &format!("{bake} --grid 2,1,1"));
    let in_the_way = folder.path().join("out/probe_001/radiance.exr");
    std::fs::remove_file(&in_the_way).unwrap();
    std::fs::create_dir_all(in_the_way.join("folder")).unwrap();
    let message = fail(folder.path(), &format!("{bake} --grid 2,1,1 --exposure 1"), 1);
    assert!(message.contains("radiance.exr"), "{message}");
    for line in ["verify out", "verify out/manifest.json", "preview out -o page.html"] {
        let message = fail(folder.path(), line, 2);
        assert!(message.contains("interrupted") && message.contains("bake again"), "{message}");
    }
    std::fs::remove_dir_all(&in_the_way).unwrap();
    // The next bake still knows the files of the first, which it does not have.
    run(folder.path(), &format!("{bake} --probe 0,0,0"));
    run(folder.path(), "verify out");
    run(folder.path(), "bake --splats few.ply --face-size 8 --probe 0,0,0 -o other");
    assert_same(folder.path(), "other", "out");
}

#[test]
fn a_bake_whose_time_is_over_is_labelled_and_goes_on() {
    let folder = demo();
    let bake = "bake --splats room.ply --grid 3,1,1 --face-size 32";
    run(folder.path(), &format!("{bake} -o whole"));
    let message = fail(folder.path(), &format!("{bake} -o out --time-budget 0.001"), 3);
    assert!(message.contains("2 probes are missing"), "{message}");
    let manifest = json(&folder.path().join("out/manifest.json"));
    assert_eq!(manifest["unfinished"], serde_json::json!(["probe_001", "probe_002"]));
    assert_eq!(manifest["probes"].as_array().unwrap().len(), 1);
    run(folder.path(), "verify out");
    fail(folder.path(), &format!("{bake} -o out --time-budget 0.001"), 3);
    let rest = stats(folder.path(), &format!("{bake} -o out --time-budget 1000"));
    assert_eq!(rest["keptProbes"], 2);
    assert_same(folder.path(), "whole", "out");
}

#[test]
fn a_bake_that_keeps_nothing_leaves_nothing_when_it_is_stopped() {
    let folder = demo();
    let mut bake = start(folder.path(), &format!("{SLOW} -o out --no-cache"));
    wait_until(|| folder.path().join("out/.splatprobe/staging").exists());
    std::thread::sleep(Duration::from_millis(200));
    bake.kill().unwrap();
    bake.wait().unwrap();
    assert_eq!(done(folder.path()), 0);
    run(folder.path(), "bake --splats room.ply --probe 5,1,2 --face-size 8 -o out");
    assert!(contents(&folder.path().join("out")).iter().all(|(name, _)| !name.starts_with('.')));
}
