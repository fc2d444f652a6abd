//! SPZ.

use std::io::Write;

use flate2::Compression;
use flate2::write::GzEncoder;
use half::f16;
use ruzstd::encoding::{CompressionLevel, compress_to_vec};
use splatprobe::scene::sh::coefficient_count;

use super::Known;

pub const FRACTIONAL_BITS: u8 = 12;

fn header(version: u32, count: usize, degree: u8, flags: u8) -> Vec<u8> {
    let mut bytes = b"NGSP".to_vec();
    bytes.extend(version.to_le_bytes());
    bytes.extend((count as u32).to_le_bytes());
    bytes.extend([degree, FRACTIONAL_BITS, flags, 0]);
    bytes
}

/// Positions, opacities, colours, scales, rotations, harmonics.
fn attributes(version: u32, gaussians: &[Known]) -> [Vec<u8>; 6] {
    let mut out: [Vec<u8>; 6] = Default::default();
    for gaussian in gaussians {
        for value in gaussian.mean.to_array() {
            match version {
                1 => out[0].extend(f16::from_f64(value).to_le_bytes()),
                _ => out[0].extend(&((value * 4096.0).round() as i32).to_le_bytes()[..3]),
            }
        }
        out[1].push((gaussian.opacity * 255.0).round() as u8);
        let per_channel = gaussian.sh.len() / 3;
        out[2].extend([0, 1, 2].map(|c| ((gaussian.sh[c * per_channel] * 0.15 + 0.5) * 255.0).round() as u8));
        out[3].extend(gaussian.deviations.to_array().map(|value| ((value.ln() + 10.0) * 16.0).round() as u8));
        let [x, y, z, w] = gaussian.rotation.to_array();
        if version <= 2 {
            out[4].extend([x, y, z].map(|q| (q * w.signum() * 127.5 + 127.5).round() as u8));
        } else {
            out[4].extend(smallest_three([x, y, z, w]).to_le_bytes());
        }
        for (k, c) in (1..per_channel).flat_map(|k| (0..3).map(move |c| (k, c))) {
            out[5].push((gaussian.sh[c * per_channel + k] * 128.0 + 128.0).round() as u8);
        }
    }
    out
}

fn smallest_three(xyzw: [f64; 4]) -> u32 {
    let largest = (0..4).fold(0, |best, i| if xyzw[i].abs() > xyzw[best].abs() { i } else { best });
    (0..4).filter(|&i| i != largest).fold(largest as u32, |word, i| {
        let value = xyzw[i] * xyzw[largest].signum() * std::f64::consts::SQRT_2;
        word << 10 | u32::from(value < 0.0) << 9 | (value.abs() * 511.0).round() as u32
    })
}

fn degree_of(gaussians: &[Known]) -> u8 {
    (0..=4).find(|&degree| 3 * coefficient_count(degree) == gaussians[0].sh.len()).expect("a degree")
}

pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).expect("compressed");
    encoder.finish().expect("compressed")
}

/// Versions 1 to 3 without gzip, with `trailer` behind the attributes.
pub fn uncompressed(version: u32, gaussians: &[Known], flags: u8, trailer: &[u8]) -> Vec<u8> {
    let attributes = attributes(version, gaussians).concat();
    [header(version, gaussians.len(), degree_of(gaussians), flags), attributes, trailer.to_vec()].concat()
}

/// Version 4 with `records` of extensions.
pub fn version_4(gaussians: &[Known], flags: u8, records: &[u8]) -> Vec<u8> {
    let attributes = attributes(4, gaussians).map(|stream| (stream.len(), zstd(&stream)));
    let degree = degree_of(gaussians);
    let stored = if degree == 0 { &attributes[..5] } else { &attributes[..] };
    let mut bytes = header(4, gaussians.len(), degree, flags);
    bytes[15] = stored.len() as u8;
    bytes.extend((32 + records.len() as u32).to_le_bytes());
    bytes.extend([0; 12]);
    bytes.extend(records);
    for (size, stream) in stored {
        bytes.extend((stream.len() as u64).to_le_bytes());
        bytes.extend((*size as u64).to_le_bytes());
    }
    bytes.extend(stored.iter().flat_map(|(_, stream)| stream));
    bytes
}

pub fn zstd(bytes: &[u8]) -> Vec<u8> {
    compress_to_vec(bytes, CompressionLevel::Fastest)
}

/// A file of `version`, wrapped as its writers do.
pub fn file(version: u32, gaussians: &[Known]) -> Vec<u8> {
    if version == 4 { version_4(gaussians, 0, &[]) } else { gzip(&uncompressed(version, gaussians, 0, &[])) }
}
