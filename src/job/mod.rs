//! What to bake: every setting, its unit and its default.
//!
//! A [`Job`] is what a job file holds and what the flags of the command line say; both have the same names.

mod background;
mod crop;
mod file;
mod footprint;
mod inputs;
mod outputs;
mod preset;
mod shard;
mod validate;

use std::path::PathBuf;

use bytesize::ByteSize;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use background::Background;
pub use crop::Crop;
pub use footprint::Footprint;
pub use inputs::{Frame, MeshInput, MissingTexture, SplatInput, Transform, parse_numbers};
pub use outputs::{HdrEncoding, OutputKind, RoughnessCurve, Tonemapper};
pub use preset::Preset;
pub use shard::Shard;
pub use validate::{MAX_FACE_SIZE, MAX_MIPS, MAX_PATHS, MAX_PROBES, MAX_SAMPLES};

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

/// How light leaves a mesh's surface.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Surface {
    /// Base colour as if lit evenly, plus emission; no light transport. The default.
    #[default]
    Unlit,
    /// Lit by a small cubemap around the middle of each part of the meshes, and by lights with their shadows: free of noise
    /// and fast, but blind to what changes over a part.
    Probe,
    /// Lit by all that the surface sees, by path tracing: Gaussians, other surfaces, lights and background.
    Path,
}

/// What computes the radiance along rays.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Tracer {
    /// All rays of a tile at once through the tree. The default.
    #[default]
    Beam,
    /// Packets of neighbouring rays through the tree, each ray with its own order, in f64.
    Ray,
    /// Every primitive for every ray in f64: the truth to measure others against. Slow.
    Reference,
}

/// How a pixel's numbers are stored.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Pixel {
    /// 16 bit floating point, at most 65504. The default.
    #[default]
    Half,
    /// 32 bit floating point.
    Float,
}

/// How the command line tool reports a running bake, on stderr.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum ProgressStyle {
    /// A bar on a terminal, plain lines elsewhere. The default.
    #[default]
    Auto,
    /// Lines of text.
    Plain,
    /// One JSON object per line.
    Json,
    /// Nothing.
    None,
}

/// Where probes stand: a grid in a box, a list, or where prediction fails.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase", default)]
pub struct Placement {
    /// Box that the probes serve, as x0, y0, z0, x1, y1, z1 in metres, world space. Default: for a grid and for adaptive
    /// placement, the box that most of the scene fills, without outliers; for a list, 5 m around each probe.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bounds: Option<[f64; 6]>,
    /// How many probes stand along x, y and z, each in the middle of its cell of the bounds. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grid: Option<[u32; 3]>,
    /// Probe positions in metres, world space, instead of a grid. Default: none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub probes: Vec<[f64; 3]>,
    /// A manifest, of `place` or of a bake, whose probes are baked, as `place` put them; a relative path is relative to the
    /// job file. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub placed: Option<PathBuf>,
    /// Fraction, 0 to 1, of the spacing by which neighbouring influence boxes overlap. Default: 0.1.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub overlap: f64,
    /// Whether probes are placed where the blend of the others fails to predict what is there. Default: false.
    #[serde(skip_serializing_if = "is_default")]
    pub adaptive: bool,
    /// Adaptive placement: heights in metres at which probes stand. Default: found from floors and ceilings.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schemars(length(max = 64))]
    pub levels: Vec<f64>,
    /// Adaptive placement: relative error of predicted reflections, 0 or more, that no place needs to be below.
    /// Default: 0.1.
    #[schemars(range(min = 0.0))]
    pub error: f64,
    /// Adaptive placement: most probes. Default: 64.
    #[schemars(range(min = 1, max = 1_000_000))]
    pub max_probes: u32,
    /// Adaptive placement: seconds after which no probe is added any more. The result then depends on how fast the machine
    /// is. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub time: Option<f64>,
    /// Adaptive placement: positions, not used otherwise, at which the error is measured; 0 measures none. Default: 100.
    #[schemars(range(max = 10_000))]
    pub held_out: u32,
}

impl Default for Placement {
    fn default() -> Self {
        Self {
            bounds: None,
            grid: None,
            probes: Vec::new(),
            placed: None,
            overlap: 0.1,
            adaptive: false,
            levels: Vec::new(),
            error: 0.1,
            max_probes: 64,
            time: None,
            held_out: 100,
        }
    }
}

