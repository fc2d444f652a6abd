//! The materials that meshes are bound to, converted when a mesh first uses them, and how meshes without one look.

use std::collections::BTreeMap;

use openusd::usd::Prim;

use super::OpenedStage;
use super::binding::{Bindings, PURPOSES};
use super::mesh::{Mesh, SurfacePrimvars};
use super::meshes::Notes;
use super::network::{self, PrimvarReader};
use super::preview::{self, GREY, Surface};
use super::primvar::Primvar;
use super::texture::Textures;
use crate::Result;
use crate::job::MissingTexture;
use crate::scene::material::AlphaMode;
use crate::scene::{Material, Meshes};

/// The materials of one stage that are in use.
pub struct Materials {
    bindings: Bindings,
    textures: Textures,
    /// By path, and by whether the mesh is seen from both sides.
    converted: BTreeMap<(String, bool), Surface>,
    /// For meshes without a material: by whether they are seen from both sides, and whether they have opacities.
    unbound: BTreeMap<(bool, bool), u32>,
}

impl Materials {
    /// None in use yet.
    pub fn new(missing_texture: MissingTexture) -> Self {
        Self {
            bindings: Bindings::default(),
            textures: Textures::new(missing_texture),
            converted: BTreeMap::new(),
            unbound: BTreeMap::new(),
        }
    }

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
                let surface =
                    preview::convert(stage, &shader, &key.0, mesh.double_sided, &mut self.textures, notes, meshes)?;
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

    /// What is wrong with the images that magenta stands for.
    pub fn into_replaced_images(self) -> Vec<String> {
        self.textures.into_replaced()
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
                metallic: 0.0.into(),
                roughness: 0.5.into(),
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
