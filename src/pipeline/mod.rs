//! The whole bake, top to bottom.

mod background;
mod ceiling;
mod depfile;
mod files;
mod inputs;
mod memory;
mod merge;
mod output;
mod placement;
mod plan;
mod surfaces;
mod tracing;
mod workspace;

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime};

use rayon::prelude::*;
use serde::Serialize;

use self::inputs::{Content, Inputs};
use self::memory::Memory;
use self::output::Output;
use self::plan::Plan;
use self::tracing::{Done, Tracing};
use self::workspace::Workspace;
use crate::bake::{Progress, Silent};
use crate::cache::Digests;
use crate::ingest::SceneReport;
use crate::job::{Job, Order};
use crate::manifest::{self, Manifest, ShardRecord};
use crate::place::adaptive::PlacementSeconds;
use crate::place::signal;
use crate::trace::{CounterReport, Footprint, TraceSettings};
use crate::{Error, Result};

pub use merge::merge;

pub use output::PREVIEW_FILE;

pub(crate) use plan::Loaded;
pub(crate) use surfaces::JobSurfaces;
pub(crate) use tracing::tracer;

/// What a bake did and how long it took; the content of `--stats`.
#[derive(Debug, Clone, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct BakeReport {
    /// The manifest that was written.
    pub manifest: PathBuf,
    /// What was found in the inputs and what was skipped.
    pub scene: SceneReport,
    /// Probes of the bake, or of its part.
    pub probes: usize,
    /// Of those, probes whose files were known from an earlier bake.
    pub kept_probes: usize,
    /// Probes that are missing because the time was over.
    pub unfinished_probes: usize,
    /// Rays traced.
    pub rays: u64,
    /// Channel values that half floats cannot hold and that were clamped to 65504.
    pub clamped_values: usize,
    /// Wall clock time by stage.
    pub seconds: Seconds,
    /// What the beam tracer did for the probes' cubemaps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub beam: Option<CounterReport>,
}

/// Wall clock time by stage, in seconds.
#[derive(Debug, Clone, Copy, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Seconds {
    /// Reading and hashing the inputs.
    pub load: f64,
    /// Building the tree.
    pub build: f64,
    /// Placing the probes.
    pub place: f64,
    /// The stages of an adaptive placement.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub placement: Option<PlacementSeconds>,
    /// Tracing and encoding.
    pub bake: f64,
}

/// Bakes `job`: reads the inputs, places the probes, traces them, and writes cubemaps and manifest to the job's output
/// folder, and the report to its `stats` file where it names one.
///
/// Output is made in a folder beside its final place and moved there when all of it is done, the manifest last; until then
/// there is none. On an error before, and when `cancel` is set, earlier output is untouched. What is done of a bake that ends early is kept, and the
/// next one goes on from there, with the same result; with a cache, also what other bakes found out is used.
///
/// Fails with [`Error::Request`] when the job is wrong, the errors of [`load_scene`](crate::ingest::load_scene),
/// [`Error::Changed`] when an input changes meanwhile, [`Error::Busy`] while another process bakes to the folder,
/// [`Error::Write`], and [`Error::Cancelled`].
pub fn bake(job: &Job, progress: &dyn Progress, cancel: &AtomicBool) -> Result<BakeReport> {
    on_its_threads(job, || run(job, job, progress, cancel))
}

/// Places the probes of `job` and writes what a bake would, but no images: the probes' statistics and spherical harmonics are
/// those of small cubemaps.
///
/// Fails as [`bake`] does.
pub fn place(job: &Job, cancel: &AtomicBool) -> Result<BakeReport> {
    let small = Job { face_size: signal::FACE_SIZE, samples: 1, outputs: Vec::new(), ..job.clone() };
    on_its_threads(job, || run(job, &small, &Silent, cancel))
}

fn on_its_threads(job: &Job, run: impl FnOnce() -> Result<BakeReport> + Send) -> Result<BakeReport> {
    job.validate()?;
    let threads = rayon::ThreadPoolBuilder::new().num_threads(job.threads).build();
    let threads = threads.map_err(|error| Error::request("--threads", error.to_string()))?;
    threads.install(run)
}

