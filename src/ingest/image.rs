//! PNG and JPEG to pixels, within limits that a hostile header cannot move.

use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

use image::{ColorType, DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use crate::{Error, Result};

/// Largest width and height, in pixels.
const MAX_EDGE: u32 = 16_384;

/// What decoding one image may allocate, in bytes.
const MAX_IMAGE_BYTES: u64 = 512 << 20;

/// What all images of a file may take, in bytes of decoded pixels.
const MAX_FILE_BYTES: u64 = 4 << 30;

/// Most pixels that a byte of a file can stand for: DEFLATE expands by 1032 at most, and PNG packs 8 pixels into a
/// byte. JPEG stays below.
const MAX_PIXELS_PER_BYTE: u64 = 1032 * 8;

/// A decoded image.
#[derive(Clone)]
pub struct Pixels {
    /// Pixels per row.
    pub width: u32,
    /// Rows from the top.
    pub height: u32,
    /// RGBA, row by row, as encoded.
    pub rgba: Arc<[[u8; 4]]>,
    /// What the image has itself: grey fills red, green and blue, and alpha is 255 without one.
    pub colour_type: ColorType,
}

/// Decodes the images of one file, and counts what they take.
#[derive(Default)]
pub struct ImageDecoding {
    bytes: u64,
}

impl ImageDecoding {
    /// The image in `bytes`, which `here` in the file at `path` uses.
    pub fn decode(&mut self, path: &Path, bytes: &[u8], here: &str) -> Result<Pixels> {
        let broken = |e: image::ImageError| Error::invalid(path, here, format!("it cannot be decoded: {e}"));
        let format =
            image::guess_format(bytes).map_err(|_| Error::invalid(path, here, "it is neither PNG nor JPEG"))?;
        if !matches!(format, ImageFormat::Png | ImageFormat::Jpeg) {
            return Err(Error::unsupported(path, format!("{here} is {format:?}; convert it to PNG or JPEG")));
        }
        let mut limits = Limits::default();
        limits.max_image_width = Some(MAX_EDGE);
        limits.max_image_height = Some(MAX_EDGE);
        limits.max_alloc = Some(MAX_IMAGE_BYTES);
        let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
        reader.limits(limits);
        let decoder = reader.into_decoder().map_err(broken)?;
        let (width, height) = decoder.dimensions();
        self.charge(path, u64::from(width) * u64::from(height), bytes.len() as u64, here)?;
        let colour_type = decoder.color_type();
        let rgba = DynamicImage::from_decoder(decoder).map_err(broken)?.into_rgba8().into_raw();
        Ok(Pixels { width, height, rgba: bytemuck::cast_slice(&rgba).into(), colour_type })
    }

    /// Refuses an image whose pixels its bytes cannot hold, or that is too large, before anything is allocated.
    fn charge(&mut self, path: &Path, pixels: u64, encoded_bytes: u64, here: &str) -> Result<()> {
        let too_large = |limit: u64| -> Error {
            Error::unsupported(
                path,
                format!("{here} has {pixels} pixels, past the limit of {} MiB; scale it down", limit >> 20),
            )
        };
        if pixels == 0 {
            return Err(Error::invalid(path, here, "it has no pixels"));
        }
        if pixels > encoded_bytes.saturating_mul(MAX_PIXELS_PER_BYTE) {
            let what = format!("its header promises {pixels} pixels, too many for its {encoded_bytes} bytes");
            return Err(Error::invalid(path, here, what));
        }
        self.bytes += pixels * 4;
        match (pixels * 4 > MAX_IMAGE_BYTES, self.bytes > MAX_FILE_BYTES) {
            (true, _) => Err(too_large(MAX_IMAGE_BYTES)),
            (_, true) => Err(too_large(MAX_FILE_BYTES)),
            _ => Ok(()),
        }
    }
}
