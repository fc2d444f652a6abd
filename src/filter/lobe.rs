//! Reflection lobes around a direction, as directions to look up and their weights.
//!
//! Samples are spread by a lobe's own density, and each is looked up in the mip whose texels have about the solid angle
//! that the sample stands for (filtered importance sampling: Křivánek and Colbert 2008, "Real-time Shading with Filtered
//! Importance Sampling", section 4). Both lobes are the same all around their axis, so that one set of samples serves every
//! texel. The samples are a Fibonacci lattice: the radius by strata, the azimuth by the golden angle.

use std::f64::consts::PI;

use glam::{DVec3, Vec3, Vec4};

use super::sampler::{LANES, Lanes, Sampler};

/// Solid angle of the texels that a sample looks up, over the sample's own. Filament takes 4 with fewer, scattered
/// samples; measured with 256 and more on a lattice, whose samples never clump, errors grow with it, and below 1/2 they
/// hang more and more on where a texel lies.
const TEXEL_PER_SAMPLE: f64 = 0.5;

/// The golden angle, in radians: 2 pi times (3 - sqrt 5) / 2.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;

/// A lobe around +Z.
#[derive(Debug, Clone)]
pub(super) struct Lobe {
    /// By mip; mips that no sample looks up have no entries.
    levels: Vec<Vec<Batch>>,
    /// Of all samples.
    weight: f32,
}

/// Directions of one mip, with their weights; unused lanes have the weight 0.
#[derive(Debug, Clone)]
struct Batch {
    directions: [Lanes; 3],
    weights: Lanes,
}

/// A direction of a lobe, its weight in the mean, and the density, per steradian, by which it was chosen.
struct Sample {
    direction: DVec3,
    weight: f64,
    density: f64,
}

impl Lobe {
    /// What GGX reflects to a viewer who looks along the normal (N = V = R), each direction weighted by the cosine to the
    /// normal: Karis 2013, "Real Shading in Unreal Engine 4", section "Image-Based Lighting". The density of half vectors is
    /// `D cos`, that of the reflected directions a quarter of D (Walter et al. 2007, equations 14 and 38, at N = V).
    pub fn ggx(roughness: f64, samples: u32, sizes: &[u32]) -> Self {
        // A lobe narrower than any texel; at 0 the density is no number.
        let alpha_squared = roughness.max(1e-3).powi(4);
        let lattice = lattice(samples).filter_map(|(u, azimuth)| {
            // Squared cosine of the half vector's angle, by inversion (Walter et al. 2007, equation 35).
            let cos2 = (1.0 - u) / (1.0 + (alpha_squared - 1.0) * u);
            let weight = 2.0 * cos2 - 1.0;
            let d = alpha_squared / (PI * (cos2 * (alpha_squared - 1.0) + 1.0).powi(2));
            (weight > 0.0).then(|| Sample { direction: polar(weight, azimuth), weight, density: d / 4.0 })
        });
        Self::new(lattice, samples, sizes)
    }

    /// What a Lambertian surface reflects: all directions by their cosine to the normal.
    pub fn lambert(samples: u32, sizes: &[u32]) -> Self {
        let lattice = lattice(samples).map(|(u, azimuth)| {
            let cosine = (1.0 - u).sqrt();
            Sample { direction: polar(cosine, azimuth), weight: 1.0, density: cosine / PI }
        });
        Self::new(lattice, samples, sizes)
    }

    /// `sizes` are those of the mips that will be looked up, the largest first.
    fn new(lattice: impl Iterator<Item = Sample>, samples: u32, sizes: &[u32]) -> Self {
        let mut levels: Vec<Vec<Batch>> = vec![Vec::new(); sizes.len()];
        let mut filled = vec![LANES; sizes.len()];
        let mut total = 0.0;
        for Sample { direction, weight, density } in lattice {
            // Mean edge of a texel that has the solid angle to look up, as a share of a face.
            let edge = (TEXEL_PER_SAMPLE / (f64::from(samples) * density) * 6.0 / (4.0 * PI)).sqrt();
            // Between two mips a sample is looked up in both.
            let lod = (f64::from(sizes[0]) * edge).log2().clamp(0.0, (sizes.len() - 1) as f64);
            let (finer, share) = (lod as usize, lod.fract());
            for (level, share) in [(finer, 1.0 - share), (finer + 1, share)] {
                let weight = (weight * share) as f32;
                if weight == 0.0 {
                    continue;
                }
                if filled[level] == LANES {
                    levels[level].push(Batch::EMPTY);
                    filled[level] = 0;
                }
                if let Some(batch) = levels[level].last_mut() {
                    batch.set(filled[level], direction, weight);
                    filled[level] += 1;
                    total += f64::from(weight);
                }
            }
        }
        Self { levels, weight: total as f32 }
    }