/// Places what `asked` says and bakes it as `job` says; the manifest echoes `asked`.
fn run(asked: &Job, job: &Job, progress: &dyn Progress, cancel: &AtomicBool) -> Result<BakeReport> {
    let begun = Instant::now();
    let folder = job.output.as_ref().ok_or_else(|| Error::request("-o", "give the folder to write the probes to"))?;
    let workspace = Workspace::begin(folder)?;
    let memory = Memory::new(job, &workspace, progress);
    let digests = Digests::new(memory.store());
    let inputs = Inputs::new(job, &digests)?;
    let (plan, content, mut loaded) = plan(job, &inputs, &memory, &digests, cancel)?;
    let planned = Instant::now();

    // As resolved, so that the manifest says what was done.
    let [asked, job] = [asked, job].map(|job| Job { order: Some(plan.order), ..job.clone() });
    let mut output = Output::begin(&job, &workspace, plan.probes.len());
    plan.pictures.iter().try_for_each(|(name, picture)| output.write_beside(name, picture))?;
    let tracing = Tracing {
        job: &job,
        plan: &plan,
        content: &content,
        memory: &memory,
        digests: &digests,
        output: &output,
        progress,
        cancel,
        deadline: job.time_budget.map(|seconds| begun + Duration::from_secs_f64(seconds)),
    };
    let chosen: Vec<usize> = (0..plan.probes.len()).filter(|&i| job.shard.is_none_or(|part| part.holds(i))).collect();
    let is_known = |number: &usize| match memory.probe(&tracing.key(&plan.probes[*number])) {
        Some((files, statistics)) => output.restore(*number, &files, statistics),
        None => Ok(false),
    };
    let known: Vec<bool> = chosen.par_iter().map(is_known).collect::<Result<_>>()?;
    let missing: Vec<usize> = chosen.iter().zip(&known).filter(|(_, known)| !**known).map(|(&i, _)| i).collect();
    let mut done = Done::default();
    if missing.is_empty() {
        progress.begin(0, 0);
        progress.finish();
    } else {
        if loaded.is_none() {
            loaded = Some(Loaded::read(&job)?);
            content.check(&digests)?;
        }
        if let Some(loaded) = &loaded {
            done = tracing.run(loaded, &missing)?;
        }
    }
    if cancel.load(Ordering::Relaxed) {
        return Err(Error::Cancelled);
    }
    content.check(&digests)?;
    let unfinished = missing.len() - done.probes;
    let published = output.publish(|records| manifest_of(&asked, &plan, records))?;
    workspace.set_resumable(memory.is_journal() && unfinished > 0);
    if let Some(path) = &job.depfile {
        let files = job.file.iter().map(PathBuf::as_path).chain(content.files());
        depfile::write(path, &published.manifest, files)?;
    }

    let [load, build] = loaded.map_or([0.0; 2], |loaded| loaded.seconds);
    let (place, placement) = plan.seconds;
    let report = BakeReport {
        manifest: published.manifest,
        scene: plan.report,
        probes: chosen.len() - unfinished,
        kept_probes: chosen.len() - missing.len(),
        unfinished_probes: unfinished,
        rays: done.rays,
        clamped_values: published.clamped_values,
        beam: done.counters,
        seconds: Seconds { load, build, place, placement, bake: planned.elapsed().as_secs_f64() },
    };
    if let Some(path) = &job.stats {
        manifest::write_json(path, &report)?;
    }
    Ok(report)
}

/// Where the probes of `job` stand, and the scene if it had to be loaded to know that.
fn plan(
    job: &Job,
    inputs: &Inputs,
    memory: &Memory,
    digests: &Digests,
    cancel: &AtomicBool,
) -> Result<(Plan, Content, Option<Loaded>)> {
    if let Some(content) = inputs.recall(memory, digests)?
        && let Some(plan) = Plan::recall(job, &content, memory)
    {
        return Ok((plan, content, None));
    }
    let begun = SystemTime::now();
    let loaded = Loaded::read(job)?;
    let content = inputs.learn(&loaded.report, begun, memory, digests)?;
    let plan = Plan::make(job, &loaded, &content, memory, cancel)?;
    Ok((plan, content, Some(loaded)))
}

/// The manifest of the probes that have `records`.
fn manifest_of(job: &Job, plan: &Plan, records: Vec<Option<manifest::ProbeRecord>>) -> Manifest {
    let mut probes = Vec::new();
    let mut unfinished = Vec::new();
    for (number, record) in records.into_iter().enumerate() {
        match record {
            Some(mut record) => {
                record.estimated_error = plan.estimated_errors.get(number).copied();
                probes.push(record);
            }
            None if job.shard.is_none_or(|part| part.holds(number)) => unfinished.push(plan.probes[number].id.clone()),
            None => {}
        }
    }
    // Triangles mean probes by number.
    let placement = if probes.len() == plan.probes.len() { plan.placement.clone() } else { None };
    let shard = job.shard.map(|part| ShardRecord {
        part,
        probes: plan.probes.iter().map(|probe| probe.id.clone()).collect(),
        placement: plan.placement.clone(),
    });
    Manifest { placement, shard, unfinished, ..Manifest::new(job, plan.encoding, plan.inputs.clone(), probes) }
}

/// The job's settings for faces of `rays` rays along an edge.
pub(crate) fn trace_settings(job: &Job, order: Order, rays: u32) -> TraceSettings {
    TraceSettings {
        order,
        sh_direction: job.sh_direction,
        t_cutoff: job.t_cutoff,
        t_near: job.t_near,
        footprint: Footprint::new(job.footprint, rays),
    }
}
