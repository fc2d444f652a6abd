//! PLY splat files: every way to write one gives the same scene, and broken ones give errors.

mod builder;
mod malformed;

use std::path::Path;

use glam::{DVec3, Vec3};
use splatprobe::Error;
use splatprobe::ingest::{SceneReport, inspect_splats, load_scene};
use splatprobe::job::{Crop, Frame, SplatInput};
use splatprobe::scene::{SplatEncoding, sh};

use crate::files::{bits, data, load, load_with};
use builder::{Builder, Encoding, Others, splats, value};

fn input(path: &Path) -> SplatInput {
    SplatInput::new(path)
}

#[test]
fn values_mean_what_3dgs_trainers_write() {
    let mut file = splats(1, 1).set(0, "opacity", 0.5);
    for (name, value) in [("x", 1.5), ("y", -2.0), ("z", 3.0), ("rot_0", 2.0), ("rot_3", 2.0)] {
        file = file.set(0, name, value);
    }
    file = file.set(0, "rot_1", 0.0).set(0, "rot_2", 0.0);
    for (i, deviation) in [0.1_f64, 0.2, 0.4].into_iter().enumerate() {
        file = file.set(0, &format!("scale_{i}"), deviation.ln());
    }
    let (scene, report) = load_with(&file.bytes(), |input| input.frame = Some(Frame::RUB)).expect("loads");
    let splats = &scene.splats;
    assert_eq!(splats.means, [Vec3::new(1.5, -2.0, 3.0)]);
    assert!((splats.opacities[0] - 0.622_459_3).abs() < 1e-7);
    // A quarter turn about z: the first axis (0.1 m) points along y, the second (0.2 m) along -x.
    let covariance = splats.covariance(0);
    for (i, expected) in [0.04, 0.01, 0.16].into_iter().enumerate() {
        assert!((covariance.col(i)[i] - expected).abs() < 1e-7, "{covariance}");
    }
    let names = (0..3_usize).flat_map(|c| {
        let rest = (0..3).map(move |k| format!("f_rest_{}", 3 * c + k));
        std::iter::once(format!("f_dc_{c}")).chain(rest)
    });
    let expected: Vec<f32> = names.map(|name| file.get(0, &name) as f32).collect();
    assert_eq!(splats.sh_of(0), expected);
    assert_eq!((report.splats[0].sh_degree, report.splats[0].encoding), (1, SplatEncoding::SrgbDisplay));
}

#[test]
fn rdf_is_the_default_and_turns_y_and_z_over() {
    let flip = Vec3::new(1.0, -1.0, -1.0);
    let file = splats(2, 3).bytes();
    let (default, report) = load(&file).expect("loads");
    let (raw, _) = load_with(&file, |input| input.frame = Some(Frame::RUB)).expect("loads");
    assert_eq!(report.splats[0].frame, Frame::RDF);
    for i in 0..3 {
        assert_eq!(default.splats.means[i], raw.splats.means[i] * flip);
        for direction in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::new(0.6, 0.0, -0.8)] {
            let found = sh::evaluate(2, default.splats.sh_of(i), direction * flip);
            let expected = sh::evaluate(2, raw.splats.sh_of(i), direction);
            assert!((found - expected).abs().max_element() < 1e-5);
        }
    }
}

#[test]
fn encodings_column_orders_line_ends_and_neighbouring_elements_give_the_same_scene() {
    let base = splats(3, 5).set(0, "x", f64::from(0.1_f32)).set(4, "f_rest_7", f64::from(1.0_f32 / 3.0));
    let expected = bits(&load(&base.bytes()).expect("loads").0);
    for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
        for others in [Others::Absent, Others::Before, Others::After] {
            for line_end in ["\n", "\r\n"] {
                let variant = Builder { others, line_end, ..base.clone().encoded(encoding) };
                for variant in [variant.clone(), variant.clone().reversed(), variant.without("nx").without("ny")] {
                    assert_eq!(bits(&load(&variant.bytes()).expect("loads").0), expected, "{}", variant.header());
                }
            }
        }
    }
}

