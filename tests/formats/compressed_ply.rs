use glam::DVec3;
use splatprobe::Error;
use splatprobe::job::Frame;
use splatprobe::scene::sh::C0;

use super::{Known, Tolerance, assert_holds, bits, error_of, known, load, load_raw};

/// Where the format lets writers choose.
#[derive(Clone, Copy, Default)]
pub struct Variant {
    /// Colours relative to each chunk's least and greatest.
    pub chunk_colours: bool,
    /// Another element before the chunks, and other columns beside the format's own.
    pub strangers: bool,
}

fn header(gaussians: &[Known], degree: u8, variant: Variant) -> String {
    let mut lines = vec!["ply".to_string(), "format binary_little_endian 1.0".into()];
    let mut columns = |element: &str, count: usize, kind: &str, names: &[String]| {
        lines.push(format!("element {element} {count}"));
        if variant.strangers {
            lines.push("property short stranger".into());
        }
        lines.extend(names.iter().map(|name| format!("property {kind} {name}")));
    };
    if variant.strangers {
        columns("camera", 3, "float", &[]);
    }
    let mut chunk = Vec::new();
    for name in ["", "scale_"] {
        for end in ["min", "max"] {
            chunk.extend(["x", "y", "z"].map(|axis| format!("{end}_{name}{axis}")));
        }
    }
    if variant.chunk_colours {
        chunk.extend(["min_r", "min_g", "min_b", "max_r", "max_g", "max_b"].map(String::from));
    }
    columns("chunk", gaussians.len().div_ceil(256), "float", &chunk);
    let vertex = ["position", "rotation", "scale", "color"].map(|name| format!("packed_{name}"));
    columns("vertex", gaussians.len(), "uint", &vertex);
    if degree > 0 {
        let count = gaussians[0].sh.len() - 3;
        columns("sh", gaussians.len(), "uchar", &(0..count).map(|i| format!("f_rest_{i}")).collect::<Vec<_>>());
    }
    lines.join("\n") + "\nend_header\n"
}

pub fn file(gaussians: &[Known], degree: u8, variant: Variant) -> Vec<u8> {
    let mut bytes = header(gaussians, degree, variant).into_bytes();
    let stranger: &[u8] = if variant.strangers { &[7, 9] } else { &[] };
    (0..3).for_each(|_| bytes.extend(stranger));
    let mut vertices = Vec::new();
    for chunk in gaussians.chunks(256) {
        let position = span(chunk.iter().map(|gaussian| gaussian.mean));
        let scale = span(chunk.iter().map(|gaussian| gaussian.deviations.ln()));
        let colours = span(chunk.iter().map(colour));
        let mut spans = vec![position, scale];
        spans.extend(variant.chunk_colours.then_some(colours));
        bytes.extend(stranger);
        let ends = spans.iter().flatten().flat_map(|end| end.to_array());
        bytes.extend(ends.flat_map(|value| (value as f32).to_le_bytes()));
        for gaussian in chunk {
            let colours = if variant.chunk_colours { colours } else { [DVec3::ZERO, DVec3::ONE] };
            let [r, g, b] = fraction(colour(gaussian), colours).map(|channel| steps(channel, 8));
            let words = [
                packed(fraction(gaussian.mean, position)),
                rotation(gaussian.rotation.to_array()),
                packed(fraction(gaussian.deviations.ln(), scale)),
                r << 24 | g << 16 | b << 8 | steps(gaussian.opacity, 8),
            ];
            vertices.extend(stranger);
            vertices.extend(words.into_iter().flat_map(u32::to_le_bytes));
        }
    }
    bytes.extend(vertices);
    for gaussian in gaussians.iter().filter(|_| degree > 0) {
        bytes.extend(stranger);
        let bands = gaussian.sh.chunks_exact(gaussian.sh.len() / 3).flat_map(|channel| &channel[1..]);
        bytes.extend(bands.map(|value| ((value / 8.0 + 0.5) * 256.0).floor().clamp(0.0, 255.0) as u8));
    }
    bytes
}

fn colour(gaussian: &Known) -> DVec3 {
    DVec3::from([0, 1, 2].map(|c| 0.5 + C0 * gaussian.sh[c * gaussian.sh.len() / 3]))
}

/// As f32 holds it.
fn span(values: impl Iterator<Item = DVec3> + Clone) -> [DVec3; 2] {
    let least = values.clone().fold(DVec3::MAX, DVec3::min);
    let greatest = values.fold(DVec3::MIN, DVec3::max);
    [least, greatest].map(|end| end.as_vec3().as_dvec3())
}

fn fraction(value: DVec3, [least, greatest]: [DVec3; 2]) -> [f64; 3] {
    // A chunk of one Gaussian spans nothing.
    ((value - least) / (greatest - least).max(DVec3::splat(1e-12))).clamp(DVec3::ZERO, DVec3::ONE).to_array()
}

fn steps(fraction: f64, bits: u32) -> u32 {
    (fraction * f64::from((1_u32 << bits) - 1)).round() as u32
}

fn packed([x, y, z]: [f64; 3]) -> u32 {
    steps(x, 11) << 21 | steps(y, 10) << 11 | steps(z, 11)
}

fn rotation([x, y, z, w]: [f64; 4]) -> u32 {
    let wxyz = [w, x, y, z];
    let largest = (0..4).fold(0, |best, i| if wxyz[i].abs() > wxyz[best].abs() { i } else { best });
    (0..4).filter(|&i| i != largest).fold(largest as u32, |word, i| {
        let value = wxyz[i] * wxyz[largest].signum() / std::f64::consts::SQRT_2 + 0.5;
        word << 10 | steps(value, 10)
    })
}

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
