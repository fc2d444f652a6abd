//! Run time against error: what the report says is so, and its files are what they should be.

use std::path::Path;

use crate::cli::{contents, splatprobe};
use serde_json::Value;
use splatprobe::bench::front::front;
use splatprobe::bench::{Axis, BenchReport, Truth};

#[test]
fn of_points_on_a_hyperbola_all_are_on_the_front_and_of_those_above_it_none() {
    let hyperbola: Vec<[f64; 2]> = (1..=20).map(|i| [f64::from(i), 1.0 / f64::from(i)]).collect();
    let above = hyperbola.iter().map(|[time, error]| [time * 1.06, error * 1.06]);
    let marks = front(&hyperbola.iter().copied().chain(above).collect::<Vec<_>>());
    assert!(marks[..20].iter().all(|mark| *mark));
    assert!(marks[20..].iter().all(|mark| !mark));
    // As good in one and better in the other is better; equal is not, nor what is within the spread of runs.
    assert_eq!(front(&[[1.0, 1.0], [1.0, 0.5], [2.0, 0.5], [1.0, 0.5]]), [false, true, false, true]);
    assert_eq!(front(&[[1.0, 1.0], [0.98, 0.98]]), [true, true]);
    assert!(front(&[]).is_empty());
}

/// Whether every tag is closed by its own, and text holds no bare `<` or `&`.
fn is_well_formed(xml: &str) -> bool {
    let mut open = Vec::new();
    let mut rest = xml;
    while let Some((text, after)) = rest.split_once('<') {
        let entities = text.split('&').skip(1);
        if !entities.into_iter().all(|rest| ["amp;", "lt;", "gt;"].iter().any(|entity| rest.starts_with(entity))) {
            return false;
        }
        let Some((tag, after)) = after.split_once('>') else { return false };
        let name = tag.split_whitespace().next().unwrap_or_default();
        match name.strip_prefix('/') {
            Some(name) if open.pop() != Some(name) => return false,
            None if !tag.ends_with('/') => open.push(name),
            _ => {}
        }
        let quotes = tag.matches('"').count();
        if !quotes.is_multiple_of(2) || tag.matches('=').count() > quotes / 2 {
            return false;
        }
        rest = after;
    }
    open.is_empty() && rest.trim().is_empty()
}

#[test]
fn broken_xml_is_told_from_whole() {
    assert!(is_well_formed("<svg a=\"1\"><g/><text x=\"0\">a &lt; b</text></svg>\n"));
    for broken in ["<svg>", "<a><b></a></b>", "<a>x & y</a>", "<a b=c/>", "<a b=\"c/>"] {
        assert!(!is_well_formed(broken), "{broken}");
    }
}

/// A bench of a scene with Gaussians and triangles, and one of Gaussians alone.
#[test]
fn a_bench_writes_what_it_measured_and_the_defaults_keep_their_bounds() {
    let folder = tempfile::tempdir().unwrap();
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/demo/lamp.glb");
    std::fs::copy(demo, folder.path().join("lamp.glb")).unwrap();
    let line = "bench interior:5000 lamp.glb --sh 1 --quick --repeats 1 -o out";
    let output = splatprobe(folder.path(), line);
    let told = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{told}");
    let names: Vec<String> = contents(&folder.path().join("out")).into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["bench.json", "bench.md", "bench.svg"]);
    let read = |name: &str| std::fs::read_to_string(folder.path().join("out").join(name)).unwrap();
    assert_eq!(read("bench.md"), String::from_utf8(output.stdout).unwrap());
    assert!(is_well_formed(&read("bench.svg")));

    let json: Value = serde_json::from_str(&read("bench.json")).unwrap();
    let schema = std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("schemas/bench.schema.json")).unwrap();
    jsonschema::validator_for(&serde_json::from_slice(&schema).unwrap()).unwrap().validate(&json).unwrap();
    let report: BenchReport = serde_json::from_value(json).unwrap();
    assert_eq!(report.command, format!("splatprobe {line}"));
    let [interior, lamp] = &report.scenes[..] else { panic!("two scenes were asked for") };
    assert_eq!((interior.gaussians, interior.sh_degree, interior.triangles), (5000, 1, 0));
    assert!(lamp.gaussians == 0 && lamp.triangles > 0);

    for truth in [Truth::Ray, Truth::Area, Truth::Image, Truth::Lobe] {
        assert!(interior.rows_by(truth).count() > 2, "{truth:?}");
        assert!(interior.rows_by(truth).any(|(_, error)| error.on_front), "{truth:?}");
    }
    assert!(interior.rows_by(Truth::Light).next().is_none());
    assert!(lamp.rows_by(Truth::Light).count() > 2);

    // What a cut-off leaves out is at most its share of a colour; without one, rounding and the threshold of 1/255 are left,
    // which may take a Gaussian that `reference` does not.
    const ROUNDING: f64 = 1.0 / 255.0;
    for (row, error) in interior.rows_by(Truth::Ray) {
        let bound = error.bound.unwrap();
        assert!(error.norms.rmse <= bound + 1e-5, "{}: {} is above {bound}", row.label, error.norms.rmse);
        assert!(error.norms.max_abs <= bound + ROUNDING, "{}: {} is above {bound}", row.label, error.norms.max_abs);
    }
    let mut cutoffs: Vec<(f32, f64, f64)> = interior
        .rows_by(Truth::Ray)
        .filter(|(row, _)| [Axis::Base, Axis::TCutoff].contains(&row.axis))
        .map(|(row, error)| (row.settings.t_cutoff, error.bound.unwrap(), error.norms.rmse))
        .collect();
    cutoffs.sort_by(|a, b| a.0.total_cmp(&b.0));
    assert!(cutoffs.len() > 2);
    assert!(cutoffs.windows(2).all(|pair| pair[0].1 < pair[1].1 && pair[0].2 <= pair[1].2 + 1e-7), "{cutoffs:?}");

    // More rays per texel come nearer to its area.
    let by_samples = |samples: u32| {
        let mut rows = interior.rows_by(Truth::Area);
        let found =
            rows.find(|(row, _)| [Axis::Base, Axis::Samples].contains(&row.axis) && row.settings.samples == samples);
        found.unwrap().1.norms.rmse
    };
    assert!(by_samples(4) < by_samples(2) && by_samples(2) < by_samples(1));
}

#[test]
fn wrong_benches_exit_with_2_and_say_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("empty.json"), "{}").unwrap();
    std::fs::write(folder.path().join("broken.json"), "{").unwrap();
    for (line, named) in [
        ("bench -o out", "SCENE"),
        ("bench interior:10", "--output"),
        ("bench interior:0 -o out", "interior:0"),
        ("bench interior:many -o out", "interior:many"),
        ("bench interior:10 --sh 9 -o out", "--sh"),
        ("bench interior:10 --repeats 0 -o out", "--repeats"),
        ("bench interior:10 --probe 1,nan,2 -o out", "probe"),
        ("bench absent.ply -o out", "absent.ply"),
        ("bench empty.json -o out", "--splats"),
        ("bench broken.json -o out", "broken.json"),
    ] {
        let output = splatprobe(folder.path(), line);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{line}: {said}");
        assert!(said.contains(named) && !said.contains("panicked"), "{line}: {said}");
    }
    assert!(!folder.path().join("out").exists());
    let output = splatprobe(folder.path(), "bench interior:10 -o empty.json");
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
}
