//! Splat primitives (KHR_gaussian_splatting) under their nodes, decoded in place from the file's buffers.
//!
//! Scales are linear standard deviations, opacities linear, rotations x y z w; spherical harmonics have one attribute per
//! coefficient, red, green and blue together, in the order and with the signs of [`crate::scene::sh`].

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DQuat, DVec3};
use gltf::json::accessor::ComponentType::{self, F32, I8, I16, U8, U16};
use gltf::json::accessor::Type;
use gltf::json::{Accessor, Index};

use super::accessor::{Layout, element_range, layout_of, stride_of};
use super::container::{Asset, place};
use super::nodes::{self, Hierarchy};
use super::primitives::SplatPrimitive;
use super::resource::{Bytes, view_bytes};
use crate::Result;
use crate::ingest::CHUNK;
use crate::ingest::sanitize::FileGaussian;
use crate::ingest::source::{SplatFile, SplatPart, SplatSource};
use crate::ingest::spz;
use crate::job::Frame;
use crate::scene::sh::coefficient_count;

/// Highest degree that the extension has attributes for.
const MAX_DEGREE: u8 = 3;

/// So many Gaussians may a file place, or one for each of its bytes: instances multiply what a small file holds.
const MIN_PLACED: usize = 1 << 20;

/// A component type, and whether it is normalised.
type Component = (ComponentType, bool);

const POSITION_TYPES: &[Component] = &[
    (F32, false),
    (I8, false),
    (I8, true),
    (U8, false),
    (U8, true),
    (I16, false),
    (I16, true),
    (U16, false),
    (U16, true),
];
const ROTATION_TYPES: &[Component] = &[(F32, false), (I8, true), (I16, true)];
const SCALE_TYPES: &[Component] = &[(F32, false), (U8, false), (U8, true), (U16, false), (U16, true)];
const OPACITY_TYPES: &[Component] = &[(F32, false), (U8, true), (U16, true)];
const COEFFICIENT_TYPES: &[Component] = &[(F32, false)];

/// Opens the splats of a scene of the glTF file at `path`: the scene called `scene`, or the default one.
///
/// # Errors
/// [`Invalid`](crate::Error::Invalid) when the scene has no splats, or an attribute of one is missing, of a wrong type or cut off;
/// [`Unsupported`](crate::Error::Unsupported) for kernels, colour spaces and compressions that are not implemented.
pub fn open_splats(path: &Path, scene: Option<&str>) -> Result<SplatFile> {
    let asset = Asset::read(path)?;
    let hierarchy = Hierarchy::of_scene(&asset, scene)?;
    let mut opened: BTreeMap<(usize, usize), PrimitiveSource> = BTreeMap::new();
    let (mut parts, mut kinds, mut placed) = (Vec::new(), Vec::new(), 0usize);
    let most = asset.buffers.iter().map(|buffer| buffer.len()).fold(MIN_PLACED, usize::saturating_add);
    for &index in &hierarchy.order {
        let node = asset.get(index, "/nodes")?;
        let Some(mesh) = node.mesh else { continue };
        let here = place("nodes", index.value(), node.name.as_deref());
        for p in 0..asset.get(mesh, &here)?.primitives.len() {
            let Some(primitive) = asset.splats.get(mesh.value(), p) else { continue };
            let key = (mesh.value(), p);
            let opened = match opened.get(&key) {
                Some(opened) => opened.clone(),
                None => {
                    let source = source_of(&asset, primitive, format!("/meshes/{}/primitives/{p}", key.0))?;
                    opened.entry(key).or_insert(source).clone()
                }
            };
            kinds.push((primitive.encoding, primitive.order));
            let file_from_node = hierarchy.file_from_node[index.value()].unwrap_or(DAffine3::IDENTITY);
            for node_from_instance in nodes::node_from_instances(&asset, node, &here)? {
                placed = placed.saturating_add(opened.source.count());
                if placed > most {
                    let what = format!("more than {most} Gaussians from {here} on, instances counted; place fewer");
                    return Err(asset.unsupported(what));
                }
                let file_from_part = file_from_node * node_from_instance;
                if !file_from_part.matrix3.determinant().is_normal() {
                    return Err(asset.invalid(here, "it flattens its splats: a scale factor is 0 or out of range"));
                }
                let file_from_part = file_from_part * DAffine3::from_mat3(opened.primitive_from_source);
                parts.push(SplatPart { file_from_part, source: Box::new(opened.source.clone()) });
            }
        }
    }
    let Some(&(encoding, order)) = kinds.first() else {
        return Err(asset.invalid("scene", "it has no splats (KHR_gaussian_splatting); name the file with --mesh"));
    };
    if kinds.iter().any(|kind| kind.0 != encoding) {
        return Err(asset.unsupported("splats of two colour spaces in one file; export them to one file each"));
    }
    if placed == 0 {
        return Err(asset.invalid("/accessors", "all splats have count 0: there are no Gaussians"));
    }
    let order = order.filter(|_| kinds.iter().all(|kind| kind.1 == order));
    Ok(SplatFile {
        format: "glTF 2.0 KHR_gaussian_splatting".into(),
        frame: Frame::RUB,
        encoding,
        order,
        parts,
        files: asset.log.files(),
    })
}

