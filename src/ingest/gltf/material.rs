//! Materials and textures, converted when a primitive first uses them.

use std::collections::BTreeMap;

use glam::{Mat3, Vec2, Vec3, Vec4};
use gltf::json::texture::{MagFilter, MinFilter, Sampler, WrappingMode};
use gltf::json::validation::Checked;
use gltf::json::{self, Index};
use serde_json::Value;

use super::container::{Asset, place};
use super::image::Images;
use super::material_json::{MaterialJson, SpecularGlossiness, TextureInfo};
use crate::Result;
use crate::job::MissingTexture;
use crate::scene::material::{
    AlphaMode, Anisotropy, Channel, Clearcoat, ColourMap, Iridescence, NormalMap, ScalarMap, Sheen, TextureRef, Volume,
};
use crate::scene::texture::{Encoding, Filter, MipFilter, Texture, Wrap};
use crate::scene::{LinearRgb, Material, Meshes};

/// How many sets of texture coordinates vertices carry.
pub const UV_SETS: u32 = 2;

/// Extensions of a texture that name another image for it, in the order in which they are taken when the texture has no
/// plain PNG or JPEG.
const SOURCE_EXTENSIONS: [&str; 2] = ["EXT_texture_webp", "KHR_texture_basisu"];

/// The materials and textures of one file that are in use, by their place in the file.
pub struct Materials {
    images: Images,
    /// Index in [`Meshes::materials`]; the key `None` is glTF's default material.
    materials: BTreeMap<Option<usize>, u32>,
    /// Index in [`Meshes::textures`] by image, sampler and encoding.
    textures: BTreeMap<(usize, Option<usize>, Encoding), u32>,
}

impl Materials {
    /// None in use yet.
    pub fn new(missing_texture: MissingTexture) -> Self {
        Self { images: Images::new(missing_texture), materials: BTreeMap::new(), textures: BTreeMap::new() }
    }

    /// Index in [`Meshes::materials`] of the file's material `index`, appended with its textures at the first call.
    pub fn get(
        &mut self,
        asset: &Asset,
        index: Option<Index<json::Material>>,
        user: &str,
        meshes: &mut Meshes,
    ) -> Result<u32> {
        let key = index.map(|index| index.value());
        if let Some(&material) = self.materials.get(&key) {
            return Ok(material);
        }
        let material = match index {
            Some(index) => {
                asset.get(index, user)?;
                let source = &asset.materials[index.value()];
                let here = place("materials", index.value(), source.name.as_deref());
                Conversion { asset, materials: self, meshes, here }.convert(source)?
            }
            None => Material::default(),
        };
        meshes.materials.push(material);
        let appended = meshes.materials.len() as u32 - 1;
        self.materials.insert(key, appended);
        Ok(appended)
    }

    /// How many materials are in use.
    pub fn materials_in_use(&self) -> usize {
        self.materials.len()
    }

    /// How many textures are in use.
    pub fn textures_in_use(&self) -> usize {
        self.textures.len()
    }

    /// Images that are missing or broken and were replaced, each with what is wrong.
    pub fn into_replaced_images(self) -> Vec<String> {
        self.images.into_replaced()
    }

    fn texture(
        &mut self,
        asset: &Asset,
        index: Index<json::Texture>,
        encoding: Encoding,
        here: &str,
        meshes: &mut Meshes,
    ) -> Result<u32> {
        let source = asset.get(index, here)?;
        let image = image_of(asset, index, source, here)?;
        let key = (image.value(), source.sampler.map(|sampler| sampler.value()), encoding);
        if let Some(&texture) = self.textures.get(&key) {
            return Ok(texture);
        }
        let sampler = match source.sampler {
            Some(sampler) => asset.get(sampler, here)?,
            None => &Sampler::default(),
        };
        let wrap = |mode| match mode {
            Checked::Valid(WrappingMode::Repeat) => Ok(Wrap::Repeat),
            Checked::Valid(WrappingMode::ClampToEdge) => Ok(Wrap::Clamp),
            Checked::Valid(WrappingMode::MirroredRepeat) => Ok(Wrap::Mirror),
            Checked::Invalid => Err(asset.invalid(here, "its sampler has a wrap mode that glTF 2.0 does not know")),
        };
        let wrap = [wrap(sampler.wrap_s)?, wrap(sampler.wrap_t)?];
        let image = self.images.get(asset, image, encoding, here)?;
        meshes.textures.push(Texture { image, wrap, filter: filter(sampler) });
        let appended = meshes.textures.len() as u32 - 1;
        self.textures.insert(key, appended);
        Ok(appended)
    }
}

