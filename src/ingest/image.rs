//! PNG, JPEG, WebP, TGA and KTX2 with Basis Universal to pixels, within limits that a hostile header cannot move.

use std::io::Cursor;
use std::ops::Deref;
use std::path::Path;

use basisu::{DecodeFlags, TargetFormat, Transcoder};
use image::{ColorType, DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use crate::job::MissingTexture;
use crate::scene::texture::{BrokenImage, Pixels};
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

/// Images up to this many pixels are not held to that: a WebP of one colour is a few bytes at any size.
const FREE_PIXELS: u64 = 2048 * 2048;

/// What a TGA of version 2 ends with.
const TGA_FOOTER: &[u8] = b"TRUEVISION-XFILE.\0";

/// What a KTX2 file begins with.
const KTX2_MAGIC: &[u8] = b"\xABKTX 20\xBB\r\n\x1A\n";

/// What stands for an image that is missing or broken, where that is allowed.
const MAGENTA: [u8; 4] = [255, 0, 255, 255];

/// Opens the images of one file, and counts what they take.
pub struct ImageFiles {
    pixel_bytes: u64,
    missing_texture: MissingTexture,
    /// What is wrong with the images that magenta stands for.
    pub replaced: Vec<String>,
}

/// How an image is packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Image(ImageFormat),
    /// KTX2 with Basis Universal, the content that KHR_texture_basisu allows.
    Basis,
}

/// An image of which only the header has been read.
pub struct EncodedImage<B> {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The channels that the file has: grey fills red, green and blue, and alpha is 1 where there is none.
    pub colour_type: ColorType,
    missing_texture: MissingTexture,
    /// The file's bytes; `None` where magenta stands for them.
    encoded: Option<(B, Format)>,
    /// What is said about an image that cannot be decoded.
    broken: BrokenImage,
}

impl ImageFiles {
    /// None yet.
    pub fn new(missing_texture: MissingTexture) -> Self {
        Self { pixel_bytes: 0, missing_texture, replaced: Vec::new() }
    }

    /// The image in `bytes`, which `here` in the file at `path` uses. Where it is missing or broken and that is allowed, it
    /// is one magenta pixel.
    pub fn open<B: Deref<Target = [u8]>>(
        &mut self,
        path: &Path,
        here: &str,
        bytes: Result<B>,
    ) -> Result<EncodedImage<B>> {
        match (bytes.and_then(|bytes| self.read_header(path, here, bytes)), self.missing_texture) {
            (Err(error @ (Error::Invalid { .. } | Error::Unsupported { .. })), MissingTexture::Magenta) => {
                self.replaced.push(error.to_string());
                Ok(EncodedImage {
                    width: 1,
                    height: 1,
                    colour_type: ColorType::Rgb8,
                    missing_texture: self.missing_texture,
                    encoded: None,
                    broken: broken(path, here),
                })
            }
            (image, _) => image,
        }
    }

    fn read_header<B: Deref<Target = [u8]>>(&mut self, path: &Path, here: &str, bytes: B) -> Result<EncodedImage<B>> {
        let format = match image::guess_format(&bytes) {
            Err(_) if bytes.starts_with(KTX2_MAGIC) => Format::Basis,
            // TGA shows itself at its end.
            Err(_) if bytes.ends_with(TGA_FOOTER) => Format::Image(ImageFormat::Tga),
            Err(_) => return Err(Error::invalid(path, here, "it is neither PNG, JPEG, WebP, TGA nor KTX2")),
            Ok(known @ (ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::WebP)) => Format::Image(known),
            Ok(other) => {
                let what = format!("{here} is {other:?}; convert it to PNG, JPEG or WebP");
                return Err(Error::unsupported(path, what));
            }
        };
        let header = match format {
            Format::Image(format) => decoder(&bytes, format).map_err(|e| e.to_string()).map(|header| {
                let (width, height) = header.dimensions();
                (width, height, header.color_type())
            }),
            Format::Basis => basis_size(&bytes).map(|(width, height)| (width, height, ColorType::Rgba8)),
        };
        let (width, height, colour_type) =
            header.map_err(|e| Error::invalid(path, here, format!("it cannot be decoded: {e}")))?;
        self.charge(path, u64::from(width) * u64::from(height), &bytes, here)?;
        let missing_texture = self.missing_texture;
        let broken = broken(path, here);
        Ok(EncodedImage { width, height, colour_type, missing_texture, encoded: Some((bytes, format)), broken })
    }

