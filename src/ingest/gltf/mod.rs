//! glTF 2.0 (.glb and .gltf) to world-space triangles, and to splats.
//!
//! The `gltf` crate gives the typed JSON. Its validation and its readers are not used: they reject or misread
//! extensions that are read here, and trust what a hostile file says. What is read instead is checked index by index.

mod accessor;
mod compressed;
mod container;
mod geometry;
mod image;
mod light;
mod material;
mod material_json;
mod meshopt;
mod nodes;
mod pose;
mod primitives;
mod resource;
mod splats;
mod variants;

use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};
use gltf::json::{Index, Node};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::geometry::{DroppedTriangles, bounds};
use super::requests::Contents;
use super::tangents;
use crate::Result;
use crate::job::MeshInput;
use crate::scene::bounds::Bounds;
use crate::scene::{Light, Meshes};

use container::{Asset, place};
use material::Materials;
use nodes::Hierarchy;

pub(super) use container::is_gltf;
pub(super) use splats::open_splats;

/// What was read from a mesh file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub struct MeshReport {
    /// The file.
    pub path: PathBuf,
    /// That file and all others that were read for it; also those that were looked for and are not there.
    #[serde(skip)]
    pub files: Vec<PathBuf>,
    /// Name of the scene that was read, when it has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
    /// Nodes of that scene.
    pub nodes: usize,
    /// Triangles that can be seen, instances counted.
    pub triangles: usize,
    /// Triangles that cannot.
    pub dropped_triangles: DroppedTriangles,
    /// Primitives of points or lines: they have no surface and were skipped.
    pub skipped_primitives: usize,
    /// Materials in use.
    pub materials: usize,
    /// Names of the material variants that the file has.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub variants: Vec<String>,
    /// Textures that the materials in use name, by image, sampler and encoding.
    pub textures: usize,
    /// What is wrong with the images that magenta stands for.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub replaced_images: Vec<String>,
    /// Lights that shine.
    pub lights: usize,
    /// Lights of intensity 0, and those whose nodes leave them no place or direction.
    pub dark_lights: usize,
    /// Extensions that the file says it uses.
    pub extensions_used: Vec<String>,
    /// Those of them that were passed over.
    pub extensions_ignored: Vec<String>,
    /// What is read in another way than the file means, or left out, each with the first place that it concerns.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub notes: Vec<String>,
    /// Box around the triangles, in metres in the world; absent without triangles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bounds: Option<Bounds>,
}

/// What the scene called `scene`, or the default one, of the file at `path` holds. Buffers are not read.
pub(super) fn contents(path: &Path, scene: Option<&str>) -> Result<Contents> {
    let (asset, _) = Asset::parse(path)?;
    let mut contents = Contents::default();
    for &node in &Hierarchy::of_scene(&asset, scene)?.order {
        let Some(mesh) = asset.get(node, "/nodes")?.mesh else { continue };
        for p in 0..asset.get(mesh, "a node's mesh")?.primitives.len() {
            let splats = asset.splats.get(mesh.value(), p).is_some();
            contents.splats |= splats;
            contents.meshes |= !splats;
        }
    }
    Ok(contents)
}

/// Appends the triangles of a scene of `input`, with their materials and textures, to `meshes`, and its lights to `lights`.
///
/// Transforms are composed in f64; positions are stored relative to `origin` (world, metres). Skins and morph targets
/// are read in their rest pose. On an error `meshes` and `lights` may hold a part of the file.
pub fn load(input: &MeshInput, origin: DVec3, meshes: &mut Meshes, lights: &mut Vec<Light>) -> Result<MeshReport> {
    let asset = Asset::read(&input.path)?;
    let hierarchy = Hierarchy::of_scene(&asset, input.scene.as_deref())?;
    let stored_from_file = DAffine3::from_translation(-origin) * input.transform.world_from_file();
    let variants = variants::names(&asset)?;
    let variant = input.variant.as_deref().map(|wanted| variants::find(&asset, &variants, wanted)).transpose()?;
    let (first_vertex, first_triangle, first_light) = (meshes.positions.len(), meshes.triangles.len(), lights.len());
    let mut loader = Loader {
        asset: &asset,
        hierarchy: &hierarchy,
        stored_from_file,
        variant,
        materials: Materials::new(input.missing_texture),
        dropped: DroppedTriangles::default(),
        skipped_primitives: 0,
        dark_lights: 0,
        meshes,
        lights,
    };
    for &node in &hierarchy.order {
        loader.append_node(node)?;
    }
    let Loader { materials, dropped, skipped_primitives, dark_lights, .. } = loader;
    Ok(MeshReport {
        path: input.path.clone(),
        files: [vec![input.path.clone()], asset.log.files()].concat(),
        nodes: hierarchy.order.len(),
        triangles: meshes.triangles.len() - first_triangle,
        dropped_triangles: dropped,
        skipped_primitives,
        materials: materials.materials_in_use(),
        variants,
        textures: materials.textures_in_use(),
        replaced_images: materials.into_replaced_images(),
        lights: lights.len() - first_light,
        dark_lights,
        extensions_ignored: asset.ignored_extensions(),
        notes: Vec::new(),
        bounds: bounds(meshes, first_vertex, origin),
        scene: hierarchy.scene,
        extensions_used: asset.root.extensions_used,
    })
}

