//! The whole bake, top to bottom.

mod background;
mod files;
mod output;
mod placement;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use glam::DVec3;
use serde::Serialize;

use self::output::Output;
use self::placement::place_probes;
use crate::bake::{self, BakeSettings, Calibration, ProbeStatistics, Progress, Silent};
use crate::bvh::Bvh;
use crate::ingest::{self, SceneReport};
use crate::job::{Background, Job, Order, OutputKind, Surface, Tracer};
use crate::manifest::{self, InputRecord, Manifest};
use crate::place::adaptive::PlacementSeconds;
use crate::place::free_space::Space;
use crate::place::{Sight, signal};
use crate::scene::Scene;
use crate::shade::{LocallyLitSurfaces, PathSettings, PathSurfaces, UnlitSurfaces, local, shadows};
use crate::trace::footprint;
use crate::trace::ray::RayScratch;
use crate::trace::{
    BeamTracer, CounterReport, Counters, Footprint, RayTracer, ReferenceTracer, Surfaces, TileTracer, TraceSettings,
};
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
/// Output is made in a folder beside its final place and moved there when all of it is done, the manifest last. On an
/// error, and when `cancel` is set, earlier output is untouched.
///
/// Fails with [`Error::Request`] when the job is wrong, the errors of [`ingest::load_scene`], [`Error::Write`], and
/// [`Error::Cancelled`].
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
    let (mut scene, scene_report) = ingest::load_scene(&job.splats, &job.meshes)?;
    let order = job.order.or(scene_report.order()).unwrap_or_default();
    // As resolved, so that the manifest says what was done.
    let [asked, job] = [asked, job].map(|job| Job { order: Some(order), ..job.clone() });
    let job = &job;
    background::set(&mut scene, &job.background)?;
    let mut inputs = input_records(&scene_report)?;
    if let Background::Map(path) = &job.background {
        let (bytes, blake3) = manifest::digest(path)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        inputs.push(InputRecord { path: name, bytes, blake3, report: serde_json::json!({ "kind": "background" }) });
    }
    let loaded = Instant::now();
    let bvh = Bvh::build(&mut scene);
    if job.mesh_shadows {
        shadows::darken(&mut scene, &bvh, trace_settings(job, order, job.face_size * job.samples));
    }
    let built = Instant::now();

    let ray_angle = footprint::ray_angle(job.face_size * job.samples);
    let unlit = UnlitSurfaces::new(&scene.meshes).for_rays_of(ray_angle);
    // Probes stand where the scene itself changes; light on its meshes comes after.
    let rules = trace_settings(job, order, signal::FACE_SIZE);
    let sight = Sight {
        // What stands between two points does so whatever the order of blending.
        space: Space {
            tracer: RayTracer {
                scene: &scene,
                bvh: &bvh,
                surfaces: &unlit,
                settings: TraceSettings { order: Order::RayHitDistance, ..rules },
            },
        },
        tiles: &BeamTracer::new(&scene, &bvh, &unlit, rules),
    };
    let placed = place_probes(&job.placement, scene_report.robust_bounds(), &sight, cancel)?;
    let probes = &placed.probes;
    let placed_at = Instant::now();

    let rules = trace_settings(job, order, job.face_size * job.samples);
    let origins: Vec<DVec3> = probes.iter().map(|probe| probe.position - scene.origin).collect();
    let lit = (job.surface == Surface::Path).then(|| {
        let settings = PathSettings { noise: job.noise, max_paths: job.max_paths, ..PathSettings::default() };
        PathSurfaces::new(&scene, &bvh, rules, settings, &origins).for_rays_of(ray_angle)
    });
    let locally_lit = (job.surface == Surface::Probe)
        .then(|| LocallyLitSurfaces::new(&scene, &bvh, trace_settings(job, order, local::FACE_SIZE)))
        .transpose()?
        .map(|surfaces| surfaces.for_rays_of(ray_angle));
    let surfaces: &dyn Surfaces = match (&lit, &locally_lit) {
        (Some(lit), _) => lit,
        (_, Some(lit)) => lit,
        _ => &unlit,
    };
    let counters = (job.stats.is_some() && job.tracer == Tracer::Beam).then(|| Counters::new(scene.splats.len()));
    let tracer = tracer(job, rules, &scene, &bvh, surfaces, counters.as_ref());
    let mut output = Output::begin(job, probes.len())?;
    placed.picture.iter().try_for_each(|picture| output.write_plan(picture))?;
    let (face_size, samples) = (job.face_size, job.samples);
    let distance = job.distance || job.outputs.contains(&OutputKind::Moments);
    let settings = BakeSettings { face_size, samples, distance, edge_texels: false };
    bake::bake_probes(&*tracer, &scene, probes, &settings, progress, cancel, |index, cubemap, statistics| {
        scene.meshes.check_textures()?;
        let surface_noise = lit.as_ref().and_then(|lit| lit.noise_of(origins[index]));
        let hidden_backs = (!scene.meshes.triangles.is_empty())
            .then(|| sight.space.hidden_backs(probes[index].position, &mut RayScratch::default()));
        let statistics = ProbeStatistics { hidden_backs, surface_noise, ..statistics };
        output.write_probe(index, &probes[index], cubemap, statistics)
    })?;
    let mut rays_per_probe = settings.rays_per_probe();
    if job.outputs.contains(&OutputKind::Envmap) {
        let samples = samples.next_multiple_of(2);
        let settings = BakeSettings { face_size, samples, distance: false, edge_texels: true };
        bake::bake_probes(&*tracer, &scene, probes, &settings, progress, cancel, |index, cubemap, _| {
            output.write_envmap(index, &probes[index], cubemap)
        })?;
        rays_per_probe += settings.rays_per_probe();
    }
    if cancel.load(Ordering::Relaxed) {
        return Err(Error::Cancelled);
    }
    let (count, placement) = (probes.len(), placed.seconds);
    let published =
        output.publish(|records| placed.describe(Manifest::new(&asked, scene.encoding, inputs, records)))?;

    let report = BakeReport {
        manifest: published.manifest,
        scene: scene_report,
        probes: count,
        rays: count as u64 * rays_per_probe,
        clamped_values: published.clamped_values,
        beam: counters.as_ref().map(Counters::report),
        seconds: Seconds {
            load: (loaded - begun).as_secs_f64(),
            build: (built - loaded).as_secs_f64(),
            place: (placed_at - built).as_secs_f64(),
            placement,
            bake: placed_at.elapsed().as_secs_f64(),
        },
    };
    if let Some(path) = &job.stats {
        manifest::write_json(path, &report)?;
    }
    Ok(report)
}

fn tracer<'a>(
    job: &Job,
    settings: TraceSettings,
    scene: &'a Scene,
    bvh: &'a Bvh,
    surfaces: &'a dyn Surfaces,
    counters: Option<&'a Counters>,
) -> Box<dyn TileTracer + 'a> {
    if job.calibration {
        return Box::new(Calibration);
    }
    match job.tracer {
        Tracer::Beam => Box::new(BeamTracer { counters, ..BeamTracer::new(scene, bvh, surfaces, settings) }),
        Tracer::Ray => Box::new(RayTracer { scene, bvh, surfaces, settings }),
        Tracer::Reference => Box::new(ReferenceTracer { scene, surfaces, settings }),
    }
}

/// The job's settings for faces of `rays` rays along an edge.
fn trace_settings(job: &Job, order: Order, rays: u32) -> TraceSettings {
    TraceSettings {
        order,
        sh_direction: job.sh_direction,
        t_cutoff: job.t_cutoff,
        t_near: job.t_near,
        footprint: Footprint::new(job.footprint, rays),
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
