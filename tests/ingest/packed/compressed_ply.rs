use splatprobe::Error;
use splatprobe::job::Frame;
use splatprobe::scene::sh::C0;

use super::{Tolerance, assert_holds, bits, error_of, known, load, load_raw};
use crate::packed_files::compressed_ply::{Variant, file, header};

fn tolerance(variant: Variant) -> Tolerance {
    Tolerance {
        // Half a step of 10 bits over 7 metres.
        mean: 0.5 * 7.0 / 1023.0 + 1e-5,
        covariance: 0.02,
        opacity: 0.002,
        dc: if variant.chunk_colours { 0.5 * 3.4 / 255.0 } else { 0.5 / 255.0 / C0 } + 1e-5,
        rest: 4.0 / 256.0 + 1e-5,
    }
}

const VARIANTS: [Variant; 3] = [
    Variant { chunk_colours: true, strangers: false },
    Variant { chunk_colours: false, strangers: false },
    Variant { chunk_colours: true, strangers: true },
];

#[test]
fn known_gaussians_come_back_in_every_variant_and_degree() {
    for variant in VARIANTS {
        for degree in 0..=4 {
            // The last chunk is not full, and one of its blocks neither.
            let gaussians = known(degree, 4096 + 300);
            let (scene, report) = load_raw(&file(&gaussians, degree, variant));
            assert_holds(&scene, &gaussians, &tolerance(variant));
            let report = &report.splats[0];
            assert_eq!((report.format.as_str(), report.sh_degree), ("PLY compressed", degree));
        }
    }
}

#[test]
fn other_elements_and_columns_change_nothing() {
    let gaussians = known(2, 600);
    let [plain, _, strangers] = VARIANTS.map(|variant| bits(&load(&file(&gaussians, 2, variant)).expect("loads").0));
    assert_eq!(plain, strangers);
}

#[test]
fn axes_are_those_of_3dgs_trainers() {
    let (_, report) = load(&file(&known(0, 3), 0, VARIANTS[0])).expect("loads");
    assert_eq!(report.splats[0].frame, Frame::RDF);
}

#[test]
fn the_ends_of_a_chunk_are_exact() {
    let gaussians = known(0, 2);
    let (scene, _) = load_raw(&file(&gaussians, 0, VARIANTS[0]));
    for axis in 0..3 {
        let mut found = [0, 1].map(|i| scene.splats.means[i][axis]);
        let mut expected = [0, 1].map(|i| gaussians[i].mean[axis] as f32);
        found.sort_by(f32::total_cmp);
        expected.sort_by(f32::total_cmp);
        assert_eq!(found, expected);
    }
}

#[test]
fn bounds_that_are_no_numbers_drop_their_chunk_and_no_other() {
    let mut gaussians = known(1, 600);
    gaussians[300].mean.y = f64::NAN;
    let mut bytes = file(&gaussians, 1, VARIANTS[0]);
    let second_chunk = header(&gaussians, 1, VARIANTS[0]).len() + 18 * 4;
    bytes[second_chunk..second_chunk + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    let (scene, report) = load(&bytes).expect("loads");
    assert_eq!((scene.splats.len(), report.splats[0].dropped.non_finite), (344, 256));
}

#[test]
fn counts_that_do_not_fit_together_or_into_the_file_are_errors() {
    let gaussians = known(1, 600);
    let bytes = file(&gaussians, 1, VARIANTS[0]);
    let header = header(&gaussians, 1, VARIANTS[0]);
    for (old, new, expected) in [
        ("element chunk 3", "element chunk 2", "600 vertices need 3 rows of element chunk, which has 2"),
        ("element chunk 3", "element chunk 18446744073709551615", "need 3 rows"),
        ("element vertex 600", "element vertex 768", "element sh has 600 rows for 768 vertices"),
        ("element vertex 600", "element vertex 0", "0 rows"),
        ("element vertex 600\n", "element vertex 600\nproperty double more\n", "before the 600 rows of element sh"),
        ("property float max_b\n", "", "'max_b' of type F32 in element chunk"),
        ("property float max_z\n", "property double max_z\n", "'max_z' of type F32"),
        ("property uint packed_scale\n", "", "'packed_scale' of type U32 in element vertex"),
        ("property uchar f_rest_8\n", "", "8 properties f_rest_"),
        ("property uchar f_rest_3\n", "property uchar f_rest_9\n", "'f_rest_3' of type U8"),
        ("property uchar f_rest_3\n", "property list uchar uchar f_rest_3\n", "'f_rest_3' of type U8"),
        ("uchar f_rest_3\n", "uchar f_rest_4\n", "'f_rest_4' is declared twice"),
        ("f_rest_3\nproperty uchar f_rest_4\n", "f_rest_4\nproperty uchar f_rest_3\n", "'f_rest_3' not after"),
        ("element chunk", "element chunks", "without 'element chunk'"),
        ("binary_little_endian", "ascii", "only binary_little_endian"),
        ("binary_little_endian", "binary_big_endian", "only binary_little_endian"),
    ] {
        let changed = header.replacen(old, new, 1);
        assert_ne!(changed, header);
        let error = error_of(&[changed.as_bytes(), &bytes[header.len()..]].concat());
        assert!(error.contains(expected), "{expected}: {error}");
    }
    let all = [("chunk 3", "chunk 16777216"), ("vertex 600", "vertex 4294967295"), ("sh 600", "sh 4294967295")];
    let huge = all.iter().fold(header.clone(), |header, (old, new)| header.replacen(old, new, 1));
    let error = load(&[huge.as_bytes(), &bytes[header.len()..]].concat()).expect_err("huge");
    assert!(matches!(error, Error::Invalid { .. }) && error.to_string().contains("rows of element chunk"), "{error}");
}
