//! UsdUVTexture to textures: as their images are where that serves, rewritten where an input takes another part of them.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Vec3;
use image::ColorType;

use super::OpenedStage;
use super::network::UvTexture;
use crate::error::{Error, Result};
use crate::ingest::image::{EncodedImage, ImageFiles};
use crate::job::MissingTexture;
use crate::scene::colour::{linear_to_srgb, srgb_to_linear};
use crate::scene::material::Channel;
use crate::scene::mesh::Meshes;
use crate::scene::texture::{BrokenImage, Encoding, Filter, Image, Pixels, Texture, Wrap};

/// The images and textures of one stage that are in use.
pub struct Textures {
    files: ImageFiles,
    /// By where they are.
    encoded: BTreeMap<String, Arc<EncodedImage<Vec<u8>>>>,
    /// By what they are made of.
    images: BTreeMap<String, Arc<Image>>,
    /// Index in [`Meshes::textures`] by image and wrap modes.
    textures: BTreeMap<(String, [u8; 2]), u32>,
}

/// A colour, and what it is to be multiplied with.
pub struct ColourTexture {
    /// Index in [`Meshes::textures`].
    pub texture: u32,
    pub factor: Vec3,
    /// Whether the texture has an alpha that counts.
    pub has_alpha: bool,
    /// What alpha is to be multiplied with.
    pub alpha_factor: f32,
}

/// A channel of a texture: the number is `offset + factor * channel`.
pub struct ChannelTexture {
    /// Index in [`Meshes::textures`].
    pub texture: u32,
    pub channel: Channel,
    pub factor: f32,
    pub offset: f32,
}

impl Textures {
    /// None yet.
    pub fn new(missing_texture: MissingTexture) -> Self {
        Self {
            files: ImageFiles::new(missing_texture),
            encoded: BTreeMap::new(),
            images: BTreeMap::new(),
            textures: BTreeMap::new(),
        }
    }

    /// How many textures are in use.
    pub fn in_use(&self) -> usize {
        self.textures.len()
    }

    /// What is wrong with the images that magenta stands for.
    pub fn into_replaced(self) -> Vec<String> {
        self.files.replaced
    }

    /// The texture whose colour is `colour`'s output (white without), and whose alpha is `alpha`'s (1 without). One of them
    /// must be there.
    pub fn colour(
        &mut self,
        stage: &OpenedStage,
        colour: Option<&UvTexture>,
        alpha: Option<&UvTexture>,
        meshes: &mut Meshes,
    ) -> Result<ColourTexture> {
        let colour = colour.map(|texture| self.source(stage, texture)).transpose()?;
        let alpha = alpha.map(|texture| self.source(stage, texture)).transpose()?;
        // Alpha that an image lacks is 1.
        let (alpha, alpha_factor) = match alpha {
            Some(source) if source.texture.output == "a" && !source.encoded.colour_type.has_alpha() => {
                (None, source.texture.scale[3] + source.texture.bias[3])
            }
            alpha => (alpha, 1.0),
        };
        let factor = colour.as_ref().map_or(Vec3::ONE, Source::colour_factor);
        let encoding = colour.as_ref().map_or(Encoding::Linear, Source::encoding);
        let white = Lookup { image: None, channel: 0, table: [255; 256] };
        let mut recipe = Recipe { images: Vec::new(), lookups: [white; 4], encoding };
        if let Some(source) = &colour {
            for (i, channel) in source.channels().into_iter().enumerate() {
                recipe.add(i, source, channel, source.table(channel, |value| value / factor[i], encoding));
            }
        }
        if let Some(source) = &alpha {
            let channel = source.channels()[0];
            recipe.add(3, source, channel, source.table(channel, |value| value, Encoding::Linear));
        }
        let wrap = colour.iter().chain(&alpha).next().map_or([Wrap::Repeat; 2], |source| source.texture.wrap);
        let has_alpha = alpha.is_some();
        Ok(ColourTexture { texture: self.texture(recipe, wrap, meshes), factor, has_alpha, alpha_factor })
    }

    /// The single channel that `texture`'s output is, of `rgb` the red one.
    pub fn channel(&mut self, stage: &OpenedStage, texture: &UvTexture, meshes: &mut Meshes) -> Result<ChannelTexture> {
        let source = self.source(stage, texture)?;
        let at = source.channels()[0];
        let recipe = Recipe::whole(&source, source.encoding());
        Ok(ChannelTexture {
            texture: self.texture(recipe, texture.wrap, meshes),
            channel: [Channel::R, Channel::G, Channel::B, Channel::A][at],
            factor: texture.scale[at],
            offset: texture.bias[at],
        })
    }