#[test]
fn every_scalar_type_in_every_column_gives_the_same_scene() {
    const SIGNED: [&str; 10] =
        ["char", "int8", "short", "int16", "int", "int32", "float", "float32", "double", "float64"];
    const UNSIGNED: [&str; 6] = ["uchar", "uint8", "ushort", "uint16", "uint", "uint32"];
    let base = splats(1, 4);
    let expected = bits(&load(&base.bytes()).expect("loads").0);
    for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
        for shift in 0..SIGNED.len() {
            let variant = base.clone().encoded(encoding).typed(|i, name| match name {
                "opacity" | "rot_0" => UNSIGNED[(i + shift) % UNSIGNED.len()],
                _ => SIGNED[(i + shift) % SIGNED.len()],
            });
            assert_eq!(bits(&load(&variant.bytes()).expect("loads").0), expected, "{}", variant.header());
        }
    }
}

#[test]
fn degrees_0_to_4_are_read() {
    for degree in 0..=4 {
        let (scene, report) = load(&splats(degree, 2).bytes()).expect("loads");
        assert_eq!((scene.splats.sh_degree, report.splats[0].sh_degree), (degree, degree));
    }
}

#[test]
fn bands_that_are_zero_for_all_are_not_stored() {
    let mut file = splats(3, 3);
    for (row, rest) in (0..3).flat_map(|row| (0..45).map(move |rest| (row, rest))) {
        if rest % 15 >= 3 {
            file = file.set(row, &format!("f_rest_{rest}"), 0.0);
        }
    }
    let (scene, report) = load_with(&file.bytes(), |input| input.frame = Some(Frame::RUB)).expect("loads");
    assert_eq!((report.splats[0].sh_degree, report.splats[0].sh_degree_used), (3, 1));
    assert_eq!((scene.splats.sh_degree, scene.splats.sh.len()), (1, 3 * 12));
    assert_eq!(scene.splats.sh_of(2)[4], value(2, "f_dc_1") as f32);
    let one = file.set(2, "f_rest_44", 0.5);
    assert_eq!(load(&one.bytes()).expect("loads").0.splats.sh_degree, 3);
}

#[test]
fn unusable_gaussians_are_dropped_and_every_other_is_kept_once_and_whole() {
    // More than one chunk, with gaps in each.
    let mut file = splats(0, 10_000);
    for row in 0..10_000 {
        file = file.set(row, "x", row as f64).set(row, "opacity", 1.0);
    }
    for (row, name, value) in [
        (0, "y", f64::NAN),
        (17, "scale_1", 1000.0),
        (4095, "opacity", -50.0),
        (4096, "f_dc_2", f64::INFINITY),
        (5000, "rot_0", 0.0),
        (5000, "rot_1", 0.0),
        (5000, "rot_2", 0.0),
        (5000, "rot_3", 0.0),
        (9999, "scale_0", f64::NEG_INFINITY),
    ] {
        file = file.set(row, name, value);
    }
    // Not a defect: fully opaque.
    file = file.set(6000, "opacity", f64::INFINITY);
    let (scene, report) = load(&file.bytes()).expect("loads");
    let dropped = report.splats[0].dropped;
    assert_eq!((report.splats[0].count, report.splats[0].kept, dropped.total()), (10_000, 9_994, 6));
    assert_eq!((dropped.non_finite, dropped.zero_rotation), (2, 1));
    assert_eq!((dropped.degenerate_scale, dropped.transparent), (2, 1));
    // x is the row that a Gaussian came from.
    let rows: Vec<usize> = scene.splats.means.iter().map(|mean| mean.x as usize).collect();
    let mut sorted = rows.clone();
    sorted.sort_unstable();
    let kept = (0..10_000).filter(|row| ![0, 17, 4095, 4096, 5000, 9999].contains(row));
    assert!(sorted.into_iter().eq(kept));
    for (i, &row) in rows.iter().enumerate() {
        assert_eq!(scene.splats.opacities[i] == 1.0, row == 6000);
        assert_eq!(scene.splats.sh_of(i)[0], file.get(row, "f_dc_0") as f32);
    }
}

