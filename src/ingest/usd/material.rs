//! UsdPreviewSurface to materials, converted when a mesh first uses them.

use std::collections::BTreeMap;

use glam::{Vec3, Vec4};
use openusd::usd::Prim;

use super::OpenedStage;
use super::binding::{Bindings, PURPOSES};
use super::mesh::{Mesh, SurfacePrimvars};
use super::meshes::Notes;
use super::network::{self, Input, PrimvarReader, UvTexture};
use super::primvar::Primvar;
use super::texture::Textures;
use crate::Result;
use crate::scene::LinearRgb;
use crate::scene::mesh::{AlphaMode, Material, Meshes, TextureRef};

/// diffuseColor where nothing says otherwise (UsdPreviewSurface).
const GREY: f32 = 0.18;

/// The materials of one stage that are in use.
#[derive(Default)]
pub struct Materials {
    bindings: Bindings,
    textures: Textures,
    /// By path, and by whether the mesh is seen from both sides.
    converted: BTreeMap<(String, bool), Surface>,
    /// For meshes without a material: by whether they are seen from both sides, and whether they have opacities.
    unbound: BTreeMap<(bool, bool), u32>,
}

/// A material as meshes use it.
#[derive(Clone, Default)]
struct Surface {
    /// Index in [`Meshes::materials`].
    material: u32,
    uv: [Option<PrimvarReader>; 2],
    colour: Option<PrimvarReader>,
    opacity: Option<PrimvarReader>,
}

impl Materials {
    /// Index in [`Meshes::materials`] of the material that `bound`, the mesh `prim` or a subset of it, is bound to, appended
    /// at the first call, and the primvars of the mesh that it reads.
    pub fn surface(
        &mut self,
        stage: &OpenedStage,
        prim: &Prim,
        mesh: &Mesh,
        bound: &Prim,
        notes: &mut Notes,
        meshes: &mut Meshes,
    ) -> Result<(u32, SurfacePrimvars)> {
        let Some((material, shader)) = self.bound(stage, bound, notes)? else {
            return self.unbound(stage, prim, mesh, meshes);
        };
        let key = (material.path().as_str().to_owned(), mesh.double_sided);
        let surface = match self.converted.get(&key) {
            Some(surface) => surface.clone(),
            None => {
                let mut conversion = Conversion { stage, shader: &shader, textures: &mut self.textures, notes, meshes };
                let surface = conversion.surface(&key.0, mesh.double_sided)?;
                self.converted.entry(key).or_insert(surface).clone()
            }
        };
        let [first, second] = &surface.uv;
        let primvars = SurfacePrimvars {
            uv: [find(stage, prim, mesh, first)?, find(stage, prim, mesh, second)?],
            colour: find(stage, prim, mesh, &surface.colour)?,
            opacity: find(stage, prim, mesh, &surface.opacity)?,
        };
        Ok((surface.material, primvars))
    }

    /// How many materials are in use.
    pub fn materials_in_use(&self) -> usize {
        self.converted.len() + self.unbound.len()
    }

    /// How many textures are in use.
    pub fn textures_in_use(&self) -> usize {
        self.textures.in_use()
    }

    /// The material of `prim` that can be read, with its UsdPreviewSurface.
    fn bound(&mut self, stage: &OpenedStage, prim: &Prim, notes: &mut Notes) -> Result<Option<(Prim, Prim)>> {
        let mut unreadable = None;
        for purpose in PURPOSES {
            let Some(path) = self.bindings.material(stage, prim, purpose)? else { continue };
            let material = stage.stage.prim(path);
            match network::preview_surface(stage, &material)? {
                Some(shader) => return Ok(Some((material, shader))),
                None => unreadable = Some(material),
            }
        }
        if let Some(material) = unreadable {
            notes.add("materials without a UsdPreviewSurface are left out", &material);
        }
        Ok(None)
    }

    /// What a mesh without a material looks like: its displayColor and displayOpacity.
    fn unbound(
        &mut self,
        stage: &OpenedStage,
        prim: &Prim,
        mesh: &Mesh,
        meshes: &mut Meshes,
    ) -> Result<(u32, SurfacePrimvars)> {
        let colour = Primvar::find(stage, prim, "displayColor", &mesh.topology)?;
        let opacity: Option<Primvar<1>> = Primvar::find(stage, prim, "displayOpacity", &mesh.topology)?;
        let opacity = opacity.filter(|opacity| opacity.values.iter().any(|&[value]| value < 1.0));
        let key = (mesh.double_sided, opacity.is_some());
        let material = *self.unbound.entry(key).or_insert_with(|| {
            meshes.materials.push(Material {
                double_sided: mesh.double_sided,
                alpha: if opacity.is_some() { AlphaMode::Blend } else { AlphaMode::Opaque },
                ..Material::default()
            });
            meshes.materials.len() as u32 - 1
        });
        let colour = Some(colour.unwrap_or(Primvar::constant([GREY; 3])));
        Ok((material, SurfacePrimvars { colour, opacity, ..SurfacePrimvars::default() }))
    }
}

