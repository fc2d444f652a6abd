//! The whole bake, top to bottom.

mod background;
mod output;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use glam::DVec3;
use serde::Serialize;

use self::output::Output;
use crate::bake::{self, BakeSettings, ProbeStatistics, Progress};
use crate::bvh::Bvh;
use crate::ingest::{self, SceneReport};
use crate::job::{Background, Job, Order, Placement, Surface, Tracer};
use crate::manifest::{self, InputRecord, Manifest};
use crate::place::{self, Probe};
use crate::scene::{Bounds, Scene};
use crate::shade::{PathSettings, PathSurfaces, UnlitSurfaces};
use crate::trace::footprint;
use crate::trace::{BeamTracer, Footprint, Level, RayTracer, ReferenceTracer, Surfaces, TileTracer, TraceSettings};
use crate::{Error, Result};

pub use output::PREVIEW_FILE;

/// What a bake did and how long it took; the content of `--stats`.
#[derive(Debug, Clone, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct BakeReport {
    /// The manifest that was written.
    pub manifest: PathBuf,
    /// What was found in the inputs and what was skipped.
    pub scene: SceneReport,
    /// Probes baked.
    pub probes: usize,
    /// Rays traced.
    pub rays: u64,
    /// Channel values that half floats cannot hold and that were clamped to 65504.
    pub clamped_values: usize,
    /// Wall clock time by stage.
    pub seconds: Seconds,
}

/// Wall clock time by stage, in seconds.
#[derive(Debug, Clone, Copy, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Seconds {
    /// Reading and hashing the inputs.
    pub load: f64,
    /// Building the tree.
    pub build: f64,
    /// Tracing and encoding.
    pub bake: f64,
}

/// Bakes `job`: reads the inputs, places the probes, traces them, and writes cubemaps and manifest to the job's output
/// folder, and the report to its `stats` file where it names one.
///
/// Output is made in a folder beside its final place and moved there when all of it is done, the manifest last. On an
/// error, and when `cancel` is set, earlier output is untouched.
///
/// Fails with [`Error::Request`] when the job is wrong, the errors of [`ingest::load_scene`], [`Error::Write`], and
/// [`Error::Cancelled`].
pub fn bake(job: &Job, progress: &dyn Progress, cancel: &AtomicBool) -> Result<BakeReport> {
    job.validate()?;
    let threads = rayon::ThreadPoolBuilder::new().num_threads(job.threads).build();
    let threads = threads.map_err(|error| Error::request("--threads", error.to_string()))?;
    threads.install(|| bake_on_these_threads(job, progress, cancel))
}