#[test]
fn merged_inputs_share_the_highest_degree_and_pad_the_others_with_zero() {
    let folder = tempfile::tempdir().expect("a folder");
    let (low, high) = (folder.path().join("low.ply"), folder.path().join("high.ply"));
    std::fs::write(&low, splats(1, 2).bytes()).expect("written");
    std::fs::write(&high, splats(2, 3).bytes()).expect("written");
    let (merged, report) = load_scene(&[input(&low), input(&high)], &[]).expect("loads");
    let (alone, _) = load_scene(&[input(&low)], &[]).expect("loads");
    assert_eq!((merged.splats.len(), merged.splats.sh_degree, report.splats.len()), (5, 2, 2));
    for c in 0..3 {
        assert_eq!(merged.splats.sh_of(1)[9 * c..9 * c + 4], alone.splats.sh_of(1)[4 * c..4 * c + 4]);
        assert_eq!(merged.splats.sh_of(1)[9 * c + 4..9 * c + 9], [0.0; 5]);
    }
}

#[test]
fn linear_inputs_beside_display_ones_are_marked_and_inputs_of_one_kind_are_not() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("scene.ply");
    std::fs::write(&path, splats(0, 2).bytes()).expect("written");
    let linear = SplatInput { encoding: Some(SplatEncoding::LinScene), ..input(&path) };
    let (mixed, report) = load_scene(&[linear.clone(), input(&path)], &[]).expect("loads");
    assert_eq!((mixed.encoding, mixed.splats.linear), (SplatEncoding::SrgbDisplay, vec![true, true, false, false]));
    assert_eq!(report.splats[0].encoding, SplatEncoding::LinScene);
    let (scene, _) = load_scene(&[linear.clone(), linear], &[]).expect("loads");
    assert_eq!((scene.encoding, scene.splats.linear), (SplatEncoding::LinScene, Vec::new()));
}

#[test]
fn crop_and_minimum_opacity_drop_by_world_mean_and_peak_and_are_counted() {
    let mut file = splats(0, 5);
    for (row, (x, logit)) in [(0.0, 4.0), (1.0, 4.0), (2.0, -1.0), (3.0, 4.0), (9.0, -20.0)].into_iter().enumerate() {
        file = file.set(row, "x", x).set(row, "y", 0.0).set(row, "z", 0.0).set(row, "opacity", logit);
    }
    let select = |input: &mut SplatInput| {
        input.transform.translation = [10.0, 0.0, 0.0];
        input.crop = Some(Crop::Box([10.5, -1.0, -1.0, 13.0, 1.0, 1.0]));
        input.min_opacity = 0.5;
    };
    let (scene, report) = load_with(&file.bytes(), select).expect("loads");
    assert_eq!(scene.splats.means, [Vec3::new(11.0, 0.0, 0.0), Vec3::new(13.0, 0.0, 0.0)]);
    let dropped = report.splats[0].dropped;
    assert_eq!((dropped.cropped, dropped.below_min_opacity, dropped.transparent, dropped.total()), (1, 1, 1, 3));
    let error = load_with(&file.bytes(), |input| input.crop = Some(Crop::Sphere([0.0, 50.0, 0.0, 1.0])));
    let error = error.expect_err("nothing left");
    assert!(matches!(error, Error::Request { .. }) && error.to_string().contains("splats[0].crop"), "{error}");
}

#[test]
fn a_scene_far_from_zero_keeps_its_detail_relative_to_its_own_origin() {
    let offset = DVec3::new(5_000_000.25, 0.0, -700_000.5);
    let file = splats(0, 100).bytes();
    let (near, _) = load(&file).expect("loads");
    let (far, report) = load_with(&file, |input| input.transform.translation = offset.to_array()).expect("loads");
    assert_eq!(near.origin, DVec3::ZERO);
    for (near_mean, far_mean) in near.splats.means.iter().zip(&far.splats.means) {
        assert_eq!(far.origin + far_mean.as_dvec3() - offset, near_mean.as_dvec3());
        assert!(far_mean.length() < 100.0);
    }
    assert!(report.splats[0].bounds.min.x > 4_999_000.0);
}