/// The image of a texture: the plain one, or that of an extension.
fn image_of(
    asset: &Asset,
    index: Index<json::Texture>,
    source: &json::Texture,
    here: &str,
) -> Result<Index<json::Image>> {
    // The gltf crate reads an absent source as this index.
    if source.source.value() != u32::MAX as usize {
        return Ok(source.source);
    }
    let texture = place("textures", index.value(), source.name.as_deref());
    let others = source.extensions.iter().flat_map(|all| &all.others);
    let by_extension = |name: &str| others.clone().find(|(other, _)| *other == name).map(|(_, extension)| extension);
    if let Some((name, extension)) = SOURCE_EXTENSIONS.iter().find_map(|name| Some((name, by_extension(name)?))) {
        let image = extension.get("source").and_then(Value::as_u64).and_then(|index| u32::try_from(index).ok());
        return image.map(Index::new).ok_or_else(|| asset.invalid(texture, format!("{name} has no source")));
    }
    let names: Vec<&str> = others.map(|(name, _)| name.as_str()).collect();
    let only = if names.is_empty() { String::new() } else { format!(", only {}", names.join(", ")) };
    Err(asset.unsupported(format!("{texture} of {here} has no PNG, JPEG, WebP or KTX2 source{only}")))
}

/// What a sampler leaves open is filtered as smoothly as possible. A filter that glTF does not know is one left open.
fn filter(sampler: &Sampler) -> Filter {
    let (minify_nearest, mips) = match sampler.min_filter {
        Some(Checked::Valid(MinFilter::Nearest)) => (true, MipFilter::None),
        Some(Checked::Valid(MinFilter::Linear)) => (false, MipFilter::None),
        Some(Checked::Valid(MinFilter::NearestMipmapNearest)) => (true, MipFilter::Nearest),
        Some(Checked::Valid(MinFilter::LinearMipmapNearest)) => (false, MipFilter::Nearest),
        Some(Checked::Valid(MinFilter::NearestMipmapLinear)) => (true, MipFilter::Linear),
        Some(Checked::Valid(MinFilter::LinearMipmapLinear) | Checked::Invalid) | None => (false, MipFilter::Linear),
    };
    let magnify_nearest = matches!(sampler.mag_filter, Some(Checked::Valid(MagFilter::Nearest)));
    Filter { magnify_nearest, minify_nearest, mips }
}

/// One material on its way from file to scene.
struct Conversion<'a> {
    asset: &'a Asset,
    materials: &'a mut Materials,
    meshes: &'a mut Meshes,
    here: String,
}

