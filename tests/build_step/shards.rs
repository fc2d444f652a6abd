//! Parts of a bake, joined, are the bake.

use std::path::Path;

use splatprobe::trace::Level;

use crate::cli::splatprobe;
use crate::scenes::{assert_same, fail, few, json, run, stats};

const BAKE: &str =
    "bake --splats few.ply --mesh square.glb --grid 3,3,2 --bounds -1,-1,-1,1,1,1 --face-size 8 --outputs strip,mips";

/// Bakes all parts to `part_1` and so on; gives their names.
fn bake_parts(folder: &Path, count: u32) -> Vec<String> {
    let parts: Vec<String> = (1..=count).map(|index| format!("part_{count}_{index}")).collect();
    for (index, part) in (1..).zip(&parts) {
        run(folder, &format!("{BAKE} --shard {index}/{count} -o {part}"));
        run(folder, &format!("verify {part}"));
    }
    parts
}

#[test]
fn any_number_of_parts_makes_the_bytes_of_the_whole() {
    let folder = few();
    run(folder.path(), &format!("{BAKE} -o whole"));
    for count in [1, 2, 7, 16] {
        let mut parts = bake_parts(folder.path(), count);
        parts.reverse();
        run(folder.path(), &format!("merge {} -o merged", parts.join(" ")));
        assert_same(folder.path(), "whole", "merged");
        std::fs::remove_dir_all(folder.path().join("merged")).unwrap();
    }
    // A part without probes is one, too.
    let parts: Vec<String> = (1..=20).map(|index| format!("part_{index}")).collect();
    for (index, part) in (1..).zip(&parts) {
        run(folder.path(), &format!("{BAKE} --shard {index}/20 -o {part} --cache kept"));
    }
    run(folder.path(), &format!("merge {} -o merged", parts.join(" ")));
    assert_same(folder.path(), "whole", "merged");
}

#[test]
fn what_is_missing_twice_damaged_or_of_another_bake_is_named() {
    let folder = few();
    let parts = bake_parts(folder.path(), 3);
    let merge = |parts: &[&str]| splatprobe(folder.path(), &format!("merge {} -o merged", parts.join(" ")));
    let refused = |parts: &[&str], named: &[&str]| {
        let output = merge(parts);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{parts:?}: {message}");
        assert!(named.iter().all(|name| message.contains(name)), "{parts:?}: {message}");
        assert!(!folder.path().join("merged").exists());
    };
    let [a, b, c] = [0, 1, 2].map(|i| parts[i].as_str());
    refused(&[a, c], &["missing: 2/3"]);
    refused(&[a, b, c, b], &["2/3 is given twice", b]);
    run(folder.path(), &format!("{BAKE} -o whole"));
    refused(&[a, b, "whole"], &["whole", "not a part of a bake"]);
    run(folder.path(), &format!("{BAKE} --shard 3/3 --exposure 1 -o exposed"));
    refused(&[a, b, "exposed"], &["exposed", "/settings"]);
    run(folder.path(), &format!("{BAKE} --shard 3/4 -o of_four"));
    refused(&[a, b, "of_four"], &["of_four", "/shard/part"]);

    let path = folder.path().join(c).join("manifest.json");
    let manifest = std::fs::read_to_string(&path).unwrap();
    let version = concat!("splatprobe ", env!("CARGO_PKG_VERSION"));
    std::fs::write(&path, manifest.replace(version, "splatprobe 0.0.1")).unwrap();
    refused(&[a, b, c], &[c, "/generator"]);
    let level = json(&path)["instructionLevel"].as_str().unwrap().to_owned();
    assert_eq!(level, Level::best().name());
    std::fs::write(&path, manifest.replace(&format!("\"{level}\""), "\"SSE\"")).unwrap();
    refused(&[a, b, c], &[c, "/instructionLevel", "SSE", &level, "machines of one instruction level"]);
    std::fs::write(&path, &manifest).unwrap();

    let file = folder.path().join(b).join("probe_001/radiance.exr");
    let whole = std::fs::read(&file).unwrap();
    std::fs::write(&file, &whole[..whole.len() - 1]).unwrap();
    refused(&[a, b, c], &["probe_001/radiance.exr"]);
    std::fs::write(&file, &whole).unwrap();
    assert_eq!(merge(&[a, b, c]).status.code(), Some(0));
}

#[test]
fn a_placement_is_made_once_and_baked_in_parts() {
    let folder = few();
    let scene = "--splats few.ply --bounds -1,-1,-1,1,1,1";
    run(folder.path(), &format!("place {scene} --grid 3,1,2 -o plan"));
    let bake = "bake --splats few.ply --placed plan/manifest.json --face-size 8";
    run(folder.path(), &format!("{bake} -o whole"));
    for index in 1..=2 {
        run(folder.path(), &format!("{bake} --shard {index}/2 -o part_{index}"));
    }
    run(folder.path(), "merge part_1 part_2/manifest.json -o merged");
    assert_same(folder.path(), "whole", "merged");
    // The same probes as if they had been placed by the bake itself.
    run(folder.path(), &format!("bake {scene} --grid 3,1,2 --face-size 8 -o direct"));
    let [whole, direct] =
        ["whole", "direct"].map(|name| json(&folder.path().join(name).join("manifest.json"))["probes"].clone());
    assert_eq!(whole, direct);
    let message = fail(folder.path(), "bake --splats few.ply --placed part_1/manifest.json -o wrong", 2);
    assert!(message.contains("not all probes of a placement"), "{message}");
}

#[test]
fn parts_share_the_work_evenly() {
    let folder = few();
    let rays = [1, 2, 3, 4].map(|index| {
        let line = format!("{BAKE} --shard {index}/4 -o part_{index}");
        stats(folder.path(), &line)["rays"].as_u64().unwrap()
    });
    assert_eq!(rays.iter().sum::<u64>(), 18 * 6 * 8 * 8);
    assert!(rays.iter().all(|rays| (4..=5).contains(&(rays / (6 * 8 * 8)))), "{rays:?}");
}