    /// The normals that `texture`'s output is, and the factor of their x and y. Normals are never sRGB-encoded.
    pub fn normal(&mut self, stage: &OpenedStage, texture: &UvTexture, meshes: &mut Meshes) -> Result<(u32, f32)> {
        let source = Source { is_srgb: false, ..self.source(stage, texture)? };
        let (scale, bias) = (texture.scale, texture.bias);
        // Written without scale and bias, normals of 8 bits could not point left: those of the schema are meant.
        let is_bare = scale == [1.0; 4] && bias == [0.0; 4];
        let is_plain = scale[0] == scale[1] && scale[2] == 2.0 && (0..3).all(|i| bias[i] == -scale[i] / 2.0);
        let recipe = match is_bare || is_plain {
            true => Recipe::whole(&source, Encoding::Linear),
            false => {
                let mut recipe = Recipe::whole(&source, Encoding::Linear);
                for channel in 0..3 {
                    let table = source.table(channel, |value| 0.5 * (value + 1.0), Encoding::Linear);
                    recipe.lookups[channel].table = table;
                }
                recipe
            }
        };
        let factor = if is_plain && !is_bare { scale[0] / 2.0 } else { 1.0 };
        Ok((self.texture(recipe, texture.wrap, meshes), factor))
    }

    /// Index in [`Meshes::textures`] of the image that `recipe` makes under these wrap modes.
    fn texture(&mut self, recipe: Recipe, wrap: [Wrap; 2], meshes: &mut Meshes) -> u32 {
        let key = recipe.key();
        let wrap_key = wrap.map(|wrap| wrap as u8);
        if let Some(&texture) = self.textures.get(&(key.clone(), wrap_key)) {
            return texture;
        }
        let image = self.images.entry(key.clone()).or_insert_with(|| Arc::new(recipe.into_image())).clone();
        meshes.textures.push(Texture { image, wrap, filter: Filter::default() });
        let appended = meshes.textures.len() as u32 - 1;
        self.textures.insert((key, wrap_key), appended);
        appended
    }

    /// The image of `texture`, with its header read.
    fn source<'a>(&mut self, stage: &OpenedStage, texture: &'a UvTexture) -> Result<Source<'a>> {
        let (name, place) = &texture.file;
        let key = place.as_deref().unwrap_or(name);
        let encoded = match self.encoded.get(key) {
            Some(encoded) => encoded.clone(),
            None => {
                let here = format!("image '{name}' of {}", texture.prim);
                let missing =
                    || Error::invalid(stage.path, here.as_str(), "it is not in the stage's folder or package");
                let bytes = place.as_ref().ok_or_else(missing).and_then(|place| {
                    let bytes = stage.resolver.read(place);
                    bytes.map_err(|error| Error::invalid(stage.path, here.as_str(), error.to_string()))
                });
                let encoded = Arc::new(self.files.open(stage.path, &here, bytes)?);
                self.encoded.entry(key.to_owned()).or_insert(encoded).clone()
            }
        };
        let is_srgb = match texture.source_colour_space.as_str() {
            "raw" => false,
            "sRGB" => true,
            // The schema's rule for images that do not say themselves.
            _ => matches!(encoded.colour_type, ColorType::Rgb8 | ColorType::Rgba8),
        };
        Ok(Source { texture, place: key.to_owned(), encoded, is_srgb })
    }
}

/// An image, and which part of it is asked for.
struct Source<'a> {
    texture: &'a UvTexture,
    place: String,
    encoded: Arc<EncodedImage<Vec<u8>>>,
    /// Whether its colours are sRGB-encoded.
    is_srgb: bool,
}