#[test]
fn the_result_is_the_same_for_any_thread_count() {
    let mut file = splats(1, 20_000);
    for row in (0..20_000).step_by(7) {
        file = file.set(row, "opacity", -20.0);
    }
    let bytes = file.bytes();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| bits(&load(&bytes).expect("loads").0))
    };
    assert!(with(1) == with(5));
}

#[test]
fn reports_are_camel_case_json_that_reads_back() {
    let (_, mut report) = load(&splats(1, 3).bytes()).expect("loads");
    let json = serde_json::to_value(&report).expect("JSON");
    // What was read where is of no matter to who reads a report.
    report.splats[0].files.clear();
    let splats = &json["splats"][0];
    assert_eq!(splats["dropped"]["nonFinite"], 0);
    assert_eq!((&splats["frame"], &splats["encoding"]), (&"rdf".into(), &"srgb-display".into()));
    assert!(splats["robustBounds"]["min"][2].is_number());
    assert_eq!(serde_json::from_value::<SceneReport>(json).expect("reads back"), report);
}

#[test]
fn a_captured_desk_loads_whole() {
    let Some(path) = data("splats/leica-sofort-8k.ply") else { return };
    let report = inspect_splats(&path).expect("loads");
    assert_eq!((report.count, report.kept, report.sh_degree, report.sh_degree_used), (8192, 8192, 3, 3));
    // From a few lines of Python over the same bytes; the default frame turns y and z over.
    let near =
        |found: f64, expected: f64| assert!((found - expected).abs() < 1e-6 * expected.abs(), "{found} {expected}");
    near(report.opacity.p10, 0.755_826_160);
    near(report.opacity.p50, 0.879_671_586);
    near(report.scale.p50, 0.032_407_060);
    near(report.bounds.min.x, -15.019_826_889);
    near(report.bounds.max.y, 10.418_102_264);
    near(report.bounds.min.z, -24.486_934_662);
    assert!(report.robust_bounds.extent().cmplt(report.bounds.extent()).all());
}

#[test]
fn published_fixtures_of_degree_1_to_3_have_the_coefficients_they_say() {
    for degree in 1..=3 {
        let Some(path) = data(&format!("splats/minimal/fixture-degree-{degree}-sh.ply")) else { return };
        let raw = SplatInput { frame: Some(Frame::RUB), ..input(&path) };
        let (scene, _) = load_scene(&[raw], &[]).expect("loads");
        let count = sh::coefficient_count(degree);
        let coefficients = scene.splats.sh_of(0);
        assert_eq!((scene.splats.sh_degree, coefficients.len()), (degree, 3 * count));
        for c in 0..3 {
            assert!((coefficients[c * count] - 0.1 * (c + 1) as f32).abs() < 1e-7);
            // Degree 1 counts on from channel to channel, the others begin at 1, 101 and 201.
            let start = if degree == 1 { 3 * c } else { 100 * c };
            for k in 1..count {
                assert_eq!(coefficients[c * count + k], (start + k) as f32);
            }
        }
        assert_eq!(scene.splats.means, [Vec3::new(1.0, 2.0, 3.0)]);
        assert!((scene.splats.standard_deviations(0) - DVec3::new(1.0, 2.0, 0.5)).length() < 1e-6);
    }
}

#[test]
fn the_published_fixture_of_degree_4_is_read_and_its_empty_bands_are_dropped() {
    let Some(path) = data("splats/minimal/fixture-degree-4-sh.ply") else { return };
    let report = inspect_splats(&path).expect("loads");
    assert_eq!((report.kept, report.sh_degree, report.sh_degree_used), (1, 4, 0));
}
