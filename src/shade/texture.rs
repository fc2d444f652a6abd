//! Texture look-ups: wrap, nearest or bilinear, decoded before filtering, over the area that a ray stands for.

use glam::{Vec2, Vec4};

use crate::scene::texture::{Encoding, Level, MipFilter, Texture, Wrap};

/// What a texture shows whose pixels could not be decoded, until the bake ends with the error.
const BROKEN: Vec4 = Vec4::new(1.0, 0.0, 1.0, 1.0);

/// Most look-ups along the longer axis of an area. Beyond it the shorter axis is widened, which blurs. Graphics hardware
/// has the same limit.
const MAX_ANISOTROPY: f32 = 16.0;

/// The part of a texture that one look-up stands for: an ellipse around the point, given by two conjugate diameters in
/// texture coordinates. The default is the point alone.
#[derive(Debug, Default, Clone, Copy, PartialEq)]
pub struct UvArea {
    /// One diameter.
    pub along: Vec2,
    /// The other.
    pub across: Vec2,
}

/// Mean of `texture` over `area` around `uv`, linear and with alpha; (0, 0) is the top left corner of the image, (1, 1)
/// the bottom right. The sampler's filters decide how the mean is made.
///
/// The shorter diameter chooses the mip level, and look-ups spread along the longer one (EXT_texture_filter_anisotropic's
/// scheme). Decodes the image at the first call.
pub fn sample(texture: &Texture, uv: Vec2, area: UvArea) -> Vec4 {
    let Ok(levels) = texture.image.levels() else { return BROKEN };
    let at = |level: usize, uv: Vec2, nearest: bool| look_up(texture, &levels[level], uv, nearest);
    let size = Vec2::new(texture.image.width as f32, texture.image.height as f32);
    let in_texels = [area.along * size, area.across * size].map(|diameter| diameter.length());
    let (longer, shorter) = (in_texels[0].max(in_texels[1]), in_texels[0].min(in_texels[1]));
    // Also when the area is not a number.
    if !(longer > 1.0) {
        return at(0, uv, texture.filter.magnify_nearest);
    }
    let nearest = texture.filter.minify_nearest;
    if texture.filter.mips == MipFilter::None {
        return at(0, uv, nearest);
    }
    let width = shorter.max(1.0).max(longer / MAX_ANISOTROPY);
    let finest = (width.log2()).min((levels.len() - 1) as f32);
    let filtered = |uv: Vec2| match texture.filter.mips {
        MipFilter::Nearest => at(finest.round() as usize, uv, nearest),
        _ => {
            let (level, coarser) = (finest as usize, finest.fract());
            let fine = at(level, uv, nearest);
            if coarser == 0.0 { fine } else { fine.lerp(at(level + 1, uv, nearest), coarser) }
        }
    };
    // At least 1 also when the area is infinite and the quotient not a number.
    let count = (longer / width).ceil().max(1.0);
    let diameter = if in_texels[0] >= in_texels[1] { area.along } else { area.across };
    let mut sum = Vec4::ZERO;
    for i in 0..count as u32 {
        sum += filtered(uv + diameter * ((i as f32 + 0.5) / count - 0.5));
    }
    sum / count
}

/// One level of `texture` at a point.
fn look_up(texture: &Texture, level: &Level, uv: Vec2, nearest: bool) -> Vec4 {
    // Chosen once for all four texels.
    match texture.image.encoding {
        Encoding::Srgb => look_up_with(texture.wrap, level, uv, nearest, |texel| Encoding::Srgb.decode(texel)),
        Encoding::Linear => look_up_with(texture.wrap, level, uv, nearest, |texel| Encoding::Linear.decode(texel)),
    }
}

