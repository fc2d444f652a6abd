//! Radiance and irradiance in spherical harmonics.
//!
//! Signs are those of graphics engines: without the Condon-Shortley phase that splat files use ([`crate::scene::sh`]), so
//! that coefficients of odd m have the opposite sign. Order: L00, L1-1, L10, L11, L2-2, L2-1, L20, L21, L22, L3-3 ... L33.

use std::f64::consts::PI;

use glam::DVec3;
use rayon::prelude::*;

use super::cubemap::{RgbCubemap, direction, solid_angles};
use crate::scene::sh::{MAX_COEFFICIENTS, basis_f64, coefficient_count};
use crate::trace::Face;

/// Factors of the bands of a clamped cosine's convolution: Ramamoorthi and Hanrahan 2001, "An Efficient Representation for
/// Irradiance Environment Maps", equation 8. Band 3 does not reach irradiance.
const COSINE: [f64; 4] = [PI, 2.0 * PI / 3.0, PI / 4.0, 0.0];

/// Bisections of a window: the width is then known to a ten-thousandth.
const BISECTIONS: u32 = 16;

/// A window of this many bands dampens the last one by under a percent: there is nothing to dampen.
const WIDEST_WINDOW: f64 = 32.0;

/// Edge of the faces whose texels are where irradiance must not be negative.
const WINDOW_SIZE: u32 = 16;

/// Radiance as coefficients, each linear red, green, blue: `L_lm = integral of L(d) Y_lm(d)`.
#[derive(Debug, Clone, PartialEq)]
pub struct ShRadiance {
    degree: u8,
    coefficients: Vec<DVec3>,
}

impl ShRadiance {
    /// Projects a cubemap on the bands 0 to `degree` (at most 3), each texel weighted by its solid angle.
    pub fn project(cubemap: &RgbCubemap, degree: u8) -> Self {
        let (size, n) = (cubemap.size(), cubemap.size() as usize);
        let weights = solid_angles(size);
        let count = coefficient_count(degree.min(3));
        // Sums by row, then over rows in their order: the same for any number of threads.
        let rows: Vec<Vec<DVec3>> = (0..6 * n)
            .into_par_iter()
            .map(|row| {
                let (face, y) = (Face::ALL[row / n], row % n);
                let mut sums = vec![DVec3::ZERO; count];
                for (x, texel) in cubemap.face(face)[y * n..][..n].iter().enumerate() {
                    let values = basis(direction(face, size, x, y));
                    let weighted = texel.as_dvec3() * weights[y * n + x];
                    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += weighted * value);
                }
                sums
            })
            .collect();
        let mut coefficients = vec![DVec3::ZERO; count];
        for row in rows {
            coefficients.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
        }
        Self { degree: degree.min(3), coefficients }
    }

    /// The highest band.
    pub fn degree(&self) -> u8 {
        self.degree
    }

    /// The raw coefficients in the module's order.
    pub fn coefficients(&self) -> &[DVec3] {
        &self.coefficients
    }

    /// The radiance that the coefficients stand for, from the unit `direction`.
    pub fn radiance(&self, direction: DVec3) -> DVec3 {
        self.coefficients.iter().zip(basis(direction)).map(|(coefficient, value)| coefficient * value).sum()
    }

    /// Irradiance over pi on a surface with the unit `normal`.
    pub fn irradiance(&self, normal: DVec3) -> DVec3 {
        let by_band = self.bands().map(|(band, coefficient)| coefficient * (COSINE[band] / PI));
        by_band.zip(basis(normal)).map(|(coefficient, value)| coefficient * value).sum()
    }

    /// The coefficients dampened by band, so that light which is much brighter in one direction leaves no dark ring opposite
    /// of it: band l times `sinc(pi l / w)^4`, 0 from band w on, with the widest w for which the irradiance of every channel
    /// is nowhere negative (Sloan 2008, "Stupid Spherical Harmonics Tricks", section "Windowing"; Filament's CubemapSH.cpp).
    /// Returns the window's width beside them; `None` where the raw ones need none.
    pub fn windowed(&self) -> (Self, Option<f64>) {
        let normals: Vec<DVec3> = Face::ALL
            .into_iter()
            .flat_map(|face| {
                let n = WINDOW_SIZE as usize;
                (0..n * n).map(move |i| direction(face, WINDOW_SIZE, i % n, i / n))
            })
            .collect();
        let is_positive = |sh: &Self| normals.iter().all(|&normal| sh.irradiance(normal).min_element() >= 0.0);
        if is_positive(self) {
            return (self.clone(), None);
        }
        // At a width of 1 only the mean is left.
        let (mut narrow, mut wide) = (1.0, WIDEST_WINDOW);
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (narrow + wide);
            if is_positive(&self.with_window(middle)) { narrow = middle } else { wide = middle }
        }
        (self.with_window(narrow), Some(narrow))
    }

    fn with_window(&self, width: f64) -> Self {
        let factor = |band: usize| match band as f64 / width {
            0.0 => 1.0,
            share if share < 1.0 => ((PI * share).sin() / (PI * share)).powi(4),
            _ => 0.0,
        };
        let coefficients = self.bands().map(|(band, coefficient)| coefficient * factor(band)).collect();
        Self { degree: self.degree, coefficients }
    }

    /// Coefficients with their bands.
    fn bands(&self) -> impl Iterator<Item = (usize, DVec3)> + '_ {
        self.coefficients.iter().enumerate().map(|(i, &coefficient)| (i.isqrt(), coefficient))
    }
}

/// The basis of bands 0 to 3 in the module's order and signs.
fn basis(direction: DVec3) -> [f64; 16] {
    let mut values = [0.0; MAX_COEFFICIENTS];
    basis_f64(3, direction, &mut values);
    // m = i - l (l + 1) is odd where i and l (l + 1), which is even, differ by an odd number.
    std::array::from_fn(|i| if i % 2 == 1 { -values[i] } else { values[i] })
}
