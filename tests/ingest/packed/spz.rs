use splatprobe::Error;
use splatprobe::ingest::inspect_splats;
use splatprobe::job::Frame;

use super::{Tolerance, assert_holds, assert_is_the_published_square, bits, data, error_of, known, load, load_raw};
use crate::packed_files::spz::{FRACTIONAL_BITS, file, gzip, uncompressed, version_4, zstd};

const ANTIALIASED: u8 = 1;
const EXTENSIONS: u8 = 2;

fn record(kind: u32, payload: &[u8]) -> Vec<u8> {
    [&kind.to_le_bytes(), &(payload.len() as u32).to_le_bytes(), payload].concat()
}

/// The extension that names a coordinate system, behind one that nobody knows.
fn coordinate_system(code: u32) -> Vec<u8> {
    [record(0x1234_0001, &[1, 2, 3]), record(0xadbe_0003, &code.to_le_bytes())].concat()
}

fn tolerance(version: u32) -> Tolerance {
    Tolerance {
        mean: if version == 1 { 2e-3 } else { 0.5 / 4096.0 + 1e-6 },
        // Half a step of a scale is 3 %, of its square 6 %; three bytes leave w uncertain where it is small.
        covariance: if version <= 2 { 0.4 } else { 0.075 },
        opacity: 0.002,
        dc: 0.5 / 255.0 / 0.15 + 1e-6,
        rest: 0.5 / 128.0 + 1e-6,
    }
}

#[test]
fn known_gaussians_come_back_from_every_version_and_degree() {
    for version in 1..=4 {
        for degree in 0..=4 {
            let gaussians = known(degree, 4200);
            let (scene, report) = load_raw(&file(version, &gaussians));
            assert_holds(&scene, &gaussians, &tolerance(version));
            assert_eq!(
                (report.splats[0].format.clone(), report.splats[0].sh_degree),
                (format!("SPZ {version}"), degree)
            );
        }
    }
}

#[test]
fn values_that_bytes_hold_exactly_come_back_exactly() {
    let mut exact = known(1, 1).remove(0);
    exact.mean = [-2047.75, 1.0 / 4096.0, -1.0 / 4096.0].into();
    exact.rotation =
        glam::DQuat::from_xyzw(0.0, 0.0, std::f64::consts::FRAC_1_SQRT_2, -std::f64::consts::FRAC_1_SQRT_2);
    exact.deviations = [(-10.0_f64).exp(), 1.0, (-0.0625_f64).exp()].into();
    exact.opacity = 51.0 / 255.0;
    exact.sh = [0.5, -0.25, 0.0, 127.0 / 128.0, -0.2, -1.0, 0.125, -0.5, 0.1, 0.5, 0.75, 0.0].into();
    for c in 0..3 {
        exact.sh[4 * c] = (f64::from(40 * (c + 1) as u8) / 255.0 - 0.5) / 0.15;
    }
    let tight = Tolerance { mean: 0.0, covariance: 1e-6, opacity: 1e-7, dc: 1e-6, rest: 0.0 };
    assert_holds(&load_raw(&file(3, &[exact.clone()])).0, &[exact.clone()], &tight);
    assert_holds(&load_raw(&file(4, &[exact.clone()])).0, &[exact], &tight);
}

#[test]
fn wrappings_of_the_same_attributes_give_the_same_scene() {
    let gaussians = known(3, 50);
    let expected = bits(&load(&file(3, &gaussians)).expect("loads").0);
    let plain = load(&uncompressed(3, &gaussians, 0, &[])).expect("loads");
    assert_eq!(bits(&plain.0), expected);
    assert_eq!(plain.1.splats[0].format, "SPZ 3, uncompressed");
    assert_eq!(bits(&load(&file(4, &gaussians)).expect("loads").0), expected);
}

#[test]
fn a_sixth_stream_without_bytes_may_stand_for_no_harmonics() {
    let gaussians = known(0, 7);
    let five = version_4(&gaussians, 0, &[]);
    let mut six = five.clone();
    six[15] = 6;
    six.splice(32 + 5 * 16..32 + 5 * 16, [0; 16]);
    assert_eq!(bits(&load(&six).expect("loads").0), bits(&load(&five).expect("loads").0));
}

#[test]
fn antialiasing_is_told_and_changes_nothing() {
    let gaussians = known(0, 7);
    let plain = load(&version_4(&gaussians, 0, &[])).expect("loads");
    let (scene, report) = load(&version_4(&gaussians, ANTIALIASED, &[])).expect("loads");
    assert_eq!(report.splats[0].format, "SPZ 4, antialiased");
    assert_eq!(bits(&scene), bits(&plain.0));
}