impl Source<'_> {
    fn encoding(&self) -> Encoding {
        if self.is_srgb { Encoding::Srgb } else { Encoding::Linear }
    }

    /// The channels of the output.
    fn channels(&self) -> [usize; 3] {
        match ["r", "g", "b", "a"].iter().position(|name| *name == self.texture.output) {
            Some(channel) => [channel; 3],
            None => [0, 1, 2],
        }
    }

    /// What texels are multiplied with: the scale, or what keeps them within 0 and 1 where there is a bias.
    fn colour_factor(&self) -> Vec3 {
        Vec3::from(self.channels().map(|channel| match (self.texture.scale[channel], self.texture.bias[channel]) {
            (scale, 0.0) if scale > 0.0 => scale,
            (scale, bias) => (scale + bias).max(bias).max(1.0),
        }))
    }

    /// For each code of `channel`, the code in `encoding` of what `map` makes of the value, scaled and biased.
    fn table(&self, channel: usize, map: impl Fn(f32) -> f32, encoding: Encoding) -> [u8; 256] {
        let (scale, bias) = (self.texture.scale[channel], self.texture.bias[channel]);
        std::array::from_fn(|code| {
            let plain = code as f32 / 255.0;
            let value = if self.is_srgb && channel < 3 { srgb_to_linear(plain) } else { plain };
            let value = map(value * scale + bias).clamp(0.0, 1.0);
            let value = if encoding == Encoding::Srgb { linear_to_srgb(value) } else { value };
            (value * 255.0).round() as u8
        })
    }
}

/// Where a channel of a made image comes from.
#[derive(Clone, Copy)]
struct Lookup {
    /// Which of the recipe's images; the table's first entry without one.
    image: Option<usize>,
    channel: usize,
    /// By the code found there.
    table: [u8; 256],
}

/// How an image is made of others.
struct Recipe {
    images: Vec<(String, Arc<EncodedImage<Vec<u8>>>)>,
    /// Red, green, blue and alpha.
    lookups: [Lookup; 4],
    encoding: Encoding,
}

impl Recipe {
    /// An image as it is.
    fn whole(source: &Source, encoding: Encoding) -> Self {
        let table = std::array::from_fn(|code| code as u8);
        let lookups = std::array::from_fn(|channel| Lookup { image: Some(0), channel, table });
        Self { images: vec![(source.place.clone(), source.encoded.clone())], lookups, encoding }
    }

    fn add(&mut self, made: usize, source: &Source, channel: usize, table: [u8; 256]) {
        let known = self.images.iter().position(|(place, _)| *place == source.place);
        let image = known.unwrap_or_else(|| {
            self.images.push((source.place.clone(), source.encoded.clone()));
            self.images.len() - 1
        });
        self.lookups[made] = Lookup { image: Some(image), channel, table };
    }

    /// Whether the image is another one, as it is.
    fn is_whole(&self) -> bool {
        let [(_, image)] = &self.images[..] else { return false };
        self.lookups.iter().enumerate().all(|(made, lookup)| {
            let same = lookup.image.is_some()
                && lookup.channel == made
                && lookup.table.iter().enumerate().all(|(code, &found)| code == usize::from(found));
            same || made == 3 && !image.colour_type.has_alpha() && lookup.table[255] == 255
        })
    }

    /// The same for recipes that make the same.
    fn key(&self) -> String {
        let places: Vec<&str> = self.images.iter().map(|(place, _)| place.as_str()).collect();
        let made: Vec<_> = match self.is_whole() {
            true => Vec::new(),
            false => self.lookups.iter().map(|lookup| (lookup.image, lookup.channel, lookup.table)).collect(),
        };
        format!("{places:?} {:?} {made:?}", self.encoding)
    }

    fn into_image(self) -> Image {
        let size = |edge: fn(&EncodedImage<Vec<u8>>) -> u32| self.images.iter().map(|(_, image)| edge(image)).max();
        let (width, height) = (size(|image| image.width).unwrap_or(1), size(|image| image.height).unwrap_or(1));
        Image::new(width, height, self.encoding, move || match self.is_whole() {
            true => self.images[0].1.pixels(),
            false => self.pixels(width as usize, height as usize),
        })
    }

    /// `width` x `height` pixels; from an image of another size the nearest ones.
    fn pixels(&self, width: usize, height: usize) -> std::result::Result<Pixels, BrokenImage> {
        let decoded =
            self.images.iter().map(|(_, image)| image.pixels()).collect::<std::result::Result<Vec<_>, _>>()?;
        let mut pixels = Vec::with_capacity(width * height);
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            pixels.push(self.lookups.each_ref().map(|lookup| {
                let Some(i) = lookup.image else { return lookup.table[0] };
                let (own_width, own_height) = (self.images[i].1.width as usize, self.images[i].1.height as usize);
                let texel = decoded[i][y * own_height / height * own_width + x * own_width / width];
                lookup.table[usize::from(texel[lookup.channel])]
            }));
        }
        Ok(pixels)
    }
}