/// One pass over the nodes of a scene.
struct Loader<'a> {
    asset: &'a Asset,
    hierarchy: &'a Hierarchy,
    stored_from_file: DAffine3,
    variant: Option<usize>,
    materials: Materials,
    dropped: DroppedTriangles,
    skipped_primitives: usize,
    dark_lights: usize,
    meshes: &'a mut Meshes,
    lights: &'a mut Vec<Light>,
}

impl Loader<'_> {
    fn append_node(&mut self, index: Index<Node>) -> Result<()> {
        let node = self.asset.get(index, "/nodes")?;
        let here = place("nodes", index.value(), node.name.as_deref());
        self.append_light(node, index, &here)?;
        let Some(mesh) = node.mesh else { return Ok(()) };
        let stored_from_instances = self.stored_from_instances(node, index, &here)?;
        let mesh_index = mesh.value();
        let mesh = self.asset.get(mesh, &here)?;
        let mesh_place = place("meshes", mesh_index, mesh.name.as_deref());
        let skin = node.skin.map(|skin| pose::joint_transforms(self.asset, self.hierarchy, skin, &here));
        let file_from_joints = skin.transpose()?;
        for (i, primitive) in mesh.primitives.iter().enumerate() {
            if self.asset.splats.get(mesh_index, i).is_some() {
                continue;
            }
            let here = format!("{mesh_place}/primitives/{i}");
            let Some(mut geometry) = geometry::read(self.asset, primitive, &here)? else {
                self.skipped_primitives += 1;
                continue;
            };
            let material = variants::material_of(self.asset, primitive, self.variant, &here)?;
            let material = self.materials.get(self.asset, material, &here, self.meshes)?;
            let tangent_uv_set = self.meshes.materials[material as usize].tangent_uv_set();
            if tangent_uv_set.is_some() {
                geometry::read_tangents(self.asset, primitive, &mut geometry, &here)?;
            }
            pose::morph(self.asset, &mut geometry, node, mesh, primitive, &here)?;
            if let Some(file_from_joints) = &file_from_joints {
                pose::skin(self.asset, &mut geometry, primitive, file_from_joints, &here)?;
            }
            if let (Some(uv_set), true) = (tangent_uv_set, geometry.tangents.is_empty()) {
                tangents::generate(&mut geometry, uv_set);
            }
            geometry.append(&self.asset.path, &stored_from_instances, material, self.meshes, &mut self.dropped)?;
        }
        Ok(())
    }

    fn append_light(&mut self, node: &Node, index: Index<Node>, here: &str) -> Result<()> {
        match light::of_node(self.asset, node, self.stored_from_node(index), here)? {
            Some(Some(light)) => self.lights.push(light),
            Some(None) => self.dark_lights += 1,
            None => {}
        }
        Ok(())
    }

    fn stored_from_node(&self, index: Index<Node>) -> DAffine3 {
        self.stored_from_file * self.hierarchy.file_from_node[index.value()].unwrap_or(DAffine3::IDENTITY)
    }

    /// Where the geometry of a node goes. Skinned geometry is posed in file coordinates: glTF ignores its node's own
    /// transform.
    fn stored_from_instances(&self, node: &Node, index: Index<Node>, here: &str) -> Result<Vec<DAffine3>> {
        if node.skin.is_some() {
            return Ok(vec![self.stored_from_file]);
        }
        let stored_from_node = self.stored_from_node(index);
        let instances = nodes::node_from_instances(self.asset, node, here)?;
        Ok(instances.into_iter().map(|node_from_instance| stored_from_node * node_from_instance).collect())
    }
}
