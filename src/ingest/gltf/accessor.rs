//! Accessors to numbers: every component type, normalised or not, strided, sparse; each byte range checked.
//!
//! glTF 2.0, sections 3.6.2 and 3.11 (normalised integers); KHR_mesh_quantization allows the same types for more
//! attributes and so needs nothing of its own.

use std::ops::Range;

use gltf::json::accessor::{self, ComponentType, GenericComponentType, IndexComponentType, Type};
use gltf::json::validation::Checked;
use gltf::json::{Accessor, Index};

use super::container::{Asset, place};
use super::resource::view_bytes;
use crate::Result;

/// What the elements of an accessor are.
#[derive(Debug, Clone, Copy)]
pub struct Layout {
    /// How many there are.
    pub count: usize,
    /// Type of a component.
    pub component: ComponentType,
    components: usize,
    /// Whether integers stand for fractions of their type's range.
    pub normalized: bool,
}

/// The elements of an accessor as vectors of `N` floats. The accessor's type must be one of `accepted`; components
/// it does not have are 1. `here` says who asks.
pub fn read_vectors<const N: usize>(
    asset: &Asset,
    index: Index<Accessor>,
    accepted: &[Type],
    here: &str,
) -> Result<Vec<[f32; N]>> {
    let accessor = asset.get(index, here)?;
    let there = place("accessors", index.value(), accessor.name.as_deref());
    let (layout, kind) = layout_of(asset, accessor, &there)?;
    if !accepted.contains(&kind) || layout.components > N {
        return Err(asset.invalid(there, format!("{here} cannot be {kind:?}; it must be one of {accepted:?}")));
    }
    let mut vectors = Vec::new();
    match accessor.buffer_view {
        Some(view) => {
            let offset = accessor.byte_offset.map_or(0, |offset| offset.0);
            let bytes = view_bytes(asset, view, &there)?;
            let stride = stride_of(asset, view);
            let elements = elements(asset, &bytes, offset, stride, layout.element_bytes(), layout.count, &there)?;
            vectors.extend(elements.map(|element| layout.decode(element)));
        }
        None => {
            vectors.resize(layout.count, layout.decode(&vec![0; layout.element_bytes()]));
        }
    }
    if let Some(sparse) = &accessor.sparse {
        substitute(asset, sparse, &layout, &mut vectors, &there)?;
    }
    Ok(vectors)
}

/// The elements of an index accessor: unsigned, not normalised, one component.
pub fn read_indices(asset: &Asset, index: Index<Accessor>, here: &str) -> Result<Vec<u32>> {
    let accessor = asset.get(index, here)?;
    let there = place("accessors", index.value(), accessor.name.as_deref());
    let (layout, kind) = layout_of(asset, accessor, &there)?;
    let unsigned = matches!(layout.component, ComponentType::U8 | ComponentType::U16 | ComponentType::U32);
    if kind != Type::Scalar || !unsigned || layout.normalized || accessor.sparse.is_some() {
        let what = format!("{here} must be plain unsigned SCALAR, not {kind:?} of {:?}", layout.component);
        return Err(asset.invalid(there, what));
    }
    let view = accessor.buffer_view.ok_or_else(|| asset.invalid(&there, "indices need a bufferView"))?;
    let offset = accessor.byte_offset.map_or(0, |offset| offset.0);
    let bytes = view_bytes(asset, view, &there)?;
    let stride = stride_of(asset, view);
    let elements = elements(asset, &bytes, offset, stride, layout.element_bytes(), layout.count, &there)?;
    Ok(elements.map(unsigned_integer).collect())
}

/// Count and types, with a count that the file's size can justify.
pub fn layout_of(asset: &Asset, accessor: &Accessor, there: &str) -> Result<(Layout, Type)> {
    let (Checked::Valid(GenericComponentType(component)), Checked::Valid(kind)) =
        (accessor.component_type, accessor.type_)
    else {
        return Err(asset.invalid(there, "its componentType or type is none that glTF 2.0 knows"));
    };
    // Elements in a buffer view are held to its bytes; without one they are zeros, and would cost the file nothing.
    let most = if accessor.buffer_view.is_some() { usize::MAX } else { asset.largest_buffer_bytes() };
    let count = usize::try_from(accessor.count.0).ok().filter(|&count| count <= most).ok_or_else(|| {
        let what = format!("{} elements, but the largest buffer has only {most} bytes", accessor.count.0);
        asset.invalid(there, what)
    })?;
    Ok((Layout { count, component, components: kind.multiplicity(), normalized: accessor.normalized }, kind))
}