#[test]
fn the_frame_is_right_up_back_unless_an_extension_names_another() {
    let gaussians = known(1, 5);
    let frame_of = |bytes: &[u8]| load(bytes).expect("loads").1.splats[0].frame;
    let named = |name: &str| name.parse::<Frame>().expect("a frame");
    assert_eq!(frame_of(&file(2, &gaussians)), Frame::RUB);
    for (code, name) in
        [(0, "rub"), (1, "ldb"), (4, "rub"), (6, "rdf"), (7, "luf"), (9, "lfd"), (12, "rfu"), (16, "rbu")]
    {
        let records = coordinate_system(code);
        assert_eq!(frame_of(&version_4(&gaussians, EXTENSIONS, &records)), named(name));
        // Behind the attributes in versions before 4.
        assert_eq!(frame_of(&gzip(&uncompressed(3, &gaussians, EXTENSIONS, &records))), named(name));
        assert_eq!(frame_of(&uncompressed(3, &gaussians, EXTENSIONS, &records)), named(name));
        // Bytes that no flag announces are not extensions.
        assert_eq!(frame_of(&uncompressed(3, &gaussians, 0, &records)), Frame::RUB);
    }
    for code in [17, u32::MAX] {
        let error = error_of(&version_4(&gaussians, EXTENSIONS, &coordinate_system(code)));
        assert!(error.contains("SPZ_ADOBE_coordinate_system") && error.contains(&code.to_string()), "{error}");
    }
}

#[test]
fn an_extension_record_that_is_cut_is_an_error_that_names_its_byte() {
    let records = coordinate_system(6);
    let error = error_of(&version_4(&known(0, 2), EXTENSIONS, &records[..9]));
    assert!(error.contains("byte 32"), "{error}");
    let error = error_of(&version_4(&known(0, 2), EXTENSIONS, &[record(7, &[0; 5]), vec![1, 0]].concat()));
    assert!(error.contains("byte 45"), "{error}");
}

#[test]
fn fractional_bits_scale_the_positions() {
    let mut bytes = uncompressed(2, &known(0, 3), 0, &[]);
    let fine = load_raw(&bytes).0.splats.means;
    bytes[13] = FRACTIONAL_BITS - 3;
    let coarse = load_raw(&bytes).0.splats.means;
    assert!(fine.iter().zip(&coarse).all(|(&fine, &coarse)| fine * 8.0 == coarse));
    bytes[13] = 31;
    assert!(error_of(&bytes).contains("header, byte 13"));
}

#[test]
fn headers_that_promise_more_than_the_file_holds_are_errors() {
    let gaussians = known(1, 20);
    let raw = uncompressed(3, &gaussians, 0, &[]);
    let with_count = |count: u32| [&raw[..8], &count.to_le_bytes(), &raw[12..]].concat();
    for count in [21, 20_000] {
        let error = error_of(&with_count(count));
        assert!(error.contains(&format!("the header's {count} points")), "{error}");
        assert!(error_of(&gzip(&with_count(count))).contains("ends before the points"));
    }
    for (bytes, file_size) in [(with_count(u32::MAX), raw.len()), (gzip(&with_count(u32::MAX)), 0)] {
        let error = error_of(&bytes);
        assert!(error.contains("header, byte 8") && error.contains("64 times"), "{error}");
        assert!(file_size == 0 || error.contains(&format!("file's {file_size}")), "{error}");
    }
    let degree = [&raw[..12], &[5], &raw[13..]].concat();
    assert!(error_of(&degree).contains("header, byte 12"));
    assert!(error_of(&with_count(0)).contains("0 points"));
}

#[test]
fn tables_that_promise_more_than_the_file_holds_are_errors_that_name_the_byte() {
    let good = version_4(&known(1, 20), 0, &[]);
    assert!(load(&good).is_ok());
    for (at, value, expected) in [
        (8, 21, "table of streams, byte 32"),
        (15, 7, "header, byte 15"),
        (15, 5, "header, byte 15"),
        (16, 31, "header, byte 16"),
        (16, 1 << 31, "header, byte 16"),
        (16, good.len() as u64 - 20, "the table of streams"),
        (32, u64::MAX, "table of streams, byte 32"),
        (112, 1 << 20, "table of streams, byte 112"),
        (56, 21, "table of streams, byte 48"),
        (56, u64::MAX, "table of streams, byte 48"),
    ] {
        let width = match at {
            15 => 1,
            8 | 16 => 4,
            _ => 8,
        };
        let mut broken = good.clone();
        broken[at..at + width].copy_from_slice(&value.to_le_bytes()[..width]);
        let error = error_of(&broken);
        assert!(error.contains(expected), "{expected}: {error}");
    }
}