fn bake_on_these_threads(job: &Job, progress: &dyn Progress, cancel: &AtomicBool) -> Result<BakeReport> {
    let begun = Instant::now();
    let (mut scene, scene_report) = ingest::load_scene(&job.splats, &job.meshes)?;
    let order = job.order.or(scene_report.order()).unwrap_or_default();
    // As resolved, so that the manifest says what was done.
    let job = &Job { order: Some(order), ..job.clone() };
    background::set(&mut scene, &job.background)?;
    let probes = place_probes(&job.placement, &scene_report)?;
    let mut inputs = input_records(&scene_report)?;
    if let Background::Map(path) = &job.background {
        let (bytes, blake3) = manifest::digest(path)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        inputs.push(InputRecord { path: name, bytes, blake3, report: serde_json::json!({ "kind": "background" }) });
    }
    let loaded = Instant::now();
    let bvh = Bvh::build(&mut scene);
    let built = Instant::now();

    let rules = trace_settings(job, order);
    let ray_angle = footprint::ray_angle(job.face_size * job.samples);
    let origins: Vec<DVec3> = probes.iter().map(|probe| probe.position - scene.origin).collect();
    let unlit = UnlitSurfaces::new(&scene.meshes).for_rays_of(ray_angle);
    let lit = (job.surface == Surface::Path).then(|| {
        let settings = PathSettings { noise: job.noise, max_paths: job.max_paths, ..PathSettings::default() };
        PathSurfaces::new(&scene, &bvh, rules, settings, &origins).for_rays_of(ray_angle)
    });
    let surfaces: &dyn Surfaces = lit.as_ref().map_or(&unlit, |lit| lit);
    let tracer = tracer(job, rules, &scene, &bvh, surfaces);
    let output = Output::begin(job, probes.len())?;
    let settings = BakeSettings { face_size: job.face_size, samples: job.samples, distance: job.distance };
    bake::bake_probes(&*tracer, &scene, &probes, &settings, progress, cancel, |index, cubemap, statistics| {
        scene.meshes.check_textures()?;
        let surface_noise = lit.as_ref().and_then(|lit| lit.noise_of(origins[index]));
        let statistics = ProbeStatistics { surface_noise, ..statistics };
        output.write_probe(index, &probes[index], &cubemap, statistics)
    })?;
    if cancel.load(Ordering::Relaxed) {
        return Err(Error::Cancelled);
    }
    let published = output.publish(|records| Manifest::new(job, scene.encoding, inputs, records))?;

    let report = BakeReport {
        manifest: published.manifest,
        scene: scene_report,
        probes: probes.len(),
        rays: probes.len() as u64 * settings.rays_per_probe(),
        clamped_values: published.clamped_values,
        seconds: Seconds {
            load: (loaded - begun).as_secs_f64(),
            build: (built - loaded).as_secs_f64(),
            bake: built.elapsed().as_secs_f64(),
        },
    };
    if let Some(path) = &job.stats {
        manifest::write_json(path, &report)?;
    }
    Ok(report)
}

fn place_probes(placement: &Placement, scene: &SceneReport) -> Result<Vec<Probe>> {
    let bounds = placement
        .bounds
        .map(|[x0, y0, z0, x1, y1, z1]| Bounds { min: DVec3::new(x0, y0, z0), max: DVec3::new(x1, y1, z1) });
    match placement.grid {
        Some(grid) => {
            let bounds = bounds.or_else(|| scene.robust_bounds());
            let bounds = bounds.ok_or_else(|| Error::request("--bounds", "the scene is empty: give the grid's box"))?;
            place::grid(bounds, grid, placement.overlap)
        }
        None => {
            let positions: Vec<DVec3> = placement.probes.iter().copied().map(DVec3::from).collect();
            place::list(&positions, bounds, placement.overlap)
        }
    }
}

fn trace_settings(job: &Job, order: Order) -> TraceSettings {
    TraceSettings {
        order,
        sh_direction: job.sh_direction,
        t_cutoff: job.t_cutoff,
        t_near: job.t_near,
        footprint: Footprint::new(job.footprint, job.face_size * job.samples),
    }
}

fn tracer<'a>(
    job: &Job,
    settings: TraceSettings,
    scene: &'a Scene,
    bvh: &'a Bvh,
    surfaces: &'a dyn Surfaces,
) -> Box<dyn TileTracer + 'a> {
    match job.tracer {
        Tracer::Beam => Box::new(BeamTracer { scene, bvh, surfaces, settings, level: Level::best() }),
        Tracer::Ray => Box::new(RayTracer { scene, bvh, surfaces, settings }),
        Tracer::Reference => Box::new(ReferenceTracer { scene, surfaces, settings }),
    }
}

/// Hashes the inputs. Reports name their files by paths of this machine; in the manifest the record's name stands alone.
fn input_records(scene: &SceneReport) -> Result<Vec<InputRecord>> {
    let splats = scene.splats.iter().map(|report| (&report.path, serde_json::json!(report)));
    let meshes = scene.meshes.iter().map(|report| (&report.path, serde_json::json!(report)));
    let mut digests = BTreeMap::new();
    splats
        .chain(meshes)
        .map(|(path, mut report)| {
            if let Some(fields) = report.as_object_mut() {
                fields.remove("path");
            }
            let (bytes, blake3) = match digests.get(path) {
                Some(digest) => Clone::clone(digest),
                None => digests.entry(path).or_insert(manifest::digest(&ingest::index_file(path))?).clone(),
            };
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            Ok(InputRecord { path: name, bytes, blake3, report })
        })
        .collect()
}
