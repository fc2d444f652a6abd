//! The manifest as types. The order of fields is the order in the file.

use std::path::{Component, Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::FORMAT_VERSION;
use crate::bake::ProbeStatistics;
use crate::job::{Job, Pixel, Shard, Tonemapper};
use crate::place::Network;
use crate::place::adaptive::PlacementRecord;
use crate::scene::SplatEncoding;
use crate::scene::bounds::Bounds;
use crate::trace::Level;

/// A bake: what went in, how it was traced, and every probe with its files.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct Manifest {
    /// Version of this format: 1.
    pub format_version: u32,
    /// The program that wrote the manifest, with its version.
    pub generator: String,
    /// The instructions of the machine that it ran on, `scalar`, `AVX2`, `AVX-512` or `NEON`: the same job gives the same
    /// bytes on machines of one level.
    pub instruction_level: String,
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
    /// How the probes are blended and how well that predicts, where they were placed adaptively. Engines that cannot blend
    /// by triangles use the influence boxes.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub placement: Option<PlacementRecord>,
    /// Which part of a bake this is, where it is not all of it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub shard: Option<ShardRecord>,
    /// Ids of the probes that are missing because the time for the bake was over; the same bake goes on with them.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub unfinished: Vec<String>,
}

/// A part of a bake.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct ShardRecord {
    /// Which part, and of how many.
    pub part: Shard,
    /// Ids of all probes of the bake, in order.
    pub probes: Vec<String>,
    /// What the whole bake says of its placement: its triangles mean probes of all parts.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub placement: Option<PlacementRecord>,
}

impl Manifest {
    /// A manifest of this program's version and conventions.
    pub fn new(job: &Job, encoding: SplatEncoding, inputs: Vec<InputRecord>, probes: Vec<ProbeRecord>) -> Self {
        Self {
            format_version: FORMAT_VERSION,
            generator: concat!("splatprobe ", env!("CARGO_PKG_VERSION")).into(),
            instruction_level: Level::best().name().into(),
            frame: Frame::default(),
            colour: Colour::new(encoding, job),
            inputs,
            settings: job.result_settings(),
            probes,
            placement: None,
            shard: None,
            unfinished: Vec::new(),
        }
    }

