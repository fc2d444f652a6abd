//! Materials and textures, converted when a primitive first uses them.

use std::collections::BTreeMap;

use glam::{Mat3, Vec2, Vec3, Vec4};
use gltf::json::material::AlphaMode as JsonAlphaMode;
use gltf::json::texture::{Info, MagFilter, Sampler, WrappingMode};
use gltf::json::validation::Checked;
use gltf::json::{self, Index};

use super::container::{Asset, place};
use super::image::Images;
use crate::Result;
use crate::scene::LinearRgb;
use crate::scene::mesh::{AlphaMode, Material, Meshes, Texture, TextureRef, Wrap};

/// How many sets of texture coordinates vertices carry.
pub const UV_SETS: u32 = 2;

/// The materials and textures of one file that are in use, by their place in the file.
#[derive(Default)]
pub struct Materials {
    images: Images,
    /// Index in [`Meshes::materials`]; the key `None` is glTF's default material.
    materials: BTreeMap<Option<usize>, u32>,
    /// Index in [`Meshes::textures`] by image and sampler.
    textures: BTreeMap<(usize, Option<usize>), u32>,
}

impl Materials {
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
            Some(index) => self.convert(asset, index, user, meshes)?,
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

    fn convert(
        &mut self,
        asset: &Asset,
        index: Index<json::Material>,
        user: &str,
        meshes: &mut Meshes,
    ) -> Result<Material> {
        let source = asset.get(index, user)?;
        let here = place("materials", index.value(), source.name.as_deref());
        let pbr = &source.pbr_metallic_roughness;
        let extensions = source.extensions.as_ref();
        let strength = extensions.and_then(|all| all.emissive_strength.as_ref()).map_or(1.0, |e| e.emissive_strength.0);
        let cutoff = source.alpha_cutoff.map_or(0.5, |cutoff| cutoff.0);
        let base_colour = Vec4::from(pbr.base_color_factor.0);
        let emissive = Vec3::from(source.emissive_factor.0) * strength;
        let usable = |factor: f32| factor.is_finite() && factor >= 0.0;
        if !base_colour.to_array().into_iter().chain(emissive.to_array()).chain([cutoff]).all(usable) {
            return Err(asset.invalid(here, "its factors must be finite and not negative"));
        }
        let alpha = match source.alpha_mode {
            Checked::Valid(JsonAlphaMode::Opaque) => AlphaMode::Opaque,
            Checked::Valid(JsonAlphaMode::Mask) => AlphaMode::Mask { cutoff },
            Checked::Valid(JsonAlphaMode::Blend) => AlphaMode::Blend,
            Checked::Invalid => return Err(asset.invalid(here, "its alphaMode is not OPAQUE, MASK or BLEND")),
        };
        let mut texture = |info: &Option<Info>, slot: &str| -> Result<Option<TextureRef>> {
            info.as_ref().map(|info| self.texture_ref(asset, info, &format!("{here} {slot}"), meshes)).transpose()
        };
        Ok(Material {
            name: source.name.clone().unwrap_or_default(),
            base_colour,
            base_colour_texture: texture(&pbr.base_color_texture, "baseColorTexture")?,
            emissive: LinearRgb(emissive),
            emissive_texture: texture(&source.emissive_texture, "emissiveTexture")?,
            alpha,
            double_sided: source.double_sided,
            unlit: extensions.is_some_and(|all| all.unlit.is_some()),
        })
    }

    fn texture_ref(&mut self, asset: &Asset, info: &Info, here: &str, meshes: &mut Meshes) -> Result<TextureRef> {
        let transform = info.extensions.as_ref().and_then(|all| all.texture_transform.as_ref());
        let uv_set = transform.and_then(|transform| transform.tex_coord).unwrap_or(info.tex_coord);
        if uv_set >= UV_SETS {
            return Err(asset.unsupported(format!("{here} uses TEXCOORD_{uv_set}; only sets 0 and 1 are read")));
        }
        let uv_from_uv = transform.map_or(Mat3::IDENTITY, |transform| {
            uv_transform(transform.offset.0.into(), transform.rotation.0, transform.scale.0.into())
        });
        if !uv_from_uv.is_finite() {
            return Err(asset.invalid(here, "its KHR_texture_transform is not finite"));
        }
        Ok(TextureRef { texture: self.texture(asset, info.index, here, meshes)?, uv_set: uv_set as u8, uv_from_uv })
    }

    fn texture(&mut self, asset: &Asset, index: Index<json::Texture>, here: &str, meshes: &mut Meshes) -> Result<u32> {
        let source = asset.get(index, here)?;
        // The gltf crate reads an absent source as this index.
        if source.source.value() == u32::MAX as usize {
            let others =
                source.extensions.as_ref().map(|all| all.others.keys().cloned().collect::<Vec<_>>().join(", "));
            let only =
                others.filter(|names| !names.is_empty()).map_or(String::new(), |names| format!(", only {names}"));
            let texture = place("textures", index.value(), source.name.as_deref());
            return Err(asset.unsupported(format!("{texture} of {here} has no PNG or JPEG source{only}")));
        }
        let key = (source.source.value(), source.sampler.map(|sampler| sampler.value()));
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
        let nearest = matches!(sampler.mag_filter, Some(Checked::Valid(MagFilter::Nearest)));
        let pixels = self.images.get(asset, source.source, here)?;
        meshes.textures.push(Texture { width: pixels.width, height: pixels.height, rgba: pixels.rgba, wrap, nearest });
        let appended = meshes.textures.len() as u32 - 1;
        self.textures.insert(key, appended);
        Ok(appended)
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
