//! Images with their mip levels, decoded when the first ray asks for them, and the samplers that read them.

use std::fmt;
use std::path::PathBuf;
use std::sync::{Arc, LazyLock};

use glam::Vec4;

use super::colour::{linear_to_srgb, srgb_to_linear};
use crate::Error;

/// An image with its sampler.
#[derive(Debug, Clone)]
pub struct Texture {
    /// The pixels. Textures that differ only in their sampler share them.
    pub image: Arc<Image>,
    /// Wrapping in u and v.
    pub wrap: [Wrap; 2],
    /// Which texels make a value.
    pub filter: Filter,
}

/// glTF's wrap modes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wrap {
    /// REPEAT, the default.
    Repeat,
    /// CLAMP_TO_EDGE.
    Clamp,
    /// MIRRORED_REPEAT.
    Mirror,
}

/// A sampler's filters. The default is the smoothest.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Filter {
    /// Nearest texel instead of bilinear, where texels are larger than the area asked for.
    pub magnify_nearest: bool,
    /// Nearest texel instead of bilinear, where they are smaller.
    pub minify_nearest: bool,
    /// Which mip levels are read where texels are smaller than the area asked for.
    pub mips: MipFilter,
}

/// How mip levels are used.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub enum MipFilter {
    /// Only the image itself: it aliases, as its sampler asks.
    None,
    /// The level that fits best.
    Nearest,
    /// The two that fit best, blended. The default.
    #[default]
    Linear,
}

/// What the three colour channels of an image mean. Alpha is always linear.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Encoding {
    /// Colour, sRGB-encoded.
    Srgb,
    /// Numbers: roughness, normals, masks.
    Linear,
}

/// An image of which only size and encoding are known until a look-up needs its pixels.
pub struct Image {
    /// Pixels per row.
    pub width: u32,
    /// Rows; row 0 is the top of the image.
    pub height: u32,
    /// What the pixels mean.
    pub encoding: Encoding,
    levels: LazyLock<Levels, Box<dyn FnOnce() -> Levels + Send>>,
}

/// The image and its mip levels, or why there are none.
type Levels = Result<Vec<Level>, BrokenImage>;

/// RGBA, 8 bit, row by row from the top, as encoded.
pub type Pixels = Vec<[u8; 4]>;

/// Why an image has no pixels: file, place in it, and what is wrong there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BrokenImage {
    /// The file that uses the image.
    pub path: PathBuf,
    /// Where in it.
    pub place: String,
    /// What is wrong.
    pub what: String,
}

impl BrokenImage {
    /// The same as an error.
    pub fn to_error(&self) -> Error {
        Error::invalid(&self.path, self.place.as_str(), self.what.as_str())
    }
}

/// An image, or half of the level before it, and so on down to one texel.
#[derive(Debug, Clone, PartialEq)]
pub struct Level {
    /// Texels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row, encoded as the image.
    pub texels: Pixels,
}

impl Image {
    /// An image of `width` x `height` pixels, which `decode` gives when they are first needed: as many as that.
    pub fn new(
        width: u32,
        height: u32,
        encoding: Encoding,
        decode: impl FnOnce() -> Result<Pixels, BrokenImage> + Send + 'static,
    ) -> Self {
        // No rayon in here: a worker that waits for its own parts may take up work that waits for this image.
        let levels = move || {
            let base = Level { width: width as usize, height: height as usize, texels: decode()? };
            assert_eq!(base.texels.len(), base.width * base.height, "a decoder gives the pixels that it promised");
            Ok(pyramid(base, encoding))
        };
        Self { width, height, encoding, levels: LazyLock::new(Box::new(levels)) }
    }

    /// The image and its mip levels, at least one, each half as wide and high as the one before it.
    pub fn levels(&self) -> Result<&[Level], &BrokenImage> {
        self.levels.as_ref().map(Vec::as_slice)
    }

    /// Whether a look-up has needed the pixels.
    pub fn is_decoded(&self) -> bool {
        LazyLock::get(&self.levels).is_some()
    }

    /// Why the pixels could not be decoded; `None` when they could or nobody needed them.
    pub fn failure(&self) -> Option<&BrokenImage> {
        LazyLock::get(&self.levels)?.as_ref().err()
    }
}

impl fmt::Debug for Image {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} x {} {:?}", self.width, self.height, self.encoding)
    }
}

/// Linear value of each 8-bit sRGB code.
static LINEAR_OF_SRGB: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|code| srgb_to_linear(code as f32 / 255.0)));

impl Encoding {
    /// Linear red, green, blue and alpha of a texel.
    #[inline]
    pub fn decode(self, [r, g, b, a]: [u8; 4]) -> Vec4 {
        let plain = |code: u8| f32::from(code) / 255.0;
        match self {
            Self::Linear => Vec4::new(plain(r), plain(g), plain(b), plain(a)),
            Self::Srgb => {
                let linear = &*LINEAR_OF_SRGB;
                let colour = [r, g, b].map(|code| linear[usize::from(code)]);
                Vec4::new(colour[0], colour[1], colour[2], plain(a))
            }
        }
    }

    /// The texel nearest to a linear value from 0 to 1.
    fn encode(self, linear: Vec4) -> [u8; 4] {
        let code = |value: f32| (value * 255.0).round() as u8;
        let colour = |value: f32| match self {
            Self::Linear => code(value),
            Self::Srgb => code(linear_to_srgb(value)),
        };
        [colour(linear.x), colour(linear.y), colour(linear.z), code(linear.w)]
    }
}

