//! Radiance by latitude and longitude, as OpenEXR lays it (ImfEnvmap.h) but with texels at pixel centres.
//!
//! The top is straight up. The middle column looks along +Z, a quarter from the left along +X, three quarters along -X, the
//! left and right edges along -Z: `d = (sin lon cos lat, sin lat, cos lon cos lat)` with lon from pi to -pi.

use std::f64::consts::PI;
use std::path::Path;

use glam::{DVec3, Vec3};
use image::codecs::hdr::HdrEncoder;
use image::{ImageError, Rgb};
use rayon::prelude::*;

use super::file::write_bytes_atomically;
use crate::error::Result;
use crate::filter::Sampler;

/// Largest value that is written; the same as in half floats, so that all files of a probe agree.
const MAX: f32 = 65504.0;

/// An image by latitude and longitude, twice as wide as high.
#[derive(Debug, Clone, PartialEq)]
pub struct Latlong {
    /// Rows; a row has twice as many pixels.
    pub height: u32,
    /// Linear RGB, row by row.
    pub pixels: Vec<Vec3>,
}

impl Latlong {
    /// What `cubemap` shows, bilinearly.
    pub fn new(cubemap: &Sampler, height: u32) -> Self {
        Self::sampled(cubemap, height, 0.5)
    }

    /// The same with what is in the direction of a pixel's top left corner, for readers that take pixels to lie there.
    pub fn of_corners(cubemap: &Sampler, height: u32) -> Self {
        Self::sampled(cubemap, height, 0.0)
    }

    /// `at` is the place in each pixel whose direction it shows.
    fn sampled(cubemap: &Sampler, height: u32, at: f64) -> Self {
        let width = 2 * height as usize;
        let mut pixels = vec![Vec3::ZERO; width * height as usize];
        pixels.par_chunks_exact_mut(width).enumerate().for_each(|(y, row)| {
            for (x, pixel) in row.iter_mut().enumerate() {
                let place = [(x as f64 + at) / width as f64, (y as f64 + at) / f64::from(height)];
                *pixel = cubemap.radiance(direction(place).as_vec3());
            }
        });
        Self { height, pixels }
    }

    /// The same image with its columns moved to the right by `quarters` of the width, for those who look along another axis
    /// in its middle. The width must be a multiple of 4.
    pub fn turned(mut self, quarters: usize) -> Self {
        let width = 2 * self.height as usize;
        self.pixels.chunks_exact_mut(width).for_each(|row| row.rotate_right(width / 4 * quarters));
        self
    }

    /// Writes Radiance RGBE: eight bits per channel and a shared exponent, rounded to the nearest, nothing below 0.
    /// Fails with [`crate::Error::Write`].
    pub fn write_hdr(&self, path: &Path) -> Result<()> {
        let pixels: Vec<Rgb<f32>> = self.pixels.iter().map(|&pixel| Rgb(rounded_to_rgbe(pixel))).collect();
        write_bytes_atomically(path, |writer| {
            let encoded = HdrEncoder::new(writer).encode(&pixels, 2 * self.height as usize, self.height as usize);
            encoded.map_err(|error| match error {
                ImageError::IoError(source) => source,
                other => std::io::Error::other(other),
            })
        })
    }
}

/// Unit direction of a place in the image, in shares of its width and height from the top left.
pub fn direction([u, v]: [f64; 2]) -> DVec3 {
    let (longitude, latitude) = (PI * (1.0 - 2.0 * u), PI * (0.5 - v));
    let radius = latitude.cos();
    DVec3::new(longitude.sin() * radius, latitude.sin(), longitude.cos() * radius)
}

/// The nearest colour that RGBE holds exactly. The encoder cuts digits off, which would make every image darker.
fn rounded_to_rgbe(colour: Vec3) -> [f32; 3] {
    let colour = colour.clamp(Vec3::ZERO, Vec3::splat(MAX));
    let largest = colour.max_element();
    if largest < f32::MIN_POSITIVE {
        return [0.0; 3];
    }
    let unit = (largest.log2().floor() - 7.0).exp2();
    // Rounding may carry into a ninth bit.
    let unit = if (largest / unit).round() > 255.0 { 2.0 * unit } else { unit };
    ((colour / unit).round() * unit).to_array()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filter::RgbCubemap;

    #[test]
    fn the_axes_lie_where_openexr_has_them() {
        let places =
            [([0.5, 0.5], DVec3::Z), ([0.25, 0.5], DVec3::X), ([0.75, 0.5], DVec3::NEG_X), ([0.0, 0.5], DVec3::NEG_Z)];
        let poles = [([0.3, 0.0], DVec3::Y), ([0.8, 1.0], DVec3::NEG_Y)];
        for (place, expected) in places.into_iter().chain(poles) {
            assert!((direction(place) - expected).length() < 1e-12, "{place:?}");
        }
    }

    #[test]
    fn a_direction_coded_cubemap_stays_one() {
        let latlong = Latlong::new(&Sampler::new(&RgbCubemap::from_fn(64, |d| d.as_vec3())), 64);
        for (i, pixel) in latlong.pixels.iter().enumerate() {
            let expected = direction([(i as f64 % 128.0 + 0.5) / 128.0, ((i / 128) as f64 + 0.5) / 64.0]);
            // A texel of the cubemap is 1/32 wide.
            assert!(pixel.as_dvec3().angle_between(expected) < 1.0 / 64.0);
        }
    }

    #[test]
    fn radiance_files_hold_the_nearest_colours() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.hdr");
        let pixels: Vec<Vec3> = (0..32)
            .map(|i| Vec3::new(1.0, 0.3, 0.01 * i as f32) * (i as f32 - 12.0).exp2())
            .chain([Vec3::NEG_ONE; 96])
            .collect();
        Latlong { height: 8, pixels: pixels.clone() }.write_hdr(&path).unwrap();
        let read = image::open(&path).unwrap().into_rgb32f();
        assert_eq!(read.dimensions(), (16, 8));
        for (pixel, expected) in read.pixels().zip(pixels) {
            let expected = expected.clamp(Vec3::ZERO, Vec3::splat(MAX));
            // Half a unit of eight bits: of the largest channel, 1/256.
            let error = (Vec3::from(pixel.0) - expected).abs().max_element();
            assert!(error <= expected.max_element() / 255.0, "{pixel:?} is not {expected}");
        }
    }
}