impl Conversion<'_> {
    fn convert(mut self, source: &MaterialJson) -> Result<Material> {
        let extensions = &source.extensions;
        let alpha = match source.alpha_mode.as_str() {
            "OPAQUE" => AlphaMode::Opaque,
            "MASK" => AlphaMode::Mask { cutoff: self.factor(source.alpha_cutoff, "alphaCutoff")? },
            "BLEND" => AlphaMode::Blend,
            _ => return Err(self.invalid("its alphaMode is not OPAQUE, MASK or BLEND")),
        };
        let strength = extensions.emissive_strength.emissive_strength;
        let emissive = Vec3::from(source.emissive_factor) * strength;
        let common = Material {
            name: source.name.clone().unwrap_or_default(),
            emissive: LinearRgb(self.factors(emissive, "emissiveFactor times emissiveStrength")?),
            emissive_texture: self.colour_texture(&source.emissive_texture, "emissiveTexture")?,
            alpha,
            double_sided: source.double_sided,
            unlit: extensions.unlit.is_some(),
            normal: self.normal(&source.normal_texture, "normalTexture")?,
            occlusion: self.occlusion(&source.occlusion_texture)?,
            ..Material::default()
        };
        match &extensions.specular_glossiness {
            Some(old) => self.specular_glossiness(common, old),
            None => self.metallic_roughness(common, source),
        }
    }

    /// The workflow of KHR_materials_pbrSpecularGlossiness, as the page of KHR_materials_specular converts it: a dielectric
    /// whose reflectance at normal incidence is the specular colour alone, which index of refraction 0 stands for.
    fn specular_glossiness(&mut self, common: Material, source: &SpecularGlossiness) -> Result<Material> {
        let slot = "specularGlossinessTexture";
        let glossiness = self.factor(source.glossiness_factor, "glossinessFactor")?;
        let glossy = self.scalar(glossiness, &source.specular_glossiness_texture, slot, Channel::A)?;
        Ok(Material {
            base_colour: self.colour_and_alpha(source.diffuse_factor, "diffuseFactor")?,
            base_colour_texture: self.colour_texture(&source.diffuse_texture, "diffuseTexture")?,
            metallic: 0.0.into(),
            roughness: ScalarMap { offset: 1.0, factor: -glossy.factor, ..glossy },
            ior: 0.0,
            specular_colour: ColourMap {
                factor: self.factors(source.specular_factor.into(), "specularFactor")?,
                texture: self.colour_texture(&source.specular_glossiness_texture, slot)?,
            },
            ..common
        })
    }

    fn metallic_roughness(&mut self, common: Material, source: &MaterialJson) -> Result<Material> {
        let (pbr, all) = (&source.pbr_metallic_roughness, &source.extensions);
        let metal_rough = &pbr.metallic_roughness_texture;
        let slot = "metallicRoughnessTexture";
        let metallic = self.factor(pbr.metallic_factor, "metallicFactor")?;
        let roughness = self.factor(pbr.roughness_factor, "roughnessFactor")?;
        let iridescence = &all.iridescence;
        let thinnest = match iridescence.iridescence_thickness_texture {
            Some(_) => self.factor(iridescence.iridescence_thickness_minimum, "iridescenceThicknessMinimum")?,
            None => 0.0,
        };
        let thickest = self.factor(iridescence.iridescence_thickness_maximum, "iridescenceThicknessMaximum")?;
        let film =
            self.map(1.0, &iridescence.iridescence_thickness_texture, "iridescenceThicknessTexture", Channel::G)?;
        let volume = &all.volume;
        let distance = volume.attenuation_distance.unwrap_or(f32::INFINITY);
        if !(distance > 0.0) {
            return Err(self.invalid(format!("its attenuationDistance is {distance}; it must be above 0")));
        }
        Ok(Material {
            base_colour: self.colour_and_alpha(pbr.base_color_factor, "baseColorFactor")?,
            base_colour_texture: self.colour_texture(&pbr.base_color_texture, "baseColorTexture")?,
            metallic: self.scalar(metallic, metal_rough, slot, Channel::B)?,
            roughness: self.scalar(roughness, metal_rough, slot, Channel::G)?,
            ior: self.index_of_refraction(all.ior.ior, "ior", 0.0)?,
            specular: self.map(
                all.specular.specular_factor,
                &all.specular.specular_texture,
                "specularTexture",
                Channel::A,
            )?,
            specular_colour: ColourMap {
                factor: self.factors(all.specular.specular_color_factor.into(), "specularColorFactor")?,
                texture: self.colour_texture(&all.specular.specular_color_texture, "specularColorTexture")?,
            },
            clearcoat: Clearcoat {
                factor: self.map(
                    all.clearcoat.clearcoat_factor,
                    &all.clearcoat.clearcoat_texture,
                    "clearcoatTexture",
                    Channel::R,
                )?,
                roughness: self.map(
                    all.clearcoat.clearcoat_roughness_factor,
                    &all.clearcoat.clearcoat_roughness_texture,
                    "clearcoatRoughnessTexture",
                    Channel::G,
                )?,
                normal: self.normal(&all.clearcoat.clearcoat_normal_texture, "clearcoatNormalTexture")?,
            },
            sheen: Sheen {
                colour: ColourMap {
                    factor: self.factors(all.sheen.sheen_color_factor.into(), "sheenColorFactor")?,
                    texture: self.colour_texture(&all.sheen.sheen_color_texture, "sheenColorTexture")?,
                },
                roughness: self.map(
                    all.sheen.sheen_roughness_factor,
                    &all.sheen.sheen_roughness_texture,
                    "sheenRoughnessTexture",
                    Channel::A,
                )?,
            },
            transmission: self.map(
                all.transmission.transmission_factor,
                &all.transmission.transmission_texture,
                "transmissionTexture",
                Channel::R,
            )?,
            volume: Volume {
                thickness: self.map(
                    volume.thickness_factor,
                    &volume.thickness_texture,
                    "thicknessTexture",
                    Channel::G,
                )?,
                attenuation_colour: LinearRgb(self.factors(volume.attenuation_color.into(), "attenuationColor")?),
                attenuation_distance: distance,
            },
            anisotropy: Anisotropy {
                strength: self.factor(all.anisotropy.anisotropy_strength, "anisotropyStrength")?,
                rotation: self.finite(all.anisotropy.anisotropy_rotation, "anisotropyRotation")?,
                texture: self.texture(&all.anisotropy.anisotropy_texture, "anisotropyTexture", Encoding::Linear)?,
            },
            iridescence: Iridescence {
                factor: self.map(
                    iridescence.iridescence_factor,
                    &iridescence.iridescence_texture,
                    "iridescenceTexture",
                    Channel::R,
                )?,
                ior: self.index_of_refraction(iridescence.iridescence_ior, "iridescenceIor", 1.0)?,
                thickness_nm: ScalarMap { offset: thinnest, factor: thickest - thinnest, ..film },
            },
            dispersion: self.factor(all.dispersion.dispersion, "dispersion")?,
            ..common
        })
    }

    fn invalid(&self, what: impl Into<String>) -> crate::Error {
        self.asset.invalid(&self.here, what)
    }

    fn finite(&self, value: f32, name: &str) -> Result<f32> {
        if value.is_finite() { Ok(value) } else { Err(self.invalid(format!("its {name} must be finite"))) }
    }

    /// `value`, if it can be a factor. Those above 1 are cut where they are used.
    fn factor(&self, value: f32, name: &str) -> Result<f32> {
        let usable = value.is_finite() && value >= 0.0;
        if usable { Ok(value) } else { Err(self.invalid(format!("its {name} must be finite and not negative"))) }
    }

    fn factors(&self, values: Vec3, name: &str) -> Result<Vec3> {
        values.to_array().into_iter().try_for_each(|value| self.factor(value, name).map(drop))?;
        Ok(values)
    }

    fn colour_and_alpha(&self, values: [f32; 4], name: &str) -> Result<Vec4> {
        values.into_iter().try_for_each(|value| self.factor(value, name).map(drop))?;
        Ok(values.into())
    }

    /// An index of refraction: at least 1, or `special`.
    fn index_of_refraction(&self, value: f32, name: &str, special: f32) -> Result<f32> {
        let usable = value.is_finite() && (value >= 1.0 || value == special);
        if usable { Ok(value) } else { Err(self.invalid(format!("its {name} is {value}; it must be at least 1"))) }
    }

    fn texture(&mut self, info: &Option<TextureInfo>, slot: &str, encoding: Encoding) -> Result<Option<TextureRef>> {
        let Some(info) = info else { return Ok(None) };
        let here = format!("{} {slot}", self.here);
        let transform = info.extensions.transform.as_ref();
        let uv_set = transform.and_then(|transform| transform.tex_coord).unwrap_or(info.tex_coord);
        if uv_set >= UV_SETS {
            return Err(self.asset.unsupported(format!("{here} uses TEXCOORD_{uv_set}; only sets 0 and 1 are read")));
        }
        let uv_from_uv = transform.map_or(Mat3::IDENTITY, |transform| {
            uv_transform(transform.offset.into(), transform.rotation, transform.scale.into())
        });
        if !uv_from_uv.is_finite() {
            return Err(self.asset.invalid(here, "its KHR_texture_transform is not finite"));
        }
        let texture = self.materials.texture(self.asset, Index::new(info.index), encoding, &here, self.meshes)?;
        Ok(Some(TextureRef { texture, uv_set: uv_set as u8, uv_from_uv }))
    }

    fn colour_texture(&mut self, info: &Option<TextureInfo>, slot: &str) -> Result<Option<TextureRef>> {
        self.texture(info, slot, Encoding::Srgb)
    }

    /// A factor, called as the texture with "Factor" in its place, and a channel of the texture.
    fn map(&mut self, factor: f32, info: &Option<TextureInfo>, slot: &str, channel: Channel) -> Result<ScalarMap> {
        let factor = self.factor(factor, &slot.replace("Texture", "Factor"))?;
        self.scalar(factor, info, slot, channel)
    }

    fn scalar(&mut self, factor: f32, info: &Option<TextureInfo>, slot: &str, channel: Channel) -> Result<ScalarMap> {
        // Alpha is the same in both encodings; the extensions put it beside a colour, whose pixels it then shares.
        let encoding = if channel == Channel::A { Encoding::Srgb } else { Encoding::Linear };
        let texture = self.texture(info, slot, encoding)?.map(|texture| (texture, channel));
        Ok(ScalarMap { texture, ..factor.into() })
    }

    fn normal(&mut self, info: &Option<TextureInfo>, slot: &str) -> Result<Option<NormalMap>> {
        let Some(texture) = self.texture(info, slot, Encoding::Linear)? else { return Ok(None) };
        let scale = self.finite(info.as_ref().map_or(1.0, |info| info.scale), &format!("{slot} scale"))?;
        Ok(Some(NormalMap { texture, scale }))
    }

    /// `1 + strength (red - 1)` (glTF 2.0, section 5.22.3).
    fn occlusion(&mut self, info: &Option<TextureInfo>) -> Result<ScalarMap> {
        let Some(texture) = self.texture(info, "occlusionTexture", Encoding::Linear)? else { return Ok(1.0.into()) };
        let strength = info.as_ref().map_or(1.0, |info| info.strength);
        let strength = self.factor(strength, "occlusionTexture strength")?;
        Ok(ScalarMap { offset: 1.0 - strength, factor: strength, texture: Some((texture, Channel::R)) })
    }
}

