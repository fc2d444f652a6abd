//! PNG, JPEG and WebP to pixels, each image once, within limits that a hostile header cannot move.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::sync::Arc;

use gltf::json::{self, Index};
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use super::container::{Asset, place};
use super::resource::{read_uri, view_bytes};
use crate::job::MissingTexture;
use crate::scene::texture::{BrokenImage, Encoding, Image};
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

/// What stands for an image that is missing or broken, where that is allowed.
const MAGENTA: [u8; 4] = [255, 0, 255, 255];

/// The images that materials have asked for so far.
pub struct Images {
    by_use: BTreeMap<(usize, Encoding), Arc<Image>>,
    bytes: u64,
    missing_texture: MissingTexture,
    /// What is wrong with the images that magenta stands for.
    pub replaced: Vec<String>,
}

impl Images {
    /// None yet.
    pub fn new(missing_texture: MissingTexture) -> Self {
        Self { by_use: BTreeMap::new(), bytes: 0, missing_texture, replaced: Vec::new() }
    }

    /// Image `index` with pixels that mean `encoding`. Its header is read at the first call, its pixels when they are
    /// needed. `user` is the material that asks, for messages.
    pub fn get(
        &mut self,
        asset: &Asset,
        index: Index<json::Image>,
        encoding: Encoding,
        user: &str,
    ) -> Result<Arc<Image>> {
        let key = (index.value(), encoding);
        if let Some(image) = self.by_use.get(&key) {
            return Ok(image.clone());
        }
        let image = match (self.open(asset, index, encoding, user), self.missing_texture) {
            (Err(error @ (Error::Invalid { .. } | Error::Unsupported { .. })), MissingTexture::Magenta) => {
                self.replaced.push(error.to_string());
                Image::new(1, 1, encoding, || Ok(vec![MAGENTA]))
            }
            (image, _) => image?,
        };
        Ok(self.by_use.entry(key).or_insert(Arc::new(image)).clone())
    }

    fn open(&mut self, asset: &Asset, index: Index<json::Image>, encoding: Encoding, user: &str) -> Result<Image> {
        let image = asset.get(index, user)?;
        let here = format!("{} of {user}", place("images", index.value(), image.name.as_deref()));
        let bytes = match (image.buffer_view, image.uri.as_deref()) {
            (Some(view), _) => view_bytes(asset, view, &here)?,
            (None, Some(uri)) => read_uri(asset, uri, &here)?.into(),
            (None, None) => return Err(asset.invalid(here, "it has neither a bufferView nor a uri")),
        };
        let format =
            image::guess_format(&bytes).map_err(|_| asset.invalid(&here, "it is neither PNG, JPEG nor WebP"))?;
        if !matches!(format, ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::WebP) {
            return Err(asset.unsupported(format!("{here} is {format:?}; convert it to PNG, JPEG or WebP")));
        }
        let broken = BrokenImage { path: asset.path.clone(), place: here.clone(), what: String::new() };
        let cannot =
            move |e: image::ImageError| BrokenImage { what: format!("it cannot be decoded: {e}"), ..broken.clone() };
        let (width, height) = decoder(&bytes, format).map_err(|e| cannot(e).to_error())?.dimensions();
        self.charge(asset, u64::from(width) * u64::from(height), &bytes, &here)?;
        let missing_texture = self.missing_texture;
        Ok(Image::new(width, height, encoding, move || {
            let pixels = decoder(&bytes, format).and_then(DynamicImage::from_decoder).map(DynamicImage::into_rgba8);
            match (pixels, missing_texture) {
                (Ok(pixels), _) => Ok(bytemuck::cast_slice(pixels.as_raw()).to_vec()),
                (Err(_), MissingTexture::Magenta) => Ok(vec![MAGENTA; width as usize * height as usize]),
                (Err(e), MissingTexture::Error) => Err(cannot(e)),
            }
        }))
    }

    /// Refuses an image whose pixels its bytes cannot hold, or that is too large, before anything is allocated.
    fn charge(&mut self, asset: &Asset, pixels: u64, encoded: &[u8], here: &str) -> Result<()> {
        let encoded_bytes = encoded.len() as u64;
        let too_large = |limit: u64| -> Error {
            asset.unsupported(format!(
                "{here} has {pixels} pixels, past the limit of {} MiB; scale it down",
                limit >> 20
            ))
        };
        if pixels == 0 {
            return Err(asset.invalid(here, "it has no pixels"));
        }
        if pixels > encoded_bytes.saturating_mul(MAX_PIXELS_PER_BYTE).max(FREE_PIXELS) {
            let what = format!("its header promises {pixels} pixels, too many for its {encoded_bytes} bytes");
            return Err(asset.invalid(here, what));
        }
        self.bytes += pixels * 4;
        match (pixels * 4 > MAX_IMAGE_BYTES, self.bytes > MAX_FILE_BYTES) {
            (true, _) => Err(too_large(MAX_IMAGE_BYTES)),
            (_, true) => Err(too_large(MAX_FILE_BYTES)),
            _ => Ok(()),
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
