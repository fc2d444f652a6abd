//! The whole bake, top to bottom.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use glam::{DVec3, Vec3};
use serde::Serialize;

use crate::bake::{self, BakeSettings, Cubemap, ProbeStatistics, Progress};
use crate::bvh::Bvh;
use crate::encode::exr::{DISTANCE_CHANNEL, RADIANCE_FILE, write_cubemap};
use crate::encode::preview::{ContactSheet, write_png};
use crate::ingest::{self, SceneReport};
use crate::job::{Job, Pixel, Placement, Surface, Tracer};
use crate::manifest::{
    self, FileFormat, FileRecord, FileRole, Influence, InputRecord, Layout, Manifest, ProbeRecord, TexelSampling,
};
use crate::place::{self, Probe};
use crate::scene::{LinearRgb, Scene, bounds};
use crate::shade::UnlitSurfaces;
use crate::trace::{RayTracer, ReferenceTracer, Surfaces, TileTracer, TraceSettings};
use crate::{Error, Result};

/// Name of the contact sheet of all probes in the output folder.
pub const PREVIEW_FILE: &str = "preview.png";

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
    let probes = place_probes(&job.placement)?;
    let begun = Instant::now();
    let (mut scene, scene_report) = ingest::load_scene(&job.splats, &job.meshes)?;
    scene.background = LinearRgb(Vec3::from(job.background));
    let inputs = input_records(job, &scene_report)?;
    let loaded = Instant::now();
    let bvh = Bvh::build(&mut scene);
    let built = Instant::now();

    let surfaces: Box<dyn Surfaces> = match job.surface {
        Surface::Unlit => Box::new(UnlitSurfaces::new(&scene.meshes)),
    };
    let tracer = tracer(job, &scene, &bvh, &*surfaces);
    let output = Output::begin(job, probes.len())?;
    let settings = BakeSettings { face_size: job.face_size, samples: job.samples, distance: job.distance };
    bake::bake_probes(&*tracer, &scene, &probes, &settings, progress, cancel, |index, cubemap, statistics| {
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

fn place_probes(placement: &Placement) -> Result<Vec<Probe>> {
    let bounds = placement
        .bounds
        .map(|[x0, y0, z0, x1, y1, z1]| place::Bounds { min: DVec3::new(x0, y0, z0), max: DVec3::new(x1, y1, z1) });
    match (placement.grid, bounds) {
        (Some(grid), Some(bounds)) => place::grid(bounds, grid, placement.overlap),
        _ => {
            let positions: Vec<DVec3> = placement.probes.iter().copied().map(DVec3::from).collect();
            place::list(&positions, bounds, placement.overlap)
        }
    }
}

fn tracer<'a>(job: &Job, scene: &'a Scene, bvh: &'a Bvh, surfaces: &'a dyn Surfaces) -> Box<dyn TileTracer + 'a> {
    let settings =
        TraceSettings { order: job.order, sh_direction: job.sh_direction, t_cutoff: job.t_cutoff, t_near: job.t_near };
    match job.tracer {
        Tracer::Ray => Box::new(RayTracer { scene, bvh, surfaces, settings }),
        Tracer::Reference => Box::new(ReferenceTracer { scene, surfaces, settings }),
    }
}

/// Hashes the inputs. Reports name their files by paths of this machine; in the manifest the record's name stands alone.
fn input_records(job: &Job, scene: &SceneReport) -> Result<Vec<InputRecord>> {
    let splats = scene.splats.iter().map(|report| serde_json::json!(report));
    let meshes = scene.meshes.iter().map(|report| serde_json::json!(report));
    let paths = job.splats.iter().map(|input| &input.path).chain(job.meshes.iter().map(|input| &input.path));
    paths
        .zip(splats.chain(meshes))
        .map(|(path, mut report)| {
            if let Some(fields) = report.as_object_mut() {
                fields.remove("path");
            }
            let (bytes, blake3) = manifest::digest(path)?;
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            Ok(InputRecord { path: name, bytes, blake3, report })
        })
        .collect()
}

/// A bake's files on their way to the output folder.
struct Output {
    folder: PathBuf,
    /// Inside `folder`, so that moving out of it is a rename; removes itself.
    staging: tempfile::TempDir,
    pixel: Pixel,
    written: Mutex<Written>,
}

