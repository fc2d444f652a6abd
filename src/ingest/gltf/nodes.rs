//! The node hierarchy, flattened: which node stands where. Iterative, so that depth costs no stack.

use glam::{DAffine3, DMat4, DQuat, DVec3, DVec4};
use gltf::json::accessor::Type;
use gltf::json::{Accessor, Index, Node};
use serde_json::Value;

use super::accessor::read_vectors;
use super::container::{Asset, LocalTransform, place};
use crate::{Error, Result};

/// The nodes of the chosen scene, and how they stand in the file's coordinates.
pub struct Hierarchy {
    /// Name of the scene, when it has one.
    pub scene: Option<String>,
    /// Nodes in depth-first order, children in the file's order.
    pub order: Vec<Index<Node>>,
    /// For every node of the file that the scene reaches: file coordinates from the node's.
    pub file_from_node: Vec<Option<DAffine3>>,
}

impl Hierarchy {
    /// Walks the scene called `wanted` (a name, else an index), or the default scene, or the first, or all roots.
    pub fn of_scene(asset: &Asset, wanted: Option<&str>) -> Result<Self> {
        let (scene, roots) = roots_of_scene(asset, wanted)?;
        let mut hierarchy = Self { scene, order: Vec::new(), file_from_node: vec![None; asset.root.nodes.len()] };
        let mut pending: Vec<(Index<Node>, DAffine3)> = Vec::new();
        pending.extend(roots.iter().rev().map(|&root| (root, DAffine3::IDENTITY)));
        while let Some((index, file_from_parent)) = pending.pop() {
            let here = place("nodes", index.value(), None);
            let node = asset.get(index, "a scene's or node's list of nodes")?;
            let here = node.name.as_deref().map_or(here, |name| place("nodes", index.value(), Some(name)));
            let slot = &mut hierarchy.file_from_node[index.value()];
            if slot.is_some() {
                return Err(asset.invalid(here, "it is reached twice: it has two parents or is its own ancestor"));
            }
            let local = asset.local_transforms.get(index.value()).map_or(Ok(DAffine3::IDENTITY), parent_from_node);
            let local = local.map_err(|why| asset.invalid(&here, why))?;
            let file_from_node = checked(asset, file_from_parent * local, &here)?;
            *slot = Some(file_from_node);
            hierarchy.order.push(index);
            let children = node.children.as_deref().unwrap_or_default();
            pending.extend(children.iter().rev().map(|&child| (child, file_from_node)));
        }
        Ok(hierarchy)
    }
}

/// `transform`, unless it is not finite.
fn checked(asset: &Asset, transform: DAffine3, here: &str) -> Result<DAffine3> {
    if transform.is_finite() {
        return Ok(transform);
    }
    Err(asset.invalid(here, "its transform is not finite: a number is too large, or a rotation has length 0"))
}

fn parent_from_node(local: &LocalTransform) -> std::result::Result<DAffine3, &'static str> {
    if let Some(matrix) = local.matrix {
        let matrix = DMat4::from_cols_array(&matrix);
        if (matrix.row(3) - DVec4::W).abs().max_element() > 1e-5 {
            return Err("its matrix is not affine: the last row must be 0 0 0 1");
        }
        return Ok(DAffine3::from_mat4(matrix));
    }
    let rotation = local.rotation.map_or(DQuat::IDENTITY, |r| DQuat::from_array(r).normalize());
    let scale = local.scale.map_or(DVec3::ONE, DVec3::from);
    let translation = local.translation.map_or(DVec3::ZERO, DVec3::from);
    Ok(DAffine3::from_scale_rotation_translation(scale, rotation, translation))
}

