//! The files of a bake and how each stands in the world.

use std::path::PathBuf;

use glam::{DAffine3, DMat3, DQuat, DVec3, EulerRot};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Crop;
use crate::scene::SplatEncoding;

/// A splat file and how it stands in the world.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct SplatInput {
    /// The file; relative paths are relative to the job file.
    pub path: PathBuf,
    /// What the file's +X +Y +Z point at, as letters of r/l u/d f/b, or `raw`. Default: what the format declares.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<Frame>,
    /// World from canonical file coordinates. Default: identity.
    #[serde(default, skip_serializing_if = "Transform::is_identity")]
    pub transform: Transform,
    /// What the colours mean; inputs of one scene may differ. Default: what the format declares, else `srgb-display`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub encoding: Option<SplatEncoding>,
    /// Level of detail of a file that has several (streamed SOG); 0 is the finest. Default: 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lod: Option<u32>,
    /// Only Gaussians whose mean lies inside are kept. Default: all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop: Option<Crop>,
    /// Gaussians with a lower peak opacity, 0 to 1, are dropped. Default: 0, so that only what is never seen is (below
    /// 1/255).
    #[serde(default, skip_serializing_if = "super::is_default")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_opacity: f64,
}

impl SplatInput {
    /// A file as its format declares it, standing where it says.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self {
            path: path.into(),
            frame: None,
            transform: Transform::default(),
            encoding: None,
            lod: None,
            crop: None,
            min_opacity: 0.0,
        }
    }
}

/// A mesh file and how it stands in the world.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct MeshInput {
    /// The file; relative paths are relative to the job file.
    pub path: PathBuf,
    /// World from the file's coordinates. Default: identity.
    #[serde(default, skip_serializing_if = "Transform::is_identity")]
    pub transform: Transform,
    /// Name or index of the scene in the file. Default: the file's default scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
    /// Name of the material variant (KHR_materials_variants). Default: none, the materials as the file's primitives name
    /// them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variant: Option<String>,
    /// What stands for an image that is missing or broken. Default: error.
    #[serde(default, skip_serializing_if = "MissingTexture::is_error")]
    pub missing_texture: MissingTexture,
}

/// What to do about an image that a material names and that is missing or broken.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum MissingTexture {
    /// The bake fails and names it. The default.
    #[default]
    Error,
    /// Its pixels are magenta.
    Magenta,
}

impl MissingTexture {
    fn is_error(&self) -> bool {
        *self == Self::Error
    }
}

impl MeshInput {
    /// A file's default scene, standing where it says.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self {
            path: path.into(),
            transform: Transform::default(),
            scene: None,
            variant: None,
            missing_texture: MissingTexture::default(),
        }
    }
}

/// Translation, rotation and scale, applied scale first.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase", default)]
pub struct Transform {
    /// Metres along x, y, z. Default: 0, 0, 0.
    pub translation: [f64; 3],
    /// Unit quaternion x, y, z, w. Default: 0, 0, 0, 1.
    pub rotation: [f64; 4],
    /// Factors along x, y, z; negative mirrors, 0 is an error. Splats keep their exact shape under all of them, because a
    /// Gaussian stays a Gaussian under any linear map. Their colours follow uniform scale and mirrors exactly, and the
    /// nearest rotation or mirror under non-uniform scale. Default: 1, 1, 1.
    pub scale: [f64; 3],
}

impl Default for Transform {
    fn default() -> Self {
        Self { translation: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0], scale: [1.0; 3] }
    }
}

impl Transform {
    /// Whether the transform leaves every point where it is.
    pub fn is_identity(&self) -> bool {
        *self == Self::default()
    }

    /// The transform as an affine map, world from file.
    pub fn world_from_file(&self) -> DAffine3 {
        DAffine3::from_scale_rotation_translation(
            DVec3::from(self.scale),
            DQuat::from_array(self.rotation).normalize(),
            DVec3::from(self.translation),
        )
    }
}

/// The command line's form: `t=x,y,z` metres, `euler=x,y,z` degrees or `r=x,y,z,w` unit quaternion, `s=k` or `s=x,y,z`;
/// any of them, separated by spaces, applied scale first. Euler angles turn about the fixed X, then Y, then Z axis.
impl std::str::FromStr for Transform {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut transform = Self::default();
        let mut seen = Vec::new();
        for part in text.split_whitespace() {
            let (key, values) = part.split_once('=').ok_or_else(|| transform_help(part))?;
            let property = match key {
                "t" => {
                    transform.translation = parse_numbers(values)?;
                    "t"
                }
                "r" => {
                    transform.rotation = parse_numbers(values)?;
                    "r or euler"
                }
                "euler" => {
                    let [x, y, z] = parse_numbers(values)?.map(f64::to_radians);
                    transform.rotation = DQuat::from_euler(EulerRot::XYZEx, x, y, z).to_array();
                    "r or euler"
                }
                "s" => {
                    transform.scale = match values.contains(',') {
                        true => parse_numbers(values)?,
                        false => [parse_numbers::<1>(values)?[0]; 3],
                    };
                    "s"
                }
                _ => return Err(transform_help(part)),
            };
            if seen.contains(&property) {
                return Err(format!("'{text}' gives {property} twice"));
            }
            seen.push(property);
        }
        if seen.is_empty() { Err(transform_help(text)) } else { Ok(transform) }
    }
}

fn transform_help(part: &str) -> String {
    format!("'{part}' is not a transform: give 't=x,y,z', 'euler=x,y,z' or 'r=x,y,z,w', and 's=k' or 's=x,y,z'")
}