/// KHR_texture_transform: translation x rotation x scale.
///
/// The rotation is counter-clockwise as seen in the image, whose v points down. That is what the extension's text and
/// its test asset (TextureTransformTest) say; the GLSL in the extension's page turns the other way.
fn uv_transform(offset: Vec2, rotation: f32, scale: Vec2) -> Mat3 {
    Mat3::from_translation(offset) * Mat3::from_angle(-rotation) * Mat3::from_scale(scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texture_transforms_put_the_arrow_of_khronos_test_asset_on_its_correct_markers() {
        // TextureTransformTest: the arrow's tip is at (0.778, 0.778) of the image; its nodes place the green markers.
        let tip = Vec2::splat(0.778);
        let rotation = uv_transform(Vec2::ZERO, std::f32::consts::FRAC_PI_8, Vec2::ONE);
        assert!(rotation.transform_point2(Vec2::new(0.421, 1.016)).abs_diff_eq(tip, 0.001));
        let scale = uv_transform(Vec2::ZERO, 0.0, Vec2::splat(1.5));
        assert!(scale.transform_point2(Vec2::splat(0.5185)).abs_diff_eq(tip, 0.001));
        let all = uv_transform(Vec2::new(-0.2, -0.1), 0.3, Vec2::splat(1.5));
        assert!(all.transform_point2(Vec2::new(0.43, 0.75)).abs_diff_eq(tip, 0.04));
    }

    #[test]
    fn texture_transforms_scale_then_rotate_then_move() {
        let quarter_turn = uv_transform(Vec2::new(10.0, 20.0), std::f32::consts::FRAC_PI_2, Vec2::new(2.0, 3.0));
        assert!(quarter_turn.transform_point2(Vec2::X).abs_diff_eq(Vec2::new(10.0, 18.0), 1e-5));
        assert!(quarter_turn.transform_point2(Vec2::Y).abs_diff_eq(Vec2::new(13.0, 20.0), 1e-5));
    }
}
