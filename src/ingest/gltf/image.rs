//! The images of a file, each opened once for each encoding.

use std::collections::BTreeMap;
use std::sync::Arc;

use gltf::json::{self, Index};

use super::container::{Asset, place};
use super::resource::{Bytes, read_uri, view_bytes};
use crate::Result;
use crate::ingest::image::ImageFiles;
use crate::job::MissingTexture;
use crate::scene::texture::{Encoding, Image};

/// The images that materials have asked for so far.
pub struct Images {
    by_use: BTreeMap<(usize, Encoding), Arc<Image>>,
    files: ImageFiles,
}

impl Images {
    /// None yet.
    pub fn new(missing_texture: MissingTexture) -> Self {
        Self { by_use: BTreeMap::new(), files: ImageFiles::new(missing_texture) }
    }

    /// What is wrong with the images that magenta stands for.
    pub fn into_replaced(self) -> Vec<String> {
        self.files.replaced
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
        let image = asset.get(index, user);
        let name = image.as_ref().ok().and_then(|image| image.name.as_deref());
        let here = format!("{} of {user}", place("images", index.value(), name));
        let bytes = image.and_then(|image| bytes_of(asset, image, &here));
        let encoded = self.files.open(&asset.path, &here, bytes)?;
        let image = Image::new(encoded.width, encoded.height, encoding, move || encoded.pixels());
        Ok(self.by_use.entry(key).or_insert(Arc::new(image)).clone())
    }
}

fn bytes_of(asset: &Asset, image: &json::Image, here: &str) -> Result<Bytes> {
    match (image.buffer_view, image.uri.as_deref()) {
        (Some(view), _) => view_bytes(asset, view, here),
        (None, Some(uri)) => Ok(read_uri(asset, uri, here)?.into()),
        (None, None) => Err(asset.invalid(here, "it has neither a bufferView nor a uri")),
    }
}
