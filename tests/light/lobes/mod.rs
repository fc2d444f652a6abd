//! Reflection lobes integrated by brute force, for the tests and the bench of the filter.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use splatprobe::filter::cubemap::solid_angles;
use splatprobe::filter::{RgbCubemap, Sampler};
use splatprobe::trace::Face;

use crate::common::Random;

/// A room: gradients, fine detail, a window 20 times as bright, and a lamp of 5 degrees 100 times as bright.
pub fn room(d: DVec3) -> Vec3 {
    let wall = DVec3::new(0.5, 0.4, 0.3) + 0.2 * d + 0.1 * (d * 19.0).map(f64::sin);
    let window = d.x > 0.7 && d.y.abs() < 0.3 && d.z.abs() < 0.4;
    let lamp = d.dot(DVec3::new(0.2, 0.9, -0.3).normalize()) > 5_f64.to_radians().cos();
    let light = f64::from(u8::from(window)) * DVec3::new(8.0, 9.0, 10.0) + f64::from(u8::from(lamp)) * 50.0;
    (wall + light).as_vec3()
}

/// A lobe's mean of what is bilinearly between the texels, around `normal`: midpoints of `steps^2` pieces of every texel.
/// `weight` is the lobe's, by the cosine of the angle to the normal.
pub fn brute_force(cubemap: &RgbCubemap, normal: DVec3, steps: u32, weight: impl Fn(f64) -> f64) -> DVec3 {
    let sampler = Sampler::new(cubemap);
    let size = cubemap.size() * steps;
    let angles = solid_angles(size);
    let n = size as usize;
    let (mut sum, mut total) = (DVec3::ZERO, 0.0);
    for face in Face::ALL {
        for (i, angle) in angles.iter().enumerate() {
            let d = face.direction(size, (i % n) as f64 + 0.5, (i / n) as f64 + 0.5).normalize();
            let weight = weight(d.dot(normal));
            if weight > 0.0 {
                sum += sampler.radiance(d.as_vec3()).as_dvec3() * (weight * angle);
                total += weight * angle;
            }
        }
    }
    sum / total
}

/// GGX at N = V = R: D of the half vector, times the cosine to the normal.
pub fn ggx(roughness: f64) -> impl Fn(f64) -> f64 {
    let alpha_squared = roughness.powi(4);
    // What lies below a hundred-millionth of the lobe's peak adds less than a millionth to its integral.
    let peak = 1.0 / alpha_squared;
    move |cosine: f64| {
        if cosine <= 0.0 {
            return 0.0;
        }
        let half2 = (1.0 + cosine) / 2.0;
        let d = alpha_squared / (half2 * (alpha_squared - 1.0) + 1.0).powi(2);
        if d * cosine < 1e-8 * peak { 0.0 } else { d * cosine }
    }
}

/// Directions of some texels of a face of `size`, and what `cubemap` has there.
pub fn some_texels(cubemap: &RgbCubemap, count: usize) -> Vec<(DVec3, DVec3)> {
    let mut random = Random(u64::from(cubemap.size()));
    let n = cubemap.size() as usize;
    let mut pick = || {
        let (face, x, y) = (Face::ALL[random.below(6)], random.below(n), random.below(n));
        let d = face.direction(cubemap.size(), x as f64 + 0.5, y as f64 + 0.5).normalize();
        (d, cubemap.face(face)[y * n + x].as_dvec3())
    };
    (0..count).map(|_| pick()).collect()
}

/// RMS of the difference to `truth` over the truth's own mean, over texels and channels.
pub fn relative_rmse(texels: &[(DVec3, DVec3)], truth: impl Fn(DVec3) -> DVec3 + Sync) -> f64 {
    let sums: Vec<[f64; 2]> = texels
        .par_iter()
        .map(|&(d, found)| {
            let truth = truth(d);
            [(found - truth).length_squared(), truth.element_sum()]
        })
        .collect();
    let values = 3.0 * texels.len() as f64;
    let total = |k: usize| sums.iter().map(|sum| sum[k]).sum::<f64>() / values;
    total(0).sqrt() / total(1)
}
