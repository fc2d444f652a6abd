//! The scenes that are measured, and where from.

use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use glam::{DVec3, Vec4, Vec4Swizzles};

use super::{BenchSettings, SceneBench};
use crate::bake::{self, BakeSettings, Cubemap, Silent};
use crate::bvh::Bvh;
use crate::error::{Error, Result};
use crate::filter::RgbCubemap;
use crate::generate::{InteriorSettings, interior};
use crate::ingest::{self, SceneReport};
use crate::job::{Job, Order, Placement};
use crate::pipeline::{JobSurfaces, Loaded, trace_settings, tracer};
use crate::place::free_space::Space;
use crate::place::{self, Probe};
use crate::scene::bounds::robust_bounds;
use crate::scene::{Scene, sh};
use crate::shade::UnlitSurfaces;
use crate::trace::{RayTracer, TileTracer, TraceSettings};

/// What stands before the number of Gaussians of a scene made by rule.
const INTERIOR: &str = "interior:";

/// More than any capture has; memory, 50 to 400 bytes for each, is to last.
const MAX_GAUSSIANS: usize = 50_000_000;

/// A bench is not cancelled from within.
static NEVER: AtomicBool = AtomicBool::new(false);

/// A scene to be measured.
#[derive(Debug, Clone)]
pub struct Source {
    name: String,
    content: Content,
}

#[derive(Debug, Clone)]
enum Content {
    /// The inputs of a job, and its settings.
    Job(Box<Job>),
    Interior(InteriorSettings),
}

impl Source {
    /// A splat or mesh file, told apart by content; a job file, by its name (`.json`); or `interior:N`, the
    /// [generated interior](interior) with N Gaussians of spherical harmonics degree `sh_degree`.
    ///
    /// Fails with [`Error::Request`] for an impossible interior, and with the errors of reading a file.
    pub fn parse(text: &str, sh_degree: u8) -> Result<Self> {
        let content = match text.strip_prefix(INTERIOR) {
            Some(count) => {
                let gaussians = count.parse().ok().filter(|count| (1..=MAX_GAUSSIANS).contains(count));
                let why = || format!("'{count}' is not a number of Gaussians from 1 to {MAX_GAUSSIANS}");
                let gaussians = gaussians.ok_or_else(|| Error::request(text, why()))?;
                if sh_degree > sh::MAX_DEGREE {
                    return Err(Error::request("--sh", format!("{sh_degree} is not 0 to {}", sh::MAX_DEGREE)));
                }
                Content::Interior(InteriorSettings { gaussians, sh_degree, ..InteriorSettings::default() })
            }
            None => Content::Job(Box::new(job_of(Path::new(text))?)),
        };
        Ok(Self { name: text.to_owned(), content })
    }

    /// As it was asked for.
    pub fn name(&self) -> &str {
        &self.name
    }
}

fn job_of(path: &Path) -> Result<Job> {
    let is_job = path.extension().is_some_and(|extension| extension == "json")
        && !ingest::SOG_INDEX_NAMES.iter().any(|index| path.file_name().is_some_and(|name| name == *index));
    if is_job {
        return Job::from_file(path, None);
    }
    let (splats, meshes) = ingest::inputs_of(path)?;
    Ok(Job { splats, meshes, ..Job::default() })
}

/// A scene in memory with its probes.
pub(super) struct Site {
    name: String,
    pub loaded: Loaded,
    /// What is varied.
    pub job: Job,
    pub order: Order,
    pub probes: Vec<Probe>,
}

impl Site {
    /// Reads or makes the scene and finds its probes.
    pub fn read(source: &Source, settings: &BenchSettings) -> Result<Self> {
        let (loaded, job) = match &source.content {
            Content::Job(job) => {
                if job.calibration {
                    return Err(Error::request(source.name(), "a calibration has no scene to be measured"));
                }
                let job = with_probes(job, &settings.probes);
                // An output folder and a probe are needed, and any will do.
                let mut checked = Job { output: Some("bench".into()), ..job.clone() };
                if checked.placement.probes.is_empty() {
                    checked.placement.probes.push([0.0; 3]);
                }
                checked.validate()?;
                (Loaded::read(&job)?, job)
            }
            Content::Interior(interior) => (made(interior), with_probes(&Job::default(), &settings.probes)),
        };
        let order = job.order.or(loaded.report.order()).unwrap_or_default();
        let mut positions: Vec<DVec3> = job.placement.probes.iter().copied().map(DVec3::from).collect();
        if positions.is_empty() {
            positions.push(free_place(&loaded)?);
        }
        let probes = place::list(&positions, None, 0.0)?;
        Ok(Self { name: source.name.clone(), loaded, job, order, probes })
    }

