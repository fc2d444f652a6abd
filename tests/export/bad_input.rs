//! Broken bakes and wrong requests are errors that say what is wrong, and nothing is written.

use std::path::Path;

use exr::prelude::{Image, SpecificChannels, WritableImage};
use serde_json::Value;
use splatprobe::export::{ENGINES, export};

use super::Baked;

/// The error of an export for every engine of the bake at `path`; each must be the same and write nothing.
fn error(path: &Path) -> String {
    let out = tempfile::tempdir().unwrap();
    let errors: Vec<String> = ENGINES
        .iter()
        .map(|engine| {
            let error = export(path, engine.name, out.path()).unwrap_err();
            assert_eq!(error.exit_code(), 2, "{error}");
            error.to_string()
        })
        .collect();
    assert_eq!(std::fs::read_dir(out.path()).unwrap().count(), 0);
    assert!(errors.windows(2).all(|pair| pair[0] == pair[1]), "{errors:?}");
    errors[0].clone()
}

/// A bake whose manifest is changed.
fn changed(change: impl FnOnce(&mut Value)) -> String {
    let baked = Baked::new();
    baked.change_manifest(change);
    error(&baked.path())
}

#[test]
fn an_unknown_engine_is_refused_with_those_that_are_known() {
    let baked = Baked::new();
    let out = tempfile::tempdir().unwrap();
    let error = export(&baked.path(), "quake", out.path()).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    let message = error.to_string();
    assert!(message.contains("'quake'") && ENGINES.iter().all(|engine| message.contains(engine.name)), "{message}");
}

#[test]
fn files_that_are_not_what_the_manifest_says_are_refused_by_name() {
    let baked = Baked::new();
    let file = baked.path().join("probe_001/radiance.exr");
    let whole = std::fs::read(&file).unwrap();
    std::fs::remove_file(&file).unwrap();
    let message = error(&baked.path());
    assert!(message.contains("probe_001") && message.contains("cannot be read"), "{message}");
    std::fs::write(&file, &whole[..whole.len() / 2]).unwrap();
    let message = error(&baked.path());
    assert!(message.contains("probe_001") && message.contains("the manifest says"), "{message}");
    let mut other = whole.clone();
    *other.last_mut().unwrap() ^= 1;
    std::fs::write(&file, other).unwrap();
    let message = error(&baked.path());
    assert!(message.contains("probe_001") && message.contains("BLAKE3"), "{message}");
}

#[test]
fn manifests_of_other_versions_and_sizes_are_refused() {
    let message = changed(|manifest| manifest["formatVersion"] = 2.into());
    assert!(message.contains("manifest format 2"), "{message}");
    let message = changed(|manifest| manifest["probes"][0]["files"][0]["width"] = 64.into());
    assert!(message.contains("64 x 192"), "{message}");
    let message = changed(|manifest| manifest["probes"][1]["files"][0]["height"] = 384.into());
    assert!(message.contains("32 x 384"), "{message}");
    let message = changed(|manifest| manifest["probes"] = Value::Array(Vec::new()));
    assert!(message.contains("only a placement"), "{message}");
    assert!(error(Path::new("absent")).contains("absent"));
}

#[test]
fn probes_that_cannot_be_named_or_stand_nowhere_are_refused() {
    for id in ["../../up", "a b", "\"; exit", "", "1st", "ä", &"x".repeat(65)] {
        let message = changed(|manifest| manifest["probes"][1]["id"] = id.into());
        assert!(message.contains("/probes/1/id"), "{id}: {message}");
    }
    let message = changed(|manifest| manifest["probes"][0]["influence"]["max"][1] = (-1.0).into());
    assert!(message.contains("/probes/0/influence"), "{message}");
    let message = changed(|manifest| manifest["probes"][0]["proxy"]["min"][1] = 9.into());
    assert!(message.contains("/probes/0/proxy"), "{message}");
    let message = changed(|manifest| manifest["probes"][0]["influence"]["blend"][3] = (-0.5).into());
    assert!(message.contains("/probes/0/influence/blend"), "{message}");
}

#[test]
fn texels_that_are_not_finite_are_refused_with_their_place() {
    let baked = Baked::new();
    let file = baked.path().join("probe_000/radiance.exr");
    let pixel = |at: exr::prelude::Vec2<usize>| {
        let red = if at == exr::prelude::Vec2(5, 70) { f32::NAN } else { 1.0 };
        [red, 1.0, 1.0, 1.0].map(exr::prelude::f16::from_f32)
    };
    let channels = SpecificChannels::rgba(move |at| {
        let [r, g, b, a] = pixel(at);
        (r, g, b, a)
    });
    Image::from_channels((32, 192), channels).write().to_file(&file).unwrap();
    let (bytes, blake3) = splatprobe::manifest::digest(&file).unwrap();
    baked.change_manifest(|manifest| {
        let record = &mut manifest["probes"][0]["files"][0];
        (record["bytes"], record["blake3"]) = (bytes.into(), blake3.into());
    });
    let message = error(&baked.path());
    assert!(message.contains("channel R, row 70") && message.contains("not finite"), "{message}");
}

#[test]
fn a_bake_without_cubemaps_is_refused_with_what_to_bake() {
    let baked = Baked::with(|job| job.outputs = vec![splatprobe::job::OutputKind::Latlong]);
    let out = tempfile::tempdir().unwrap();
    let error = export(&baked.path(), "unity", out.path()).unwrap_err().to_string();
    assert!(error.contains("probe_000") && error.contains("strip or faces"), "{error}");
}

#[test]
fn six_face_files_do_as_well_as_a_strip() {
    let strip = Baked::new();
    let faces = Baked::with(|job| job.outputs = vec![splatprobe::job::OutputKind::Faces]);
    let read = |baked: &Baked| std::fs::read(baked.export("unity").join("probe_001.exr")).unwrap();
    assert!(read(&strip) == read(&faces));
}

#[test]
fn faces_that_are_no_power_of_two_are_reduced_with_a_note() {
    let baked = Baked::with(|job| job.face_size = 48);
    let (out, export) = baked.exported("unity");
    assert!(export.notes.iter().any(|note| note.contains("probe_000") && note.contains("48") && note.contains("32")));
    assert_eq!(super::exr(&out.join("probe_000.exr")).0, 6 * 32);
}
