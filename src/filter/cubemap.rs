//! A cubemap of linear RGB alone, and the solid angles of its texels.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::trace::Face;

/// Linear radiance from every direction. All values are finite.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbCubemap {
    size: u32,
    texels: Vec<Vec3>,
}

impl RgbCubemap {
    /// A cubemap of `texels`: faces +X -X +Y -Y +Z -Z of `size` x `size` texels, each row by row from its top left, texels
    /// at pixel centres, linear RGB.
    ///
    /// Fails with [`Error::Request`] when there are not `6 size^2` texels or one of them is not finite.
    pub fn new(size: u32, texels: Vec<Vec3>) -> Result<Self> {
        let n = size as usize;
        if size == 0 || texels.len() != 6 * n * n {
            let why = format!("{} texels are not six faces of {size} x {size}", texels.len());
            return Err(Error::request("cubemap", why));
        }
        if let Some(at) = texels.iter().position(|texel| !texel.is_finite()) {
            let (face, x, y) = (Face::ALL[at / (n * n)], at % n, at / n % n);
            let why = format!("face {}, column {x}, row {y}: {} is not finite", face.name(), texels[at]);
            return Err(Error::request("cubemap", why));
        }
        Ok(Self { size, texels })
    }

    /// A cubemap whose texels are `radiance` of the unit direction through their centres. The values must be finite.
    pub fn from_fn(size: u32, radiance: impl Fn(DVec3) -> Vec3 + Sync) -> Self {
        Self::from_rows(size, |face, y, row| {
            for (x, texel) in row.iter_mut().enumerate() {
                *texel = radiance(direction(face, size, x, y));
            }
        })
    }

    /// A cubemap whose rows `fill` writes, in parallel, given face and row.
    pub(super) fn from_rows(size: u32, fill: impl Fn(Face, usize, &mut [Vec3]) + Sync) -> Self {
        let n = size as usize;
        let mut texels = vec![Vec3::ZERO; 6 * n * n];
        texels.par_chunks_exact_mut(n).enumerate().for_each(|(row, texels)| fill(Face::ALL[row / n], row % n, texels));
        Self { size, texels }
    }

    /// Texels along an edge of a face.
    pub fn size(&self) -> u32 {
        self.size
    }

    /// All texels in file order, as [`RgbCubemap::new`] takes them.
    pub fn texels(&self) -> &[Vec3] {
        &self.texels
    }

    /// The texels of one face, row by row.
    pub fn face(&self, face: Face) -> &[Vec3] {
        let len = (self.size as usize).pow(2);
        &self.texels[face as usize * len..][..len]
    }

    /// The same radiance in fewer texels: means of the texels under each new one, weighted by solid angle and by how
    /// much of them it covers. `size` is at most the cubemap's.
    pub fn reduced(&self, size: u32) -> Self {
        let (n, m) = (self.size as usize, size as usize);
        if n == m {
            return self.clone();
        }
        let weights = solid_angles(self.size);
        let spans: Vec<Vec<(usize, f64)>> = (0..m).map(|i| span(i, m, n)).collect();
        Self::from_rows(size, |face, y, row| {
            let face = self.face(face);
            for (texel, columns) in row.iter_mut().zip(&spans) {
                let (mut sum, mut total) = (DVec3::ZERO, 0.0);
                for &(from_y, share_y) in &spans[y] {
                    for &(from_x, share_x) in columns {
                        let weight = share_x * share_y * weights[from_y * n + from_x];
                        sum += face[from_y * n + from_x].as_dvec3() * weight;
                        total += weight;
                    }
                }
                *texel = (sum / total).as_vec3();
            }
        })
    }
}

/// Unit direction through the centre of a texel.
pub(super) fn direction(face: Face, size: u32, x: usize, y: usize) -> DVec3 {
    face.direction(size, x as f64 + 0.5, y as f64 + 0.5).normalize()
}