    /// What `work` makes with the tracer that `job` asks for.
    pub fn with_tracer<T>(&self, job: &Job, work: impl FnOnce(&dyn TileTracer) -> Result<T>) -> Result<T> {
        let surfaces = JobSurfaces::new(job, self.order, &self.loaded, &self.origins(), &Silent, &NEVER)?;
        let rules = trace_settings(job, self.order, job.face_size * job.samples);
        let made = work(&*tracer(job, rules, &self.loaded, surfaces.as_dyn(), None))?;
        self.loaded.scene.meshes.check_textures()?;
        Ok(made)
    }

    /// Cubemaps of all probes as `job` says.
    pub fn trace(&self, job: &Job) -> Result<Vec<RgbCubemap>> {
        let settings =
            BakeSettings { face_size: job.face_size, samples: job.samples, distance: false, edge_texels: false };
        let delivered = Mutex::new(Vec::new());
        let deliver = |index, cubemap: Cubemap, _| {
            let texels = cubemap.texels.into_iter().map(|texel| Vec4::from(texel).xyz()).collect();
            let cubemap = RgbCubemap::new(settings.face_size, texels)?;
            if let Ok(mut delivered) = delivered.lock() {
                delivered.push((index, cubemap));
            }
            Ok(())
        };
        let scene = &self.loaded.scene;
        self.with_tracer(job, |tracer| {
            bake::bake_probes(tracer, scene, &self.probes, &settings, &Silent, &NEVER, deliver)
        })?;
        let mut cubemaps = delivered.into_inner().unwrap_or_default();
        cubemaps.sort_by_key(|(index, _)| *index);
        Ok(cubemaps.into_iter().map(|(_, cubemap)| cubemap).collect())
    }

    /// The probes, in metres relative to the scene origin.
    pub fn origins(&self) -> Vec<DVec3> {
        self.probes.iter().map(|probe| probe.position - self.loaded.scene.origin).collect()
    }

    /// What a report says of the scene, without rows.
    pub fn describe(&self) -> SceneBench {
        let scene = &self.loaded.scene;
        SceneBench {
            scene: self.name.clone(),
            gaussians: scene.splats.len(),
            sh_degree: scene.splats.sh_degree,
            triangles: scene.meshes.triangles.len(),
            probes: self.probes.iter().map(|probe| probe.position.to_array()).collect(),
            truths: Vec::new(),
            rows: Vec::new(),
        }
    }
}

/// `job` with the probes that were asked for, or those of its own list; other placements do not matter here.
fn with_probes(job: &Job, asked: &[[f64; 3]]) -> Job {
    let probes = if asked.is_empty() { job.placement.probes.clone() } else { asked.to_vec() };
    Job { placement: Placement { probes, ..Placement::default() }, ..job.clone() }
}

fn made(settings: &InteriorSettings) -> Loaded {
    let begun = Instant::now();
    let mut scene = Scene { splats: interior(settings), ..Scene::default() };
    let generated = Instant::now();
    let bvh = Bvh::build(&mut scene);
    let seconds = [(generated - begun).as_secs_f64(), generated.elapsed().as_secs_f64()];
    Loaded { scene, bvh, report: SceneReport::default(), seconds }
}

/// Where a probe may stand, near the middle of what most of the scene fills; the middle where nothing is free.
fn free_place(loaded: &Loaded) -> Result<DVec3> {
    let Loaded { scene, bvh, report, .. } = loaded;
    let generated = || robust_bounds(&scene.splats.means).map(|bounds| bounds.translated(scene.origin));
    let bounds = report.robust_bounds().or_else(generated);
    let bounds = bounds.ok_or_else(|| Error::request("--probe", "the scene is empty: nothing can be measured"))?;
    let surfaces = UnlitSurfaces::new(&scene.meshes);
    let tracer = RayTracer { scene, bvh, surfaces: &surfaces, settings: TraceSettings::default() };
    Ok(Space { tracer }.free_place(&bounds).unwrap_or(bounds.centre()))
}