struct Written {
    records: Vec<Option<ProbeRecord>>,
    preview: ContactSheet,
    clamped_values: usize,
}

struct Published {
    manifest: PathBuf,
    clamped_values: usize,
}

impl Output {
    fn begin(job: &Job, probes: usize) -> Result<Self> {
        let folder =
            job.output.clone().ok_or_else(|| Error::request("-o", "give the folder to write the probes to"))?;
        let make = || {
            std::fs::create_dir_all(&folder)?;
            tempfile::Builder::new().prefix(".splatprobe-").tempdir_in(&folder)
        };
        let staging = make().map_err(|source| Error::write(&folder, source))?;
        let written = Written {
            records: vec![None; probes],
            // Validation keeps the number of probes far below 2^32.
            preview: ContactSheet::new(probes as u32, job.face_size),
            clamped_values: 0,
        };
        Ok(Self { folder, staging, pixel: job.pixel, written: Mutex::new(written) })
    }

    /// Called on many threads at once.
    fn write_probe(&self, index: usize, probe: &Probe, cubemap: &Cubemap, statistics: ProbeStatistics) -> Result<()> {
        let folder = self.staging.path().join(&probe.id);
        std::fs::create_dir(&folder).map_err(|source| Error::write(&folder, source))?;
        let path = folder.join(RADIANCE_FILE);
        let clamped = write_cubemap(&path, cubemap, self.pixel)?;
        let record = probe_record(probe, vec![radiance_record(&path, probe, cubemap, self.pixel)?], statistics);
        // A panic on another thread ends the bake by itself.
        if let Ok(mut written) = self.written.lock() {
            written.records[index] = Some(record);
            written.preview.draw(index as u32, cubemap);
            written.clamped_values += clamped;
        }
        Ok(())
    }

    /// Moves everything to its final place, the manifest last.
    fn publish(self, manifest: impl FnOnce(Vec<ProbeRecord>) -> Manifest) -> Result<Published> {
        let written = self.written.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
        let staging = self.staging.path();
        write_png(&staging.join(PREVIEW_FILE), written.preview.image())?;
        let manifest = manifest(written.records.into_iter().flatten().collect());
        let files = manifest.probes.iter().flat_map(|probe| &probe.files).map(|file| file.path.as_str());
        for file in files.chain([PREVIEW_FILE]) {
            rename(&staging.join(file), &self.folder.join(file))?;
        }
        let path = self.folder.join(manifest::FILE_NAME);
        manifest.write(&path)?;
        Ok(Published { manifest: path, clamped_values: written.clamped_values })
    }
}

fn rename(from: &Path, to: &Path) -> Result<()> {
    let rename = || {
        to.parent().map_or(Ok(()), std::fs::create_dir_all)?;
        std::fs::rename(from, to)
    };
    rename().map_err(|source| Error::write(to, source))
}

fn radiance_record(path: &Path, probe: &Probe, cubemap: &Cubemap, pixel: Pixel) -> Result<FileRecord> {
    let (bytes, blake3) = manifest::digest(path)?;
    let distance = cubemap.distance.as_ref().map(|_| DISTANCE_CHANNEL);
    Ok(FileRecord {
        path: format!("{}/{RADIANCE_FILE}", probe.id),
        role: FileRole::Radiance,
        format: FileFormat::Exr,
        layout: Layout::Strip,
        width: cubemap.face_size,
        height: 6 * cubemap.face_size,
        pixel,
        texel_sampling: TexelSampling::Center,
        channels: ["A", "B", "G", "R"].into_iter().chain(distance).map(String::from).collect(),
        bytes,
        blake3,
    })
}

fn probe_record(probe: &Probe, files: Vec<FileRecord>, statistics: ProbeStatistics) -> ProbeRecord {
    let place::Bounds { min, max } = probe.influence;
    ProbeRecord {
        id: probe.id.clone(),
        position: probe.position.into(),
        influence: Influence { min: min.into(), max: max.into(), blend: probe.blend },
        proxy: bounds::Bounds { min, max },
        priority: 0,
        files,
        statistics,
    }
}
