//! What is the same is not baked again; of what has changed, only the tiles that see it.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use splatprobe::bake::Progress;
use splatprobe::job::{Job, MeshInput, Placement, SplatInput};
use splatprobe::{Error, pipeline};

use crate::cli::contents;
use crate::common::gltf::File;
use crate::scenes::{assert_same, demo, few, json, run, stats, write_picture};

const GRID: &str = "bake --splats room.ply --mesh lamp.glb --mesh-transform t=3.2,0,0.6 --grid 3,3,3 --face-size 24";

#[test]
fn an_unchanged_bake_loads_nothing_traces_nothing_and_is_the_same() {
    let folder = demo();
    let first = stats(folder.path(), &format!("{GRID} --cache kept -o first"));
    assert_eq!((&first["probes"], &first["keptProbes"]), (&27.into(), &0.into()));
    assert_eq!(first["rays"], 27 * 6 * 24 * 24);
    let begun = Instant::now();
    // What does not touch pixels: where it goes, how many threads, how it is told.
    let second = stats(folder.path(), &format!("{GRID} --cache kept -o second --threads 1 --progress json"));
    println!("an unchanged bake of 27 probes: {:.3} s", begun.elapsed().as_secs_f64());
    assert_eq!((&second["rays"], &second["keptProbes"]), (&0.into(), &27.into()));
    assert_eq!((&second["seconds"]["load"], &second["seconds"]["build"]), (&0.0.into(), &0.0.into()));
    assert_same(folder.path(), "first", "second");
    run(folder.path(), "verify second");
}

#[test]
fn other_encodings_are_made_without_rays_and_further_probes_are_baked_alone() {
    let folder = few();
    let bake = "bake --splats few.ply --probe 0,0,0 --face-size 16 --cache kept";
    stats(folder.path(), &format!("{bake} -o out"));
    let encoded = stats(folder.path(), &format!("{bake} -o out --pixel float --outputs strip,mips --exposure 1"));
    assert_eq!((&encoded["rays"], &encoded["keptProbes"]), (&0.into(), &0.into()));
    run(folder.path(), &format!("{bake} -o clean --no-cache --pixel float --outputs strip,mips --exposure 1"));
    assert_same(folder.path(), "out", "clean");
    let further = stats(folder.path(), &format!("{bake} --probe 1,0.5,0 -o out --bounds -2,-2,-2,2,2,2"));
    assert_eq!(further["rays"], 6 * 16 * 16, "of two probes one was traced before");
}

#[test]
fn a_ceiling_on_memory_changes_when_probes_are_baked_but_not_what_is_written() {
    let folder = few();
    let bake = "bake --splats few.ply --grid 3,1,1 --bounds -1,-1,-1,1,1,1 --face-size 32";
    run(folder.path(), &format!("{bake} -o free"));
    // 6 x 32 x 32 texels of 120 bytes are 720 KiB: one probe fits beside the scene, and two do not.
    run(folder.path(), &format!("{bake} -o narrow --max-memory 1100KiB"));
    assert_same(folder.path(), "free", "narrow");
}

#[test]
fn without_a_cache_nothing_but_the_result_is_left() {
    let folder = few();
    run(folder.path(), "bake --splats few.ply --probe 0,0,0 --face-size 8 -o out");
    let names: Vec<String> = contents(&folder.path().join("out")).into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["manifest.json", "preview.png", "probe_000/preview.png", "probe_000/radiance.exr"]);
    assert!(!folder.path().join("out/.splatprobe").exists());
}