/// Exactly `N` finite numbers separated by commas, as flags take them.
pub fn parse_numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|number| number.trim().parse().ok().filter(|value: &f64| value.is_finite()))
        .collect::<Option<_>>()
        .unwrap_or_default();
    numbers.try_into().map_err(|_| match N {
        1 => format!("'{text}' is not a number"),
        _ => format!("'{text}' is not {N} numbers separated by commas"),
    })
}

/// What a file's +X, +Y and +Z point at, each one of right/left, up/down, forward/back; `raw` leaves coordinates as
/// they are, which is the same as `rub`. The canonical frame is right-handed, +Y up, -Z forward: `rub`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String", extend("pattern" = "^([rludfb]{3}|raw)$"))]
pub struct Frame {
    letters: [u8; 3],
}

impl Frame {
    /// +X right, +Y down, +Z forward: what 3DGS trainers write.
    pub const RDF: Self = Self { letters: *b"rdf" };
    /// +X right, +Y up, +Z back: glTF and this program.
    pub const RUB: Self = Self { letters: *b"rub" };
    /// +X right, +Y forward, +Z up: USD stages whose up axis is Z.
    pub const RFU: Self = Self { letters: *b"rfu" };

    /// Canonical from file coordinates: a signed permutation, which may mirror.
    pub fn canonical_from_file(self) -> DMat3 {
        let axis = |letter| match letter {
            b'r' => DVec3::X,
            b'l' => DVec3::NEG_X,
            b'u' => DVec3::Y,
            b'd' => DVec3::NEG_Y,
            b'b' => DVec3::Z,
            _ => DVec3::NEG_Z,
        };
        DMat3::from_cols(axis(self.letters[0]), axis(self.letters[1]), axis(self.letters[2]))
    }
}

impl std::str::FromStr for Frame {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "raw" {
            return Ok(Self::RUB);
        }
        let dimension = |letter| match letter {
            b'r' | b'l' => Some(0),
            b'u' | b'd' => Some(1),
            b'f' | b'b' => Some(2),
            _ => None,
        };
        let seen: Option<Vec<usize>> = text.bytes().map(dimension).collect();
        match (seen, <[u8; 3]>::try_from(text.as_bytes())) {
            (Some(mut seen), Ok(letters)) => {
                seen.sort_unstable();
                if seen == [0, 1, 2] { Ok(Self { letters }) } else { Err(frame_help(text)) }
            }
            _ => Err(frame_help(text)),
        }
    }
}

fn frame_help(text: &str) -> String {
    format!("'{text}' is not a frame: give one letter each of r/l, u/d and f/b for the file's +X +Y +Z, or 'raw'")
}

impl TryFrom<String> for Frame {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Frame> for String {
    fn from(frame: Frame) -> Self {
        String::from_utf8_lossy(&frame.letters).into_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point_of(text: &str, point: DVec3) -> DVec3 {
        text.parse::<Transform>().unwrap().world_from_file().transform_point3(point)
    }

    #[test]
    fn a_quarter_turn_about_y_takes_x_to_minus_z() {
        assert!((point_of("euler=0,90,0", DVec3::X) - DVec3::NEG_Z).length() < 1e-12);
        assert!((point_of("r=0,0.7071067811865476,0,0.7071067811865476", DVec3::X) - DVec3::NEG_Z).length() < 1e-12);
    }

    #[test]
    fn euler_angles_turn_about_fixed_axes_x_first() {
        // Y goes to Z by the turn about X; the turn about Z then leaves it there.
        assert!((point_of("euler=90,0,90", DVec3::Y) - DVec3::Z).length() < 1e-12);
        // X stays under the turn about X and goes to Y by the turn about Z.
        assert!((point_of("euler=90,0,90", DVec3::X) - DVec3::Y).length() < 1e-12);
    }

    #[test]
    fn scale_is_applied_first_and_translation_last() {
        let moved = point_of("t=10,0,0 euler=0,0,90 s=2,3,1", DVec3::new(1.0, 1.0, 0.0));
        assert!((moved - DVec3::new(7.0, 2.0, 0.0)).length() < 1e-12, "{moved}");
        assert_eq!(point_of("s=2", DVec3::ONE), DVec3::splat(2.0));
    }

    #[test]
    fn malformed_transforms_are_errors() {
        for text in
            ["", "t", "t=1,2", "t=1,2,3,4", "x=1,2,3", "t=1,2,nan", "s=inf", "t=1,2,3 t=1,2,3", "r=0,0,0,1 euler=0,0,0"]
        {
            assert!(text.parse::<Transform>().is_err(), "{text}");
        }
    }

    #[test]
    fn the_canonical_frame_is_rub_and_trainers_frame_turns_about_x() {
        assert_eq!(Frame::RUB.canonical_from_file(), DMat3::IDENTITY);
        assert_eq!("rdf".parse(), Ok(Frame::RDF));
        assert_eq!(Frame::RDF.canonical_from_file() * DVec3::new(1.0, 2.0, 3.0), DVec3::new(1.0, -2.0, -3.0));
        assert_eq!("raw".parse(), Ok(Frame::RUB));
    }

    #[test]
    fn a_frame_names_each_dimension_once() {
        for text in ["", "ru", "rru", "rlu", "rubf", "RUB", "r\u{fc}"] {
            assert!(text.parse::<Frame>().is_err(), "{text}");
        }
    }
}
