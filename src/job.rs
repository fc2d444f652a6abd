//! What to bake: every setting, its unit and its default.

use std::path::PathBuf;

use glam::{DAffine3, DMat3, DQuat, DVec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::scene::SplatEncoding;

/// In which order contributions along a ray are blended (OpenUSD's and KHR_gaussian_splatting's terms).
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "camelCase")]
pub enum Order {
    /// By the distance of the strongest response along the ray. The default.
    #[default]
    #[cfg_attr(feature = "cli", value(name = "rayHitDistance"))]
    RayHitDistance,
    /// By the distance of the Gaussian's mean from the ray's origin; triangles by their hit distance.
    #[cfg_attr(feature = "cli", value(name = "cameraDistance"))]
    CameraDistance,
}

/// The direction in which a Gaussian's colour is evaluated.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum ShDirection {
    /// From the ray's origin to the mean, as 3DGS trains it. The default.
    #[default]
    Mean,
    /// Along the ray, as 3DGRT trains it.
    Ray,
}

/// How a radiance channel is stored.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Pixel {
    /// 16-bit floating point: 11 significant bits, up to 65504. The default.
    #[default]
    Half,
    /// 32-bit floating point.
    Float,
}

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
    #[serde(default)]
    pub transform: Transform,
    /// What the colours mean. Default: what the format declares, else `srgb-display`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub encoding: Option<SplatEncoding>,
}

/// A glTF file and how it stands in the world.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct MeshInput {
    /// The file; relative paths are relative to the job file.
    pub path: PathBuf,
    /// World from the file's coordinates. Default: identity.
    #[serde(default)]
    pub transform: Transform,
    /// Name or index of the scene in the file. Default: the file's default scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
}

/// Translation, rotation and scale, applied scale first.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase", default)]
pub struct Transform {
    /// Metres along x, y, z.
    pub translation: [f64; 3],
    /// Unit quaternion x, y, z, w.
    pub rotation: [f64; 4],
    /// Factors along x, y, z; negative mirrors, 0 is an error. Splats keep their exact shape under all of them, because a
    /// Gaussian stays a Gaussian under any linear map. Their colours follow uniform scale and mirrors exactly, and the
    /// nearest rotation or mirror under non-uniform scale.
    pub scale: [f64; 3],
}

impl Default for Transform {
    fn default() -> Self {
        Self { translation: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0], scale: [1.0; 3] }
    }
}

impl Transform {
    /// The transform as an affine map, world from file.
    pub fn world_from_file(&self) -> DAffine3 {
        DAffine3::from_scale_rotation_translation(
            DVec3::from(self.scale),
            DQuat::from_array(self.rotation).normalize(),
            DVec3::from(self.translation),
        )
    }
}

/// What a file's +X, +Y and +Z point at, each one of right/left, up/down, forward/back; `raw` leaves coordinates as
/// they are. The canonical frame is right-handed, +Y up, -Z forward: `rub`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String")]
pub struct Frame {
    letters: [u8; 3],
}

impl Frame {
    /// +X right, +Y down, +Z forward: what 3DGS trainers write.
    pub const RDF: Self = Self { letters: *b"rdf" };
    /// +X right, +Y up, +Z back: glTF and this program.
    pub const RUB: Self = Self { letters: *b"rub" };

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