impl Layout {
    /// Size of an element.
    pub fn element_bytes(&self) -> usize {
        self.component.size() * self.components
    }

    /// The floats of one element; components past the accessor's are 1.
    pub fn decode<const N: usize>(&self, element: &[u8]) -> [f32; N] {
        let mut vector = [1.0; N];
        for (value, bytes) in vector.iter_mut().zip(element.chunks_exact(self.component.size())) {
            *value = float(self.component, self.normalized, bytes);
        }
        vector
    }
}

/// One component; `bytes` has the component's size.
fn float(component: ComponentType, normalized: bool, bytes: &[u8]) -> f32 {
    let (value, largest) = match component {
        ComponentType::I8 => (f64::from(unsigned_integer(bytes) as i8), f64::from(i8::MAX)),
        ComponentType::U8 => (f64::from(unsigned_integer(bytes)), f64::from(u8::MAX)),
        ComponentType::I16 => (f64::from(unsigned_integer(bytes) as i16), f64::from(i16::MAX)),
        ComponentType::U16 => (f64::from(unsigned_integer(bytes)), f64::from(u16::MAX)),
        ComponentType::U32 => (f64::from(unsigned_integer(bytes)), f64::from(u32::MAX)),
        ComponentType::F32 => return f32::from_bits(unsigned_integer(bytes)),
    };
    if normalized { (value / largest).max(-1.0) as f32 } else { value as f32 }
}

/// Up to four little-endian bytes.
fn unsigned_integer(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |value, &byte| value << 8 | u32::from(byte))
}

/// byteStride of a view that [`view_bytes`] has found.
pub fn stride_of(asset: &Asset, view: Index<gltf::json::buffer::View>) -> Option<usize> {
    asset.root.get(view).and_then(|view| view.byte_stride).map(|stride| stride.0)
}

/// `count` elements of `size` bytes in `bytes`, from `offset` on, `stride` (default: `size`) bytes apart.
fn elements<'a>(
    asset: &Asset,
    bytes: &'a [u8],
    offset: u64,
    stride: Option<usize>,
    size: usize,
    count: usize,
    there: &str,
) -> Result<impl Iterator<Item = &'a [u8]> + use<'a>> {
    let stride = stride.unwrap_or(size);
    let range = element_range(asset, bytes.len(), offset, stride, size, count, there)?;
    Ok(bytes[range].chunks(stride).map(move |element| &element[..size]))
}

/// Where `count` elements of `size` bytes, `stride` apart, from `offset` on lie in a view of `view` bytes.
pub fn element_range(
    asset: &Asset,
    view: usize,
    offset: u64,
    stride: usize,
    size: usize,
    count: usize,
    there: &str,
) -> Result<Range<usize>> {
    if stride < size {
        return Err(asset.invalid(there, format!("byteStride {stride} is less than an element's {size} bytes")));
    }
    let length = match count.checked_sub(1) {
        Some(last) => last.checked_mul(stride).and_then(|start| start.checked_add(size)),
        None => Some(0),
    };
    let offset_bytes = usize::try_from(offset).ok();
    let range = offset_bytes.zip(length).and_then(|(start, length)| Some(start..start.checked_add(length)?));
    range.filter(|range| range.end <= view).ok_or_else(|| {
        let what = format!(
            "{count} elements of {size} bytes, {stride} apart, from byte {offset} on do not fit the bufferView's {view} bytes"
        );
        asset.invalid(there, what)
    })
}