/// Bakes with a lamp that moves, moves far, and goes, each time from what is kept, and compares with clean bakes.
fn assert_dirty_tiles_are_enough(flags: &str) {
    let folder = demo();
    let bake = format!("--splats room.ply --pixel float --distance --probe 2.5,1.4,2.1 {flags}");
    for (step, place) in
        [Some([3.2, 0.0, 0.6]), Some([3.0, 0.5, 0.6]), Some([8.0, 0.3, 3.5]), None].into_iter().enumerate()
    {
        // Beside the one that moves there is one that stays.
        let lamp = |place, scale| serde_json::json!({"path": "lamp.glb", "transform": {"translation": place, "scale": [scale, scale, scale]}});
        let lamps: Vec<_> =
            [lamp([9.0, 0.2, 0.5], 0.5)].into_iter().chain(place.map(|place| lamp(place, 1.0))).collect();
        std::fs::write(folder.path().join("lamps.json"), serde_json::json!({ "meshes": lamps }).to_string()).unwrap();
        let kept = stats(folder.path(), &format!("bake lamps.json {bake} --cache kept -o kept_{step}"));
        let clean = stats(folder.path(), &format!("bake lamps.json {bake} --no-cache -o clean_{step}"));
        assert_same(folder.path(), &format!("kept_{step}"), &format!("clean_{step}"));
        let (rays, all) = (kept["rays"].as_u64().unwrap(), clean["rays"].as_u64().unwrap());
        println!("{flags}, step {step}: {rays} of {all} rays");
        if step > 0 {
            assert!(rays > 0 && rays < all * 2 / 3, "step {step}: {rays} of {all} rays");
        }
    }
}

#[test]
fn of_a_moved_mesh_only_the_tiles_that_see_it_are_traced_and_the_bytes_are_those_of_a_clean_bake() {
    assert_dirty_tiles_are_enough("--tracer beam --face-size 160 --probe 7.5,1.4,2.1");
}

#[test]
fn footprints_envmaps_and_single_rays_keep_their_tiles_as_exactly() {
    assert_dirty_tiles_are_enough("--face-size 66 --footprint pixel --outputs strip,envmap");
    assert_dirty_tiles_are_enough("--tracer ray --face-size 24");
}

#[test]
fn a_changed_picture_beside_a_mesh_is_seen_and_unlit_tiles_elsewhere_are_kept() {
    let folder = few();
    let bake = "bake --splats few.ply --mesh square.glb --mesh-transform t=1,0,0 --probe 0,0,0 --face-size 128";
    let first = stats(folder.path(), &format!("{bake} --cache kept -o out"));
    write_picture(folder.path(), 90);
    let second = stats(folder.path(), &format!("{bake} --cache kept -o out"));
    run(folder.path(), &format!("{bake} --no-cache -o clean"));
    assert_same(folder.path(), "out", "clean");
    let [first, second] = [first, second].map(|stats| stats["rays"].as_u64().unwrap());
    assert!(second > 0 && second <= first / 2, "{second} of {first} rays");
    // Put back, it is known.
    write_picture(folder.path(), 200);
    assert_eq!(stats(folder.path(), &format!("{bake} --cache kept -o out"))["rays"], 0);
}

#[test]
fn light_that_is_the_same_after_all_takes_the_files_it_had() {
    let folder = few();
    // Facing away, it is not seen: wherever it moves, tiles are traced again for nothing.
    std::fs::write(folder.path().join("away.glb"), File::square().glb()).unwrap();
    let bake = "bake --splats few.ply --probe 0,0,0 --face-size 64 --outputs strip,mips --pixel float --mesh away.glb";
    let backs = |out: &str| {
        json(&folder.path().join(out).join("manifest.json"))["probes"][0]["statistics"]["hiddenBacks"].clone()
    };
    let bake_and_count = |place: &str| {
        let stats = stats(folder.path(), &format!("{bake} --mesh-transform t=-0.5,-0.5,{place} --cache kept -o out"));
        let kept: serde_json::Value = serde_json::from_slice(&run(folder.path(), "cache stats kept").stdout).unwrap();
        (stats["rays"].as_u64().unwrap(), kept["bytes"].as_u64().unwrap(), backs("out"))
    };
    let (_, first, far) = bake_and_count("2");
    let (rays, second, near) = bake_and_count("0.4");
    let size = |name: &str| std::fs::metadata(folder.path().join("out/probe_000").join(name)).unwrap().len();
    let files = size("radiance.exr") + size("specular.exr") + size("preview.png");
    let radiance = 6 * 64 * 64 * 16;
    println!("{rays} rays; the cache grew from {first} to {second} bytes; files {files}, radiance {radiance}");
    assert!(rays > 0 && second - first < radiance + files / 2);
    // What is told of it all the same is of now.
    assert_ne!(far, near);
    run(folder.path(), &format!("{bake} --mesh-transform t=-0.5,-0.5,0.4 --no-cache -o clean"));
    assert_same(folder.path(), "out", "clean");
    stats(folder.path(), &format!("{bake} --mesh-transform t=-0.5,-0.5,2 --cache kept -o again"));
    assert_eq!(backs("again"), far);
}

