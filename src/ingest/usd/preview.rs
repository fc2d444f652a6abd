//! UsdPreviewSurface to glTF's material model.

use glam::{Mat3, Vec2, Vec3, Vec4};
use openusd::sdf::Value;
use openusd::usd::Prim;

use super::OpenedStage;
use super::meshes::Notes;
use super::network::{self, Input, PrimvarReader, UvTexture};
use super::texture::Textures;
use super::values::numbers;
use crate::Result;
use crate::scene::material::{AlphaMode, Clearcoat, ColourMap, NormalMap, ScalarMap, TextureRef};
use crate::scene::{LinearRgb, Material, Meshes};

/// diffuseColor where nothing says otherwise.
pub const GREY: f32 = 0.18;

/// A material as meshes use it.
#[derive(Clone, Default)]
pub struct Surface {
    /// Index in [`Meshes::materials`].
    pub material: u32,
    /// Texture coordinates of sets 0 and 1.
    pub uv: [Option<PrimvarReader>; 2],
    pub colour: Option<PrimvarReader>,
    pub opacity: Option<PrimvarReader>,
}

/// Appends what the UsdPreviewSurface `shader` of the material `name` says to `meshes`.
pub fn convert(
    stage: &OpenedStage,
    shader: &Prim,
    name: &str,
    double_sided: bool,
    textures: &mut Textures,
    notes: &mut Notes,
    meshes: &mut Meshes,
) -> Result<Surface> {
    Conversion { stage, shader, textures, notes, meshes, surface: Surface::default() }.convert(name, double_sided)
}

/// A UsdPreviewSurface on its way to a material.
struct Conversion<'a, 'b> {
    stage: &'a OpenedStage<'a>,
    shader: &'a Prim,
    textures: &'b mut Textures,
    notes: &'b mut Notes,
    meshes: &'b mut Meshes,
    surface: Surface,
}

impl Conversion<'_, '_> {
    /// The material and what it reads of its mesh.
    ///
    /// opacity below its threshold cuts, else it blends all of the surface, as opacityMode `presence` says; that of
    /// `transparent`, which keeps the reflections, has no counterpart.
    fn convert(mut self, name: &str, double_sided: bool) -> Result<Surface> {
        let uses_specular = self.parameter("useSpecularWorkflow", 0.0)? != 0.0;
        let mut material = Material {
            name: name.to_owned(),
            double_sided,
            roughness: self.scalar("roughness", 0.5)?,
            occlusion: self.scalar("occlusion", 1.0)?,
            normal: self.normal()?,
            clearcoat: Clearcoat {
                factor: self.scalar("clearcoat", 0.0)?,
                roughness: self.scalar("clearcoatRoughness", 0.01)?,
                normal: None,
            },
            ..Material::default()
        };
        self.base_colour(&mut material)?;
        let emission = self.colour("emissiveColor", [0.0; 3])?;
        (material.emissive, material.emissive_texture) = (LinearRgb(emission.factor), emission.texture);
        if uses_specular {
            // A dielectric whose reflectance at normal incidence is the colour alone, which index of refraction 0 stands for.
            material.metallic = 0.0.into();
            material.specular_colour = self.colour("specularColor", [0.0; 3])?;
            material.ior = 0.0;
        } else {
            material.metallic = self.scalar("metallic", 0.0)?;
            material.ior = self.index_of_refraction()?;
        }
        if !matches!(self.input("displacement")?, Input::Value(value) if value.is_none() || is_zero(value.as_ref())) {
            self.notes.add("displacement is left out", self.shader);
        }
        self.surface.material = self.meshes.materials.len() as u32;
        self.meshes.materials.push(material);
        Ok(self.surface)
    }

    /// diffuseColor with opacity as its alpha.
    fn base_colour(&mut self, material: &mut Material) -> Result<()> {
        let (mut colour_texture, mut alpha_texture) = (None, None);
        let mut factor = Vec4::ONE;
        match self.input("diffuseColor")? {
            Input::Value(value) => factor = self.constant("diffuseColor", value, [GREY; 3])?.extend(1.0),
            Input::Primvar(reader) => self.surface.colour = Some(reader),
            Input::Texture(texture) => colour_texture = Some(texture),
            other @ Input::Other(_) => {
                self.note_fallback("diffuseColor", &other);
                factor = Vec3::splat(GREY).extend(1.0);
            }
        }
        match self.input("opacity")? {
            Input::Value(value) => {
                [factor.w] = network::constant(self.stage, self.shader, "opacity", value.as_ref(), [1.0])?;
            }
            Input::Primvar(reader) => self.surface.opacity = Some(reader),
            Input::Texture(texture) => alpha_texture = Some(texture),
            other @ Input::Other(_) => self.note_fallback("opacity", &other),
        }
        let mut varies = self.surface.opacity.is_some();
        if let (Some(colour), Some(alpha)) = (&colour_texture, &alpha_texture)
            && (&colour.coordinates, colour.st_from_st, colour.wrap)
                != (&alpha.coordinates, alpha.st_from_st, alpha.wrap)
        {
            self.notes.add("opacity by other coordinates than diffuseColor is left out", self.shader);
            alpha_texture = None;
        }
        let (colour, alpha) = (colour_texture.as_deref(), alpha_texture.as_deref());
        if let Some(placed) = colour.or(alpha) {
            let made = self.textures.colour(self.stage, colour, alpha, self.meshes)?;
            if let Some(texture) = self.texture_ref(made.texture, placed)? {
                material.base_colour_texture = Some(texture);
                factor *= made.factor.extend(made.alpha_factor);
                varies |= made.has_alpha;
            }
        }
        material.base_colour = factor.max(Vec4::ZERO);
        let threshold = self.parameter("opacityThreshold", 0.0)?;
        material.alpha = match varies || factor.w < 1.0 {
            false => AlphaMode::Opaque,
            true if threshold > 0.0 => AlphaMode::Mask { cutoff: threshold },
            true => AlphaMode::Blend,
        };
        Ok(())
    }