#[test]
fn data_that_decompresses_to_more_than_promised_is_an_error() {
    let gaussians = known(1, 20);
    // 100 MB of zeros in 100 kB, behind all that the header promises.
    let bomb = gzip(&uncompressed(3, &gaussians, 0, &vec![0; 100_000_000]));
    assert!(bomb.len() < 200_000 && error_of(&bomb).contains("more data than the header's 20 points"));
    // As much promised, too: refused before anything is decompressed.
    let mut claimed = uncompressed(3, &gaussians, 0, &vec![0; 100_000_000]);
    let points = (claimed.len() - 16) / 29;
    claimed[8..12].copy_from_slice(&(points as u32).to_le_bytes());
    assert!(error_of(&gzip(&claimed)).contains("64 times"));

    let stream = |size: usize| zstd(&vec![0; size]);
    for (size, expected) in [(10_000_000, "zstd stream at byte"), (19, "19 bytes in it, expected 20")] {
        let mut broken = version_4(&gaussians, 0, &[]);
        let opacities = 32 + 6 * 16 + broken[32] as usize + 256 * broken[33] as usize;
        let old = usize::from(broken[48]);
        broken.splice(opacities..opacities + old, stream(size));
        broken[48..56].copy_from_slice(&(stream(size).len() as u64).to_le_bytes());
        let error = error_of(&broken);
        assert!(error.contains(expected) && error.contains(&opacities.to_string()), "{error}");
    }
}

#[test]
fn other_versions_and_variants_are_unsupported_by_name() {
    let raw = uncompressed(3, &known(0, 2), 0, &[]);
    let with = |at: usize, value: u8| [&raw[..at], &[value], &raw[at + 1..]].concat();
    for (bytes, expected) in [
        (with(4, 5), "version 5"),
        (with(4, 0), "version 0"),
        (gzip(&with(4, 9)), "version 9"),
        (gzip(&version_4(&known(0, 2), 0, &[])), "version 4 inside gzip"),
        (with(14, 0x80), "levels of detail"),
    ] {
        let error = load(&bytes).expect_err("unsupported");
        assert!(matches!(error, Error::Unsupported { .. }) && error.to_string().contains(expected), "{error}");
    }
    assert!(error_of(&gzip(b"a text that somebody compressed")).contains("gzip data, but not .spz"));
}

#[test]
fn positions_of_version_1_that_are_no_numbers_are_dropped() {
    let mut gaussians = known(0, 10);
    gaussians[1].mean.y = f64::NAN;
    gaussians[2].mean.x = f64::INFINITY;
    let dropped = load_raw(&file(1, &gaussians)).1.splats[0].dropped;
    assert_eq!((dropped.non_finite, dropped.total()), (2, 2));
}

#[test]
fn the_published_squares_are_read() {
    for name in ["v3", "v4"] {
        assert_is_the_published_square(&format!("splats/minimal/minimal-{name}.spz"), None);
    }
    // Written without turning the axes over.
    for name in ["raw", "v2"] {
        assert_is_the_published_square(&format!("splats/minimal/minimal-{name}.spz"), Some(Frame::RDF));
    }
}

#[test]
fn a_captured_desk_is_read_as_the_reference_decoder_reads_it() {
    let Some(path) = data("splats/leica-sofort-8k.spz") else { return };
    let report = inspect_splats(&path).expect("loads");
    assert_eq!((report.count, report.kept, report.sh_degree, report.sh_degree_used), (8192, 8192, 3, 3));
    assert_eq!(report.format, "SPZ 2, antialiased");
    // From a few lines of Python over the PLY that splat-transform makes of it, whose frame turns y and z over.
    let near =
        |found: f64, expected: f64| assert!((found - expected).abs() < 1e-6 * expected.abs(), "{found} {expected}");
    near(report.opacity.p50, 0.996_078_432);
    near(report.scale.p50, 0.000_588_755_25);
    near(report.bounds.min.x, -0.248_046_875);
    near(report.bounds.max.x, 0.241_699_218_75);
    near(report.bounds.max.y, 0.088_378_906_25);
    near(report.bounds.min.z, -0.241_699_218_75);
    assert!(report.robust_bounds.extent().cmplt(report.bounds.extent()).all());
}