#[test]
fn light_that_bounces_reaches_every_tile() {
    let folder = few();
    let bake = "bake --splats few.ply --mesh square.glb --probe 0,0,0 --face-size 8 --surface path --max-paths 4";
    stats(folder.path(), &format!("{bake} --mesh-transform t=1,0,0 --cache kept -o out"));
    let moved = stats(folder.path(), &format!("{bake} --mesh-transform t=1,0.5,0 --cache kept -o out"));
    assert_eq!(moved["rays"], 6 * 8 * 8);
    let again = stats(folder.path(), &format!("{bake} --mesh-transform t=1,0.5,0 --cache kept -o again"));
    assert_eq!(again["rays"], 0);
    run(folder.path(), &format!("{bake} --mesh-transform t=1,0.5,0 --no-cache -o clean"));
    assert_same(folder.path(), "out", "clean");
    assert_same(folder.path(), "again", "clean");
}

#[test]
fn damaged_cut_off_and_foreign_entries_are_baked_anew() {
    let folder = few();
    let bake = "bake --splats few.ply --grid 2,1,1 --face-size 16 --cache kept";
    let first = stats(folder.path(), &format!("{bake} -o first"));
    type Ruin<'a> = &'a dyn Fn(&Path, Vec<u8>);
    let ruin = |change: Ruin| {
        for (name, content) in contents(&folder.path().join("kept")) {
            change(&folder.path().join("kept").join(name), content);
        }
    };
    let ruins: [Ruin; 3] = [
        &|path, mut content| {
            *content.last_mut().unwrap() ^= 1;
            std::fs::write(path, content).unwrap();
        },
        &|path, content| std::fs::write(path, &content[..content.len() / 2]).unwrap(),
        &|path, _| std::fs::write(path, "of another program").unwrap(),
    ];
    for change in ruins {
        ruin(change);
        let again = stats(folder.path(), &format!("{bake} -o again"));
        assert_eq!(again["rays"], first["rays"]);
        assert_same(folder.path(), "first", "again");
        assert_eq!(stats(folder.path(), &format!("{bake} -o again"))["rays"], 0, "mended");
    }
}

#[test]
fn a_cache_that_cannot_be_written_is_one_warning_and_the_bake_is_whole() {
    let folder = few();
    let bake = "bake --splats few.ply --grid 2,1,1 --face-size 8";
    let output = run(folder.path(), &format!("{bake} --cache few.ply/kept -o out"));
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(message.matches("warning: ").count(), 1, "{message}");
    run(folder.path(), &format!("{bake} -o clean"));
    assert_same(folder.path(), "out", "clean");
}

#[test]
fn a_cache_is_shared_by_checkouts_in_other_folders() {
    let [one, other] = [few(), few()];
    let cache = one.path().join("kept");
    let bake = format!(
        "bake --splats few.ply --mesh square.glb --grid 2,1,1 --face-size 16 -o out --cache {}",
        cache.display()
    );
    stats(one.path(), &bake);
    let second = stats(other.path(), &bake);
    assert_eq!((&second["rays"], &second["keptProbes"]), (&0.into(), &2.into()));
    let [one, other] = [one, other].map(|folder| contents(&folder.path().join("out")));
    assert!(one == other);
}

#[test]
fn stats_and_prune_count_and_remove_entries() {
    let folder = few();
    run(folder.path(), "bake --splats few.ply --grid 2,1,1 --face-size 8 -o out --cache kept");
    let print = |line: &str| -> serde_json::Value { serde_json::from_slice(&run(folder.path(), line).stdout).unwrap() };
    let all = print("cache stats kept");
    assert!(all["entries"].as_u64().unwrap() >= 6 && all["bytes"].as_u64().unwrap() > 1000, "{all}");
    assert_eq!(print("cache prune kept --max-age 1")["entries"], 0);
    assert_eq!(print("cache prune kept --max-size 0"), all);
    assert_eq!(print("cache stats kept")["entries"], 0);
    crate::scenes::fail(folder.path(), "cache stats absent", 2);
    crate::scenes::fail(folder.path(), "cache prune kept", 2);
}

