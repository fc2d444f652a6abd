//! `splatprobe export` on the command line.

use super::{Baked, cli::splatprobe};

#[test]
fn the_command_prints_what_it_wrote_and_tells_what_it_changed() {
    let baked = Baked::with(|job| job.face_size = 48);
    let folder = baked.folder.path();
    let output = splatprobe(folder, "export bake/manifest.json --engine gltf --out made/here");
    assert!(output.status.success(), "{output:?}");
    let written: Vec<String> = String::from_utf8(output.stdout).unwrap().lines().map(String::from).collect();
    assert!(written.contains(&"made/here/probes.gltf".to_owned()), "{written:?}");
    assert!(written.iter().all(|file| folder.join(file).is_file()), "{written:?}");
    let notes = String::from_utf8(output.stderr).unwrap();
    assert!(notes.contains("probe_001: faces of 48 pixels reduced to 32"), "{notes}");
}

#[test]
fn wrong_requests_exit_with_2_and_help_lists_the_engines() {
    let baked = Baked::new();
    let folder = baked.folder.path();
    let output = splatprobe(folder, "export bake --engine quake --out made");
    assert_eq!(output.status.code(), Some(2));
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(message.contains("engine: 'quake' is not known; known are unity, "), "{message}");
    assert!(!folder.join("made").exists());
    let help = String::from_utf8(splatprobe(folder, "export --help").stdout).unwrap();
    for engine in splatprobe::export::ENGINES {
        assert!(help.contains(engine.name) && help.contains(engine.about), "{help}");
    }
}