/// The mip levels of an image: each texel is the mean, in linear light, of the area that it covers.
fn pyramid(base: Level, encoding: Encoding) -> Vec<Level> {
    let (mut width, mut height) = (base.width, base.height);
    let mut linear: Vec<Vec4> = Vec::new();
    let mut levels = vec![base];
    while width > 1 || height > 1 {
        // Halved from unrounded values, so that rounding does not add up over the levels.
        linear = match &levels[..] {
            [base] => halved(|i| encoding.decode(base.texels[i]), width, height),
            _ => halved(|i| linear[i], width, height),
        };
        (width, height) = (half(width), half(height));
        levels.push(Level { width, height, texels: linear.iter().map(|&texel| encoding.encode(texel)).collect() });
    }
    levels
}

fn half(size: usize) -> usize {
    (size / 2).max(1)
}

/// Half of an image of `width` x `height` texels, whose texel i is `texel(i)`.
fn halved(texel: impl Fn(usize) -> Vec4, width: usize, height: usize) -> Vec<Vec4> {
    let columns: Vec<_> = (0..half(width)).map(|x| cover(width, x)).collect();
    let rows = (0..half(height)).map(|y| cover(height, y));
    rows.flat_map(|(top, row_weights)| {
        let (texel, columns) = (&texel, &columns);
        columns.iter().map(move |&(left, column_weights)| {
            let mut sum = Vec4::ZERO;
            for (y, row_weight) in row_weights.into_iter().enumerate().filter(|(_, weight)| *weight > 0.0) {
                for (x, weight) in column_weights.into_iter().enumerate().filter(|(_, weight)| *weight > 0.0) {
                    sum += texel((top + y) * width + left + x) * (row_weight * weight);
                }
            }
            sum
        })
    })
    .collect()
}

/// Which texels of a row of `size` texel `i` of half the row covers: the first, and the weights of up to three. An odd
/// row has no texel to spare, so each covers a little more than two.
fn cover(size: usize, i: usize) -> (usize, [f32; 3]) {
    let length = size as f64 / half(size) as f64;
    let (start, end) = (i as f64 * length, (i + 1) as f64 * length);
    let first = start as usize;
    let weight = |k: usize| {
        let (left, right) = ((first + k) as f64, (first + k + 1) as f64);
        let covered = (right.min(end) - left.max(start)) / length;
        // What rounding leaves over beyond the row's end is nothing.
        if first + k < size { covered.max(0.0) as f32 } else { 0.0 }
    };
    (first, [weight(0), weight(1), weight(2)])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn levels(width: u32, height: u32, encoding: Encoding, pixel: impl Fn(u32, u32) -> [u8; 4]) -> Vec<Level> {
        let pixels: Pixels =
            (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| pixel(x, y)).collect();
        Image::new(width, height, encoding, || Ok(pixels)).levels().unwrap().to_vec()
    }

    #[test]
    fn a_constant_image_is_constant_in_all_levels_down_to_one_texel() {
        for encoding in [Encoding::Srgb, Encoding::Linear] {
            for (width, height) in [(8, 8), (7, 5), (1, 9), (13, 1), (1, 1), (64, 3)] {
                for code in [0, 1, 7, 100, 254, 255] {
                    let levels = levels(width, height, encoding, |_, _| [code, 255 - code, 3, 128]);
                    let last = levels.last().unwrap();
                    assert_eq!((last.width, last.height), (1, 1));
                    let texels = levels.iter().flat_map(|level| &level.texels);
                    assert!(
                        texels.clone().all(|texel| *texel == [code, 255 - code, 3, 128]),
                        "{width} x {height} {code}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_checkers_mean_is_that_of_linear_light_and_of_plain_numbers() {
        let checker = |x: u32, y: u32| if (x + y).is_multiple_of(2) { [255; 4] } else { [0, 0, 0, 0] };
        let last = |encoding| levels(16, 16, encoding, checker).last().unwrap().texels[0];
        // Half of the light is sRGB code 188; half of a number is 128.
        assert_eq!(last(Encoding::Srgb), [188, 188, 188, 128]);
        assert_eq!(last(Encoding::Linear), [128; 4]);
    }

    #[test]
    fn odd_rows_weigh_every_texel_alike() {
        // A single bright texel weighs 1/7 of the row wherever it stands: 7 -> 3 -> 1.
        for bright in 0..7 {
            let levels = levels(7, 1, Encoding::Linear, |x, _| if x == bright { [255; 4] } else { [0; 4] });
            assert_eq!(levels.iter().map(|level| level.width).collect::<Vec<_>>(), [7, 3, 1]);
            assert_eq!(levels[2].texels[0], [36; 4], "{bright}");
        }
    }

    #[test]
    fn pixels_are_decoded_once_and_only_when_asked_for() {
        let count = Arc::new(std::sync::atomic::AtomicUsize::new(0));
        let counted = count.clone();
        let image = Image::new(1, 1, Encoding::Linear, move || {
            counted.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            Ok(vec![[1; 4]])
        });
        assert!(!image.is_decoded() && image.failure().is_none());
        for _ in 0..2 {
            image.levels().unwrap();
        }
        assert!(image.is_decoded());
        assert_eq!(count.load(std::sync::atomic::Ordering::Relaxed), 1);
    }
}