/// Writes to an input when the first rays have been traced.
struct Meddler<'a>(&'a Path, AtomicBool);

impl Progress for Meddler<'_> {
    fn begin(&self, _: usize, _: u64) {}

    fn advance(&self, _: u64) {
        if !self.1.swap(true, Ordering::Relaxed) {
            let mut content = std::fs::read(self.0).unwrap();
            content.push(b'\n');
            std::fs::write(self.0, content).unwrap();
        }
    }

    fn probe_done(&self, _: usize) {}

    fn finish(&self) {}
}

#[test]
fn an_input_that_changes_during_the_bake_ends_it_and_leaves_what_was() {
    let folder = few();
    let path = |name: &str| folder.path().join(name);
    run(folder.path(), "bake --splats few.ply --probe 0,0,0 --face-size 8 -o out");
    let before = contents(&path("out"));
    for name in ["few.ply", "square.glb", "picture.png"] {
        let job = Job {
            splats: vec![SplatInput::new(path("few.ply"))],
            meshes: vec![MeshInput::new(path("square.glb"))],
            placement: Placement { probes: vec![[0.0; 3]], ..Placement::default() },
            output: Some(path("out")),
            face_size: 16,
            ..Job::default()
        };
        let result = pipeline::bake(&job, &Meddler(&path(name), AtomicBool::new(false)), &AtomicBool::new(false));
        assert!(matches!(&result, Err(Error::Changed { path }) if path.ends_with(name)), "{name}: {result:?}");
        assert_eq!(result.unwrap_err().exit_code(), 1);
        assert!(contents(&path("out")) == before, "{name}");
    }
}

#[test]
fn what_lights_surfaces_is_told_of_before_the_probes() {
    let folder = few();
    let line =
        "bake --splats few.ply --mesh square.glb --probe 0,0,0 --face-size 8 -o out --surface probe --progress json";
    let output = run(folder.path(), line);
    let events = String::from_utf8(output.stderr).unwrap();
    let events: Vec<serde_json::Value> = events.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!((&events[0]["event"], &events[1]["event"]), (&"stage".into(), &"begin".into()));
    assert!(events[0]["message"].as_str().unwrap().contains("cubemaps that light the meshes"));
}

#[test]
fn a_depfile_names_every_file_that_was_read() {
    let folder = few();
    run(folder.path(), "bake --splats few.ply --mesh square.glb --probe 0,0,0 --face-size 8 -o out --depfile out.d");
    let rule = std::fs::read_to_string(folder.path().join("out.d")).unwrap();
    assert!(rule.starts_with("out/manifest.json:"), "{rule}");
    let first = rule.split("\n\n").next().unwrap();
    for name in ["few.ply", "square.glb", "picture.png"] {
        assert_eq!(first.matches(name).count(), 1, "{name} in {rule}");
    }
    assert!(json(&folder.path().join("out/manifest.json"))["settings"].get("depfile").is_none());
}

#[test]
fn a_depfile_names_the_job_file_and_every_file_that_it_names() {
    let folder = few();
    run(folder.path(), "place --splats few.ply --probe 0,0,0 -o plan");
    image::Rgb32FImage::from_pixel(8, 4, image::Rgb([0.5; 3])).save(folder.path().join("sky.hdr")).unwrap();
    let job = serde_json::json!({
        "splats": [{"path": "few.ply"}],
        "meshes": [{"path": "square.glb"}],
        "placement": {"placed": "plan/manifest.json"},
        "background": "sky.hdr",
        "faceSize": 8,
        "depfile": "out.d",
        "output": "out",
    });
    std::fs::write(folder.path().join("job.json"), job.to_string()).unwrap();
    for _ in 0..2 {
        run(folder.path(), "bake job.json --cache kept");
        let rule = std::fs::read_to_string(folder.path().join("out.d")).unwrap();
        let named: Vec<&str> = rule.split("\n\n").next().unwrap().split_whitespace().collect();
        for name in ["job.json", "few.ply", "square.glb", "picture.png", "sky.hdr", "plan/manifest.json"] {
            assert_eq!(named.iter().filter(|path| path.ends_with(name)).count(), 1, "{name} in {rule}");
        }
    }
}