    /// Refuses an image whose pixels its bytes cannot hold, or that is too large, before anything is allocated.
    fn charge(&mut self, path: &Path, pixels: u64, encoded: &[u8], here: &str) -> Result<()> {
        let encoded_bytes = encoded.len() as u64;
        let too_large = |limit: u64| -> Error {
            Error::unsupported(
                path,
                format!("{here} has {pixels} pixels, past the limit of {} MiB; scale it down", limit >> 20),
            )
        };
        if pixels == 0 {
            return Err(Error::invalid(path, here, "it has no pixels"));
        }
        if pixels > encoded_bytes.saturating_mul(MAX_PIXELS_PER_BYTE).max(FREE_PIXELS) {
            let what = format!("its header promises {pixels} pixels, too many for its {encoded_bytes} bytes");
            return Err(Error::invalid(path, here, what));
        }
        self.pixel_bytes += pixels * 4;
        match (pixels * 4 > MAX_IMAGE_BYTES, self.pixel_bytes > MAX_FILE_BYTES) {
            (true, _) => Err(too_large(MAX_IMAGE_BYTES)),
            (_, true) => Err(too_large(MAX_FILE_BYTES)),
            _ => Ok(()),
        }
    }
}

fn broken(path: &Path, here: &str) -> BrokenImage {
    BrokenImage { path: path.to_owned(), place: here.to_owned(), what: String::new() }
}

impl<B: Deref<Target = [u8]>> EncodedImage<B> {
    /// The pixels, decoded at every call.
    pub fn pixels(&self) -> std::result::Result<Pixels, BrokenImage> {
        let magenta = || vec![MAGENTA; self.width as usize * self.height as usize];
        let Some((bytes, format)) = &self.encoded else { return Ok(magenta()) };
        let rgba = match format {
            Format::Image(format) => {
                let pixels = decoder(bytes, *format).and_then(DynamicImage::from_decoder);
                pixels.map(|pixels| pixels.into_rgba8().into_raw()).map_err(|e| e.to_string())
            }
            Format::Basis => basis_rgba(bytes),
        };
        match (rgba, self.missing_texture) {
            (Ok(rgba), _) => Ok(bytemuck::cast_slice(&rgba).to_vec()),
            (Err(_), MissingTexture::Magenta) => Ok(magenta()),
            (Err(e), MissingTexture::Error) => {
                Err(BrokenImage { what: format!("it cannot be decoded: {e}"), ..self.broken.clone() })
            }
        }
    }
}

/// A decoder that has read the header and keeps to the limits.
fn decoder(bytes: &[u8], format: ImageFormat) -> image::ImageResult<impl ImageDecoder> {
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_EDGE);
    limits.max_image_height = Some(MAX_EDGE);
    limits.max_alloc = Some(MAX_IMAGE_BYTES);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(limits);
    reader.into_decoder()
}

/// Width and height of a KTX2 file.
fn basis_size(bytes: &[u8]) -> std::result::Result<(u32, u32), String> {
    let word = |at: usize| bytes.get(at..).and_then(<[u8]>::first_chunk).map(|word| u32::from_le_bytes(*word));
    match (word(20), word(24)) {
        (Some(width), Some(height)) if width.max(height) <= MAX_EDGE => Ok((width, height)),
        (Some(width), Some(height)) => Err(format!("{width} x {height} pixels are more than {MAX_EDGE} a side")),
        _ => Err("it ends in its header".into()),
    }
}

/// Red, green, blue and alpha of the finest level of a KTX2 file.
fn basis_rgba(bytes: &[u8]) -> std::result::Result<Vec<u8>, String> {
    let texture = Transcoder::new(bytes).map_err(|e| format!("{e:?}"))?;
    texture.transcode(0, TargetFormat::Rgba32, DecodeFlags::NONE).map_err(|e| format!("{e:?}"))
}