/// A bake: what goes in, where probes stand, how they are traced, what comes out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase", default)]
pub struct Job {
    /// The file that it was read from, which is an input of the bake like those that it names.
    #[serde(skip)]
    pub file: Option<PathBuf>,
    /// Splat files; all are one scene. What meshes they hold comes along, under the same transform, unless `meshes` names
    /// the file too. Default: none.
    pub splats: Vec<SplatInput>,
    /// glTF files placed in that scene. What splats they hold comes along, under the same transform, unless `splats` names
    /// the file too. Default: none.
    pub meshes: Vec<MeshInput>,
    /// Folder that the manifest and the probes are written to; a relative path is relative to the job file. Needed;
    /// Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub output: Option<PathBuf>,
    /// Where probes stand. Default: nowhere; a grid, a list or adaptive placement is needed.
    pub placement: Placement,
    /// Where settings of speed and accuracy come from that the file does not state: `faceSize`, `samples`, `footprint`,
    /// `tCutoff`, `noise`, `maxPaths`. Default: standard.
    #[serde(skip_serializing_if = "is_default")]
    pub preset: Preset,
    /// Edge of a cube face, in pixels. Default: 256.
    #[schemars(range(min = 1, max = 8192))]
    pub face_size: u32,
    /// Rays per pixel and axis: N stands for N x N rays in a regular pattern. Default: 1.
    #[schemars(range(min = 1, max = 64))]
    pub samples: u32,
    /// How Gaussians are widened so that fine ones do not alias: `none`; `pixel`, to what a ray of the bake stands for, with
    /// the light of each kept; `train:` and a focal length in pixels, at least 1, as 3DGS does while it trains on images of
    /// that focal length. Default: none.
    pub footprint: Footprint,
    /// Blending order along a ray. Default: what the splat files ask for where they agree, else rayHitDistance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub order: Option<Order>,
    /// Direction in which colours of Gaussians are evaluated. Default: mean.
    pub sh_direction: ShDirection,
    /// A ray ends when its transmittance falls below this share; 0 follows every ray to its end. What it leaves out is
    /// at most this share of a colour. Default: 1/2048.
    #[schemars(extend("minimum" = 0, "exclusiveMaximum" = 1))]
    pub t_cutoff: f32,
    /// Contributions nearer than this, in metres, are ignored. Default: 0.
    #[schemars(extend("minimum" = 0))]
    pub t_near: f32,
    /// How light leaves a mesh's surface. Default: unlit.
    pub surface: Surface,
    /// Whether Gaussians near meshes are darkened by the ambient light that the meshes keep from them. Default: false.
    pub mesh_shadows: bool,
    /// Noise of surfaces that are lit by path tracing: each is refined until its reflected light is known to this share of
    /// it (standard error; where it is darker than 1/20 of paper white, to this share of that). 0 refines each to
    /// `maxPaths`. Default: 0.02.
    #[schemars(range(min = 0.0))]
    pub noise: f32,
    /// Most paths per ray that meets a surface. Default: 1024.
    #[schemars(range(min = 1, max = 1_048_576))]
    pub max_paths: u32,
    /// What computes the radiance along rays. Default: beam.
    pub tracer: Tracer,
    /// How pixels are stored. Default: half.
    pub pixel: Pixel,
    /// Whether a layer with the mean distance along each ray, in metres, is written. Default: false.
    pub distance: bool,
    /// What is written for every probe. Default: strip.
    #[schemars(length(min = 1), extend("uniqueItems" = true))]
    pub outputs: Vec<OutputKind>,
    /// Most mips of prefiltered radiance; each has half of the size of the one before, down to a texel. Default: 7.
    #[schemars(range(min = 1, max = 14))]
    pub mips: u32,
    /// How roughness grows along the mips. Default: linear.
    pub roughness_curve: RoughnessCurve,
    /// How KTX2 files store radiance. Default: rgba16f.
    pub hdr_encoding: HdrEncoding,
    /// Stops by which everything written is brighter than traced: radiance times 2 to this power. Default: 0.
    #[schemars(range(min = -32, max = 32))]
    pub exposure: f32,
    /// The tone mapper of an engine that shows splats without it: everything written is then light that the mapper shows
    /// as the splats are. Default: none.
    pub match_tonemapper: Tonemapper,
    /// Radiance that paper white becomes in a further file, `expanded.exr`, in which what is bright, at least 0.8, is taken
    /// to have been clipped by the camera; at least 1. Default: none, no such file.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("minimum" = 1))]
    pub highlight_expansion: Option<f32>,
    /// Highest band of the spherical harmonics of each probe: 2 or 3. Default: 2.
    #[schemars(range(min = 2, max = 3))]
    pub sh_degree: u8,
    /// Whether a windowed copy of the spherical harmonics is stored beside the raw ones, whose irradiance is nowhere negative.
    /// Default: false.
    pub sh_window: bool,
    /// Whether light that codes its direction is baked instead of the scene, to check how consumers look cubemaps up.
    /// Default: false.
    pub calibration: bool,
    /// What rays that leave the scene see: linear red, green, blue, or an .exr or .hdr image of all directions. A probe's
    /// coverage counts the scene alone. Default: 0, 0, 0.
    pub background: Background,
    /// Threads to work with; 0 is one per core. The result does not depend on it. Default: 0.
    #[serde(skip_serializing_if = "is_default")]
    #[schemars(range(max = 1024))]
    pub threads: usize,
    /// How the command line tool reports a running bake. Default: auto.
    #[serde(skip_serializing_if = "is_default")]
    pub progress: ProgressStyle,
    /// File that run times and counts are written to, as JSON; a relative path is relative to the job file.
    /// Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stats: Option<PathBuf>,
    /// Folder in which results are kept under the hash of all that they depend on; bakes share it. A relative path is
    /// relative to the job file. Default: none; what is done of a bake is kept in its output folder until all of it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cache: Option<PathBuf>,
    /// Whether nothing is kept, not even what is done of a bake that is interrupted. Default: false.
    #[serde(skip_serializing_if = "is_default")]
    pub no_cache: bool,
    /// The part of the probes that is baked, as `I/N`: probe number k, from 0 on, is in part k mod N + 1. `merge` joins the
    /// parts. Default: all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shard: Option<Shard>,
    /// File that all inputs are written to as a rule of Make, for Make and Ninja; a relative path is relative to the job
    /// file. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depfile: Option<PathBuf>,
    /// Seconds after which no further probe is begun; what is done is then written, and the manifest names the rest.
    /// Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub time_budget: Option<f64>,
    /// Memory that the scene, its tree and the cubemaps under way may take, such as `4GiB`: fewer probes are baked at a
    /// time, and what cannot fit is refused before it is read. Mapped files and textures come on top. Default: no limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<String>")]
    pub max_memory: Option<ByteSize>,
}