/// The old texels under new texel `i`, and how much of each it covers, when `n` texels become `m`.
fn span(i: usize, m: usize, n: usize) -> Vec<(usize, f64)> {
    let (start, end) = (i * n, (i + 1) * n);
    let covered = |old: usize| ((old + 1) * m).min(end) - (old * m).max(start);
    (start / m..end.div_ceil(m)).map(|old| (old, covered(old) as f64 / m as f64)).collect()
}

/// Solid angles in steradians of the texels of a face of `size` texels, row by row; all faces have the same. Those of six
/// faces add up to 4 pi.
///
/// Exact: differences at the texel's corners of the solid angle `atan2(x y, sqrt(x^2 + y^2 + 1))` of the rectangle from
/// the face's centre to (x, y) on the plane at distance 1.
pub fn solid_angles(size: u32) -> Vec<f64> {
    let n = size as usize;
    let edge = |i: usize| 2.0 * i as f64 / n as f64 - 1.0;
    let corner = |i: usize, j: usize| {
        let (x, y) = (edge(i), edge(j));
        (x * y).atan2((x * x + y * y + 1.0).sqrt())
    };
    let corners: Vec<f64> = (0..=n).flat_map(|j| (0..=n).map(move |i| corner(i, j))).collect();
    let at = |i: usize, j: usize| corners[j * (n + 1) + i];
    let texel = |i: usize, j: usize| at(i + 1, j + 1) - at(i, j + 1) - at(i + 1, j) + at(i, j);
    (0..n).flat_map(|j| (0..n).map(move |i| texel(i, j))).collect()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    #[test]
    fn solid_angles_add_up_to_the_sphere() {
        for size in [1, 2, 7, 64, 513] {
            let angles = solid_angles(size);
            let sum = 6.0 * angles.iter().sum::<f64>();
            assert!((sum / (4.0 * PI) - 1.0).abs() < 1e-12, "{size}: {sum}");
            assert!(angles.iter().all(|&angle| angle > 0.0));
        }
    }

    #[test]
    fn a_small_texels_solid_angle_is_its_area_times_the_cube_of_the_cosine() {
        let size = 256;
        let angles = solid_angles(size);
        for (x, y) in [(0, 0), (255, 3), (100, 40), (128, 128)] {
            let cosine = direction(Face::PosX, size, x, y).x;
            let expected = (2.0 / f64::from(size)).powi(2) * cosine.powi(3);
            assert!((angles[y * 256 + x] / expected - 1.0).abs() < 2e-5, "{x} {y}");
        }
    }

    #[test]
    fn texels_that_are_missing_or_not_finite_are_refused_with_their_place() {
        let mut texels = vec![Vec3::ONE; 6 * 16];
        assert!(RgbCubemap::new(4, texels.clone()).is_ok());
        for wrong in [0, 3, 5] {
            assert!(RgbCubemap::new(wrong, texels.clone()).is_err());
        }
        texels[16 + 4 * 2 + 3].y = f32::NAN;
        let error = RgbCubemap::new(4, texels).unwrap_err().to_string();
        assert!(error.contains("face -X, column 3, row 2"), "{error}");
    }

    #[test]
    fn a_reduction_keeps_the_mean_of_all_directions() {
        let mean = |cubemap: &RgbCubemap| {
            let angles = solid_angles(cubemap.size());
            let sum: DVec3 =
                cubemap.texels().iter().zip(angles.iter().cycle()).map(|(texel, &w)| texel.as_dvec3() * w).sum();
            sum / (4.0 * PI)
        };
        let source = RgbCubemap::from_fn(64, |d| ((d * 9.0).map(f64::sin) + 2.0).as_vec3());
        // Halves are exact; of the others, texels that two new ones share bring all of their radiance to both.
        for (size, tolerance) in [(32, 1e-6), (8, 1e-6), (1, 1e-6), (48, 2e-3), (7, 2e-3)] {
            let difference = (mean(&source.reduced(size)) / mean(&source) - 1.0).abs().max_element();
            assert!(difference < tolerance, "{size}: {difference}");
        }
    }
}
