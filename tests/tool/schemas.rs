//! The committed schemas are those of the types, and an example job is valid by them.
//!
//! `BLESS=1 cargo test --test tool schemas` writes them anew.

use std::path::PathBuf;

use schemars::Schema;
use serde_json::{Value, json};
use splatprobe::bake::ProgressEvent;
use splatprobe::bench::BenchReport;
use splatprobe::job::Job;
use splatprobe::manifest::Manifest;

fn check(name: &str, schema: Schema) {
    let path: PathBuf = [env!("CARGO_MANIFEST_DIR"), "schemas", name].iter().collect();
    let text = format!("{:#}\n", schema.as_value());
    if std::env::var_os("BLESS").is_some() {
        std::fs::write(&path, &text).unwrap();
    }
    let committed = std::fs::read_to_string(&path).unwrap();
    assert!(committed == text, "{} is out of date: run BLESS=1 cargo test --test tool schemas", path.display());
}

#[test]
fn committed_schemas_are_those_of_the_types() {
    check("job.schema.json", schemars::schema_for!(Job));
    check("manifest.schema.json", schemars::schema_for!(Manifest));
    check("progress.schema.json", schemars::schema_for!(ProgressEvent));
    check("bench.schema.json", schemars::schema_for!(BenchReport));
}

#[test]
fn a_job_with_every_field_is_valid_by_the_schema_and_a_wrong_one_is_not() {
    let validator = jsonschema::validator_for(schemars::schema_for!(Job).as_value()).unwrap();
    let job = json!({
        "splats": [{"path": "room.ply", "frame": "rdf", "transform": {"translation": [0, 1.5, 0]}, "encoding": "srgb-display",
                    "lod": 1}],
        "meshes": [{"path": "chair.glb", "transform": {"rotation": [0, 1, 0, 0], "scale": [2, 2, 2]}, "scene": "Main"}],
        "output": "out",
        "placement": {"bounds": [-4, 0, -4, 4, 3, 4], "grid": [3, 1, 3], "probes": [], "overlap": 0.1},
        "preset": "draft", "faceSize": 256, "samples": 1, "footprint": "train:812.5", "order": "rayHitDistance", "shDirection": "mean", "tCutoff": 0.001, "tNear": 0,
        "surface": "unlit", "tracer": "ray", "pixel": "half", "distance": true,
        "outputs": ["strip", "ktx2"], "mips": 7, "roughnessCurve": "filament", "hdrEncoding": "rgb9e5", "exposure": -1, "matchTonemapper": "agx", "highlightExpansion": 4,
        "shDegree": 3, "shWindow": true, "calibration": false, "background": [0, 0, 0],
        "threads": 2, "progress": "plain", "stats": "stats.json", "cache": "cache", "noCache": false, "shard": "2/7",
        "depfile": "out.d", "timeBudget": 60
    });
    validator.validate(&job).unwrap();
    serde_json::from_value::<Job>(job.clone()).unwrap().validate().unwrap();

    let wrong = [
        ("faceSize", json!(0)),
        ("faceSize", json!(8193)),
        ("footprint", json!("train")),
        ("tCutoff", json!(1)),
        ("background", json!([0, 0, -1])),
        ("tracer", json!("guess")),
        ("splats", json!([{"path": "a.ply", "frame": "right"}])),
        ("shard", json!("0/x")),
        ("unknown", json!(1)),
    ];
    for (field, value) in wrong {
        let mut job = job.clone();
        job[field] = value;
        assert!(!validator.is_valid(&job), "{field}: {}", job[field]);
    }
}

#[test]
fn every_setting_of_a_job_states_its_default() {
    let schema = schemars::schema_for!(Job);
    let described = |fields: &Value| {
        fields.as_object().unwrap().iter().for_each(|(name, field)| {
            let description = field["description"].as_str().unwrap_or_default();
            assert!(description.contains("Default:"), "{name}: {description}");
        });
    };
    described(&schema.as_value()["properties"]);
    described(&schema.as_value()["$defs"]["Placement"]["properties"]);
    described(&schema.as_value()["$defs"]["Transform"]["properties"]);
}