impl Default for Job {
    fn default() -> Self {
        Self {
            file: None,
            splats: Vec::new(),
            meshes: Vec::new(),
            output: None,
            placement: Placement::default(),
            preset: Preset::default(),
            face_size: 256,
            samples: 1,
            footprint: Footprint::default(),
            order: None,
            sh_direction: ShDirection::default(),
            t_cutoff: 1.0 / 2048.0,
            t_near: 0.0,
            surface: Surface::default(),
            mesh_shadows: false,
            noise: 0.02,
            max_paths: 1024,
            tracer: Tracer::default(),
            pixel: Pixel::default(),
            distance: false,
            outputs: vec![OutputKind::Strip],
            mips: 7,
            roughness_curve: RoughnessCurve::default(),
            hdr_encoding: HdrEncoding::default(),
            exposure: 0.0,
            match_tonemapper: Tonemapper::default(),
            highlight_expansion: None,
            sh_degree: 2,
            sh_window: false,
            calibration: false,
            background: Background::default(),
            threads: 0,
            progress: ProgressStyle::default(),
            stats: None,
            cache: None,
            no_cache: false,
            shard: None,
            depfile: None,
            time_budget: None,
            max_memory: None,
        }
    }
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

impl Job {
    /// Placement, as far as it decides the result.
    pub fn placement_settings(&self) -> Placement {
        self.result_settings().placement
    }

    /// The part that decides the bytes of the result: no output folder, no threads, no reporting, and of each input's
    /// path only the file name, so that a bake's manifest does not depend on where or how it was run. Settings are what they
    /// are, whichever preset they come from.
    pub fn result_settings(&self) -> Self {
        let mut job = Self {
            file: None,
            output: None,
            preset: Preset::default(),
            threads: 0,
            progress: ProgressStyle::default(),
            stats: None,
            cache: None,
            no_cache: false,
            shard: None,
            depfile: None,
            time_budget: None,
            max_memory: None,
            ..self.clone()
        };
        let paths = job
            .splats
            .iter_mut()
            .map(|input| &mut input.path)
            .chain(job.meshes.iter_mut().map(|input| &mut input.path))
            .chain(match &mut job.background {
                Background::Map(path) => Some(path),
                Background::Colour(_) => None,
            })
            .chain(&mut job.placement.placed);
        for path in paths {
            *path = path.file_name().unwrap_or_default().into();
        }
        job
    }
}
