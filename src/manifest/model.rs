//! The manifest as types. The order of fields is the order in the file.

use std::path::{Component, Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::FORMAT_VERSION;
use crate::bake::ProbeStatistics;
use crate::job::{Job, Pixel};
use crate::scene::SplatEncoding;
use crate::scene::bounds::Bounds;

/// A bake: what went in, how it was traced, and every probe with its files.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct Manifest {
    /// Version of this format: 1.
    pub format_version: u32,
    /// The program that wrote the manifest, with its version.
    pub generator: String,
    /// Axes and unit of every position and direction.
    pub frame: Frame,
    /// What the numbers in the images mean.
    pub colour: Colour,
    /// What went in: splats, then meshes, each in the job's order, then the background's image. A file that brought both stands in both.
    pub inputs: Vec<InputRecord>,
    /// The job, without what cannot change the result. Of the inputs' paths only the file names are kept.
    pub settings: Job,
    /// The probes, in the order of their placement.
    pub probes: Vec<ProbeRecord>,
}

impl Manifest {
    /// A manifest of this program's version and conventions.
    pub fn new(job: &Job, encoding: SplatEncoding, inputs: Vec<InputRecord>, probes: Vec<ProbeRecord>) -> Self {
        Self {
            format_version: FORMAT_VERSION,
            generator: concat!("splatprobe ", env!("CARGO_PKG_VERSION")).into(),
            frame: Frame::default(),
            colour: Colour::new(encoding),
            inputs,
            settings: job.result_settings(),
            probes,
        }
    }
}

/// Axes and unit of every position and direction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct Frame {
    /// `right`: X cross Y is Z.
    pub handedness: String,
    /// The axis that points up: `+Y`.
    pub up: String,
    /// The axis that a camera without rotation looks along: `-Z`.
    pub forward: String,
    /// `metre`.
    pub unit: String,
}

impl Default for Frame {
    fn default() -> Self {
        Self { handedness: "right".into(), up: "+Y".into(), forward: "-Z".into(), unit: "metre".into() }
    }
}

/// What the numbers in the images mean.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct Colour {
    /// Colour space of radiance: `lin_rec709`, linear with Rec.709 primaries and D65 white, unclamped.
    pub space: String,
    /// Radiance of paper white.
    pub paper_white: f64,
    /// What the blended splat colours were taken to mean. Linear inputs beside display-referred ones were added to linear
    /// light by themselves; each input's report states its own encoding.
    pub splat_encoding: SplatEncoding,
    /// What took blended splat colours to linear light; its inverse shows linear light as the capture looked.
    pub display_transform: DisplayTransform,
}

impl Colour {
    fn new(splat_encoding: SplatEncoding) -> Self {
        let display_transform = match splat_encoding {
            SplatEncoding::SrgbDisplay => DisplayTransform::Srgb,
            SplatEncoding::LinDisplay | SplatEncoding::LinScene => DisplayTransform::None,
        };
        Self { space: "lin_rec709".into(), paper_white: 1.0, splat_encoding, display_transform }
    }
}

/// A transfer function between display-referred and linear light.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum DisplayTransform {
    /// The exact sRGB curve, extended above 1.
    Srgb,
    /// Colours were linear already.
    None,
}

/// A file that went in.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct InputRecord {
    /// The file's name; folders are left out, so that the manifest does not depend on where inputs lie.
    pub path: String,
    /// Size in bytes.
    pub bytes: u64,
    /// BLAKE3 hash of the content, in hexadecimal.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    pub blake3: String,
    /// What was found in the file and what was skipped; its form depends on the file's format.
    pub report: serde_json::Value,
}

/// A probe: where it stands, how far it reaches, its images.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct ProbeRecord {
    /// Unique name; also the name of the probe's folder.
    pub id: String,
    /// Where the images were taken, in metres.
    pub position: [f64; 3],
    /// Where the probe is used.
    pub influence: Influence,
    /// Box that reflections are corrected against (parallax), in metres.
    pub proxy: Bounds,
    /// Where influences overlap, a higher priority wins in engines that do not blend.
    pub priority: i32,
    /// The probe's files.
    pub files: Vec<FileRecord>,
    /// What the rays of the probe met.
    pub statistics: ProbeStatistics,
}

/// The box in which a probe is used, and how it fades toward each face.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct Influence {
    /// Corner with the smallest coordinates, in metres.
    pub min: [f64; 3],
    /// Corner with the largest coordinates, in metres.
    pub max: [f64; 3],
    /// Per face +X -X +Y -Y +Z -Z: the distance inward from the face, in metres, over which the probe's weight rises
    /// from 0 at the face to 1.
    pub blend: [f64; 6],
}

/// A file of a probe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct FileRecord {
    /// The file, relative to the manifest, with forward slashes.
    pub path: String,
    /// What the file is for.
    pub role: FileRole,
    /// File format.
    pub format: FileFormat,
    /// How the six faces lie in the image.
    pub layout: Layout,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// How a pixel's numbers are stored.
    pub pixel: Pixel,
    /// Where in a face the first and last texel lie.
    pub texel_sampling: TexelSampling,
    /// Names of the channels, sorted.
    pub channels: Vec<String>,
    /// Size in bytes.
    pub bytes: u64,
    /// BLAKE3 hash of the content, in hexadecimal.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    pub blake3: String,
}

impl FileRecord {
    /// The file, for a manifest in `folder`; `None` when its path leads out of there.
    pub fn path_in(&self, folder: &Path) -> Option<PathBuf> {
        path_in(folder, &self.path)
    }
}

/// A file of a manifest in `folder`; `None` when `relative` leads out of there.
pub fn path_in(folder: &Path, relative: &str) -> Option<PathBuf> {
    let mut components = Path::new(relative).components();
    let stays = !relative.is_empty() && components.all(|component| matches!(component, Component::Normal(_)));
    stays.then(|| folder.join(relative))
}

/// What a probe's file is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum FileRole {
    /// Linear radiance R, G, B, background included; coverage A, the share of light that the scene itself sent; where
    /// asked for, the mean distance in metres as another layer.
    Radiance,
}

/// A file format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum FileFormat {
    /// OpenEXR, one part, scan lines.
    Exr,
}

/// How the six faces of a cube lie in an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Layout {
    /// One below the other: +X -X +Y -Y +Z -Z, each oriented as OpenEXR orients cube faces, seen from inside, not
    /// mirrored.
    Strip,
}

/// Where in a face its texels lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum TexelSampling {
    /// Texel i of N lies at (i + 1/2) / N of the face's edge.
    Center,
}
