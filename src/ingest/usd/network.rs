//! Shader networks: where an input gets its value from (UsdShade), and the nodes of UsdPreviewSurface that feed it.

use glam::{Mat3, Vec2};
use openusd::sdf::Value;
use openusd::usd::{Attribute, Prim};

use super::OpenedStage;
use super::values::{name_of, numbers};
use crate::Result;
use crate::scene::texture::Wrap;

/// Longest chain of connections between an input and what feeds it.
const MAX_HOPS: usize = 64;

/// What feeds an input of a shader.
pub enum Input {
    /// A value, or nothing at all.
    Value(Option<Value>),
    /// Numbers of the mesh.
    Primvar(PrimvarReader),
    /// An image.
    Texture(Box<UvTexture>),
    /// A node that is none of UsdPreviewSurface's, by its identifier.
    Other(String),
}

/// UsdPrimvarReader: a primvar by its name, and what it is where the mesh has none.
#[derive(Debug, Clone, PartialEq)]
pub struct PrimvarReader {
    pub name: String,
    pub fallback: Vec<f64>,
}

/// UsdUVTexture: an output of a texture.
#[derive(Debug, Clone, PartialEq)]
pub struct UvTexture {
    /// Path of the shader, for messages.
    pub prim: String,
    /// The image as the file names it, and where that is, if it is anywhere.
    pub file: (String, Option<String>),
    /// `rgb`, `r`, `g`, `b` or `a`.
    pub output: String,
    pub scale: [f32; 4],
    pub bias: [f32; 4],
    /// Along s and t.
    pub wrap: [Wrap; 2],
    /// Whether a wrap mode is `black`, which is read as clamp.
    pub ends_black: bool,
    /// `raw`, `sRGB` or `auto`.
    pub source_colour_space: String,
    pub coordinates: PrimvarReader,
    /// UsdTransform2d, with t pointing up.
    pub st_from_st: Mat3,
}

/// What an output that feeds an input belongs to, or the value at the end of the chain.
enum Source {
    Value(Option<Value>),
    Output { shader: Prim, id: String, output: String },
}

/// What feeds `inputs:name` of `shader`.
pub fn input(stage: &OpenedStage, shader: &Prim, name: &str) -> Result<Input> {
    Ok(match source(stage, shader, &format!("inputs:{name}"))? {
        Source::Value(value) => Input::Value(value),
        Source::Output { shader, id, output } => match id.as_str() {
            "UsdUVTexture" => Input::Texture(Box::new(uv_texture(stage, &shader, output)?)),
            id if id.starts_with("UsdPrimvarReader_") => Input::Primvar(primvar_reader(stage, &shader)?),
            _ => Input::Other(id),
        },
    })
}

/// The UsdPreviewSurface that `material` has as its surface, if it has one.
pub fn preview_surface(stage: &OpenedStage, material: &Prim) -> Result<Option<Prim>> {
    Ok(match source(stage, material, "outputs:surface")? {
        Source::Output { shader, id, .. } if id == "UsdPreviewSurface" => Some(shader),
        _ => None,
    })
}

/// The numbers of a value that should have `N` of them; `default` where there is no value.
pub fn constant<const N: usize>(
    stage: &OpenedStage,
    shader: &Prim,
    name: &str,
    value: Option<&Value>,
    default: [f32; N],
) -> Result<[f32; N]> {
    let Some(value) = value else { return Ok(default) };
    let numbers = numbers(value).and_then(|it| <[f64; N]>::try_from(it).ok()).map(|it| it.map(|x| x as f32));
    let usable = numbers.filter(|it| it.iter().all(|x| x.is_finite()));
    usable.ok_or_else(|| stage.invalid(shader, format!("inputs:{name} is not {N} finite numbers")))
}

fn source(stage: &OpenedStage, prim: &Prim, property: &str) -> Result<Source> {
    let mut attribute: Attribute = prim.attribute(property);
    for _ in 0..MAX_HOPS {
        let connections = stage.ask(prim, attribute.connections())?;
        let Some(target) = connections.into_iter().next() else {
            return Ok(Source::Value(stage.attribute_value(prim, &attribute)?));
        };
        let owner = stage.stage.prim(target.prim_path());
        let name = target.property_suffix().trim_start_matches('.').to_owned();
        let is_shader = stage.ask(&owner, owner.type_name())?.is_some_and(|kind| kind == "Shader");
        if let (true, Some(output)) = (is_shader, name.strip_prefix("outputs:")) {
            let id = stage.token(&owner, "info:id")?.unwrap_or_default();
            return Ok(Source::Output { id, output: output.to_owned(), shader: owner });
        }
        attribute = stage.stage.attribute(target);
    }
    Err(stage.invalid(prim, format!("{property} is connected over more than {MAX_HOPS} steps, or to itself")))
}

/// An input that cannot be fed by a texture.
fn parameter(stage: &OpenedStage, shader: &Prim, name: &str) -> Result<Option<Value>> {
    Ok(match source(stage, shader, &format!("inputs:{name}"))? {
        Source::Value(value) => value,
        Source::Output { .. } => None,
    })
}