fn roots_of_scene(asset: &Asset, wanted: Option<&str>) -> Result<(Option<String>, Vec<Index<Node>>)> {
    let scenes = &asset.root.scenes;
    let chosen = match (wanted, asset.root.scene) {
        (Some(wanted), _) => {
            let named = scenes.iter().find(|scene| scene.name.as_deref() == Some(wanted));
            let indexed = || wanted.parse::<usize>().ok().and_then(|index| scenes.get(index));
            Some(named.or_else(indexed).ok_or_else(|| unknown_scene(asset, wanted))?)
        }
        (None, Some(default)) => Some(asset.get(default, "/scene")?),
        (None, None) => scenes.first(),
    };
    if let Some(scene) = chosen {
        return Ok((scene.name.clone(), scene.nodes.clone()));
    }
    let nodes = &asset.root.nodes;
    let mut is_child = vec![false; nodes.len()];
    for child in nodes.iter().flat_map(|node| node.children.as_deref().unwrap_or_default()) {
        asset.get(*child, "a node's children")?;
        is_child[child.value()] = true;
    }
    let roots: Vec<_> = (0..nodes.len()).filter(|&i| !is_child[i]).map(|i| Index::new(i as u32)).collect();
    if roots.is_empty() && !nodes.is_empty() {
        return Err(asset.invalid("/nodes", "every node is the child of another: the hierarchy has a cycle"));
    }
    Ok((None, roots))
}

fn unknown_scene(asset: &Asset, wanted: &str) -> Error {
    let scenes = asset.root.scenes.iter().enumerate();
    let names: Vec<_> = scenes.map(|(i, scene)| format!("{i} ('{}')", scene.name.as_deref().unwrap_or(""))).collect();
    let has = if names.is_empty() { "no scenes".to_string() } else { names.join(", ") };
    Error::request("scene", format!("{} has no scene '{wanted}'; it has {has}", asset.path.display()))
}

/// Where a node's mesh stands, relative to the node: once, or once per instance of EXT_mesh_gpu_instancing.
pub fn node_from_instances(asset: &Asset, node: &Node, here: &str) -> Result<Vec<DAffine3>> {
    let extension = node.extensions.as_ref().and_then(|all| all.others.get("EXT_mesh_gpu_instancing"));
    let Some(attributes) = extension.map(|extension| extension.get("attributes").unwrap_or(&Value::Null)) else {
        return Ok(vec![DAffine3::IDENTITY]);
    };
    let translations = instance_attribute::<3>(asset, attributes, "TRANSLATION", Type::Vec3, here)?;
    let rotations = instance_attribute::<4>(asset, attributes, "ROTATION", Type::Vec4, here)?;
    let scales = instance_attribute::<3>(asset, attributes, "SCALE", Type::Vec3, here)?;
    let counts = [&translations, &scales].map(|a| a.as_ref().map(Vec::len));
    let counts = [counts[0], counts[1], rotations.as_ref().map(Vec::len)];
    let mut given = counts.iter().flatten();
    let count = *given
        .next()
        .ok_or_else(|| asset.invalid(here, "EXT_mesh_gpu_instancing has none of TRANSLATION, ROTATION and SCALE"))?;
    if given.any(|&other| other != count) {
        return Err(asset.invalid(here, "the attributes of EXT_mesh_gpu_instancing differ in count"));
    }
    let vec3 = |values: &Option<Vec<[f32; 3]>>, i: usize| values.as_ref().map(|v| v[i].map(f64::from));
    (0..count)
        .map(|i| {
            let local = LocalTransform {
                matrix: None,
                translation: vec3(&translations, i),
                rotation: rotations.as_ref().map(|v| v[i].map(f64::from)),
                scale: vec3(&scales, i),
            };
            let here = format!("{here}, instance {i}");
            checked(asset, parent_from_node(&local).map_err(|why| asset.invalid(&here, why))?, &here)
        })
        .collect()
}

fn instance_attribute<const N: usize>(
    asset: &Asset,
    attributes: &Value,
    name: &str,
    kind: Type,
    here: &str,
) -> Result<Option<Vec<[f32; N]>>> {
    let Some(value) = attributes.get(name) else { return Ok(None) };
    let index = value.as_u64().and_then(|index| u32::try_from(index).ok());
    let index = index.ok_or_else(|| asset.invalid(here, format!("instance attribute {name} is not an index")))?;
    let index: Index<Accessor> = Index::new(index);
    read_vectors(asset, index, &[kind], &format!("{here}, instance attribute {name}")).map(Some)
}
