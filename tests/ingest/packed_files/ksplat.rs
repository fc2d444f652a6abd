//! .ksplat.

use glam::DVec3;
use half::f16;
use splatprobe::scene::sh::C0;

use super::Known;

const BLOCK: f64 = 5.0;
const RANGE: u32 = 32767;
const SH_BOUNDS: [f32; 2] = [-1.25, 1.0];

/// Gaussians of a section, bucket by bucket: a bucket of `capacity` is full.
pub struct Section {
    pub gaussians: Vec<Known>,
    pub buckets: Vec<usize>,
    pub capacity: usize,
    pub degree: u8,
}

/// Puts `value` over the bytes from `at` on.
pub fn put(bytes: &mut [u8], at: usize, value: impl AsRef<[u8]>) {
    bytes[at..at + value.as_ref().len()].copy_from_slice(value.as_ref());
}

pub fn file(level: u16, sections: &[Section]) -> Vec<u8> {
    let mut bytes = vec![0; 4096 + 1024 * sections.len()];
    let total: usize = sections.iter().map(|section| section.gaussians.len()).sum();
    put(&mut bytes, 0, [0, 1]);
    for (at, value) in [(4, sections.len()), (8, sections.len()), (12, total), (16, total)] {
        put(&mut bytes, at, (value as u32).to_le_bytes());
    }
    put(&mut bytes, 20, level.to_le_bytes());
    put(&mut bytes, 36, SH_BOUNDS[0].to_le_bytes());
    put(&mut bytes, 40, SH_BOUNDS[1].to_le_bytes());
    for (number, section) in sections.iter().enumerate() {
        let header = 4096 + 1024 * number;
        let count = section.gaussians.len() as u32;
        put(&mut bytes, header, count.to_le_bytes());
        put(&mut bytes, header + 4, count.to_le_bytes());
        put(&mut bytes, header + 40, u16::from(section.degree).to_le_bytes());
        if level > 0 {
            let full = section.buckets.iter().filter(|&&length| length == section.capacity).count();
            let partial = section.buckets.len() - full;
            for (at, value) in [(8, section.capacity), (12, section.buckets.len()), (32, full), (36, partial)] {
                put(&mut bytes, header + at, (value as u32).to_le_bytes());
            }
            put(&mut bytes, header + 16, (BLOCK as f32).to_le_bytes());
            put(&mut bytes, header + 20, 12_u16.to_le_bytes());
            put(&mut bytes, header + 24, RANGE.to_le_bytes());
        }
        push_section(&mut bytes, level, section);
    }
    bytes
}

fn push_section(bytes: &mut Vec<u8>, level: u16, section: &Section) {
    let mut centres = Vec::new();
    let mut centre_of = Vec::new();
    let mut next = 0;
    for &length in &section.buckets {
        // Off the Gaussians, so that the wrong bucket shows.
        let centre = section.gaussians[next].mean + DVec3::new(0.5, -0.25, 0.125) * (centres.len() % 2) as f64;
        let centre = centre.as_vec3().as_dvec3();
        centres.push(centre);
        centre_of.extend(vec![centre; length]);
        next += length;
    }
    if level > 0 {
        let partial = section.buckets.iter().filter(|&&length| length != section.capacity);
        bytes.extend(partial.flat_map(|&length| (length as u32).to_le_bytes()));
        bytes.extend(centres.iter().flat_map(|centre| centre.as_vec3().to_array()).flat_map(f32::to_le_bytes));
    }
    for (gaussian, centre) in section.gaussians.iter().zip(centre_of.iter().chain(std::iter::repeat(&DVec3::ZERO))) {
        let [x, y, z, w] = gaussian.rotation.to_array();
        let numbers = [gaussian.deviations.to_array().as_slice(), &[w, x, y, z]].concat();
        if level == 0 {
            let numbers = gaussian.mean.to_array().into_iter().chain(numbers);
            bytes.extend(numbers.flat_map(|value| (value as f32).to_le_bytes()));
        } else {
            let steps = ((gaussian.mean - centre) / (BLOCK / 2.0) * f64::from(RANGE)).round() + f64::from(RANGE);
            bytes.extend(steps.to_array().into_iter().flat_map(|step| (step as u16).to_le_bytes()));
            bytes.extend(numbers.into_iter().flat_map(|value| f16::from_f64(value).to_le_bytes()));
        }
        let per_channel = gaussian.sh.len() / 3;
        bytes.extend([0, 1, 2].map(|c| ((0.5 + C0 * gaussian.sh[c * per_channel]) * 255.0).round() as u8));
        bytes.push((gaussian.opacity * 255.0).round() as u8);
        for (channel, range) in [1..4, 4..9].into_iter().flat_map(|band| (0..3).map(move |c| (c, band.clone()))) {
            for &value in gaussian.sh[channel * per_channel..][..per_channel].get(range).unwrap_or_default() {
                match level {
                    0 => bytes.extend((value as f32).to_le_bytes()),
                    1 => bytes.extend(f16::from_f64(value).to_le_bytes()),
                    _ => {
                        let [least, greatest] = SH_BOUNDS.map(f64::from);
                        bytes.push(((value - least) / (greatest - least) * 255.0).round() as u8);
                    }
                }
            }
        }
    }
}