/// The primvar that `reader` reads on `prim`, or its fallback.
fn find<const N: usize>(
    stage: &OpenedStage,
    prim: &Prim,
    mesh: &Mesh,
    reader: &Option<PrimvarReader>,
) -> Result<Option<Primvar<N>>> {
    let Some(reader) = reader else { return Ok(None) };
    let found = match reader.name.as_str() {
        "" => None,
        name => Primvar::find(stage, prim, name, &mesh.topology)?,
    };
    let fallback = || std::array::from_fn(|i| reader.fallback.get(i).map_or(0.0, |&x| x as f32));
    Ok(Some(found.unwrap_or_else(|| Primvar::constant(fallback()))))
}

/// A UsdPreviewSurface on its way to a material.
struct Conversion<'a, 'b> {
    stage: &'a OpenedStage<'a>,
    shader: &'a Prim,
    textures: &'b mut Textures,
    notes: &'b mut Notes,
    meshes: &'b mut Meshes,
}

impl Conversion<'_, '_> {
    fn surface(&mut self, name: &str, double_sided: bool) -> Result<Surface> {
        let mut surface = Surface::default();
        let [threshold] = network::parameters(self.stage, self.shader, "opacityThreshold", [0.0])?;
        let mut material = Material { name: name.to_owned(), double_sided, ..Material::default() };
        self.base_colour(threshold, &mut material, &mut surface)?;
        self.emission(&mut material, &mut surface)?;
        surface.material = self.meshes.materials.len() as u32;
        self.meshes.materials.push(material);
        Ok(surface)
    }

    /// diffuseColor with opacity as its alpha.
    fn base_colour(&mut self, threshold: f32, material: &mut Material, surface: &mut Surface) -> Result<()> {
        let diffuse = self.input("diffuseColor")?;
        let opacity = self.input("opacity")?;
        let (mut colour_texture, mut alpha_texture) = (None, None);
        let colour = match diffuse {
            Input::Value(value) => {
                network::constant(self.stage, self.shader, "diffuseColor", value.as_ref(), [GREY; 3])?
            }
            Input::Primvar(reader) => {
                surface.colour = Some(reader);
                [1.0; 3]
            }
            Input::Texture(texture) => {
                colour_texture = Some(texture);
                [1.0; 3]
            }
            Input::Other(_) => [GREY; 3],
        };
        let mut alpha = 1.0;
        match opacity {
            Input::Value(value) => {
                [alpha] = network::constant(self.stage, self.shader, "opacity", value.as_ref(), [1.0])?;
            }
            Input::Primvar(reader) => surface.opacity = Some(reader),
            Input::Texture(texture) => alpha_texture = Some(texture),
            Input::Other(_) => {}
        }
        let mut varies = surface.opacity.is_some();
        material.base_colour = Vec3::from(colour).extend(alpha);
        if colour_texture.is_some() || alpha_texture.is_some() {
            let (colour, alpha) = (colour_texture.as_deref(), alpha_texture.as_deref());
            let baked = self.textures.colour(self.stage, colour, alpha, self.notes, self.meshes)?;
            if let Some(source) = colour.or(alpha) {
                material.base_colour_texture = self.texture_ref(baked.texture, source, surface)?;
            }
            material.base_colour *= baked.factor;
            varies |= baked.alpha_varies;
        }
        material.base_colour = material.base_colour.max(Vec4::ZERO);
        material.alpha = match varies || material.base_colour.w < 1.0 {
            false => AlphaMode::Opaque,
            true if threshold > 0.0 => AlphaMode::Mask { cutoff: threshold },
            true => AlphaMode::Blend,
        };
        Ok(())
    }

    fn emission(&mut self, material: &mut Material, surface: &mut Surface) -> Result<()> {
        let factor = match self.input("emissiveColor")? {
            Input::Value(value) => {
                network::constant(self.stage, self.shader, "emissiveColor", value.as_ref(), [0.0; 3])?.into()
            }
            Input::Texture(source) => {
                let baked = self.textures.colour(self.stage, Some(&source), None, self.notes, self.meshes)?;
                material.emissive_texture = self.texture_ref(baked.texture, &source, surface)?;
                baked.factor.truncate()
            }
            Input::Primvar(_) | Input::Other(_) => {
                self.notes.add("emissiveColor from a primvar is left out", self.shader);
                Vec3::ZERO
            }
        };
        material.emissive = LinearRgb(factor.max(Vec3::ZERO));
        Ok(())
    }

    fn input(&mut self, name: &str) -> Result<Input> {
        let input = network::input(self.stage, self.shader, name)?;
        if let Input::Other(id) = &input {
            self.notes.add(&format!("inputs fed by {id} nodes have their fallback"), self.shader);
        }
        Ok(input)
    }

    /// The texture `texture` by the coordinates of `source`; a surface reads at most two sets of them.
    fn texture_ref(&mut self, texture: u32, source: &UvTexture, surface: &mut Surface) -> Result<Option<TextureRef>> {
        let mut sets = surface.uv.iter_mut().enumerate();
        let set = sets.find(|(_, set)| set.as_ref().is_none_or(|reader| *reader == source.coordinates));
        let Some((uv_set, set)) = set else {
            self.notes.add("textures by a third set of coordinates are left out", self.shader);
            return Ok(None);
        };
        *set = Some(source.coordinates.clone());
        // t points up in the file and down in the scene.
        let flip = glam::Mat3::from_cols_array(&[1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 1.0, 1.0]);
        Ok(Some(TextureRef { texture, uv_set: uv_set as u8, uv_from_uv: flip * source.st_from_st * flip }))
    }
}
