//! Compressed geometry, unpacked in place: afterwards accessors and buffer views read as if the file were plain.
//!
//! EXT_meshopt_compression packs buffer views, KHR_draco_mesh_compression whole primitives. A primitive that has plain
//! data beside the packed ones is read from those.

use draco_core::DataType;
use draco_core::decode_limits::DecodeLimits;
use draco_core::decoder_buffer::DecoderBuffer;
use draco_core::geometry_attribute::PointAttribute;
use draco_core::geometry_indices::PointIndex;
use draco_core::mesh::Mesh;
use draco_core::mesh_decoder::MeshDecoder;
use gltf::json::accessor::{ComponentType, GenericComponentType};
use gltf::json::buffer::View;
use gltf::json::mesh::Mode;
use gltf::json::validation::Checked::{self, Valid};
use gltf::json::validation::USize64;
use gltf::json::{Accessor, Buffer, Index, Root};
use serde::Deserialize;
use serde_json::{Map, Value};

use super::container::{Asset, place};
use super::meshopt::Compression;
use super::resource::{Bytes, view_bytes};
use crate::Result;
use crate::ingest::geometry::MAX_ELEMENTS;

const MESHOPT: &str = "EXT_meshopt_compression";
const DRACO: &str = "KHR_draco_mesh_compression";

/// For every buffer, whether it only stands for what [`MESHOPT`] unpacks, so that it need not be there.
pub fn placeholders(root: &Root) -> Vec<bool> {
    let (mut is_used_packed, mut is_used_plain) = (vec![false; root.buffers.len()], vec![false; root.buffers.len()]);
    for view in &root.buffer_views {
        let uses = if packed(view).is_some() { &mut is_used_packed } else { &mut is_used_plain };
        if let Some(is_used) = uses.get_mut(view.buffer.value()) {
            *is_used = true;
        }
    }
    is_used_packed.into_iter().zip(is_used_plain).map(|(packed, plain)| packed && !plain).collect()
}

/// What [`MESHOPT`] says about a view.
fn packed(view: &View) -> Option<&Value> {
    view.extensions.as_ref()?.others.get(MESHOPT)
}

/// Unpacks all that is packed, and lets accessors and buffer views mean the result.
pub fn unpack(asset: &mut Asset) -> Result<()> {
    for index in 0..asset.root.buffer_views.len() {
        let view = &asset.root.buffer_views[index];
        if let Some(packed) = packed(view) {
            let here = format!("{}/extensions/{MESHOPT}", place("bufferViews", index, view.name.as_deref()));
            let bytes = unpack_view(asset, packed, &here)?;
            let (buffer, byte_length) = append_buffer(asset, bytes);
            let view = &mut asset.root.buffer_views[index];
            (view.buffer, view.byte_length, view.byte_offset) = (buffer, byte_length, None);
        }
    }
    for mesh in 0..asset.root.meshes.len() {
        for primitive in 0..asset.root.meshes[mesh].primitives.len() {
            unpack_primitive(asset, mesh, primitive)?;
        }
    }
    Ok(())
}

fn append_buffer(asset: &mut Asset, bytes: Vec<u8>) -> (Index<Buffer>, USize64) {
    let byte_length = USize64::from(bytes.len());
    let index = Index::push(
        &mut asset.root.buffers,
        Buffer { byte_length, name: None, uri: None, extensions: None, extras: None },
    );
    asset.buffers.push(Bytes::from(bytes));
    (index, byte_length)
}

fn unpack_view(asset: &Asset, packed: &Value, here: &str) -> Result<Vec<u8>> {
    let compression = Compression::deserialize(packed).map_err(|e| asset.invalid(here, e.to_string()))?;
    let buffer: Index<Buffer> = Index::new(compression.buffer);
    asset.get(buffer, here)?;
    let bytes = &asset.buffers[buffer.value()];
    let range = usize::try_from(compression.byte_offset).ok().zip(usize::try_from(compression.byte_length).ok());
    let range = range.and_then(|(start, length)| bytes.get(start..start.checked_add(length)?));
    let range =
        range.ok_or_else(|| asset.invalid(here, format!("it reaches past the end of buffer {}", buffer.value())))?;
    compression.unpack(range).map_err(|why| asset.invalid(here, why))
}

