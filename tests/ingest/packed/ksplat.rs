use splatprobe::Error;
use splatprobe::job::Frame;
use splatprobe::scene::sh::C0;

use super::{Tolerance, assert_holds, assert_is_the_published_square, error_of, known, load, load_raw};
use crate::packed_files::Known;
use crate::packed_files::ksplat::{Section, file, put};

/// All of `gaussians` in full buckets of 4, then buckets of 1, 2, 3 and what is left.
pub fn section(gaussians: Vec<Known>, degree: u8) -> Section {
    let mut buckets = vec![4; gaussians.len().saturating_sub(6) / 4];
    let mut left = gaussians.len() - 4 * buckets.len();
    for length in [1, 2, 3] {
        let length = left.min(length);
        buckets.extend((length > 0).then_some(length));
        left -= length;
    }
    buckets.extend((left > 0).then_some(left));
    Section { gaussians, buckets, capacity: 4, degree }
}

fn tolerance(level: u16) -> Tolerance {
    let (dc, opacity) = (0.5 / 255.0 / C0 + 1e-6, 0.002);
    match level {
        0 => Tolerance { mean: 1e-6, covariance: 1e-6, opacity, dc, rest: 1e-6 },
        1 => Tolerance { mean: 4e-5, covariance: 4e-3, opacity, dc, rest: 5e-4 },
        _ => Tolerance { mean: 4e-5, covariance: 4e-3, opacity, dc, rest: 0.5 * 2.25 / 255.0 + 1e-6 },
    }
}

/// Neighbours that fit into blocks of [`BLOCK`] metres.
fn clustered(degree: u8, count: usize) -> Vec<Known> {
    let mut gaussians = known(degree, count);
    gaussians.iter_mut().for_each(|gaussian| gaussian.mean *= 0.2);
    gaussians
}

#[test]
fn known_gaussians_come_back_at_every_level_and_degree() {
    for level in 0..=2 {
        for degree in 0..=2 {
            let gaussians = clustered(degree, 5000);
            let (scene, report) = load_raw(&file(level, &[section(gaussians.clone(), degree)]));
            assert_holds(&scene, &gaussians, &tolerance(level));
            assert_eq!(report.splats[0].format, format!(".ksplat 0.1, compression level {level}"));
        }
    }
}

#[test]
fn sections_follow_each_other_with_their_own_degrees() {
    for level in 0..=2 {
        let parts = [clustered(0, 30), clustered(2, 41), clustered(1, 9)];
        let sections: Vec<Section> = parts.iter().zip([0, 2, 1]).map(|(p, d)| section(p.clone(), d)).collect();
        let (scene, report) = load_raw(&file(level, &sections));
        assert_eq!((report.splats[0].count, report.splats[0].sh_degree), (80, 2));
        for (i, known) in parts.iter().flatten().enumerate() {
            // Bands that a section lacks are zero.
            let per_channel = known.sh.len() / 3;
            let padded = (0..27).map(|k| if k % 9 < per_channel { known.sh[k / 9 * per_channel + k % 9] } else { 0.0 });
            let padded = Known { sh: padded.collect(), ..known.clone() };
            super::assert_near(&scene, i, &padded, &tolerance(level));
        }
    }
}

#[test]
fn axes_are_those_of_3dgs_trainers() {
    let (_, report) = load(&file(0, &[section(clustered(0, 3), 0)])).expect("loads");
    assert_eq!(report.splats[0].frame, Frame::RDF);
}

#[test]
fn the_published_square_is_read() {
    assert_is_the_published_square("splats/minimal/minimal.ksplat", None);
}

#[test]
fn headers_that_promise_more_than_the_file_holds_are_errors_that_name_the_byte() {
    let good = file(1, &[section(clustered(1, 12), 1)]);
    for (at, value, expected) in [
        (4, 40_u32, "header, byte 4"),
        (4, u32::MAX, "header, byte 4"),
        (16, 13, "header, byte 16"),
        (4096, 13, "byte 4096"),
        (4096 + 4, 13, "byte 4100"),
        (4096 + 4, u32::MAX, "do not fit"),
        (4096 + 8, 2, "the buckets hold"),
        (4096 + 12, u32::MAX, "do not fit"),
        (4096 + 12, 1, "expected 1 together"),
        (4096 + 20, 0, "0 bytes each"),
        (4096 + 32, 9, "expected"),
        (4096 + 36, u32::MAX, "do not fit"),
        (4096 + 40, 3, "degree 3"),
    ] {
        let mut broken = good.clone();
        put(&mut broken, at, value.to_le_bytes());
        let error = error_of(&broken);
        assert!(error.contains(expected), "{expected}: {error}");
    }
}

#[test]
fn bucket_lengths_that_do_not_hold_all_gaussians_are_errors() {
    let mut broken = file(1, &[section(clustered(0, 12), 0)]);
    put(&mut broken, 4096 + 1024, 0_u32.to_le_bytes());
    assert!(error_of(&broken).contains("of the section's 12"));
    // A length whose sum overflows any count is not trusted either, but no Gaussian is misread by it.
    put(&mut broken, 4096 + 1024, u32::MAX.to_le_bytes());
    assert!(load(&broken).is_ok());
}

#[test]
fn other_versions_levels_and_empty_files_are_told() {
    let good = file(0, &[section(clustered(0, 2), 0)]);
    let mut level = good.clone();
    put(&mut level, 20, 3_u16.to_le_bytes());
    let error = load(&level).expect_err("level 3");
    assert!(matches!(error, Error::Unsupported { .. }) && error.to_string().contains("level 3"), "{error}");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("scene.ksplat");
    let mut version = good;
    put(&mut version, 0, [1, 0]);
    std::fs::write(&path, &version).expect("written");
    let error = splatprobe::ingest::inspect_splats(&path).expect_err("version 1.0");
    assert!(matches!(error, Error::Unsupported { .. }) && error.to_string().contains("[1, 0]"), "{error}");
    assert!(error_of(&file(0, &[section(Vec::new(), 0)])).contains("hold 0"));
    assert!(error_of(&file(0, &[])).contains("hold 0"));
}

#[test]
fn values_that_are_no_numbers_are_dropped() {
    let mut gaussians = clustered(1, 10);
    gaussians[1].mean.y = f64::NAN;
    gaussians[2].deviations.x = f64::INFINITY;
    gaussians[3].sh[5] = f64::NEG_INFINITY;
    let dropped = load_raw(&file(0, &[section(gaussians, 1)])).1.splats[0].dropped;
    assert_eq!((dropped.non_finite, dropped.degenerate_scale, dropped.total()), (2, 1, 3));
}