/// A parameter that is a name.
fn name_parameter(stage: &OpenedStage, shader: &Prim, name: &str) -> Result<Option<String>> {
    let Some(value) = parameter(stage, shader, name)? else { return Ok(None) };
    name_of(value).map(Some).ok_or_else(|| stage.invalid(shader, format!("inputs:{name} is not a name")))
}

/// A parameter of `N` numbers.
pub fn parameters<const N: usize>(
    stage: &OpenedStage,
    shader: &Prim,
    name: &str,
    default: [f32; N],
) -> Result<[f32; N]> {
    constant(stage, shader, name, parameter(stage, shader, name)?.as_ref(), default)
}

/// A parameter that is yes or no; no without a value.
pub fn flag(stage: &OpenedStage, shader: &Prim, name: &str) -> Result<bool> {
    parameters(stage, shader, name, [0.0]).map(|[value]| value != 0.0)
}

fn primvar_reader(stage: &OpenedStage, shader: &Prim) -> Result<PrimvarReader> {
    let name = name_parameter(stage, shader, "varname")?.unwrap_or_default();
    let fallback = parameter(stage, shader, "fallback")?.as_ref().and_then(numbers).unwrap_or_default();
    Ok(PrimvarReader { name, fallback })
}

fn uv_texture(stage: &OpenedStage, shader: &Prim, output: String) -> Result<UvTexture> {
    if !["rgb", "r", "g", "b", "a"].contains(&output.as_str()) {
        return Err(stage.invalid(shader, format!("it has no output {output}")));
    }
    let file = match parameter(stage, shader, "file")? {
        Some(Value::AssetPath(file)) => (file.asset_path().to_owned(), file.resolved_path().map(str::to_owned)),
        None => (String::new(), None),
        Some(_) => return Err(stage.invalid(shader, "inputs:file is not an asset")),
    };
    let mut ends_black = false;
    let mut wrap = |name: &str| {
        Ok(match name_parameter(stage, shader, name)?.as_deref() {
            // Images that are read here carry no such metadata; most writers that leave it open mean to repeat.
            None | Some("useMetadata" | "repeat") => Wrap::Repeat,
            Some("mirror") => Wrap::Mirror,
            Some("clamp") => Wrap::Clamp,
            Some("black") => {
                ends_black = true;
                Wrap::Clamp
            }
            Some(other) => return Err(stage.invalid(shader, format!("inputs:{name} is {other}, no wrap mode"))),
        })
    };
    let wrap = [wrap("wrapS")?, wrap("wrapT")?];
    let (coordinates, st_from_st) = coordinates(stage, shader)?;
    Ok(UvTexture {
        prim: shader.path().as_str().to_owned(),
        file,
        output,
        scale: parameters(stage, shader, "scale", [1.0; 4])?,
        bias: parameters(stage, shader, "bias", [0.0; 4])?,
        wrap,
        ends_black,
        source_colour_space: name_parameter(stage, shader, "sourceColorSpace")?.unwrap_or_else(|| "auto".into()),
        coordinates,
        st_from_st,
    })
}

/// The primvar at the end of a texture's chain of UsdTransform2d nodes, and what they do to it.
fn coordinates(stage: &OpenedStage, texture: &Prim) -> Result<(PrimvarReader, Mat3)> {
    let mut st_from_st = Mat3::IDENTITY;
    let (mut node, mut name) = (texture.clone(), "inputs:st");
    for _ in 0..MAX_HOPS {
        match source(stage, &node, name)? {
            Source::Output { shader, id, .. } if id == "UsdTransform2d" => {
                st_from_st *= transform_2d(stage, &shader)?;
                (node, name) = (shader, "inputs:in");
            }
            Source::Output { shader, id, .. } if id.starts_with("UsdPrimvarReader_") => {
                return Ok((primvar_reader(stage, &shader)?, st_from_st));
            }
            Source::Output { id, .. } => {
                return Err(
                    stage.invalid(texture, format!("its texture coordinates come from {id}, which is not read"))
                );
            }
            // The schema's constant (0, 0) would be one texel for all: nobody means that.
            Source::Value(_) => return Ok((PrimvarReader { name: "st".into(), fallback: Vec::new() }, st_from_st)),
        }
    }
    Err(stage.invalid(texture, "its texture coordinates pass through too many nodes, or through themselves"))
}

/// UsdTransform2d: scaled, then turned counter-clockwise by degrees, then moved, t pointing up.
fn transform_2d(stage: &OpenedStage, node: &Prim) -> Result<Mat3> {
    let scale = parameters(stage, node, "scale", [1.0; 2])?;
    let [degrees] = parameters(stage, node, "rotation", [0.0])?;
    let translation = parameters(stage, node, "translation", [0.0; 2])?;
    Ok(Mat3::from_translation(Vec2::from(translation))
        * Mat3::from_angle(degrees.to_radians())
        * Mat3::from_scale(Vec2::from(scale)))
}
