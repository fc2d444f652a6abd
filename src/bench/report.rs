//! What a bench found: `bench.json` (schemas/bench.schema.json), and the same as a table and as a plot.

use std::io::Write;
use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::front::front;
use super::{Axis, markdown, plot};
use crate::compare::ErrorNorms;
use crate::encode::file::write_bytes_atomically;
use crate::error::{Error, Result};
use crate::job::{Footprint, Job, Surface, Tracer};
use crate::manifest::write_json;

/// Everything that one run of `bench` measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct BenchReport {
    /// Program and version.
    pub generator: String,
    /// The command that made it.
    pub command: String,
    /// What it ran on.
    pub machine: Machine,
    /// Whether faces were small and values few.
    pub quick: bool,
    /// Runs of which times are medians; runs of more than ten seconds were made once.
    pub repeats: u32,
    /// In the order in which they were asked for.
    pub scenes: Vec<SceneBench>,
}

/// A machine and what was made of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct Machine {
    /// Model of the processor as the system tells it, else its architecture.
    pub cpu: String,
    /// Operating system.
    pub system: String,
    /// Cores that the process may use.
    pub cores: usize,
    /// Threads of "all cores".
    pub threads: usize,
    /// Instruction level of the kernels.
    pub level: String,
    /// `release`, or `development` where debug assertions were on.
    pub build: String,
}

/// A scene and what was measured in it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct SceneBench {
    /// As it was asked for.
    pub scene: String,
    /// How many Gaussians it has.
    pub gaussians: usize,
    /// Highest band of their colours.
    pub sh_degree: u8,
    /// How many triangles it has.
    pub triangles: usize,
    /// Where the probes stand, in metres, world space.
    pub probes: Vec<[f64; 3]>,
    /// What errors are against.
    pub truths: Vec<TruthRecord>,
    /// What was measured.
    pub rows: Vec<Row>,
}

/// What an error is against.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum Truth {
    /// What `reference` sees along the same rays, at random texels: what a tracer and its cut-off lose.
    Ray,
    /// What a texel of the base's size sees as an area: 16 x 16 rays of it, none cut off before a millionth.
    Area,
    /// What a mirror shows: the areas of the finest cubemap's texels. Coarser cubemaps are looked up between their texels, as
    /// engines do.
    Image,
    /// Surfaces that are lit by many paths for every hit.
    Light,
    /// Every texel of the source, weighted by the reflection lobe.
    Lobe,
}

impl Truth {
    /// All of them, as a report lists them.
    pub const ALL: [Self; 5] = [Self::Ray, Self::Area, Self::Image, Self::Light, Self::Lobe];

    /// As tables name it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ray => "ray",
            Self::Area => "area",
            Self::Image => "image",
            Self::Light => "light",
            Self::Lobe => "lobe",
        }
    }
}

/// How a truth was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct TruthRecord {
    /// Which one.
    pub truth: Truth,
    /// In words, with its numbers.
    pub description: String,
    /// Wall time that it took on all cores, in seconds.
    pub seconds: f64,
}

/// Median time of tracing all probes (of `lobe`: of prefiltering the first), in seconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct Seconds {
    /// Wall time on all cores.
    pub all: f64,
    /// Processor time on one core; wall time where the system does not tell it.
    pub one: f64,
}

/// A job's settings of speed and accuracy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct RowSettings {
    /// The tracer.
    pub tracer: Tracer,
    /// Texels along an edge of a face.
    pub face_size: u32,
    /// Rays along an edge of a texel.
    pub samples: u32,
    /// How Gaussians are widened.
    pub footprint: Footprint,
    /// Transmittance at which a ray ends.
    pub t_cutoff: f32,
    /// How light leaves surfaces.
    pub surface: Surface,
    /// Noise that path-traced surfaces are refined to.
    pub noise: f32,
    /// Most paths of a hit.
    pub max_paths: u32,
    /// Samples of a prefiltered texel's widest lobe.
    pub prefilter_samples: u32,
}

impl RowSettings {
    pub(super) fn new(job: &Job, prefilter_samples: u32) -> Self {
        let Job { tracer, face_size, samples, footprint, t_cutoff, surface, noise, max_paths, .. } = *job;
        Self { tracer, face_size, samples, footprint, t_cutoff, surface, noise, max_paths, prefilter_samples }
    }
}

/// What some settings cost and how far they are off.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct Row {
    /// The setting that is changed.
    pub axis: Axis,
    /// Its value, as tables name it.
    pub label: String,
    /// All settings.
    pub settings: RowSettings,
    /// Rays from the probes; 0 where nothing is traced.
    pub rays: u64,
    /// What it takes.
    pub seconds: Seconds,
    /// Against each truth that it can be compared to.
    pub errors: Vec<RowError>,
}

/// An error in display space: of sRGB-encoded values, clamped to [0, 1].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub struct RowError {
    /// What it is against.
    pub truth: Truth,
    /// Over channels and texels of all probes.
    #[serde(flatten)]
    pub norms: ErrorNorms,
    /// Mean FLIP; none where there is no whole image.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub flip: Option<f64>,
    /// What the settings promise for it: the cut-off's share of a colour up to paper white. None where other causes count.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub bound: Option<f64>,
    /// Whether no other row of this scene is as fast, on one core, and as near to this truth by RMSE, and by more than 5 %
    /// better in one of them.
    pub on_front: bool,
}

impl SceneBench {
    /// Rows that have an error against `truth`, with that error.
    pub fn rows_by(&self, truth: Truth) -> impl Iterator<Item = (&Row, &RowError)> {
        self.rows.iter().filter_map(move |row| Some((row, row.errors.iter().find(|error| error.truth == truth)?)))
    }

    /// Marks what is on the front of each truth.
    pub(super) fn mark_fronts(&mut self) {
        for truth in Truth::ALL {
            let points: Vec<[f64; 2]> =
                self.rows_by(truth).map(|(row, error)| [row.seconds.one, error.norms.rmse]).collect();
            let errors = self.rows.iter_mut().flat_map(|row| &mut row.errors);
            for (error, on_front) in errors.filter(|error| error.truth == truth).zip(front(&points)) {
                error.on_front = on_front;
            }
        }
    }
}

impl BenchReport {
    /// As a page of tables, one per scene and truth.
    pub fn markdown(&self) -> String {
        markdown::page(self)
    }

    /// As plots of error over time, one per scene and truth.
    pub fn svg(&self) -> String {
        plot::page(self)
    }

    /// Writes `bench.json`, `bench.md` and `bench.svg` to `folder`, which is made where it is not there.
    pub fn write(&self, folder: &Path) -> Result<()> {
        std::fs::create_dir_all(folder).map_err(|source| Error::write(folder, source))?;
        for (name, text) in [("bench.md", self.markdown()), ("bench.svg", self.svg())] {
            write_bytes_atomically(&folder.join(name), |file| file.write_all(text.as_bytes()))?;
        }
        write_json(&folder.join("bench.json"), self)
    }
}
