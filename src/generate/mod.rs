//! Scenes made by rule: interiors with the statistics of captured ones, and extremes, for tests and benches.
//!
//! The same settings give the same Gaussians on any number of threads.

mod paint;
mod plan;
pub(crate) mod random;

use std::f64::consts::TAU;

use glam::{DMat3, DQuat, DVec2, DVec3, Mat3, Vec3};
use rayon::prelude::*;

use crate::scene::{Splats, sh};

use paint::Lamp;
use plan::{Building, Part, Shape};
use random::Random;

pub use plan::ROOM;

/// Which interior to make.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InteriorSettings {
    /// How many Gaussians. More of them make the same building denser.
    pub gaussians: usize,
    /// How many rooms along x and z, at least 1, each [`ROOM`] metres large.
    pub rooms: [usize; 2],
    /// Pairs of neighbouring rooms that have no wall between them: corridors and halls. Rooms are counted along x and z.
    pub joined: &'static [[[usize; 2]; 2]],
    /// Spherical harmonics degree, 0 to [`sh::MAX_DEGREE`]. It changes no Gaussian's shape and no lower band.
    pub sh_degree: u8,
    /// Another seed is another building of the same kind.
    pub seed: u64,
    /// Factor on the Gaussians' standard deviations; 1 is a capture's. Sparse scenes need more to have no holes.
    pub gaussian_size: f64,
}

impl Default for InteriorSettings {
    /// A captured floor of 16 rooms: 1.5 million Gaussians of degree 3.
    fn default() -> Self {
        Self { gaussians: 1_500_000, rooms: [4, 4], joined: &[], sh_degree: 3, seed: 1, gaussian_size: 1.0 }
    }
}

/// [`InteriorSettings::joined`] of a building of 4 by 4 rooms: a corridor through all of it, an L-shaped hall of three, and
/// nine rooms.
pub const CORRIDOR_AND_HALL: &[[[usize; 2]; 2]] =
    &[[[0, 1], [1, 1]], [[1, 1], [2, 1]], [[2, 1], [3, 1]], [[0, 2], [1, 2]], [[1, 2], [1, 3]]];

/// Colour of a spherical harmonics DC coefficient of 1: `1 / (2 sqrt(pi))`.
const DC: f64 = 0.282_094_791_773_878_14;
/// Largest value of band 1's functions: `sqrt(3 / (4 pi))`.
const LINEAR: f64 = 0.488_602_511_902_919_9;

/// Quantiles of the logits of opacities, of the logarithms of the largest and of the smallest standard deviation in
/// metres, as measured in captured interiors.
const OPACITY_LOGIT: [(f64, f64); 6] = [(0.0, -4.9), (0.01, -2.95), (0.1, -1.9), (0.5, 0.84), (0.9, 5.55), (1.0, 9.5)];
const LARGEST_LN: [(f64, f64); 7] =
    [(0.0, -5.0), (0.01, -4.0), (0.16, -3.35), (0.5, -2.85), (0.84, -2.2), (0.99, -1.4), (1.0, -0.3)];
const SMALLEST_LN: [(f64, f64); 5] = [(0.0, -9.9), (0.05, -7.8), (0.5, -5.8), (0.95, -4.4), (1.0, -3.5)];
const SMALLEST_SD: f64 = 5e-5;
const LARGEST_SD: f64 = 10.0;

/// A furnished building with closed walls, in the canonical frame: from the origin towards +X and +Z, its floor at
/// y = 0. Room (i, k)'s middle lies at x = (i + 1/2) and z = (k + 1/2) times [`ROOM`]'s.
///
/// Surfaces are several layers of flat Gaussians, sized and as opaque as in a captured interior; at the default
/// settings a ray blends about 40 of them until its transmittance is below 0.001. Colours are display-encoded.
pub fn interior(settings: &InteriorSettings) -> Splats {
    assert!(!settings.rooms.contains(&0), "a building has at least one room");
    let building = Building::new(settings.rooms, settings.joined, settings.seed);
    let total: f64 = building.parts.iter().map(|part| part.weight).sum();
    let ends: Vec<usize> = building
        .parts
        .iter()
        .scan(0.0, |sum, part| {
            *sum += part.weight;
            Some((*sum / total * settings.gaussians as f64).round() as usize)
        })
        .collect();
    collect(settings.gaussians, settings.sh_degree, |i, coefficients| {
        let place = scattered(i, settings.gaussians);
        let index = ends.partition_point(|&end| end <= place).min(ends.len() - 1);
        let within = place - if index > 0 { ends[index - 1] } else { 0 };
        let part = &building.parts[index];
        let mut random = Random::new(settings.seed ^ 0x5eed, place as u64);
        let gaussian = cover(part, &building.lamps[part.room], within, settings.gaussian_size, &mut random);
        let part_seed = settings.seed.wrapping_add(index as u64);
        gaussian.write_colour(coefficients, &mut Random::new(part_seed, u64::MAX), &mut random);
        gaussian
    })
}

/// Gaussians as hard on numerics as any: standard deviations from 5e-5 to 5 m independently on each axis, any
/// rotation, 0.1 to 50 m from the origin, degree 3.
pub fn extreme(count: usize, seed: u64) -> Splats {
    collect(count, 3, |i, coefficients| {
        let mut random = Random::new(seed, i as u64);
        let gaussian = Gaussian {
            mean: random.direction() * random.log_range(0.1, 50.0),
            rotation: random.rotation(),
            sds: DVec3::from_array(std::array::from_fn(|_| random.log_range(SMALLEST_SD, 5.0))),
            opacity: random.range(0.01, 1.0),
            colour: DVec3::from_array(std::array::from_fn(|_| random.unit())),
            highlight: random.direction() * 0.2,
        };
        gaussian.write_colour(coefficients, &mut Random::new(seed, u64::MAX - i as u64), &mut random);
        gaussian
    })
}

