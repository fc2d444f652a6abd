//! The steps in `pipelines` for build systems: a project of two scenes and a shared mesh is rebuilt as its inputs ask for.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, SystemTime};

use crate::scenes::{few, run};

const SPLATPROBE: &str = env!("CARGO_BIN_EXE_splatprobe");

fn pipelines() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines")
}

/// Whether a program is there; says so where it is not.
fn has(program: &str) -> bool {
    let is_there = Command::new(program).arg("--version").output().is_ok();
    if !is_there {
        println!("skipped: {program} is not installed");
    }
    is_there
}

/// Two jobs, `room` and `hall`, with splats of their own and `square.glb` in both.
fn project() -> tempfile::TempDir {
    let folder = few();
    std::fs::rename(folder.path().join("few.ply"), folder.path().join("room.ply")).unwrap();
    std::fs::copy(folder.path().join("room.ply"), folder.path().join("hall.ply")).unwrap();
    for name in ["room", "hall"] {
        let job = serde_json::json!({"splats": [{"path": format!("{name}.ply")}], "meshes": [{"path": "square.glb"}],
            "placement": {"probes": [[0, 0, 0]]}, "faceSize": 8});
        std::fs::write(folder.path().join(name).with_extension("json"), job.to_string()).unwrap();
    }
    // Inputs of a build are older than what is made of them.
    for entry in std::fs::read_dir(folder.path()).unwrap() {
        age(&entry.unwrap().path());
    }
    folder
}

fn age(path: &Path) {
    let file = std::fs::File::options().write(true).open(path).unwrap();
    file.set_modified(SystemTime::now() - Duration::from_secs(3600)).unwrap();
}

/// Changes a file's content and its time.
fn touch(path: &Path) {
    let mut content = std::fs::read(path).unwrap();
    let last = content.len() - 1;
    match path.extension().and_then(|extension| extension.to_str()) {
        // Another number in the last row.
        Some("ply") => content[last - 1] ^= 1,
        Some("json") => content.push(b' '),
        // The green of the first pixels is stored as it is in none of these: another picture.
        _ => content = crate::common::gltf::png(1, 1, &[[last as u8, 90, 30, 255]]),
    }
    std::fs::write(path, content).unwrap();
}

/// Builds with `program`, and says which of the bakes have run.
fn built(folder: &Path, outputs: &Path, program: &str, arguments: &[&str]) -> Vec<&'static str> {
    let manifest = |name: &str| outputs.join(name).join("manifest.json");
    let time = |name: &str| std::fs::metadata(manifest(name)).and_then(|metadata| metadata.modified()).ok();
    let before = ["room", "hall"].map(time);
    // Coarse clocks: what is built now must be later than what was built before.
    std::thread::sleep(Duration::from_millis(20));
    let output = Command::new(program).args(arguments).current_dir(folder).output().unwrap();
    let message = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{program}: {message}");
    let after = ["room", "hall"].map(time);
    ["room", "hall"].into_iter().enumerate().filter(|(i, _)| before[*i] != after[*i]).map(|(_, name)| name).collect()
}

/// Changes one input after the other; `outputs` holds a folder for each bake.
fn assert_rebuilds_what_inputs_ask_for(folder: &Path, outputs: &Path, program: &str, arguments: &[&str]) {
    let built = || built(folder, outputs, program, arguments);
    let nothing: [&str; 0] = [];
    assert_eq!(built(), ["room", "hall"]);
    // Some build systems look at the depfile only now.
    assert_eq!(built(), nothing, "nothing has changed");
    for (file, expected) in [
        ("room.ply", &["room"][..]),
        ("hall.json", &["hall"]),
        // Named by the mesh, which both jobs name.
        ("picture.png", &["room", "hall"]),
    ] {
        touch(&folder.join(file));
        assert_eq!(built(), expected, "{file}");
        assert_eq!(built(), nothing, "after {file}");
    }
    for name in ["room", "hall"] {
        run(folder, &format!("verify {}", outputs.join(name).display()));
        run(folder, &format!("bake {name}.json --no-cache -o clean/{name}"));
        let [kept, clean] =
            [outputs.join(name), folder.join("clean").join(name)].map(|path| crate::cli::contents(&path));
        assert!(kept == clean, "{name}");
    }
}

#[test]
fn ninja_rebuilds_what_its_inputs_ask_for() {
    if !has("ninja") {
        return;
    }
    let folder = project();
    let rule = pipelines().join("ninja/splatprobe.ninja");
    let mut build = format!("include {}\nsplatprobe = {SPLATPROBE}\n", rule.display());
    for name in ["room", "hall"] {
        build += &format!("build out/{name}/manifest.json: splatprobe_bake {name}.json\n  dir = out/{name}\n");
    }
    std::fs::write(folder.path().join("build.ninja"), build).unwrap();
    assert_rebuilds_what_inputs_ask_for(folder.path(), &folder.path().join("out"), "ninja", &[]);
}

#[test]
fn make_rebuilds_what_its_inputs_ask_for() {
    if !has("make") {
        return;
    }
    let folder = project();
    let rules = pipelines().join("make/splatprobe.mk");
    let makefile = format!(
        "all: out/room/manifest.json out/hall/manifest.json\ninclude {}\nSPLATPROBE = {SPLATPROBE}\n",
        rules.display()
    );
    std::fs::write(folder.path().join("Makefile"), makefile).unwrap();
    assert_rebuilds_what_inputs_ask_for(folder.path(), &folder.path().join("out"), "make", &[]);
}

#[test]
fn cmake_rebuilds_what_its_inputs_ask_for() {
    if !has("cmake") {
        return;
    }
    for generator in ["Unix Makefiles", "Ninja"] {
        if !has(if generator == "Ninja" { "ninja" } else { "make" }) {
            continue;
        }
        let folder = project();
        let function = pipelines().join("cmake/splatprobe.cmake");
        let lists = format!(
            "cmake_minimum_required(VERSION 3.20)\nproject(probes NONE)\nset(SPLATPROBE {SPLATPROBE})\ninclude({})\n\
             splatprobe_add_bake(room JOB room.json OUTPUT out/room)\n\
             splatprobe_add_bake(hall JOB hall.json OUTPUT out/hall)\n",
            function.display()
        );
        std::fs::write(folder.path().join("CMakeLists.txt"), lists).unwrap();
        let configure =
            Command::new("cmake").args(["-S", ".", "-B", "build", "-G", generator]).current_dir(folder.path()).output();
        let configure = configure.unwrap();
        assert!(configure.status.success(), "{generator}: {}", String::from_utf8_lossy(&configure.stderr));
        let outputs = folder.path().join("build/out");
        assert_rebuilds_what_inputs_ask_for(folder.path(), &outputs, "cmake", &["--build", "build"]);
    }
}