    fn colour(&mut self, name: &str, default: [f32; 3]) -> Result<ColourMap> {
        match self.input(name)? {
            Input::Value(value) => Ok(ColourMap::new(self.constant(name, value, default)?)),
            Input::Texture(source) => {
                let made = self.textures.colour(self.stage, Some(&source), None, self.meshes)?;
                let texture = self.texture_ref(made.texture, &source)?;
                Ok(ColourMap { factor: texture.map_or(Vec3::from(default), |_| made.factor), texture })
            }
            other => {
                self.note_fallback(name, &other);
                Ok(ColourMap::new(Vec3::from(default)))
            }
        }
    }

    fn scalar(&mut self, name: &str, default: f32) -> Result<ScalarMap> {
        match self.input(name)? {
            Input::Value(value) => {
                let [value] = network::constant(self.stage, self.shader, name, value.as_ref(), [default])?;
                Ok(value.clamp(0.0, 1.0).into())
            }
            Input::Texture(source) => {
                let made = self.textures.channel(self.stage, &source, self.meshes)?;
                Ok(match self.texture_ref(made.texture, &source)? {
                    None => default.into(),
                    Some(texture) => {
                        ScalarMap { offset: made.offset, factor: made.factor, texture: Some((texture, made.channel)) }
                    }
                })
            }
            other => {
                self.note_fallback(name, &other);
                Ok(default.into())
            }
        }
    }

    fn normal(&mut self) -> Result<Option<NormalMap>> {
        match self.input("normal")? {
            Input::Texture(source) => {
                let (texture, scale) = self.textures.normal(self.stage, &source, self.meshes)?;
                Ok(self.texture_ref(texture, &source)?.map(|texture| NormalMap { texture, scale }))
            }
            Input::Value(None) => Ok(None),
            Input::Value(value) => {
                if self.constant("normal", value, [0.0, 0.0, 1.0])? != Vec3::Z {
                    self.notes.add("normals that are not a texture are left out", self.shader);
                }
                Ok(None)
            }
            other => {
                self.note_fallback("normal", &other);
                Ok(None)
            }
        }
    }

    /// Reflectance is the same for an index and its inverse.
    fn index_of_refraction(&mut self) -> Result<f32> {
        let ior = match self.input("ior")? {
            Input::Value(value) => network::constant(self.stage, self.shader, "ior", value.as_ref(), [1.5])?[0],
            other => {
                self.note_fallback("ior", &other);
                1.5
            }
        };
        if !(ior > 0.0) {
            return Err(self.stage.invalid(self.shader, format!("its ior is {ior}; it must be above 0")));
        }
        Ok(ior.max(ior.recip()))
    }

    /// Says that what feeds an input is passed over.
    fn note_fallback(&mut self, name: &str, input: &Input) {
        let node = match input {
            Input::Other(id) => id,
            Input::Texture(_) => "UsdUVTexture",
            _ => "UsdPrimvarReader",
        };
        self.notes.add(&format!("{name} has its fallback where {node} feeds it"), self.shader);
    }

    fn parameter(&self, name: &str, default: f32) -> Result<f32> {
        network::parameters(self.stage, self.shader, name, [default]).map(|[value]| value)
    }

    fn constant(&self, name: &str, value: Option<Value>, default: [f32; 3]) -> Result<Vec3> {
        let colour = network::constant(self.stage, self.shader, name, value.as_ref(), default)?;
        Ok(Vec3::from(colour).max(Vec3::ZERO))
    }

    fn input(&self, name: &str) -> Result<Input> {
        network::input(self.stage, self.shader, name)
    }

    /// The texture `texture` by the coordinates of `source`; a surface reads at most two sets of them.
    fn texture_ref(&mut self, texture: u32, source: &UvTexture) -> Result<Option<TextureRef>> {
        if source.ends_black {
            self.notes.add("wrap mode black is read as clamp", self.shader);
        }
        let mut sets = self.surface.uv.iter_mut().enumerate();
        let set = sets.find(|(_, set)| set.as_ref().is_none_or(|reader| *reader == source.coordinates));
        let Some((uv_set, set)) = set else {
            self.notes.add("textures by a third set of coordinates are left out", self.shader);
            return Ok(None);
        };
        *set = Some(source.coordinates.clone());
        // t points up in the file and down in the scene.
        let flip = Mat3::from_translation(Vec2::Y) * Mat3::from_scale(Vec2::new(1.0, -1.0));
        Ok(Some(TextureRef { texture, uv_set: uv_set as u8, uv_from_uv: flip * source.st_from_st * flip }))
    }
}

fn is_zero(value: Option<&Value>) -> bool {
    value.and_then(numbers).is_some_and(|it| it.iter().all(|&x| x == 0.0))
}