/// The Gaussians of a primitive, and how they stand in it.
#[derive(Clone)]
struct PrimitiveSource {
    source: Arc<dyn SplatSource>,
    primitive_from_source: DMat3,
}

/// The Gaussians of the splat primitive at `here`.
///
/// SPZ inside glTF is to be unpacked to left-up-front, a half turn about y from the right-up-back that SPZ stores by
/// default; writers of the first drafts (which name no kernel) left it as it was, and their readers do so still.
fn source_of(asset: &Asset, primitive: &SplatPrimitive, here: String) -> Result<PrimitiveSource> {
    let Some((extension, view)) = primitive.compression else {
        let source = Arc::new(PrimitiveSplats::open(asset, primitive, here)?);
        return Ok(PrimitiveSource { source, primitive_from_source: DMat3::IDENTITY });
    };
    let bytes = view_bytes(asset, Index::new(view), &here)?;
    let opened = spz::open_wrapped(&asset.path, &bytes);
    let (frame, source) = opened.map_err(|error| error.within(&format!("{here}, {extension}")))?;
    let half_turn = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, -1.0));
    let turn = if primitive.names_kernel { half_turn } else { DMat3::IDENTITY };
    Ok(PrimitiveSource { source, primitive_from_source: turn * frame.canonical_from_file() })
}

/// A splat primitive whose attributes are all there.
#[derive(Debug)]
struct PrimitiveSplats {
    count: usize,
    position: Attribute<3>,
    rotation_xyzw: Attribute<4>,
    scale: Attribute<3>,
    opacity: Attribute<1>,
    sh_degree: u8,
    /// By band and then by order.
    coefficients: Vec<Attribute<3>>,
}

impl PrimitiveSplats {
    fn open(asset: &Asset, primitive: &SplatPrimitive, here: String) -> Result<Self> {
        let has = |name: &str| primitive.attributes.contains_key(name);
        let find = |name: &str| {
            let what = || format!("it has no attribute {name}, which splats must have");
            primitive.attributes.get(name).copied().ok_or_else(|| asset.invalid(&here, what()))
        };
        let position = Attribute::find(asset, find("POSITION")?, Type::Vec3, POSITION_TYPES, &here, "POSITION")?;
        let rotation_xyzw = Attribute::find(asset, find("ROTATION")?, Type::Vec4, ROTATION_TYPES, &here, "ROTATION")?;
        let scale = Attribute::find(asset, find("SCALE")?, Type::Vec3, SCALE_TYPES, &here, "SCALE")?;
        let opacity = Attribute::find(asset, find("OPACITY")?, Type::Scalar, OPACITY_TYPES, &here, "OPACITY")?;
        // Bands must be whole and start at 0: whatever a band has, it and all below it must be there.
        let in_band = |l: &u8| (0..2 * l + 1).any(|n| has(&format!("SH_DEGREE_{l}_COEF_{n}")));
        let sh_degree = (0..=MAX_DEGREE).rev().find(in_band).unwrap_or(0);
        let mut coefficients = Vec::with_capacity(coefficient_count(sh_degree));
        for (l, n) in (0..=sh_degree).flat_map(|l| (0..2 * l + 1).map(move |n| (l, n))) {
            let name = format!("SH_DEGREE_{l}_COEF_{n}");
            coefficients.push(Attribute::find(asset, find(&name)?, Type::Vec3, COEFFICIENT_TYPES, &here, &name)?);
        }
        let count = position.layout.count;
        let counts = [rotation_xyzw.layout.count, scale.layout.count, opacity.layout.count];
        if counts.into_iter().chain(coefficients.iter().map(|it| it.layout.count)).any(|other| other != count) {
            return Err(asset.invalid(here, format!("an attribute has not as many elements as POSITION, {count}")));
        }
        Ok(Self { count, position, rotation_xyzw, scale, opacity, sh_degree, coefficients })
    }
}