    /// The lobe's mean of what `mips` (those whose sizes the lobe was made for) show around the unit `normal`.
    #[inline(always)]
    pub fn mean(&self, mips: &[Sampler], normal: Vec3) -> Vec3 {
        let [tangent, bitangent] = tangents(normal);
        let mut sum = Vec4::ZERO;
        for (mip, batches) in mips.iter().zip(&self.levels) {
            for batch in batches {
                let [x, y, z] = &batch.directions;
                let mut turned = [Lanes([0.0; LANES]); 3];
                for (axis, lanes) in turned.iter_mut().enumerate() {
                    for i in 0..LANES {
                        lanes.0[i] = x.0[i] * tangent[axis] + y.0[i] * bitangent[axis] + z.0[i] * normal[axis];
                    }
                }
                mip.add_weighted(&turned, &batch.weights, &mut sum);
            }
        }
        sum.truncate() / self.weight
    }
}

impl Batch {
    const EMPTY: Self = Self {
        directions: [Lanes([0.0; LANES]), Lanes([0.0; LANES]), Lanes([1.0; LANES])],
        weights: Lanes([0.0; LANES]),
    };

    fn set(&mut self, lane: usize, direction: DVec3, weight: f32) {
        let axes = self.directions.iter_mut().zip(direction.to_array());
        axes.for_each(|(lanes, value)| lanes.0[lane] = value as f32);
        self.weights.0[lane] = weight;
    }
}

/// Points of [0, 1) x [0, 2 pi): strata and azimuths.
fn lattice(samples: u32) -> impl Iterator<Item = (f64, f64)> {
    (0..samples).map(move |i| ((f64::from(i) + 0.5) / f64::from(samples), f64::from(i) * GOLDEN_ANGLE))
}

fn polar(cosine: f64, azimuth: f64) -> DVec3 {
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    DVec3::new(sine * azimuth.cos(), sine * azimuth.sin(), cosine)
}

/// Two unit vectors that are at right angles to the unit `normal` and to each other. They turn without a break over the
/// whole sphere except straight down, so that the lattice's small errors make no seam (Frisvad 2012).
#[inline(always)]
fn tangents(normal: Vec3) -> [Vec3; 2] {
    let Vec3 { x, y, z } = normal;
    // Nearer to straight down, f32 has no digits left in 1 + y.
    if y < -0.999_999 {
        return [Vec3::X, Vec3::Z];
    }
    let a = 1.0 / (1.0 + y);
    let b = -x * z * a;
    [Vec3::new(1.0 - x * x * a, -x, b), Vec3::new(b, -z, 1.0 - z * z * a)]
}

#[cfg(test)]
mod tests {
    use glam::Vec3Swizzles;

    use super::*;

    #[test]
    fn tangents_and_normal_are_orthonormal() {
        for (u, azimuth) in lattice(3000) {
            let normal = polar(2.0 * u - 1.0, azimuth).xzy().as_vec3();
            let frame = glam::Mat3::from_cols(tangents(normal)[0], tangents(normal)[1], normal);
            let error = frame.transpose() * frame - glam::Mat3::IDENTITY;
            assert!(error.to_cols_array().into_iter().all(|e| e.abs() < 1e-3), "{normal}");
        }
    }

    /// The share of a lobe's weight within an angle t of its axis is sin^2 t for Lambert's, and for GGX's at alpha 1 too,
    /// where D is the same for all half vectors: both are then a hemisphere weighted by the cosine.
    #[test]
    fn samples_of_a_lobe_lie_where_its_density_says() {
        let lobes = [Lobe::lambert(4096, &[16]), Lobe::ggx(1.0, 4096, &[16])];
        for (lobe, cosine) in lobes.iter().flat_map(|lobe| [0.9, 0.5, 0.1].map(|cosine| (lobe, cosine))) {
            let inside: f32 = weights(lobe).filter(|(z, _)| *z > cosine).map(|(_, weight)| weight).sum();
            assert!((inside / lobe.weight - (1.0 - cosine * cosine)).abs() < 2e-3, "{cosine}");
        }
    }

    /// Cosine to the axis and weight of every sample.
    fn weights(lobe: &Lobe) -> impl Iterator<Item = (f32, f32)> + '_ {
        let batches = lobe.levels.iter().flatten();
        batches.flat_map(|batch| batch.directions[2].0.into_iter().zip(batch.weights.0))
    }
}
