//! Cubemaps convolved with reflection lobes.

use glam::Vec3;

use super::cubemap::{RgbCubemap, direction};
use super::lobe::Lobe;
use super::sampler::Sampler;
use crate::job::RoughnessCurve;
use crate::trace::Level;

/// Samples of the widest GGX lobe and of the Lambertian one, per texel. Narrower lobes take fewer in proportion to their
/// roughness: measured, the error is then about the same along a chain, well under 1 % of a room with a lamp 100 times as
/// bright as its walls (`tests/filter.rs`).
pub const SAMPLES: u32 = 2048;

/// Samples of the narrowest lobe, of [`SAMPLES`] of the widest.
const MIN_SAMPLES: u32 = 256;

/// A mip of a roughness chain.
#[derive(Debug, Clone, PartialEq)]
pub struct RoughnessMip {
    /// Perceptual roughness; GGX alpha is its square.
    pub roughness: f64,
    /// What a surface of that roughness reflects, by reflected direction.
    pub cubemap: RgbCubemap,
}

/// A cubemap prepared for convolution: its mips, each for look-ups.
#[derive(Debug, Clone)]
pub struct Prefilter {
    source: RgbCubemap,
    /// Of the widest lobes.
    samples: u32,
    /// Edges of the mips' faces; the first is the source's.
    sizes: Vec<u32>,
    mips: Vec<Sampler>,
}

impl Prefilter {
    /// Prepares `source`. Its size need not be a power of two.
    pub fn new(source: RgbCubemap) -> Self {
        let sizes: Vec<u32> = std::iter::successors(Some(source.size()), |&n| (n > 1).then_some(n / 2)).collect();
        let mut mips = Vec::with_capacity(sizes.len());
        let mut reduced = source.clone();
        for &size in &sizes {
            reduced = reduced.reduced(size);
            mips.push(Sampler::new(&reduced));
        }
        Self { source, samples: SAMPLES, sizes, mips }
    }

    /// The same with another number of samples than [`SAMPLES`].
    pub fn with_samples(self, samples: u32) -> Self {
        Self { samples, ..self }
    }

    /// Looks up the source without any convolution.
    pub fn mirror(&self) -> &Sampler {
        &self.mips[0]
    }

    /// The mean radiance over about `solid_angle` steradians around `direction`, which has unit length: between the two
    /// mips whose texels are nearest to it in size.
    pub fn mean_radiance(&self, direction: Vec3, solid_angle: f32) -> Vec3 {
        // Mean edge of a texel of that solid angle, in texels of the source.
        let edge = f64::from(self.sizes[0]) * (f64::from(solid_angle) * 6.0 / (4.0 * std::f64::consts::PI)).sqrt();
        let lod = edge.max(1.0).log2().min((self.sizes.len() - 1) as f64) as f32;
        let finer = self.mips[lod as usize].radiance(direction);
        match self.mips.get(lod as usize + 1) {
            Some(coarser) if lod.fract() > 0.0 => finer.lerp(coarser.radiance(direction), lod.fract()),
            _ => finer,
        }
    }

    /// What a surface of perceptual `roughness` (0 to 1) reflects, by reflected direction, in faces of `size` texels.
    ///
    /// The split sum's first part: the mean of radiance over GGX's lobe for N = V = R, weighted by the cosine and divided
    /// by the sum of weights, so that even light stays as it is. Roughness 0 is the source itself, reduced.
    pub fn specular(&self, roughness: f64, size: u32) -> RgbCubemap {
        if roughness == 0.0 && size <= self.source.size() {
            return self.source.reduced(size);
        }
        let least = self.samples / (SAMPLES / MIN_SAMPLES);
        let samples = ((f64::from(self.samples) * roughness) as u32).max(least).max(1);
        self.convolve(&Lobe::ggx(roughness, samples, &self.sizes), size)
    }

    /// Irradiance over pi, by normal: what a white Lambertian surface reflects.
    pub fn irradiance(&self, size: u32) -> RgbCubemap {
        self.convolve(&Lobe::lambert(self.samples, &self.sizes), size)
    }

    /// A chain of `count` mips, from the source's size by halves, with the roughnesses of `curve`; fewer where a single texel
    /// is reached before.
    pub fn chain(&self, curve: RoughnessCurve, count: u32) -> Vec<RoughnessMip> {
        // As many as there are halves, so that the last is the roughest.
        let count = count.min(self.sizes.len() as u32);
        let sizes = self.sizes.iter().zip(0..count);
        sizes
            .map(|(&size, index)| {
                let roughness = curve.roughness(index, count, size);
                RoughnessMip { roughness, cubemap: self.specular(roughness, size) }
            })
            .collect()
    }

    fn convolve(&self, lobe: &Lobe, size: u32) -> RgbCubemap {
        let level = Level::best();
        RgbCubemap::from_rows(size, |face, y, row| {
            level.run(Row { mips: &self.mips, lobe, normals: |x| direction(face, size, x, y).as_vec3(), row });
        })
    }
}

/// Convolves a row of texels, at an instruction level.
struct Row<'a, Normals> {
    mips: &'a [Sampler],
    lobe: &'a Lobe,
    normals: Normals,
    row: &'a mut [Vec3],
}

impl<Normals: Fn(usize) -> Vec3> pulp::WithSimd for Row<'_, Normals> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        for (x, texel) in self.row.iter_mut().enumerate() {
            *texel = self.lobe.mean(self.mips, (self.normals)(x));
        }
    }
}