impl SplatSource for PrimitiveSplats {
    fn count(&self) -> usize {
        self.count
    }

    fn sh_degree(&self) -> u8 {
        self.sh_degree
    }

    fn for_each_in_chunk(&self, chunk: usize, sink: &mut dyn FnMut(&mut FileGaussian)) -> Result<()> {
        let per_channel = coefficient_count(self.sh_degree);
        let (position, rotation, scale) =
            (self.position.elements(), self.rotation_xyzw.elements(), self.scale.elements());
        let opacity = self.opacity.elements();
        let coefficients: Vec<_> = self.coefficients.iter().map(Attribute::elements).collect();
        let mut gaussian = FileGaussian::default();
        for i in chunk * CHUNK..((chunk + 1) * CHUNK).min(self.count) {
            gaussian.mean = DVec3::from(position.get(i).map(f64::from));
            gaussian.rotation = DQuat::from_array(rotation.get(i).map(f64::from));
            gaussian.standard_deviations = DVec3::from(scale.get(i).map(f64::from));
            gaussian.opacity = f64::from(opacity.get(i)[0]);
            for (k, attribute) in coefficients.iter().enumerate() {
                for (channel, value) in attribute.get(i).into_iter().enumerate() {
                    gaussian.coefficients[channel * per_channel + k] = value;
                }
            }
            sink(&mut gaussian);
        }
        Ok(())
    }
}

/// An accessor's elements of `N` components, where they lie in the file.
#[derive(Debug)]
struct Attribute<const N: usize> {
    layout: Layout,
    stride: usize,
    bytes: Bytes,
}

impl<const N: usize> Attribute<N> {
    /// The accessor `index` as attribute `name` of the primitive `here`; it must be `kind` of one of the types `accepted`.
    fn find(asset: &Asset, index: u32, kind: Type, accepted: &[Component], here: &str, name: &str) -> Result<Self> {
        let here = format!("{here} {name}");
        let index: Index<Accessor> = Index::new(index);
        let accessor = asset.get(index, &here)?;
        let there = place("accessors", index.value(), accessor.name.as_deref());
        let (layout, found) = layout_of(asset, accessor, &there)?;
        if found != kind || !accepted.contains(&(layout.component, layout.normalized)) {
            let normalized = if layout.normalized { "normalized " } else { "" };
            let what = format!("{here} cannot be {found:?} of {normalized}{:?}", layout.component);
            return Err(asset.invalid(there, what));
        }
        if accessor.sparse.is_some() {
            return Err(asset.unsupported(format!("{there}: sparse {here}; export it without")));
        }
        let view = accessor.buffer_view.ok_or_else(|| asset.invalid(&there, format!("{here} needs a bufferView")))?;
        let bytes = view_bytes(asset, view, &there)?;
        let stride = stride_of(asset, view).unwrap_or(layout.element_bytes());
        let offset = accessor.byte_offset.map_or(0, |offset| offset.0);
        let range = element_range(asset, bytes.len(), offset, stride, layout.element_bytes(), layout.count, &there)?;
        let bytes = bytes.part(range).unwrap_or(bytes);
        Ok(Self { layout, stride, bytes })
    }

    fn elements(&self) -> Elements<'_, N> {
        Elements { layout: self.layout, stride: self.stride, size: self.layout.element_bytes(), bytes: &self.bytes }
    }
}

/// The elements of an [`Attribute`], by number.
struct Elements<'a, const N: usize> {
    layout: Layout,
    stride: usize,
    size: usize,
    bytes: &'a [u8],
}

impl<const N: usize> Elements<'_, N> {
    /// Element `i`, which must be below the layout's count.
    #[inline]
    fn get(&self, i: usize) -> [f32; N] {
        let start = i * self.stride;
        self.layout.decode(&self.bytes[start..start + self.size])
    }
}
