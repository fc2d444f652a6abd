//! Streamed SOG: levels, ranges, environment, and which files are opened.

use std::path::Path;

use serde_json::{Value, json};
use splatprobe::Error;
use splatprobe::ingest::{SceneReport, load_scene};
use splatprobe::job::{Frame, SplatInput};
use splatprobe::scene::Scene;

use super::builder::Builder;

/// Two levels in three files: level 0 in `a` and `b`, level 1 in `c`; and an environment of 2.
pub fn write(folder: &Path) -> Value {
    for (name, count) in [("a", 10), ("b", 6), ("c", 7), ("env", 2)] {
        std::fs::create_dir_all(folder.join(name)).expect("a folder");
        Builder::new(2, 1, count).write_loose(&folder.join(name));
    }
    let bound = json!({"min": [-1, -1, -1], "max": [1, 1, 1]});
    let leaf = |lods: Value| json!({"bound": bound, "lods": lods});
    let range = |file: u32, offset: u32, count: u32| json!({"file": file, "offset": offset, "count": count});
    json!({
        "version": 1, "count": 20, "counts": [14, 6], "lodLevels": 2, "environment": "env/meta.json",
        "filenames": ["a/meta.json", "b/meta.json", "c/meta.json"],
        "tree": {"bound": bound, "children": [
            leaf(json!({"0": range(0, 0, 4), "1": range(2, 0, 5)})),
            {"bound": bound, "children": [
                leaf(json!({"0": range(0, 4, 3), "1": range(2, 6, 1)})),
                leaf(json!({"0": range(1, 0, 6)})),
            ]},
            leaf(json!({"0": range(0, 9, 1)})),
        ]},
    })
}

/// Loads the streamed SOG in `folder` with another index.
pub fn load(folder: &Path, index: &Value, lod: Option<u32>) -> splatprobe::Result<(Scene, SceneReport)> {
    std::fs::write(folder.join("lod-meta.json"), index.to_string()).expect("written");
    load_scene(&[SplatInput { lod, frame: Some(Frame::RUB), ..SplatInput::new(folder) }], &[])
}

#[test]
fn a_level_is_its_ranges_of_each_file_in_order_and_the_environment() {
    let folder = tempfile::tempdir().expect("a folder");
    let index = write(folder.path());
    let means_of = |name: &str| {
        let (scene, _) = super::load_path(&folder.path().join(name)).expect("loads");
        scene.splats.means
    };
    let [a, b, c, env] = ["a", "b", "c", "env"].map(means_of);
    let (fine, report) = load(folder.path(), &index, None).expect("loads");
    assert_eq!(fine.splats.means, [&a[0..7], &a[9..10], &b[0..6], &env].concat());
    assert_eq!((report.splats[0].count, report.splats[0].format.as_str()), (16, "streamed SOG, level 0 of 0 to 1"));
    let (coarse, _) = load(folder.path(), &index, Some(1)).expect("loads");
    assert_eq!(coarse.splats.means, [&c[0..5], &c[6..7], &env].concat());
}

#[test]
fn files_without_gaussians_of_the_level_are_never_opened() {
    let folder = tempfile::tempdir().expect("a folder");
    let index = write(folder.path());
    std::fs::remove_dir_all(folder.path().join("a")).expect("removed");
    load(folder.path(), &index, Some(1)).expect("loads");
    let error = load(folder.path(), &index, Some(0)).expect_err("a is gone");
    assert!(error.to_string().contains("'a/meta.json'"), "{error}");
}

#[test]
fn files_that_the_crop_leaves_out_are_not_decoded_and_the_others_are_cropped() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut index = write(folder.path());
    index["environment"] = Value::Null;
    // b lies elsewhere, and its images are gone.
    let mut far = Builder::new(2, 1, 6);
    far.meta["means"]["mins"] = json!([4.0, -2.0, 0.5]);
    far.meta["means"]["maxs"] = json!([5.0, 0.25, 3.0]);
    far.write_loose(&folder.path().join("b"));
    std::fs::remove_file(folder.path().join("b/sh0.webp")).expect("removed");
    std::fs::write(folder.path().join("lod-meta.json"), index.to_string()).expect("written");
    // The file's axes: right, down, forward. b begins at x = exp(4) - 1 = 53.6.
    let load = |crop: &str, scale: f64| {
        let mut input = SplatInput { crop: Some(crop.parse().expect("a region")), ..SplatInput::new(folder.path()) };
        input.transform.scale = [scale; 3];
        load_scene(&[input], &[])
    };
    let (all, report) = load("box:-10,-10,-30,53.5,10,10", 1.0).expect("loads");
    assert_eq!((all.splats.len(), report.splats[0].count), (8, 8));
    load("sphere:0,0,0,107", 2.0).expect("loads");
    let (some, report) = load("box:-10,-10,-30,0.5,10,10", 1.0).expect("loads");
    assert!((1..8).contains(&some.splats.len()) && report.splats[0].dropped.cropped == 8 - some.splats.len() as u64);
    assert!(some.splats.means.iter().all(|mean| mean.x <= 0.5));
    for reached in ["box:-10,-10,-30,53.7,10,10", "sphere:0,0,0,80"] {
        assert!(load(reached, 1.0).expect_err("b is needed").to_string().contains("sh0.webp"));
    }
    let error = load("sphere:0,500,0,1", 1.0).expect_err("nothing there");
    assert!(matches!(&error, Error::Request { field, .. } if field == "splats[0].crop"), "{error}");
}

