//! Texture look-ups: wrap, nearest or bilinear, sRGB decoded before filtering.

use std::sync::LazyLock;

use glam::{Vec2, Vec4};

use crate::scene::colour::srgb_to_linear;
use crate::scene::mesh::{Texture, Wrap};

/// Linear value of each 8-bit sRGB code.
static LINEAR_OF_SRGB: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|code| srgb_to_linear(code as f32 / 255.0)));

/// Linear colour and alpha of `texture` at `uv`; (0, 0) is the top left corner of the image, (1, 1) the bottom right.
///
/// The texture is sampled as it is, without a footprint.
pub fn sample(texture: &Texture, uv: Vec2) -> Vec4 {
    let (width, height) = (texture.width as i32, texture.height as i32);
    // Keeps the arithmetic in i32 for any number that a file's coordinates and transforms can make.
    let bounded = |v: f32| if v.is_nan() { 0.0 } else { v.clamp(-1e9, 1e9) };
    let (x, y) = (bounded(uv.x * width as f32), bounded(uv.y * height as f32));
    let texel = |x: i32, y: i32| {
        let x = wrap(texture.wrap[0], x, width);
        let y = wrap(texture.wrap[1], y, height);
        let [r, g, b, a] = texture.rgba[y as usize * width as usize + x as usize];
        let linear = |code: u8| LINEAR_OF_SRGB[usize::from(code)];
        Vec4::new(linear(r), linear(g), linear(b), f32::from(a) / 255.0)
    };
    if texture.nearest {
        return texel(x.floor() as i32, y.floor() as i32);
    }
    let (x, y) = (x - 0.5, y - 0.5);
    let (left, top) = (x.floor(), y.floor());
    let (right_weight, bottom_weight) = (x - left, y - top);
    let (left, top) = (left as i32, top as i32);
    let upper = texel(left, top).lerp(texel(left + 1, top), right_weight);
    let lower = texel(left, top + 1).lerp(texel(left + 1, top + 1), right_weight);
    upper.lerp(lower, bottom_weight)
}

/// The texel of a row of `size` that stands at `i`, which may lie outside.
fn wrap(mode: Wrap, i: i32, size: i32) -> i32 {
    match mode {
        Wrap::Repeat => i.rem_euclid(size),
        Wrap::Clamp => i.clamp(0, size - 1),
        Wrap::Mirror => {
            let i = i.rem_euclid(2 * size);
            i.min(2 * size - 1 - i)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A 4 x 2 texture whose texel (x, y) has red code 40 x + 10, green code 100 y and alpha 255 - 30 x.
    fn texture(mode: Wrap, nearest: bool) -> Texture {
        let rgba = (0..8u8).map(|i| [40 * (i % 4) + 10, 100 * (i / 4), 7, 255 - 30 * (i % 4)]).collect();
        Texture { width: 4, height: 2, rgba, wrap: [mode; 2], nearest }
    }

    fn expected(x: u8, y: u8) -> Vec4 {
        let linear = |code: u8| srgb_to_linear(f32::from(code) / 255.0);
        Vec4::new(linear(40 * x + 10), linear(100 * y), linear(7), f32::from(255 - 30 * x) / 255.0)
    }

    #[test]
    fn texel_centres_give_the_texels_in_both_filters() {
        for nearest in [false, true] {
            let texture = texture(Wrap::Repeat, nearest);
            for (x, y) in (0..4u8).flat_map(|x| (0..2u8).map(move |y| (x, y))) {
                let uv = Vec2::new((f32::from(x) + 0.5) / 4.0, (f32::from(y) + 0.5) / 2.0);
                assert_eq!(sample(&texture, uv), expected(x, y), "{x} {y} nearest {nearest}");
            }
        }
    }

    #[test]
    fn bilinear_filtering_averages_linear_light_not_codes() {
        let middle = sample(&texture(Wrap::Repeat, false), Vec2::new(0.25, 0.5));
        let mean = (expected(0, 0) + expected(1, 0) + expected(0, 1) + expected(1, 1)) / 4.0;
        assert!(middle.abs_diff_eq(mean, 1e-6));
        let of_mean_code = srgb_to_linear(30.0 / 255.0);
        assert!((middle.x - of_mean_code).abs() > 1e-3, "decoding after filtering would pass too");
    }

    #[test]
    fn wrap_modes_continue_the_row_as_their_names_say() {
        let rows = [
            (Wrap::Repeat, [0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3]),
            (Wrap::Clamp, [0, 0, 0, 0, 0, 1, 2, 3, 3, 3, 3, 3]),
            (Wrap::Mirror, [3, 2, 1, 0, 0, 1, 2, 3, 3, 2, 1, 0]),
        ];
        for (mode, row) in rows {
            for (i, &x) in row.iter().enumerate() {
                let u = (i as f32 - 4.0 + 0.5) / 4.0;
                for nearest in [false, true] {
                    let found = sample(&texture(mode, nearest), Vec2::new(u, 0.25));
                    assert_eq!(found, expected(x, 0), "{mode:?} at {u}");
                }
            }
        }
    }

    #[test]
    fn the_seam_of_a_repeated_texture_blends_the_last_texel_with_the_first() {
        let seam = sample(&texture(Wrap::Repeat, false), Vec2::new(1.0, 0.25));
        assert!(seam.abs_diff_eq((expected(3, 0) + expected(0, 0)) / 2.0, 1e-6));
        let edge = sample(&texture(Wrap::Clamp, false), Vec2::new(1.0, 0.25));
        assert_eq!(edge, expected(3, 0));
    }

    #[test]
    fn no_coordinate_panics_or_gives_a_colour_that_is_not_finite() {
        for mode in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
            for u in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, 1e9, -1e9, f32::MIN_POSITIVE] {
                for nearest in [false, true] {
                    assert!(sample(&texture(mode, nearest), Vec2::new(u, u)).is_finite(), "{mode:?} {u}");
                }
            }
        }
    }
}