fn unpack_primitive(asset: &mut Asset, mesh: usize, primitive: usize) -> Result<()> {
    let source = &asset.root.meshes[mesh].primitives[primitive];
    let Some(packed) = source.extensions.as_ref().and_then(|all| all.others.get(DRACO)) else { return Ok(()) };
    let accessors: Vec<(String, Index<Accessor>)> = source
        .attributes
        .iter()
        .filter_map(|(semantic, accessor)| match semantic {
            Valid(semantic) => Some((semantic.to_string(), *accessor)),
            Checked::Invalid => None,
        })
        .collect();
    let is_plain = |accessor: &Index<Accessor>| asset.root.get(*accessor).is_some_and(|it| it.buffer_view.is_some());
    if accessors.iter().any(|(name, accessor)| name == "POSITION" && is_plain(accessor)) {
        return Ok(());
    }
    let here = format!("/meshes/{mesh}/primitives/{primitive}/extensions/{DRACO}");
    let indices = source.indices.ok_or_else(|| asset.invalid(&here, "its primitive has no indices"))?;
    let (ids, decoded) = decode(asset, packed, &here)?;
    let count = decoded.num_points();
    for (name, accessor) in accessors {
        let Some(id) = ids.get(&name).and_then(Value::as_u64).and_then(|id| u32::try_from(id).ok()) else { continue };
        let here = format!("{here}/attributes/{name}");
        let attribute = decoded.attribute_by_unique_id(id);
        let attribute = attribute.ok_or_else(|| asset.invalid(&here, format!("its data have no attribute {id}")))?;
        let (component, bytes) = packed_values(asset, attribute, count, &here)?;
        let components = match asset.get(accessor, &here)?.type_ {
            Valid(kind) => kind.multiplicity(),
            Checked::Invalid => 0,
        };
        if components != usize::from(attribute.num_components()) {
            return Err(asset.invalid(here, "it has not as many components as its accessor says"));
        }
        replace(asset, accessor, component, count, bytes);
    }
    asset.get(indices, &here)?;
    let corners: Vec<u8> =
        decoded.faces().iter().flatten().flat_map(|PointIndex(corner)| corner.to_le_bytes()).collect();
    replace(asset, indices, ComponentType::U32, decoded.num_faces() * 3, corners);
    // Strips were taken apart when they were packed.
    asset.root.meshes[mesh].primitives[primitive].mode = Valid(Mode::Triangles);
    Ok(())
}

/// The ids of the attributes by name, and the decoded mesh.
fn decode(asset: &Asset, packed: &Value, here: &str) -> Result<(Map<String, Value>, Mesh)> {
    let index = packed.get("bufferView").and_then(Value::as_u64).and_then(|index| u32::try_from(index).ok());
    let view = Index::new(index.ok_or_else(|| asset.invalid(here, "it has no bufferView"))?);
    let bytes = view_bytes(asset, view, here)?;
    let limits = DecodeLimits::default().with_max_points(MAX_ELEMENTS as u64).with_max_faces(MAX_ELEMENTS as u64);
    let mut mesh = Mesh::new();
    let decoded = MeshDecoder::new().decode(&mut DecoderBuffer::new(&bytes).with_limits(limits), &mut mesh);
    decoded.map_err(|e| asset.invalid(here, format!("its data cannot be decoded: {e}")))?;
    let ids = packed.get("attributes").and_then(Value::as_object).cloned().unwrap_or_default();
    Ok((ids, mesh))
}

/// The values of all points, tightly packed, and their type.
fn packed_values(
    asset: &Asset,
    attribute: &PointAttribute,
    count: usize,
    here: &str,
) -> Result<(ComponentType, Vec<u8>)> {
    let component = match attribute.data_type() {
        DataType::Int8 => ComponentType::I8,
        DataType::Uint8 => ComponentType::U8,
        DataType::Int16 => ComponentType::I16,
        DataType::Uint16 => ComponentType::U16,
        DataType::Uint32 => ComponentType::U32,
        DataType::Float32 => ComponentType::F32,
        other => return Err(asset.unsupported(format!("{here}: components of type {other:?}"))),
    };
    let size = component.size() * usize::from(attribute.num_components());
    let stride = usize::try_from(attribute.byte_stride()).unwrap_or(size);
    let values = attribute.buffer().data();
    let mut bytes = Vec::with_capacity(count * size);
    for point in 0..count as u32 {
        let start = attribute.mapped_index(PointIndex(point)).0 as usize * stride;
        let value = values.get(start..start + size);
        bytes.extend(value.ok_or_else(|| asset.invalid(here, "its data have fewer values than points"))?);
    }
    Ok((component, bytes))
}

/// Lets an accessor, which must exist, mean `count` elements of `bytes`.
fn replace(asset: &mut Asset, accessor: Index<Accessor>, component: ComponentType, count: usize, bytes: Vec<u8>) {
    let (buffer, byte_length) = append_buffer(asset, bytes);
    let view = View {
        buffer,
        byte_length,
        byte_offset: None,
        byte_stride: None,
        name: None,
        target: None,
        extensions: None,
        extras: None,
    };
    let view = Index::push(&mut asset.root.buffer_views, view);
    let accessor = &mut asset.root.accessors[accessor.value()];
    accessor.buffer_view = Some(view);
    accessor.byte_offset = None;
    accessor.component_type = Valid(GenericComponentType(component));
    accessor.count = USize64::from(count);
    accessor.sparse = None;
}
