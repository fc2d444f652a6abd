//! RGBD: high dynamic range in 8-bit images, as EXT_lights_image_based and Babylon.js take it.
//!
//! A colour is stored divided by a factor that alpha holds the inverse of: `linear = (rgb / 255)^2.2 / (a / 255)`
//! (Babylon.js, toRGBD and fromRGBD in helperFunctions). Alpha is full where the colour is at most 1.

use glam::Vec3;
use image::{Rgba, RgbaImage};

/// Exponent between stored and linear colours.
const GAMMA: f32 = 2.2;

/// Largest colour that alpha can scale back.
pub const MAX: f32 = 255.0;

/// A row-by-row image of linear colours as RGBD, `width` wide. What is negative becomes 0, what is above [`MAX`] that.
pub fn encode(width: u32, pixels: &[Vec3]) -> RgbaImage {
    let mut image = RgbaImage::new(width, pixels.len() as u32 / width);
    for (stored, &colour) in image.pixels_mut().zip(pixels) {
        *stored = rgbd(colour);
    }
    image
}

fn rgbd(colour: Vec3) -> Rgba<u8> {
    let colour = colour.clamp(Vec3::ZERO, Vec3::splat(MAX));
    // Rounded down, so that no channel is above 1 once it is multiplied by it.
    let alpha = (255.0 / colour.max_element().max(1.0)).floor();
    let byte = |linear: f32| ((linear * alpha / 255.0).powf(1.0 / GAMMA) * 255.0).round() as u8;
    Rgba([byte(colour.x), byte(colour.y), byte(colour.z), alpha as u8])
}

/// The linear colour that four bytes stand for.
pub fn decode(Rgba([r, g, b, a]): Rgba<u8>) -> Vec3 {
    let linear = |byte: u8| (f32::from(byte) / 255.0).powf(GAMMA);
    Vec3::new(linear(r), linear(g), linear(b)) * (255.0 / f32::from(a.max(1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_come_back_within_the_steps_of_eight_bits() {
        let values: Vec<Vec3> = (0..400).map(|i| Vec3::new(1.0, 0.5, 0.1) * 0.01 * (i as f32 / 40.0).exp2()).collect();
        let image = encode(20, &values);
        assert_eq!(image.dimensions(), (20, 20));
        for (&stored, expected) in image.pixels().zip(values) {
            let alpha = f32::from(stored[3]) / 255.0;
            for (found, expected) in decode(stored).to_array().into_iter().zip(expected.to_array()) {
                // Half a step of the stored value s, whose linear slope is 2.2 s^1.2.
                let slope = GAMMA * (expected * alpha).powf(1.0 - 1.0 / GAMMA);
                assert!((found - expected).abs() <= 0.51 / 255.0 * slope / alpha + 1e-5, "{found} is not {expected}");
            }
        }
    }

    #[test]
    fn what_cannot_be_stored_is_the_nearest_that_can() {
        assert_eq!(decode(rgbd(Vec3::new(-1.0, 0.0, 1e9))), Vec3::new(0.0, 0.0, MAX));
    }
}
