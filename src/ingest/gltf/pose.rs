//! The rest pose: morph targets at their default weights, skins as their joints stand in the file.

use glam::{DAffine3, DMat3, DMat4, DVec3, Vec3};
use gltf::json::accessor::Type;
use gltf::json::mesh::{Mesh, Primitive, Semantic};
use gltf::json::{Accessor, Index, Node, Skin};

use super::accessor::read_vectors;
use super::container::{Asset, place};
use super::geometry::{Geometry, attribute, cofactor};
use super::nodes::Hierarchy;
use crate::Result;

/// Moves `geometry` by its morph targets; the node's weights win over the mesh's.
pub fn morph(
    asset: &Asset,
    geometry: &mut Geometry,
    node: &Node,
    mesh: &Mesh,
    primitive: &Primitive,
    here: &str,
) -> Result<()> {
    let weights = node.weights.as_deref().or(mesh.weights.as_deref()).unwrap_or_default();
    for (target, &weight) in primitive.targets.iter().flatten().zip(weights).filter(|(_, weight)| **weight != 0.0) {
        let offsets_of = |target: Option<Index<Accessor>>| -> Result<Vec<DVec3>> {
            let Some(offsets) = target else { return Ok(Vec::new()) };
            let offsets: Vec<[f32; 3]> = read_vectors(asset, offsets, &[Type::Vec3], &format!("{here} morph target"))?;
            if offsets.len() != geometry.positions.len() {
                return Err(asset.invalid(here, "a morph target has another count than the positions"));
            }
            Ok(offsets.into_iter().map(|offset| Vec3::from(offset).as_dvec3() * f64::from(weight)).collect())
        };
        let (positions, normals, tangents) =
            (offsets_of(target.positions)?, offsets_of(target.normals)?, offsets_of(target.tangents)?);
        geometry.positions.iter_mut().zip(positions).for_each(|(value, offset)| *value += offset);
        geometry.normals.iter_mut().zip(normals).for_each(|(value, offset)| *value += offset);
        geometry.tangents.iter_mut().zip(tangents).for_each(|(value, offset)| *value += offset.extend(0.0));
    }
    Ok(())
}

/// For every joint of a skin, file coordinates from the mesh's in bind pose: joint x inverse bind matrix.
pub fn joint_transforms(asset: &Asset, hierarchy: &Hierarchy, skin: Index<Skin>, here: &str) -> Result<Vec<DAffine3>> {
    let index = skin.value();
    let skin = asset.get(skin, here)?;
    let here = place("skins", index, skin.name.as_deref());
    let inverse_bind: Vec<[f32; 16]> = match skin.inverse_bind_matrices {
        Some(accessor) => read_vectors(asset, accessor, &[Type::Mat4], &format!("{here} inverseBindMatrices"))?,
        None => Vec::new(),
    };
    let joints = skin.joints.iter().enumerate().map(|(i, &joint)| {
        asset.get(joint, &here)?;
        let file_from_joint = hierarchy.file_from_node[joint.value()]
            .ok_or_else(|| asset.invalid(&here, format!("joint {i}, node {}, is not in the scene", joint.value())))?;
        let joint_from_mesh = match (inverse_bind.is_empty(), inverse_bind.get(i)) {
            (true, _) => DAffine3::IDENTITY,
            (false, Some(matrix)) => DAffine3::from_mat4(DMat4::from_cols_array(&matrix.map(f64::from))),
            (false, None) => return Err(asset.invalid(&here, format!("inverseBindMatrices has none for joint {i}"))),
        };
        Ok(file_from_joint * joint_from_mesh)
    });
    joints.collect()
}

/// Moves `geometry` to file coordinates by its joints, as the weighted mean of their transforms. A vertex without
/// weights has no place: it becomes NaN, so that its triangles are dropped and counted.
pub fn skin(
    asset: &Asset,
    geometry: &mut Geometry,
    primitive: &Primitive,
    file_from_mesh: &[DAffine3],
    here: &str,
) -> Result<()> {
    let count = geometry.positions.len();
    let mut sums = vec![(DMat3::ZERO, DVec3::ZERO, 0.0); count];
    if attribute(primitive, Semantic::Joints(0)).is_none() {
        return Err(asset.invalid(here, "its node has a skin, but it has no JOINTS_0"));
    }
    for set in 0.. {
        let joints = attribute(primitive, Semantic::Joints(set)).zip(attribute(primitive, Semantic::Weights(set)));
        let Some((joints, weights)) = joints else { break };
        let joints: Vec<[f32; 4]> = read_vectors(asset, joints, &[Type::Vec4], &format!("{here} JOINTS_{set}"))?;
        let weights: Vec<[f32; 4]> = read_vectors(asset, weights, &[Type::Vec4], &format!("{here} WEIGHTS_{set}"))?;
        if joints.len() != count || weights.len() != count {
            return Err(asset.invalid(here, format!("JOINTS_{set} or WEIGHTS_{set} has another count than POSITION")));
        }
        for (sum, (joints, weights)) in sums.iter_mut().zip(joints.into_iter().zip(weights)) {
            for (joint, weight) in joints.into_iter().zip(weights).filter(|(_, weight)| *weight != 0.0) {
                let transform = file_from_mesh.get(joint as usize).ok_or_else(|| {
                    asset.invalid(
                        here,
                        format!("JOINTS_{set} names joint {joint}; the skin has {}", file_from_mesh.len()),
                    )
                })?;
                let weight = f64::from(weight);
                sum.0 += transform.matrix3 * weight;
                sum.1 += transform.translation * weight;
                sum.2 += weight;
            }
        }
    }
    for (v, (linear, translation, weight)) in sums.into_iter().enumerate() {
        geometry.positions[v] = (linear * geometry.positions[v] + translation) / weight;
        geometry.normals[v] = cofactor(linear) * geometry.normals[v];
        if let Some(tangent) = geometry.tangents.get_mut(v) {
            *tangent = (linear * tangent.truncate()).extend(tangent.w);
        }
    }
    Ok(())
}
