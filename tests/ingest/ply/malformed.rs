//! Broken and foreign files: always an error that tells where and what, never a panic.

use splatprobe::Error;
use splatprobe::ingest::inspect_splats;

use super::builder::{Builder, Encoding, Others, splats};
use super::load;

fn error_of(bytes: &[u8]) -> String {
    load(bytes).expect_err("an error").to_string()
}

#[test]
fn every_truncation_is_an_error() {
    let small = splats(1, 2);
    let with_others = Builder { others: Others::Before, ..small.clone() };
    for file in [small.clone(), small.clone().encoded(Encoding::Big), with_others] {
        let bytes = file.bytes();
        for length in 0..bytes.len() {
            let error = load(&bytes[..length]).expect_err("truncated");
            assert!(matches!(error, Error::Invalid { .. }), "{length}: {error}");
        }
    }
    // In text a number that lost digits is still a number: only what lacks a whole value can be told.
    let text = small.encoded(Encoding::Ascii).bytes();
    let last_value = text.trim_ascii_end().iter().rposition(|&byte| byte == b' ').expect("values");
    for length in 0..=last_value {
        assert!(load(&text[..length]).is_err(), "{length}");
    }
}

#[test]
fn counts_larger_than_the_file_are_errors_that_name_the_element() {
    for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
        let file = Builder { others: Others::Before, ..splats(0, 2).encoded(encoding) };
        let header = file.header();
        let bytes = file.bytes();
        for (element, count) in [("vertex", 2), ("face", 3), ("camera", 2)] {
            for larger in ["4000000000", "18446744073709551615"] {
                let larger = header.replace(&format!("{element} {count}"), &format!("{element} {larger}"));
                let error = error_of(&[larger.as_bytes(), &bytes[header.len()..]].concat());
                assert!(error.contains(&format!("rows of element {element}")), "{error}");
            }
        }
        let one_more = header.replace("vertex 2", "vertex 3");
        assert!(error_of(&[one_more.as_bytes(), &bytes[header.len()..]].concat()).contains("element vertex"));
        let overflow = header.replace("vertex 2", "vertex 18446744073709551616");
        assert!(error_of(overflow.as_bytes()).contains("is not a count"));
    }
}

#[test]
fn zero_vertices_are_an_error() {
    assert!(error_of(&splats(0, 0).bytes()).contains("0 rows"));
}

#[test]
fn a_file_without_any_usable_gaussian_is_an_error_that_tells_why() {
    let error = error_of(&splats(0, 1).set(0, "opacity", -9.0).bytes());
    assert!(error.contains("none can be used") && error.contains("transparent: 1"), "{error}");
}

#[test]
fn a_point_cloud_is_told_what_it_lacks() {
    let lacking = ["f_dc_0", "f_dc_1", "f_dc_2", "opacity", "rot_2"];
    let cloud = lacking.into_iter().fold(splats(0, 1), Builder::without);
    let error = error_of(&cloud.bytes());
    assert!(error.contains(&format!("lacks {}", lacking.join(", "))), "{error}");
}

#[test]
fn rest_coefficients_of_no_degree_are_an_error() {
    let error = error_of(&splats(2, 2).without("f_rest_23").bytes());
    assert!(error.contains("23 properties f_rest_"), "{error}");
}

#[test]
fn rest_coefficients_with_a_gap_are_told_by_name() {
    let header = splats(1, 1).header().replace("f_rest_4", "f_rest_9");
    assert!(error_of(header.as_bytes()).contains("lacks f_rest_4"));
}

#[test]
fn broken_headers_are_errors_that_name_the_line_or_the_word() {
    let good = splats(0, 1).header();
    let padding = "comment padding padding\n".repeat(4000) + "end_header\n";
    for (old, new, expected) in [
        ("end_header\n", "", "no 'end_header' line"),
        ("end_header\n", padding.as_str(), "64 KiB"),
        ("ply\n", "plywood\n", "header line 1"),
        ("1.0", "2.0", "header line 2"),
        ("binary_little_endian", "binary_pdp_endian", "not a PLY format"),
        ("format binary_little_endian 1.0\n", "", "no 'format'"),
        ("element vertex 1\n", "", "before any element"),
        ("element vertex 1\n", "element vertex -1\n", "'-1' is not a count"),
        ("element vertex 1\n", "element vertex 1\nelement vertex 1\n", "'vertex' is declared twice"),
        ("element vertex", "element vortex", "no 'element vertex'"),
        ("property float x\n", "property float x\nproperty float x\n", "'x' is declared twice"),
        ("property float x\n", "property half x\n", "'half' is not a PLY type"),
        ("property float x\n", "property list float x\n", "property list TYPE TYPE NAME"),
        ("property float nx\n", "property list uchar float nx\n", "list property 'nx'"),
    ] {
        let header = good.replacen(old, new, 1);
        assert_ne!(header, good);
        let error = error_of(&[header.as_bytes(), &[0; 400]].concat());
        assert!(error.contains(expected), "{expected}: {error}");
    }
}

#[test]
fn a_word_in_an_ascii_row_is_an_error_that_names_the_vertex() {
    let bytes = splats(0, 3).encoded(Encoding::Ascii).bytes();
    let text = String::from_utf8(bytes).expect("text");
    let last_row = text.trim_end().rfind('\n').expect("rows") + 1;
    let error = error_of(format!("{}four{}", &text[..last_row], &text[last_row..]).as_bytes());
    assert!(error.contains("vertex 2") && error.contains("'four"), "{error}");
}

#[test]
fn random_byte_changes_never_panic_and_never_give_unusable_numbers() {
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut random = |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state % below as u64) as usize
    };
    let mut loaded = 0;
    for encoding in [Encoding::Ascii, Encoding::Little] {
        let bytes = Builder { others: Others::Before, ..splats(1, 3).encoded(encoding) }.bytes();
        for _ in 0..1000 {
            let mut broken = bytes.clone();
            for _ in 0..1 + random(4) {
                let at = random(broken.len());
                broken[at] = random(256) as u8;
            }
            if let Ok((scene, _)) = load(&broken) {
                loaded += 1;
                assert!(scene.splats.means.iter().all(|mean| mean.is_finite()));
                assert!(scene.splats.unit_from_world.iter().all(|matrix| matrix.is_finite()));
                assert!(scene.splats.sh.iter().all(|coefficient| coefficient.is_finite()));
            }
        }
    }
    assert!((100..1900).contains(&loaded), "{loaded} of 2000 loaded: the changes test only one side");
}

#[test]
fn unknown_formats_are_told_by_their_first_bytes() {
    let error = load(b"\x00\x01hello").expect_err("unknown");
    assert!(matches!(error, Error::Invalid { .. }));
    assert!(error.to_string().contains("\\x00\\x01hello") && error.to_string().contains("PLY"), "{error}");
    assert!(error_of(b"").contains("empty"));
}

#[test]
fn a_missing_file_and_a_folder_cannot_be_read() {
    let folder = tempfile::tempdir().expect("a folder");
    for path in [folder.path().join("absent.ply"), folder.path().to_path_buf()] {
        assert!(matches!(inspect_splats(&path), Err(Error::Read { .. })));
    }
}
