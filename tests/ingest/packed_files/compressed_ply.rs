//! PlayCanvas compressed PLY.

use glam::DVec3;
use splatprobe::scene::sh::C0;

use super::Known;

/// Where the format lets writers choose.
#[derive(Clone, Copy, Default)]
pub struct Variant {
    /// Colours relative to each chunk's least and greatest.
    pub chunk_colours: bool,
    /// Another element before the chunks, and other columns beside the format's own.
    pub strangers: bool,
}

pub fn header(gaussians: &[Known], degree: u8, variant: Variant) -> String {
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
