//! The file itself: GLB or JSON, its typed root, its extensions, and look-ups that name what is missing.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use gltf::json::root::Get;
use gltf::json::{Index, Root};
use serde::Deserialize;
use serde_json::Value;

use super::compressed;
use super::material_json::MaterialJson;
use super::primitives::SplatPrimitives;
use super::resource::{self, Bytes};
use crate::ingest::file_log::FileLog;
use crate::ingest::map;
use crate::{Error, Result};

/// What a GLB begins with.
const MAGIC: &[u8] = b"glTF";

/// Whether a file's bytes are a GLB, or JSON with the member that every glTF file must have.
pub fn is_gltf(bytes: &[u8]) -> bool {
    let is_json = || bytes.iter().find(|byte| !byte.is_ascii_whitespace()) == Some(&b'{');
    bytes.starts_with(MAGIC) || is_json() && bytes.windows(7).any(|window| window == b"\"asset\"")
}

/// Extensions that are implemented.
const SUPPORTED: [&str; 24] = [
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_dispersion",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_lights_punctual",
    "KHR_texture_basisu",
    "KHR_texture_transform",
    "EXT_texture_webp",
    "EXT_meshopt_compression",
    "KHR_draco_mesh_compression",
    "KHR_mesh_quantization",
    "EXT_mesh_gpu_instancing",
    "KHR_gaussian_splatting",
    "KHR_gaussian_splatting_compression_spz",
    "KHR_gaussian_splatting_compression_spz_2",
];

/// Extensions that a file may require although they are passed over: motion and metadata.
const WITHOUT_EFFECT: [&str; 2] = ["KHR_animation_pointer", "KHR_xmp_json_ld"];

/// A parsed glTF file with its buffers. Every index in `root` is unchecked until it went through [`Asset::get`].
pub struct Asset {
    /// The file, for messages.
    pub path: PathBuf,
    /// Folder that relative URIs start from.
    pub folder: PathBuf,
    /// The typed JSON. It is not validated by the `gltf` crate, whose rules reject extensions that we read.
    pub root: Root,
    /// `nodes` again, with the transforms in the f64 that JSON has; `root` rounds them to f32.
    pub local_transforms: Vec<LocalTransform>,
    /// `materials` again, with all their extensions; as many as `root` has.
    pub materials: Vec<MaterialJson>,
    /// Which primitives of which meshes are splats.
    pub splats: SplatPrimitives,
    /// Content of each buffer, cut to its byteLength.
    pub buffers: Vec<Bytes>,
    /// Files beside this one that were read.
    pub log: FileLog,
}

/// How a node stands in its parent, as written: `matrix` (column by column) or translation, rotation and scale.
#[derive(Debug, Default, Clone, PartialEq, Deserialize)]
#[serde(default)]
pub struct LocalTransform {
    /// 4 x 4, column by column.
    pub matrix: Option<[f64; 16]>,
    /// Along x, y, z.
    pub translation: Option<[f64; 3]>,
    /// Quaternion x, y, z, w.
    pub rotation: Option<[f64; 4]>,
    /// Factors along x, y, z.
    pub scale: Option<[f64; 3]>,
}

impl Asset {
    /// Reads the file at `path`, whichever of GLB and JSON it holds, and the buffers that it names.
    pub fn read(path: &Path) -> Result<Self> {
        let (mut asset, glb_chunk) = Self::parse(path)?;
        asset.buffers = resource::read_buffers(&asset, glb_chunk)?;
        compressed::unpack(&mut asset)?;
        Ok(asset)
    }

    /// Reads the JSON of the file at `path`: the asset without its buffers, and the GLB's binary chunk.
    pub fn parse(path: &Path) -> Result<(Self, Option<Bytes>)> {
        let bytes = map(path)?;
        let (json, glb_chunk) = if bytes.starts_with(MAGIC) { split_glb(path, &bytes)? } else { (&bytes[..], None) };
        let json_error = |e: serde_json::Error| {
            Error::invalid(path, format!("JSON line {}, column {}", e.line(), e.column()), format!("not glTF: {e}"))
        };
        let value: Value = serde_json::from_slice(json).map_err(json_error)?;
        check_version_and_extensions(path, &value)?;
        let local_transforms = match value.get("nodes") {
            Some(nodes) => Vec::deserialize(nodes).map_err(|e| Error::invalid(path, "/nodes", e.to_string()))?,
            None => Vec::new(),
        };
        let materials = value.get("materials").and_then(Value::as_array).into_iter().flatten().enumerate();
        let materials = materials.map(|(i, material)| {
            MaterialJson::deserialize(material)
                .map_err(|e| Error::invalid(path, place("materials", i, None), e.to_string()))
        });
        let materials = materials.collect::<Result<Vec<_>>>()?;
        let splats = SplatPrimitives::of(path, &value)?;
        let root = Root::deserialize(value).map_err(|e| Error::invalid(path, "JSON", format!("not glTF 2.0: {e}")))?;
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_path_buf();
        let path = path.to_path_buf();
        let asset = Self {
            path,
            folder,
            root,
            local_transforms,
            materials,
            splats,
            buffers: Vec::new(),
            log: FileLog::default(),
        };
        let glb_chunk = glb_chunk.map(|chunk| Bytes::new(Arc::new(bytes), chunk));
        Ok((asset, glb_chunk))
    }

