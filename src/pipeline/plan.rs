//! All that is known before the first ray of a probe: what was read, and where probes stand. It is kept, so that a bake
//! whose probes are all known loads nothing.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::ceiling;
use super::inputs::Content;
use super::memory::{Memory, Part, Parts};
use super::placement::place_probes;
use super::trace_settings;
use crate::bvh::{Box3, Bvh};
use crate::cache::{Bundle, Key};
use crate::encode::plan::PlanPicture;
use crate::encode::preview::png_bytes;
use crate::ingest::{self, SceneReport};
use crate::job::{Background, Job, Order};
use crate::manifest::InputRecord;
use crate::place::adaptive::{PlacementRecord, PlacementSeconds};
use crate::place::free_space::Space;
use crate::place::{Probe, Sight, signal};
use crate::scene::{Bounds, Scene, SplatEncoding};
use crate::shade::{UnlitSurfaces, shadows};
use crate::trace::{RayTracer, TraceSettings, footprint};
use crate::{Error, Result};

/// A scene in memory, ready to be traced.
pub(crate) struct Loaded {
    pub scene: Scene,
    pub bvh: Bvh,
    pub report: SceneReport,
    /// Wall clock time of reading, and of building the tree, in seconds.
    pub seconds: [f64; 2],
}

impl Loaded {
    /// Reads the inputs of `job` and builds the tree.
    pub fn read(job: &Job) -> Result<Self> {
        let begun = Instant::now();
        ceiling::check_inputs(job)?;
        let (mut scene, report) = ingest::load_scene(&job.splats, &job.meshes)?;
        super::background::set(&mut scene, &job.background)?;
        let loaded = Instant::now();
        let bvh = Bvh::build(&mut scene);
        if job.mesh_shadows {
            // What is between a Gaussian and the light is so whatever the order of blending.
            shadows::darken(&mut scene, &bvh, trace_settings(job, Order::RayHitDistance, job.face_size * job.samples));
        }
        let seconds = [(loaded - begun).as_secs_f64(), loaded.elapsed().as_secs_f64()];
        Ok(Self { scene, bvh, report, seconds })
    }
}

/// What was read and where probes stand.
#[derive(Serialize, Deserialize)]
pub(super) struct Plan {
    pub report: SceneReport,
    pub inputs: Vec<InputRecord>,
    pub encoding: SplatEncoding,
    pub order: Order,
    /// World position of the scene origin.
    pub origin: DVec3,
    /// The boxes below the root of the tree, in metres relative to that.
    boxes: Vec<Option<Bounds>>,
    pub probes: Vec<Probe>,
    /// Per probe; empty unless placed adaptively.
    pub estimated_errors: Vec<f64>,
    pub placement: Option<PlacementRecord>,
    /// Pictures of an adaptive placement, by file name.
    #[serde(skip)]
    pub pictures: Vec<(String, Vec<u8>)>,
    /// Wall clock time of placing, in seconds; and of the stages of an adaptive placement.
    #[serde(skip)]
    pub seconds: (f64, Option<PlacementSeconds>),
}

impl Plan {
    /// Names of the plan's pictures in the output folder.
    pub const PICTURES: [&str; 2] = ["plan.png", "plan.svg"];

    /// The plan of `job`, if it was made before.
    pub fn recall(job: &Job, content: &Content, memory: &Memory) -> Option<Self> {
        let bundle = memory.get(&key(job, content))?;
        let mut plan: Self = bundle.get_json("plan")?;
        plan.pictures =
            Self::PICTURES.into_iter().filter_map(|name| Some((name.to_owned(), bundle.get(name)?.to_vec()))).collect();
        // Paths are where this job has its inputs.
        for (report, input) in plan.report.splats.iter_mut().zip(&job.splats) {
            report.path.clone_from(&input.path);
        }
        for (report, input) in plan.report.meshes.iter_mut().zip(&job.meshes) {
            report.path.clone_from(&input.path);
        }
        Some(plan)
    }

