//! UsdUVTexture to textures: as their images are where that serves, rewritten where an input takes another part of them.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{Vec3, Vec4};
use image::ColorType;

use super::OpenedStage;
use super::meshes::Notes;
use super::network::UvTexture;
use crate::error::{Error, Result};
use crate::ingest::image::{ImageDecoding, Pixels};
use crate::scene::colour::{linear_to_srgb, srgb_to_linear};
use crate::scene::mesh::{Meshes, Texture};

/// The images and textures of one stage that are in use.
#[derive(Default)]
pub struct Textures {
    decoding: ImageDecoding,
    /// By where they are.
    images: BTreeMap<String, Pixels>,
    /// Index in [`Meshes::textures`] by what it was made of.
    textures: BTreeMap<String, Colour>,
}

/// A colour with alpha that is a texture.
#[derive(Clone, Copy)]
pub struct Colour {
    /// Index in [`Meshes::textures`].
    pub texture: u32,
    /// What the texture is to be multiplied with.
    pub factor: Vec4,
    /// Whether the texture's alpha is not 1 everywhere.
    pub alpha_varies: bool,
}

impl Textures {
    /// The texture whose colour is `colour`'s output (white without), and whose alpha is `alpha`'s (1 without).
    pub fn colour(
        &mut self,
        stage: &OpenedStage,
        colour: Option<&UvTexture>,
        alpha: Option<&UvTexture>,
        notes: &mut Notes,
        meshes: &mut Meshes,
    ) -> Result<Colour> {
        let key = format!("{colour:?} {alpha:?}");
        if let Some(&known) = self.textures.get(&key) {
            return Ok(known);
        }
        let colour = colour.map(|texture| self.source(stage, texture, notes)).transpose()?;
        let alpha = alpha.map(|texture| self.source(stage, texture, notes)).transpose()?;
        // Alpha that an image lacks is 1.
        let (alpha, constant_alpha) = match alpha {
            Some(source) if source.texture.output == "a" && !source.pixels.colour_type.has_alpha() => {
                (None, source.texture.scale[3] + source.texture.bias[3])
            }
            alpha => (alpha, 1.0),
        };
        let factor = colour.as_ref().map_or(Vec3::ONE, Source::colour_factor).extend(constant_alpha);
        let alpha_varies = alpha.is_some();
        meshes.textures.push(made(colour, alpha, factor));
        let made = Colour { texture: meshes.textures.len() as u32 - 1, factor, alpha_varies };
        self.textures.insert(key, made);
        Ok(made)
    }

    /// How many textures are in use.
    pub fn in_use(&self) -> usize {
        self.textures.len()
    }

    /// The decoded image of `texture`.
    fn source<'a>(&mut self, stage: &OpenedStage, texture: &'a UvTexture, notes: &mut Notes) -> Result<Source<'a>> {
        let (name, Some(place)) = &texture.file else {
            let what = format!("its image '{}' is not in the stage's folder or package", texture.file.0);
            return Err(Error::invalid(stage.path, texture.prim.as_str(), what));
        };
        if texture.ends_black {
            notes.add_at("wrap mode black is read as clamp", &texture.prim);
        }
        let pixels = match self.images.get(place) {
            Some(pixels) => pixels.clone(),
            None => {
                let here = format!("image '{name}' of {}", texture.prim);
                let bytes = stage.resolver.read(place);
                let bytes = bytes.map_err(|error| Error::invalid(stage.path, here.as_str(), error.to_string()))?;
                let pixels = self.decoding.decode(stage.path, &bytes, &here)?;
                self.images.entry(place.clone()).or_insert(pixels).clone()
            }
        };
        let is_srgb = match texture.source_colour_space.as_str() {
            "raw" => false,
            "sRGB" => true,
            // The schema's rule for images that do not say themselves.
            _ => matches!(pixels.colour_type, ColorType::Rgb8 | ColorType::Rgba8),
        };
        Ok(Source { texture, pixels, is_srgb })
    }
}

/// An image, and which part of it is asked for.
struct Source<'a> {
    texture: &'a UvTexture,
    pixels: Pixels,
    /// Whether its colours are sRGB-encoded.
    is_srgb: bool,
}

impl Source<'_> {
    /// The channels of the output.
    fn channels(&self) -> [usize; 3] {
        match ["r", "g", "b", "a"].iter().position(|name| *name == self.texture.output) {
            Some(channel) => [channel; 3],
            None => [0, 1, 2],
        }
    }

    /// What the texels are multiplied with: the scale, or what keeps them within 0 and 1 where there is a bias.
    fn colour_factor(&self) -> Vec3 {
        Vec3::from(self.channels().map(|channel| match (self.texture.scale[channel], self.texture.bias[channel]) {
            (scale, 0.0) if scale > 0.0 => scale,
            (scale, bias) => (scale + bias).max(bias).max(1.0),
        }))
    }

    /// The codes of `output / factor` for each code of `channel`.
    fn table(&self, channel: usize, factor: f32, to_srgb: bool) -> [u8; 256] {
        let (scale, bias) = (self.texture.scale[channel] / factor, self.texture.bias[channel] / factor);
        std::array::from_fn(|code| {
            let plain = code as f32 / 255.0;
            let value = if self.is_srgb && channel < 3 { srgb_to_linear(plain) } else { plain };
            let value = (value * scale + bias).clamp(0.0, 1.0);
            ((if to_srgb { linear_to_srgb(value) } else { value }) * 255.0).round() as u8
        })
    }

    /// The texel of an image of `width` x `height` at `x`, `y`; the nearest one where this has another size.
    fn texel(&self, x: usize, y: usize, width: usize, height: usize) -> [u8; 4] {
        let (own_width, own_height) = (self.pixels.width as usize, self.pixels.height as usize);
        self.pixels.rgba[y * own_height / height * own_width + x * own_width / width]
    }
}

/// The texture of `colour` divided by `factor`, and of `alpha`.
fn made(colour: Option<Source>, alpha: Option<Source>, factor: Vec4) -> Texture {
    let tables = colour.as_ref().map(|source| {
        let channels = source.channels();
        std::array::from_fn::<_, 3, _>(|i| source.table(channels[i], factor[i], true))
    });
    let alpha_table = alpha.as_ref().map(|source| source.table(source.channels()[0], 1.0, false));
    let sizes = || colour.iter().chain(&alpha).map(|source| &source.pixels);
    let width = sizes().map(|pixels| pixels.width).max().unwrap_or(1);
    let height = sizes().map(|pixels| pixels.height).max().unwrap_or(1);
    let wrap =
        colour.iter().chain(&alpha).next().map_or([crate::scene::mesh::Wrap::Repeat; 2], |source| source.texture.wrap);
    let (w, h) = (width as usize, height as usize);
    let texel = |x: usize, y: usize| {
        let mut made = [255; 4];
        if let (Some(source), Some(tables)) = (&colour, &tables) {
            let (texel, channels) = (source.texel(x, y, w, h), source.channels());
            for i in 0..3 {
                made[i] = tables[i][usize::from(texel[channels[i]])];
            }
        }
        if let (Some(source), Some(table)) = (&alpha, &alpha_table) {
            made[3] = table[usize::from(source.texel(x, y, w, h)[source.channels()[0]])];
        }
        made
    };
    let texel = &texel;
    let rgba: Arc<[[u8; 4]]> = (0..h).flat_map(|y| (0..w).map(move |x| texel(x, y))).collect();
    Texture { width, height, rgba, wrap, nearest: false }
}