    /// The object that `index` means, or an error that says which property `place` pointed nowhere.
    pub fn get<T>(&self, index: Index<T>, place: &str) -> Result<&T>
    where
        Root: Get<T>,
    {
        let missing = || self.invalid(place, format!("index {} is out of range", index.value()));
        self.root.get(index).ok_or_else(missing)
    }

    /// An error about this file's content at `place`.
    pub fn invalid(&self, place: impl Into<String>, what: impl Into<String>) -> Error {
        Error::invalid(&self.path, place, what)
    }

    /// An error about a feature of this file that is not implemented.
    pub fn unsupported(&self, what: impl Into<String>) -> Error {
        Error::unsupported(&self.path, what)
    }

    /// Extensions that the file uses and this program passes over.
    pub fn ignored_extensions(&self) -> Vec<String> {
        self.root.extensions_used.iter().filter(|name| !SUPPORTED.contains(&name.as_str())).cloned().collect()
    }

    /// Size of the largest buffer: the measure for what has no bytes of its own.
    pub fn largest_buffer_bytes(&self) -> usize {
        self.buffers.iter().map(|buffer| buffer.len()).max().unwrap_or(0)
    }
}

/// How messages call element `index` of the array `kind`: `/nodes/3 ('Wheel')`.
pub fn place(kind: &str, index: usize, name: Option<&str>) -> String {
    match name {
        Some(name) => format!("/{kind}/{index} ('{name}')"),
        None => format!("/{kind}/{index}"),
    }
}

/// Version and required extensions, from the untyped JSON: a file that asks for more than we have may well not fit
/// the typed root, and the missing feature is the better message.
fn check_version_and_extensions(path: &Path, value: &Value) -> Result<()> {
    let asset = value.get("asset").ok_or_else(|| Error::invalid(path, "/asset", "missing: this is not glTF 2.0"))?;
    for key in ["version", "minVersion"] {
        if let Some(version) = asset.get(key).and_then(Value::as_str)
            && !(version == "2.0" || key == "version" && version.starts_with("2."))
        {
            return Err(Error::unsupported(path, format!("glTF {key} {version}; export it as glTF 2.0")));
        }
    }
    let required = value.get("extensionsRequired").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    for name in required.iter().filter_map(Value::as_str) {
        if !SUPPORTED.contains(&name) && !WITHOUT_EFFECT.contains(&name) {
            return Err(Error::unsupported(path, format!("{name}, which the file requires; export it without")));
        }
    }
    Ok(())
}

/// JSON and place of the BIN chunk of a GLB (glTF 2.0, section 4.4). Unknown chunks are passed over, as the format asks.
fn split_glb<'a>(path: &Path, bytes: &'a [u8]) -> Result<(&'a [u8], Option<Range<usize>>)> {
    let word = |at: usize| -> Result<usize> {
        match bytes.get(at..).and_then(<[u8]>::first_chunk) {
            Some(word) => Ok(u32::from_le_bytes(*word) as usize),
            None => Err(Error::invalid(path, format!("byte {at}"), "the GLB ends inside a header; it is truncated")),
        }
    };
    let version = word(4)?;
    if version != 2 {
        return Err(Error::unsupported(path, format!("GLB version {version}; export it as glTF 2.0")));
    }
    let length = word(8)?;
    if length > bytes.len() {
        let what = format!("the header promises {length} bytes, the file has {}; it is truncated", bytes.len());
        return Err(Error::invalid(path, "byte 8", what));
    }
    let (mut json, mut bin) = (None, None);
    let mut at = 12;
    while at < length {
        let chunk_length = word(at)?;
        let kind = word(at + 4)?;
        let start = at + 8;
        let chunk = bytes[..length].get(start..start.saturating_add(chunk_length)).ok_or_else(|| {
            let what = format!("a chunk of {chunk_length} bytes reaches past the end of the GLB at byte {length}");
            Error::invalid(path, format!("byte {at}"), what)
        })?;
        match kind {
            0x4E4F_534A if json.is_none() => json = Some(chunk),
            0x004E_4942 if bin.is_none() => bin = Some(start..start + chunk_length),
            _ => {}
        }
        at = start + chunk_length;
    }
    let json = json.ok_or_else(|| Error::invalid(path, "byte 12", "the GLB has no JSON chunk"))?;
    Ok((json, bin))
}
