//! Which primitives are splats, and what KHR_gaussian_splatting says about them, from the untyped JSON: the typed root
//! merges all attributes whose names it does not know.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::Value;

use crate::job::Order;
use crate::scene::SplatEncoding;
use crate::{Error, Result};

/// The extension's name, and the prefix of its attributes.
const EXTENSION: &str = "KHR_gaussian_splatting";

/// Extensions inside it whose buffer view holds all attributes as an SPZ file.
const COMPRESSIONS: [&str; 2] = ["KHR_gaussian_splatting_compression_spz", "KHR_gaussian_splatting_compression_spz_2"];

/// The primitives of a file that are splats, by the indices of their mesh and of themselves in it.
#[derive(Debug, Default)]
pub struct SplatPrimitives {
    by_index: BTreeMap<(usize, usize), SplatPrimitive>,
}

/// A primitive that is splats.
#[derive(Debug)]
pub struct SplatPrimitive {
    /// Accessors by semantic, the extension's without its prefix.
    pub attributes: BTreeMap<String, u32>,
    /// What the blended colours mean.
    pub encoding: SplatEncoding,
    /// The blending order asked for, if it is one that a probe can follow.
    pub order: Option<Order>,
    /// Name and buffer view of the extension that holds the attributes instead.
    pub compression: Option<(&'static str, u32)>,
    /// Whether the extension names its kernel, as every version but the first drafts demands.
    pub names_kernel: bool,
}

impl SplatPrimitives {
    /// Those of the glTF file at `path` with the JSON `root`. What is no object or array where glTF has one is left to
    /// the typed root to complain about.
    pub fn of(path: &Path, root: &Value) -> Result<Self> {
        let mut found = Self::default();
        for (m, mesh) in array(root.get("meshes")).iter().enumerate() {
            for (p, primitive) in array(mesh.get("primitives")).iter().enumerate() {
                let extension = primitive.get("extensions").and_then(|extensions| extensions.get(EXTENSION));
                if let Some(extension) = extension {
                    let here = format!("/meshes/{m}/primitives/{p}");
                    found.by_index.insert((m, p), SplatPrimitive::of(path, primitive, extension, &here)?);
                }
            }
        }
        Ok(found)
    }

    /// Primitive `primitive` of mesh `mesh`, if it is splats.
    pub fn get(&self, mesh: usize, primitive: usize) -> Option<&SplatPrimitive> {
        self.by_index.get(&(mesh, primitive))
    }
}

fn array(value: Option<&Value>) -> &[Value] {
    value.and_then(Value::as_array).map_or(&[], Vec::as_slice)
}

impl SplatPrimitive {
    fn of(path: &Path, primitive: &Value, extension: &Value, here: &str) -> Result<Self> {
        let inside = format!("{here}/extensions/{EXTENSION}");
        let invalid = |place: &str, what: &str| Error::invalid(path, place, what);
        if !extension.is_object() {
            return Err(invalid(&inside, "it is not an object"));
        }
        // Drafts of the extension left out what was the only choice.
        let property = |name: &str, default: &'static str| match extension.get(name) {
            None => Ok(default),
            Some(Value::String(value)) => Ok(value.as_str()),
            Some(_) => Err(invalid(&format!("{inside}/{name}"), "it is not a string")),
        };
        let kernel = property("kernel", "ellipse")?;
        if kernel != "ellipse" {
            return Err(Error::unsupported(path, format!("{inside}: kernel '{kernel}'; export it with 'ellipse'")));
        }
        let encoding = match property("colorSpace", "srgb_rec709_display")? {
            "srgb_rec709_display" => SplatEncoding::SrgbDisplay,
            "lin_rec709_display" => SplatEncoding::LinDisplay,
            other => {
                let what = format!("{inside}: colorSpace '{other}'; export it with 'srgb_rec709_display'");
                return Err(Error::unsupported(path, what));
            }
        };
        let order = match property("sortingMethod", "cameraDistance")? {
            "cameraDistance" => Some(Order::CameraDistance),
            "rayHitDistance" => Some(Order::RayHitDistance),
            _ => None,
        };
        // Points; a primitive without a mode is triangles.
        if primitive.get("mode").and_then(Value::as_u64) != Some(0) {
            return Err(invalid(&format!("{here}/mode"), "splats must be POINTS (0)"));
        }
        if primitive.get("indices").is_some() {
            return Err(Error::unsupported(path, format!("{here}: splats with indices; export it without")));
        }
        let index = |value: &Value, place: String| {
            let index = value.as_u64().and_then(|index| u32::try_from(index).ok());
            index.ok_or_else(|| invalid(&place, "it is not an index"))
        };
        let mut attributes = BTreeMap::new();
        for (name, accessor) in primitive.get("attributes").and_then(Value::as_object).into_iter().flatten() {
            let semantic = name.strip_prefix(EXTENSION).and_then(|name| name.strip_prefix(':')).unwrap_or(name);
            attributes.insert(semantic.to_owned(), index(accessor, format!("{here}/attributes/{name}"))?);
        }
        let extensions = extension.get("extensions");
        let compressed = |name| Some((name, extensions?.get(name)?));
        let compression = COMPRESSIONS.into_iter().find_map(compressed).map(|(name, compression)| {
            let view = compression.get("bufferView").unwrap_or(&Value::Null);
            Ok((name, index(view, format!("{inside}/extensions/{name}/bufferView"))?))
        });
        let names_kernel = extension.get("kernel").is_some();
        Ok(Self { attributes, encoding, order, compression: compression.transpose()?, names_kernel })
    }
}