/// Replaces the elements that `sparse` lists.
fn substitute<const N: usize>(
    asset: &Asset,
    sparse: &accessor::sparse::Sparse,
    layout: &Layout,
    vectors: &mut [[f32; N]],
    there: &str,
) -> Result<()> {
    let Checked::Valid(IndexComponentType(component)) = sparse.indices.component_type else {
        return Err(asset.invalid(there, "its sparse indices have a componentType that glTF 2.0 does not know"));
    };
    let count = usize::try_from(sparse.count.0).ok().filter(|&count| count <= layout.count).ok_or_else(|| {
        asset.invalid(there, format!("sparse count {} exceeds the accessor's {}", sparse.count.0, layout.count))
    })?;
    let (indices, values) = (&sparse.indices, &sparse.values);
    let index_bytes = view_bytes(asset, indices.buffer_view, there)?;
    let value_bytes = view_bytes(asset, values.buffer_view, there)?;
    let indices = elements(asset, &index_bytes, indices.byte_offset.0, None, component.size(), count, there)?;
    let values = elements(asset, &value_bytes, values.byte_offset.0, None, layout.element_bytes(), count, there)?;
    for (index, value) in indices.map(unsigned_integer).zip(values) {
        let target = vectors.get_mut(index as usize);
        *target.ok_or_else(|| asset.invalid(there, format!("sparse index {index} is out of range")))? =
            layout.decode(value);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use gltf::json::Root;
    use serde_json::{Value, json};

    use super::*;

    fn asset(json: Value, buffer: Vec<u8>) -> Asset {
        let root: Root = serde_json::from_value(json).unwrap();
        let path = PathBuf::from("test.gltf");
        Asset {
            path,
            folder: PathBuf::new(),
            root,
            local_transforms: Vec::new(),
            materials: Vec::new(),
            splats: Default::default(),
            buffers: vec![buffer.into()],
            log: Default::default(),
        }
    }

    /// A component type's code, four values as its bytes, and as floats: as they are, and normalised.
    type Row = (u32, [Vec<u8>; 4], [f32; 4], [f32; 4]);

    fn table() -> Vec<Row> {
        fn bytes<const N: usize>(values: [[u8; N]; 4]) -> [Vec<u8>; 4] {
            values.map(|v| v.to_vec())
        }
        let floats = [-1.5, 0.25, 3.0e7, 0.0];
        vec![
            (5120, bytes([-128i8, -127, 0, 127].map(i8::to_le_bytes)), [-128., -127., 0., 127.], [-1., -1., 0., 1.]),
            (5121, bytes([0u8, 51, 204, 255].map(u8::to_le_bytes)), [0., 51., 204., 255.], [0., 0.2, 0.8, 1.]),
            (
                5122,
                bytes([-32768i16, -32767, 0, 32767].map(i16::to_le_bytes)),
                [-32768., -32767., 0., 32767.],
                [-1., -1., 0., 1.],
            ),
            (
                5123,
                bytes([0u16, 13107, 52428, 65535].map(u16::to_le_bytes)),
                [0., 13107., 52428., 65535.],
                [0., 0.2, 0.8, 1.],
            ),
            (
                5125,
                bytes([0u32, 858_993_459, 1 << 31, u32::MAX].map(u32::to_le_bytes)),
                [0., 858_993_459., 2_147_483_648., 4_294_967_295.],
                [0., 0.2, 0.5, 1.],
            ),
            (5126, bytes(floats.map(f32::to_le_bytes)), floats, floats),
        ]
    }

    #[test]
    fn every_component_type_decodes_plain_and_normalised_tight_and_strided_dense_and_sparse() {
        for (code, raw, plain, normalised) in table() {
            let size = raw[0].len();
            for (normalized, padding, sparse) in (0..12).map(|i| (i & 1 == 1, i / 2 % 3 * 4, i / 6 == 1)) {
                // Two VEC2 elements after an offset of 4; then sparse index 1, then the sparse value (3, 2).
                let mut buffer = vec![0xEE; 4];
                buffer.extend([&raw[0][..], &raw[1], &vec![0xEE; padding], &raw[2], &raw[3]].concat());
                let dense_end = buffer.len();
                buffer.extend([1, 0].iter().chain(&raw[3]).chain(&raw[2]));
                let stride = 2 * size + padding;
                let mut accessor = json!({"bufferView": 0, "byteOffset": 4, "count": 2, "componentType": code,
                    "type": "VEC2", "normalized": normalized});
                if sparse {
                    accessor["sparse"] = json!({"count": 1, "indices": {"bufferView": 1, "componentType": 5123},
                        "values": {"bufferView": 1, "byteOffset": 2}});
                }
                let mut view = json!({"buffer": 0, "byteLength": dense_end});
                if padding > 0 {
                    view["byteStride"] = json!(stride);
                }
                let rest = json!({"buffer": 0, "byteOffset": dense_end, "byteLength": buffer.len() - dense_end});
                let asset = asset(
                    json!({"asset": {"version": "2.0"}, "accessors": [accessor], "bufferViews": [view, rest],
                        "buffers": [{"byteLength": buffer.len()}]}),
                    buffer,
                );
                let found: Vec<[f32; 2]> = read_vectors(&asset, Index::new(0), &[Type::Vec2], "test").unwrap();
                let e = if normalized { normalised } else { plain };
                let expected = [[e[0], e[1]], if sparse { [e[3], e[2]] } else { [e[2], e[3]] }];
                let case = format!("type {code} normalized {normalized} padding {padding} sparse {sparse}");
                for (found, expected) in found.as_flattened().iter().zip(expected.as_flattened()) {
                    assert!((found - expected).abs() <= 1e-7 * expected.abs(), "{case}: {found} is not {expected}");
                }
                assert_eq!(found.len(), 2, "{case}");
            }
        }
    }

    #[test]
    fn sparse_values_without_a_buffer_view_stand_among_zeros() {
        let buffer = [[2, 0, 0, 0], 7f32.to_le_bytes()].concat();
        let views = json!([{"buffer": 0, "byteLength": 4}, {"buffer": 0, "byteOffset": 4, "byteLength": 4}]);
        let accessor = json!({"count": 4, "componentType": 5126, "type": "SCALAR", "sparse": {"count": 1,
            "indices": {"bufferView": 0, "componentType": 5125}, "values": {"bufferView": 1}}});
        let json = json!({"asset": {"version": "2.0"}, "accessors": [accessor], "bufferViews": views,
            "buffers": [{"byteLength": 8}]});
        let found: Vec<[f32; 1]> = read_vectors(&asset(json, buffer), Index::new(0), &[Type::Scalar], "test").unwrap();
        assert_eq!(found, [[0.0], [0.0], [7.0], [0.0]]);
    }

    #[test]
    fn a_range_that_does_not_fit_is_an_error_and_not_a_read_past_the_end() {
        let with = |accessor: Value, view: Value| {
            let mut json = json!({"asset": {"version": "2.0"}, "buffers": [{"byteLength": 64}],
                "accessors": [{"bufferView": 0, "count": 4, "componentType": 5126, "type": "VEC3"}],
                "bufferViews": [{"buffer": 0, "byteLength": 48}]});
            json["accessors"][0].as_object_mut().unwrap().extend(accessor.as_object().unwrap().clone());
            json["bufferViews"][0].as_object_mut().unwrap().extend(view.as_object().unwrap().clone());
            read_vectors::<3>(&asset(json, vec![0; 64]), Index::new(0), &[Type::Vec3], "test")
        };
        let none = json!({});
        assert_eq!(with(none.clone(), none.clone()).unwrap().len(), 4);
        let huge = u64::MAX;
        for (accessor, view, message) in [
            (json!({"count": 5}), none.clone(), "do not fit"),
            (json!({"byteOffset": 1}), none.clone(), "do not fit"),
            (json!({"byteOffset": huge}), none.clone(), "do not fit"),
            (json!({"count": huge}), none.clone(), "do not fit"),
            (json!({"bufferView": null, "count": 65}), none.clone(), "the largest buffer has only 64 bytes"),
            (json!({"bufferView": 9}), none.clone(), "out of range"),
            (json!({"componentType": 5127}), none.clone(), "none that glTF 2.0 knows"),
            (json!({"type": "VEC4"}), none.clone(), "cannot be Vec4"),
            (none.clone(), json!({"byteStride": 0}), "less than an element"),
            (none.clone(), json!({"byteStride": 13}), "do not fit"),
            (none.clone(), json!({"byteStride": huge}), "do not fit"),
            (none.clone(), json!({"byteLength": 65}), "past the end of buffer 0"),
            (none.clone(), json!({"byteOffset": huge}), "past the end of buffer 0"),
            (none.clone(), json!({"buffer": 1}), "out of range"),
        ] {
            let error = with(accessor.clone(), view.clone()).unwrap_err().to_string();
            assert!(error.contains(message), "{accessor} {view}: {error}");
        }
    }
}