    /// Places the probes of `job` in the scene, and keeps the plan.
    pub fn make(job: &Job, loaded: &Loaded, content: &Content, memory: &Memory, cancel: &AtomicBool) -> Result<Self> {
        let begun = Instant::now();
        let Loaded { scene, bvh, report, .. } = loaded;
        let order = job.order.or(report.order()).unwrap_or_default();
        let unlit = UnlitSurfaces::new(&scene.meshes).for_rays_of(footprint::ray_angle(job.face_size * job.samples));
        // Probes stand where the scene itself changes; light on its meshes comes after.
        let rules = trace_settings(job, order, signal::FACE_SIZE);
        // Of faces as small as these, rays are traced in a third of the beam's time.
        let tiles = RayTracer { scene, bvh, surfaces: &unlit, settings: rules };
        // What stands between two points does so whatever the order of blending.
        let between = TraceSettings { order: Order::RayHitDistance, ..rules };
        let sight = Sight { space: Space { tracer: RayTracer { settings: between, ..tiles } }, tiles: &tiles };
        let placed = place_probes(&job.placement, report.robust_bounds(), &sight, cancel)?;
        let plan = Self {
            report: report.clone(),
            inputs: input_records(job, report, content)?,
            encoding: scene.encoding,
            order,
            origin: scene.origin,
            boxes: bvh.part_boxes().map(|part| part.map(bounds)).to_vec(),
            probes: placed.probes,
            estimated_errors: placed.estimated_errors,
            placement: placed.record,
            pictures: placed.picture.as_ref().map_or(Ok(Vec::new()), |picture| pictures(job, picture))?,
            seconds: (begun.elapsed().as_secs_f64(), placed.seconds),
        };
        let mut bundle = Bundle::default();
        bundle.add_json("plan", &plan);
        plan.pictures.iter().for_each(|(name, picture)| bundle.add(name, picture.clone()));
        memory.put(&key(job, content), &bundle);
        Ok(plan)
    }

    /// The scene's parts, by content and place.
    pub fn parts(&self, content: &Content) -> Parts {
        let bounds = |lane: usize| self.boxes.get(lane).copied().flatten();
        let mesh = |(i, &key): (usize, &Key)| Part { key, bounds: bounds(1 + i) };
        Parts {
            splats: Part { key: content.splats, bounds: bounds(0) },
            meshes: content.meshes.iter().enumerate().map(mesh).collect(),
        }
    }
}

/// Of all that a plan depends on.
fn key(job: &Job, content: &Content) -> Key {
    let Job { order, sh_direction, t_cutoff, t_near, footprint, mesh_shadows, .. } = *job;
    let rays = job.face_size * job.samples;
    let rules = (order, sh_direction, t_cutoff, t_near, footprint, mesh_shadows, rays);
    Key::of("plan", &(content.scene, content.placed, &job.placement_settings(), rules))
}

fn bounds(part: Box3) -> Bounds {
    Bounds { min: part.min.as_dvec3(), max: part.max.as_dvec3() }
}

fn pictures(job: &Job, picture: &PlanPicture) -> Result<Vec<(String, Vec<u8>)>> {
    let output = job.output.clone().unwrap_or_default();
    let image = png_bytes(&picture.image()).map_err(|source| Error::write(output, source))?;
    let [image_name, drawing_name] = Plan::PICTURES.map(String::from);
    Ok(vec![(image_name, image), (drawing_name, picture.svg().into_bytes())])
}

/// What the manifest says of the inputs. Reports name their files by paths of this machine; in the manifest the record's
/// name stands alone.
fn input_records(job: &Job, scene: &SceneReport, content: &Content) -> Result<Vec<InputRecord>> {
    let splats = scene.splats.iter().map(|report| (report.path.clone(), serde_json::json!(report)));
    let meshes = scene.meshes.iter().map(|report| (report.path.clone(), serde_json::json!(report)));
    let background = match &job.background {
        Background::Map(path) => Some((path.clone(), serde_json::json!({ "kind": "background" }))),
        Background::Colour(_) => None,
    };
    let record = |(path, mut report): (PathBuf, serde_json::Value)| {
        if let Some(fields) = report.as_object_mut() {
            fields.remove("path");
        }
        let file = ingest::index_file(&path);
        let digest = content.digest(&file).cloned().ok_or(Error::Changed { path: file })?;
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok(InputRecord { path: name, bytes: digest.bytes, blake3: digest.blake3, report })
    };
    splats.chain(meshes).chain(background).map(record).collect()
}