#[inline(always)]
fn look_up_with(wraps: [Wrap; 2], level: &Level, uv: Vec2, nearest: bool, decode: impl Fn([u8; 4]) -> Vec4) -> Vec4 {
    let (width, height) = (level.width as i32, level.height as i32);
    // Keeps the arithmetic in i32 for any number that a file's coordinates and transforms can make.
    let bounded = |v: f32| if v.is_nan() { 0.0 } else { v.clamp(-1e9, 1e9) };
    let (x, y) = (bounded(uv.x * width as f32), bounded(uv.y * height as f32));
    let texel = |x: i32, y: i32| {
        let (x, y) = (wrap(wraps[0], x, width), wrap(wraps[1], y, height));
        decode(level.texels[y as usize * level.width + x as usize])
    };
    if nearest {
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
    use std::sync::Arc;

    use super::*;
    use crate::scene::colour::srgb_to_linear;
    use crate::scene::texture::{Filter, Image};

    /// A 4 x 2 texture whose texel (x, y) has red code 40 x + 10, green code 100 y and alpha 255 - 30 x.
    fn texture(mode: Wrap, nearest: bool) -> Texture {
        let rgba = (0..8u8).map(|i| [40 * (i % 4) + 10, 100 * (i / 4), 7, 255 - 30 * (i % 4)]).collect();
        textured(4, 2, rgba, mode, Filter { magnify_nearest: nearest, ..Filter::default() })
    }

    fn textured(width: u32, height: u32, rgba: Vec<[u8; 4]>, mode: Wrap, filter: Filter) -> Texture {
        let image = Arc::new(Image::new(width, height, Encoding::Srgb, || Ok(rgba)));
        Texture { image, wrap: [mode; 2], filter }
    }

    /// At the point alone.
    fn sample(texture: &Texture, uv: Vec2) -> Vec4 {
        super::sample(texture, uv, UvArea::default())
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

    #[test]
    fn no_area_panics_or_gives_a_colour_that_is_not_finite() {
        let numbers = [0.0, f32::NAN, f32::INFINITY, f32::MAX, 1e-30, 0.5, 1e9];
        for (along, across) in numbers.iter().flat_map(|&along| numbers.map(|across| (along, across))) {
            let area = UvArea { along: Vec2::new(along, 0.0), across: Vec2::new(0.0, across) };
            let found = super::sample(&texture(Wrap::Repeat, false), Vec2::splat(0.3), area);
            assert!(found.is_finite(), "{area:?}: {found}");
        }
    }

    fn checker(mips: MipFilter) -> Texture {
        let rgba = (0..64 * 64).map(|i| [if (i % 64 + i / 64) % 2 == 0 { 255 } else { 0 }; 4]).collect();
        textured(64, 64, rgba, Wrap::Repeat, Filter { mips, ..Filter::default() })
    }

    #[test]
    fn a_checker_over_many_texels_is_its_mean_in_linear_light() {
        for mips in [MipFilter::Linear, MipFilter::Nearest] {
            let texture = checker(mips);
            for width in [4.0, 8.0, 64.0, 1e6] {
                for (along, across) in [(width, width), (width, 4.0 * width), (0.5, width)] {
                    let area = UvArea { along: Vec2::X * along / 64.0, across: Vec2::Y * across / 64.0 };
                    let found = super::sample(&texture, Vec2::new(0.123, 0.456), area);
                    // Half the light, within half an sRGB code: (188.5 / 255)^2.4 is 0.507.
                    assert!((found.x - 0.5).abs() < 0.005, "{mips:?} {area:?}: {found}");
                    assert!((found.w - 0.5).abs() < 0.003, "{mips:?} {area:?}: {found}");
                }
            }
        }
        let area = UvArea { along: Vec2::X, across: Vec2::Y };
        let aliased = super::sample(&checker(MipFilter::None), Vec2::splat(0.5 / 64.0), area);
        assert_eq!(aliased, Vec4::ONE, "a sampler without mips reads the image itself");
    }

    #[test]
    fn a_long_area_is_averaged_along_itself_and_stays_sharp_across() {
        // Black columns left, white right; an area 16 texels high and 1 wide sees the column it is in, and turned by 90
        // degrees the mean of both sides.
        let rgba = (0..64 * 64).map(|i| [if i % 64 < 32 { 0 } else { 255 }; 4]).collect();
        let texture = textured(64, 64, rgba, Wrap::Clamp, Filter::default());
        let at = |x: f32, along: Vec2, across: Vec2| {
            super::sample(&texture, Vec2::new(x / 64.0, 0.5), UvArea { along: along / 64.0, across: across / 64.0 }).x
        };
        let (high, wide) = (Vec2::Y * 16.0, Vec2::X * 16.0);
        assert_eq!([30.5, 33.5].map(|x| at(x, high, Vec2::X)), [0.0, 1.0]);
        assert!((at(32.0, wide, Vec2::Y) - 0.5).abs() < 1e-5);
        // A quarter of the area lies on the white side: 4 of 16 texels.
        assert!((at(28.0, wide, Vec2::Y) - 0.25).abs() < 1e-5);
        assert!((at(28.0, Vec2::Y, wide) - 0.25).abs() < 1e-5, "which diameter is the longer one does not matter");
    }
}
