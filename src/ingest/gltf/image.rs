//! The images of a file, each decoded once.

use std::collections::BTreeMap;

use gltf::json::{self, Index};

use super::container::{Asset, place};
use super::resource::{read_uri, view_bytes};
use crate::Result;
use crate::ingest::image::{ImageDecoding, Pixels};

/// The images that materials have asked for so far.
#[derive(Default)]
pub struct Images {
    decoded: BTreeMap<usize, Pixels>,
    decoding: ImageDecoding,
}

impl Images {
    /// Image `index`, decoded at the first call. `user` is the material that asks, for messages.
    pub fn get(&mut self, asset: &Asset, index: Index<json::Image>, user: &str) -> Result<Pixels> {
        if let Some(pixels) = self.decoded.get(&index.value()) {
            return Ok(pixels.clone());
        }
        let image = asset.get(index, user)?;
        let here = format!("{} of {user}", place("images", index.value(), image.name.as_deref()));
        let pixels = match (image.buffer_view, image.uri.as_deref()) {
            (Some(view), _) => self.decoding.decode(&asset.path, &view_bytes(asset, view, &here)?, &here)?,
            (None, Some(uri)) => self.decoding.decode(&asset.path, &read_uri(asset, uri, &here)?, &here)?,
            (None, None) => return Err(asset.invalid(here, "it has neither a bufferView nor a uri")),
        };
        self.decoded.insert(index.value(), pixels.clone());
        Ok(pixels)
    }
}
