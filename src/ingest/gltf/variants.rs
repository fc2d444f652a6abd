//! KHR_materials_variants: which material a primitive has in a chosen variant.

use gltf::json::mesh::Primitive;
use gltf::json::{Index, Material};
use serde::Deserialize;

use super::container::Asset;
use crate::{Error, Result};

const EXTENSION: &str = "KHR_materials_variants";

#[derive(Default, Deserialize)]
#[serde(default)]
struct Variants {
    variants: Vec<Variant>,
}

#[derive(Deserialize)]
struct Variant {
    #[serde(default)]
    name: String,
}

#[derive(Deserialize)]
struct Mappings {
    mappings: Vec<Mapping>,
}

#[derive(Deserialize)]
struct Mapping {
    material: u32,
    variants: Vec<usize>,
}

/// The names of all variants of a file.
pub fn names(asset: &Asset) -> Result<Vec<String>> {
    let Some(extension) = asset.root.extensions.as_ref().and_then(|all| all.others.get(EXTENSION)) else {
        return Ok(Vec::new());
    };
    let variants = Variants::deserialize(extension);
    let variants = variants.map_err(|e| asset.invalid(format!("/extensions/{EXTENSION}"), e.to_string()))?;
    Ok(variants.variants.into_iter().map(|variant| variant.name).collect())
}

/// The index of the variant called `wanted` among `names`.
///
/// # Errors
/// [`Error::Request`] when there is none, with the names that there are.
pub fn find(asset: &Asset, names: &[String], wanted: &str) -> Result<usize> {
    names.iter().position(|name| name == wanted).ok_or_else(|| {
        let has = if names.is_empty() { "no variants".to_owned() } else { names.join(", ") };
        Error::request("--variant", format!("{} has no variant '{wanted}'; it has {has}", asset.path.display()))
    })
}

/// The material of a primitive in `variant`: that of the first mapping which lists it, else the primitive's own.
pub fn material_of(
    asset: &Asset,
    primitive: &Primitive,
    variant: Option<usize>,
    here: &str,
) -> Result<Option<Index<Material>>> {
    let extension = primitive.extensions.as_ref().and_then(|all| all.others.get(EXTENSION));
    let (Some(variant), Some(extension)) = (variant, extension) else { return Ok(primitive.material) };
    let mappings = Mappings::deserialize(extension);
    let mappings = mappings.map_err(|e| asset.invalid(format!("{here}/extensions/{EXTENSION}"), e.to_string()))?;
    let mapping = mappings.mappings.iter().find(|mapping| mapping.variants.contains(&variant));
    Ok(mapping.map(|mapping| Index::new(mapping.material)).or(primitive.material))
}