    /// What [`interpolate`](crate::place::interpolate) needs of the manifest. Probes that were not placed adaptively have no
    /// levels.
    pub fn network(&self) -> Network {
        let levels = self.placement.iter().flat_map(|placement| placement.levels.iter().cloned()).collect();
        Network { probes: self.probes.iter().map(|probe| (probe.position.into(), probe.proxy)).collect(), levels }
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
    /// Stops by which radiance is brighter than traced.
    pub exposure: f32,
    /// Radiance of paper white, the display white of the capture, before a tone mapper is matched: 2 to the power of the
    /// exposure.
    pub paper_white: f64,
    /// Whose inverse everything written went through, so that it shows this light as the splats are.
    pub match_tonemapper: Tonemapper,
    /// What the blended splat colours were taken to mean. Linear inputs beside display-referred ones were added to linear
    /// light by themselves; each input's report states its own encoding.
    pub splat_encoding: SplatEncoding,
    /// What took blended splat colours to linear light; its inverse shows linear light as the capture looked.
    pub display_transform: DisplayTransform,
}

impl Colour {
    fn new(splat_encoding: SplatEncoding, job: &Job) -> Self {
        let (exposure, match_tonemapper) = (job.exposure, job.match_tonemapper);
        let display_transform = match splat_encoding {
            SplatEncoding::SrgbDisplay => DisplayTransform::Srgb,
            SplatEncoding::LinDisplay | SplatEncoding::LinScene => DisplayTransform::None,
        };
        let paper_white = f64::from(exposure).exp2();
        let space = "lin_rec709".into();
        Self { space, exposure, paper_white, match_tonemapper, splat_encoding, display_transform }
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
    /// Radiance around the probe as spherical harmonics.
    pub sh: ShRecord,
    /// What the rays of the probe met.
    pub statistics: ProbeStatistics,
    /// Of a probe that was placed adaptively: the mean relative error expected where it has the greatest weight.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub estimated_error: Option<f64>,
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
    pub pixel: PixelFormat,
    /// Where in a face the first and last texel lie.
    pub texel_sampling: TexelSampling,
    /// Names of the channels, sorted.
    pub channels: Vec<String>,
    /// The cube face that the file shows, where it shows one.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub face: Option<String>,
    /// The images in the file where they are prefiltered for rough reflection: parts, levels or the only one, the largest
    /// first.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub mips: Vec<MipRecord>,
    /// Moments: the distance in metres that nothing counts as farther than, and that open directions have.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub max_distance: Option<f64>,
    /// Size in bytes.
    pub bytes: u64,
    /// BLAKE3 hash of the content, in hexadecimal.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    pub blake3: String,
}

/// An image that is prefiltered for rough reflection.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct MipRecord {
    /// Perceptual roughness, 0 to 1; GGX alpha is its square.
    pub roughness: f64,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Radiance as real, orthonormal spherical harmonics: `L_lm = integral of L(d) Y_lm(d)` over the sphere.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct ShRecord {
    /// Highest band, 2 or 3.
    pub degree: u8,
    /// What the coefficients stand for and in which order they come.
    pub basis: String,
    /// Raw coefficients of linear red, green, blue.
    pub coefficients: Vec<[f64; 3]>,
    /// A copy whose irradiance is nowhere negative, where asked for.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub windowed: Option<WindowedSh>,
}

impl ShRecord {
    /// What [`ShRecord::basis`] says.
    pub const BASIS: &str = "L00 L1-1 L10 L11 L2-2 L2-1 L20 L21 L22 (L3-3 ... L33); radiance, not convolved; \
        no Condon-Shortley phase: Y1-1 = 0.488603 y, Y10 = 0.488603 z, Y11 = 0.488603 x";
}

/// Coefficients multiplied by a window.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct WindowedSh {
    /// The window's width w in bands: band l was multiplied by sinc(pi l / w)^4; none where no window was needed.
    pub width: Option<f64>,
    /// Coefficients of linear red, green, blue.
    pub coefficients: Vec<[f64; 3]>,
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
    /// Radiance, with what the camera is taken to have clipped made brighter.
    Expanded,
    /// Linear radiance, prefiltered for reflection by rough surfaces (GGX at N = V = R).
    Specular,
    /// Irradiance over pi by the surface's normal: linear R, G, B.
    Irradiance,
    /// Mean distance R and mean squared distance G by direction, in metres.
    Moments,
}

/// A file format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum FileFormat {
    /// OpenEXR, scan lines; a part per mip.
    Exr,
    /// Radiance RGBE.
    Hdr,
    /// KTX 2.0, levels compressed with Zstandard.
    Ktx2,
    /// PNG.
    Png,
}

/// How the six faces of a cube lie in an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Layout {
    /// One below the other: +X -X +Y -Y +Z -Z, each oriented as OpenEXR orients cube faces, seen from inside, not
    /// mirrored.
    Strip,
    /// One face, oriented likewise.
    Face,
    /// By latitude and longitude: straight up at the top, +Z in the middle, +X a quarter from the left.
    Latlong,
    /// A cube map of a graphics API, looked up by the direction in the manifest's frame as it is.
    Cube,
    /// Octahedral: +Z in the middle, +X at the right, +Y at the last row.
    Octahedral,
}

/// Where in a face its texels lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum TexelSampling {
    /// Texel i of N lies at (i + 1/2) / N of the face's edge.
    Center,
    /// Texel i of N lies at i / (N - 1) of the face's edge: the outermost ones are shared by neighbouring faces.
    Edge,
}

/// How a pixel's numbers are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum PixelFormat {
    /// 16 bit floating point.
    Half,
    /// 32 bit floating point.
    Float,
    /// 8 bits per channel with a shared exponent.
    Rgbe,
    /// 9 bits per channel with a shared exponent of 5.
    Rgb9e5,
    /// 8 bits per channel: linear = (rgb / 255)^2.2 / (a / 255).
    Rgbd,
}

impl From<Pixel> for PixelFormat {
    fn from(pixel: Pixel) -> Self {
        match pixel {
            Pixel::Half => Self::Half,
            Pixel::Float => Self::Float,
        }
    }
}