#[test]
fn a_level_that_is_not_there_is_a_wrong_request() {
    let folder = tempfile::tempdir().expect("a folder");
    let index = write(folder.path());
    let error = load(folder.path(), &index, Some(2)).expect_err("two levels");
    assert!(
        matches!(&error, Error::Request { field, why } if field == "splats[0].lod" && why.contains("0 to 1")),
        "{error}"
    );
    let plain = SplatInput { lod: Some(0), ..SplatInput::new(folder.path().join("a")) };
    let error = load_scene(&[plain], &[]).expect_err("no levels");
    assert!(matches!(&error, Error::Request { why, .. } if why.contains("no levels")), "{error}");
}

#[test]
fn broken_trees_are_errors_that_tell_what_does_not_fit() {
    let folder = tempfile::tempdir().expect("a folder");
    let good = write(folder.path());
    type Fault = fn(&mut Value);
    let faults: [(&str, Fault); 13] = [
        ("version 2", |index| index["version"] = 2.into()),
        ("no node has Gaussians", |index| index["tree"] = json!({})),
        ("no node has Gaussians", |index| {
            index["tree"]["children"] = json!([{"lods": {"7": {"file": 0, "offset": 0, "count": 1}}}])
        }),
        ("filenames has 3", |index| index["tree"]["children"][0]["lods"]["0"]["file"] = 3.into()),
        ("Gaussians 9 to 109 of", |index| index["tree"]["children"][2]["lods"]["0"]["count"] = 100.into()),
        ("two nodes share Gaussian 4 of file 0", |index| index["tree"]["children"][0]["lods"]["0"]["count"] = 5.into()),
        ("from 18446744073709551615", |index| index["tree"]["children"][0]["lods"]["0"]["offset"] = u64::MAX.into()),
        ("invalid value", |index| index["tree"]["children"][0]["lods"]["0"]["count"] = (-1).into()),
        ("leads out", |index| index["filenames"][0] = "../a/meta.json".into()),
        ("leads out", |index| index["environment"] = "/env/meta.json".into()),
        ("not a SOG", |index| index["filenames"][0] = "lod-meta.json".into()),
        ("named twice", |index| index["filenames"][1] = "./a/meta.json".into()),
        ("cannot be read", |index| index["environment"] = "sky/meta.json".into()),
    ];
    for (expected, fault) in faults {
        let mut index = good.clone();
        fault(&mut index);
        let error = load(folder.path(), &index, None).expect_err(expected);
        assert!(!matches!(error, Error::Request { .. }) && error.to_string().contains(expected), "{expected}: {error}");
    }
}

#[test]
fn a_tree_that_is_absurdly_deep_is_an_error() {
    let folder = tempfile::tempdir().expect("a folder");
    let index = write(folder.path());
    let depth = 100_000;
    let tree = format!("{}{{}}{}", "{\"children\":[".repeat(depth), "]}".repeat(depth));
    let text = index.to_string().replace(&index["tree"].to_string(), &tree);
    std::fs::write(folder.path().join("lod-meta.json"), text).expect("written");
    let error = load_scene(&[SplatInput::new(folder.path())], &[]).expect_err("too deep");
    assert!(error.to_string().contains("recursion limit"), "{error}");
}

#[test]
fn a_cut_off_index_is_an_error_at_every_length() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = write(folder.path()).to_string();
    for length in 0..text.len() {
        std::fs::write(folder.path().join("lod-meta.json"), &text[..length]).expect("written");
        assert!(load_scene(&[SplatInput::new(folder.path())], &[]).is_err(), "{length}");
    }
}
