//! One lossless WebP image, decoded to the bytes that its pixels are.

use std::io::Cursor;
use std::ops::{Range, RangeInclusive};

use image_webp::WebPDecoder;

use super::files::Files;
use crate::error::{Error, Result};

/// 8-bit pixels, row by row from the top.
#[derive(Debug)]
pub(super) struct Image {
    pub width: usize,
    pub height: usize,
    /// 4 where the file has alpha, else 3: alpha is 255 then.
    channels: usize,
    bytes: Vec<u8>,
}

impl Image {
    /// Decodes `webp`, the content of the file `name`, exactly: colours stay where alpha is 0.
    ///
    /// # Errors
    /// [`Error::Invalid`] when it is broken, lossy, or has not as many pixels as `pixels` allows, which is asked before
    /// any is decoded; [`Error::Unsupported`] when it is no WebP.
    pub fn decode(files: &Files, name: &str, webp: &[u8], pixels: RangeInclusive<usize>) -> Result<Self> {
        if !webp.starts_with(b"RIFF") {
            let what = format!("image '{name}' is not WebP; write the SOG with splat-transform");
            return Err(Error::unsupported(files.path(), what));
        }
        let broken = |error: image_webp::DecodingError| files.invalid(name, error.to_string());
        let mut decoder = WebPDecoder::new(Cursor::new(webp)).map_err(broken)?;
        let (width, height) = decoder.dimensions();
        let (width, height) = (width as usize, height as usize);
        if decoder.is_animated() || decoder.is_lossy() {
            return Err(files.invalid(name, "a lossy or animated WebP: its pixels cannot be the numbers stored"));
        }
        if !width.checked_mul(height).is_some_and(|count| pixels.contains(&count)) {
            let (least, most) = pixels.into_inner();
            let what = format!("{width} x {height} pixels; meta.json asks for {least}, and allows {most}");
            return Err(files.invalid(name, what));
        }
        let channels = if decoder.has_alpha() { 4 } else { 3 };
        let mut bytes = vec![0; width * height * channels];
        decoder.read_image(&mut bytes).map_err(broken)?;
        Ok(Self { width, height, channels, bytes })
    }

    /// Pixels by number, which must be there: red, green, blue, alpha.
    pub fn pixels(&self, range: Range<usize>) -> impl Iterator<Item = [u8; 4]> + Clone + '_ {
        let bytes = &self.bytes[range.start * self.channels..range.end * self.channels];
        bytes.chunks_exact(self.channels).map(|pixel| match *pixel {
            [red, green, blue, alpha] => [red, green, blue, alpha],
            [red, green, blue, ..] => [red, green, blue, u8::MAX],
            // There are 3 or 4 channels.
            _ => [0; 4],
        })
    }
}