/// A Gaussian with the broad strokes of its colour.
struct Gaussian {
    mean: DVec3,
    rotation: DQuat,
    sds: DVec3,
    opacity: f64,
    /// Display-encoded, the mean over all directions.
    colour: DVec3,
    /// What is added to the colour seen along this direction, times its cosine.
    highlight: DVec3,
}

impl Gaussian {
    /// Coefficients channel by channel: colour and highlight, and noise that falls from band to band, half of it
    /// common to the whole part (so that it survives blending) and half the Gaussian's own.
    fn write_colour(&self, coefficients: &mut [f32], part: &mut Random, own: &mut Random) {
        let per_channel = coefficients.len() / 3;
        // Band 1 of the basis is (-y, z, -x).
        let linear = DVec3::new(-self.highlight.y, self.highlight.z, -self.highlight.x) / LINEAR;
        for k in 0..per_channel {
            let band = k.isqrt();
            let noise = [0.0, 0.06, 0.04, 0.025, 0.015][band];
            for channel in 0..3 {
                let broad = match k {
                    0 => (self.colour[channel] - 0.5) / DC,
                    1..=3 => linear[k - 1],
                    _ => 0.0,
                };
                coefficients[channel * per_channel + k] = (broad + noise * (part.normal() + own.normal())) as f32;
            }
        }
    }
}

/// Makes `count` Gaussians in parallel; `make` gets an index and the Gaussian's coefficients to fill.
fn collect(count: usize, sh_degree: u8, make: impl Fn(usize, &mut [f32]) -> Gaussian + Sync) -> Splats {
    assert!(sh_degree <= sh::MAX_DEGREE, "spherical harmonics of degree {sh_degree}");
    let mut splats = Splats {
        means: vec![Vec3::ZERO; count],
        unit_from_world: vec![Mat3::ZERO; count],
        opacities: vec![0.0; count],
        sh_degree,
        sh: Vec::new(),
        linear: Vec::new(),
    };
    let stride = splats.sh_stride();
    splats.sh = vec![0.0; count * stride];
    let shapes = splats.means.par_iter_mut().zip(&mut splats.unit_from_world).zip(&mut splats.opacities);
    shapes.zip(splats.sh.par_chunks_mut(stride)).enumerate().for_each(|(i, (((mean, unit), opacity), sh))| {
        let gaussian = make(i, sh);
        *mean = gaussian.mean.as_vec3();
        *unit = Splats::unit_from_world(gaussian.rotation, gaussian.sds);
        *opacity = gaussian.opacity as f32;
    });
    splats
}

/// A permutation of 0..count that tears neighbours apart: captures come in no spatial order.
fn scattered(i: usize, count: usize) -> usize {
    // A prime larger than any count, so that it shares no factor with it.
    const PRIME: u128 = 2_654_435_761;
    (i as u128 * PRIME % count as u128) as usize
}

/// The `within`-th Gaussian on `part`.
fn cover(part: &Part, lamp: &Lamp, within: usize, gaussian_size: f64, random: &mut Random) -> Gaussian {
    let largest = random.quantile(&LARGEST_LN).exp() * part.grain * gaussian_size;
    let middle = largest * random.range(0.25, 1.0);
    let smallest = random.quantile(&SMALLEST_LN).exp();
    let opacity = part.opacity / (1.0 + (-random.quantile(&OPACITY_LOGIT)).exp());
    let limit = |sd: f64, extent: f64| sd.min(0.3 * extent).clamp(SMALLEST_SD, LARGEST_SD);
    match part.shape {
        Shape::Rectangle(corner, [right, up]) => {
            let size = DVec2::new(right.length(), up.length());
            let [right, up] = [right / size.x, up / size.y];
            let normal = right.cross(up);
            let largest = limit(largest, size.min_element());
            let sds = DVec3::new(largest, middle.min(largest), smallest.min(middle).min(largest));
            // Even cover by the R2 sequence (Roberts 2018); Gaussians end where the surface does.
            let share = (DVec2::new(0.754_877_666_246_692_7, 0.569_840_290_998_053_3) * (within + 1) as f64).fract();
            let at = (share * size).clamp(DVec2::splat(largest), size - largest);
            let depth = -0.008 * random.normal().abs();
            let turn = DQuat::from_rotation_z(random.range(0.0, TAU));
            let tilt = DQuat::from_scaled_axis(random.normal3() * 0.015);
            let mean = corner + right * at.x + up * at.y + normal * depth;
            let paint = part.paint.colour(at, size, random);
            let colour = if part.paint.shines() { paint } else { paint * lamp.shade(mean, normal) };
            Gaussian {
                mean,
                rotation: DQuat::from_mat3(&DMat3::from_cols(right, up, normal)) * tilt * turn,
                sds,
                opacity,
                colour,
                highlight: lamp.highlight(mean, normal) * 0.12,
            }
        }
        Shape::Blob { centre, radii, hollow } => {
            let outward = random.direction();
            let radius = random.range(hollow.powi(3), 1.0).cbrt();
            let mean = centre + outward * radius * radii;
            let largest = limit(largest, 2.0 * radii.min_element());
            let paint = part.paint.colour(DVec2::ZERO, DVec2::ONE, random);
            Gaussian {
                mean,
                rotation: random.rotation(),
                sds: DVec3::new(largest, middle.min(largest), smallest.min(middle).min(largest)),
                opacity,
                colour: if part.paint.shines() { paint } else { paint * lamp.shade(mean, outward) },
                highlight: DVec3::ZERO,
            }
        }
    }
}

#[cfg(test)]
mod tests;
