//! The probes that no earlier bake knows, traced; of those that it knows in part, what has changed.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use glam::DVec3;

use super::ceiling;
use super::inputs::{Content, files_key};
use super::memory::{Memory, Parts, Site};
use super::output::Output;
use super::plan::{Loaded, Plan};
use super::surfaces::JobSurfaces;
use super::trace_settings;
use crate::Result;
use crate::bake::{self, BakeSettings, Calibration, Cubemap, ProbeStatistics, Progress};
use crate::cache::{Digests, Key};
use crate::job::{Job, OutputKind, Tracer};
use crate::place::Probe;
use crate::place::free_space::Space;
use crate::shade::UnlitSurfaces;
use crate::shade::path::SurfaceNoise;
use crate::trace::ray::RayScratch;
use crate::trace::{
    BeamTracer, CounterReport, Counters, RayTracer, ReferenceTracer, Surfaces, TileTracer, TraceSettings,
};

/// A bake of some probes of a plan.
pub(super) struct Tracing<'a> {
    /// With the order that the plan has found.
    pub job: &'a Job,
    pub plan: &'a Plan,
    pub content: &'a Content,
    pub memory: &'a Memory<'a>,
    pub digests: &'a Digests<'a>,
    pub output: &'a Output<'a>,
    pub progress: &'a dyn Progress,
    pub cancel: &'a AtomicBool,
    /// When no further probe is begun.
    pub deadline: Option<Instant>,
}

/// What was done.
#[derive(Default)]
pub(super) struct Done {
    /// Rays traced.
    pub rays: u64,
    /// Of the probes asked for, how many are done: the first.
    pub probes: usize,
    pub counters: Option<CounterReport>,
}

impl Tracing<'_> {
    /// Traces the probes with the numbers `missing` in `loaded`, and writes them.
    pub fn run(&self, loaded: &Loaded, missing: &[usize]) -> Result<Done> {
        let Loaded { scene, .. } = loaded;
        let Job { face_size, samples, .. } = *self.job;
        let rules = trace_settings(self.job, self.plan.order, face_size * samples);
        let origins: Vec<DVec3> = self.plan.probes.iter().map(|probe| probe.position - scene.origin).collect();
        let surfaces = JobSurfaces::new(self.job, self.plan.order, loaded, &origins, self.progress, self.cancel)?;
        let is_counted = self.job.stats.is_some() && self.job.tracer == Tracer::Beam;
        let counters = is_counted.then(|| Counters::new(scene.splats.len()));
        let tracer = tracer(self.job, rules, loaded, surfaces.as_dyn(), counters.as_ref());

        let settings = self.job.bake_settings();
        let edges = self.job.outputs.contains(&OutputKind::Envmap).then(|| edge_settings(&settings));
        let rays_per_probe = settings.rays_per_probe() + edges.map_or(0, |edges| edges.rays_per_probe());
        // Both kinds of rays of a probe are traced before the next ones, and a clock is looked at between probes.
        let step = match (self.deadline, edges) {
            (Some(_), _) => 1,
            (None, Some(_)) => settings.probes_at_a_time(),
            (None, None) => missing.len(),
        };
        let step = step.min(ceiling::probes_at_a_time(self.job, loaded)?.unwrap_or(step));
        let parts = self.plan.parts(self.content);
        let mut done = Done::default();
        self.progress.begin(missing.len(), missing.len() as u64 * rays_per_probe);
        let result = missing.chunks(step.max(1)).try_for_each(|numbers| {
            if done.probes > 0 && self.deadline.is_some_and(|deadline| Instant::now() >= deadline) {
                return Ok(());
            }
            let noise_of = |number: usize| surfaces.noise_of(origins[number]);
            let pass = Pass { tracing: self, loaded, tracer: &*tracer, rules, parts: &parts, numbers };
            done.rays += pass.radiance(&settings, &noise_of, edges.is_none())?;
            if let Some(edges) = &edges {
                done.rays += pass.envmap(edges)?;
            }
            done.probes += numbers.len();
            Ok(())
        });
        self.progress.finish();
        result?;
        done.counters = counters.as_ref().map(Counters::report);
        Ok(done)
    }

    /// The key of a probe's files.
    pub fn key(&self, probe: &Probe) -> Key {
        self.content.probe_key(self.job, probe)
    }

    /// Keeps the files of the probe with this number under `files`.
    fn keep(&self, number: usize, files: &Key) -> Result<()> {
        if self.memory.store().is_some()
            && let Some(bundle) = self.output.bundle(number)?
            && let Some(statistics) = self.output.statistics(number)
        {
            self.memory.put(files, &bundle);
            self.memory.put_probe(&self.key(&self.plan.probes[number]), files, &statistics);
        }
        Ok(())
    }

    /// Writes a probe's files, or takes those that the same light has become before, and keeps them.
    fn write(&self, number: usize, cubemap: Cubemap, statistics: ProbeStatistics) -> Result<()> {
        let Tracing { job, plan, memory, output, .. } = *self;
        let probe = &plan.probes[number];
        if memory.store().is_none() {
            return output.write_probe(number, probe, cubemap, statistics);
        }
        let files = files_key(job, probe, &cubemap);
        if let Some(bundle) = memory.get(&files)
            && output.restore(number, &bundle, statistics)?
        {
            memory.put_probe(&self.key(probe), &files, &statistics);
            return Ok(());
        }
        output.write_probe(number, probe, cubemap, statistics)?;
        self.keep(number, &files)
    }
}

/// One round over some probes.
struct Pass<'a> {
    tracing: &'a Tracing<'a>,
    loaded: &'a Loaded,
    tracer: &'a dyn TileTracer,
    rules: TraceSettings,
    parts: &'a Parts,
    numbers: &'a [usize],
}

impl Pass<'_> {
    /// Traces and writes all files but the `envmap`; `is_all` says that there is none. Returns the rays traced.
    fn radiance(
        &self,
        settings: &BakeSettings,
        noise_of: &(dyn Fn(usize) -> Option<SurfaceNoise> + Sync),
        is_all: bool,
    ) -> Result<u64> {
        self.trace(settings, noise_of, |number, traced, surface_noise| {
            let Tracing { plan, output, .. } = *self.tracing;
            let hidden_backs = self.hidden_backs(&plan.probes[number]);
            let statistics = ProbeStatistics { hidden_backs, surface_noise, ..traced.statistics(settings) };
            let cubemap = traced.cubemap;
            if is_all {
                self.tracing.write(number, cubemap, statistics)
            } else {
                output.write_probe(number, &plan.probes[number], cubemap, statistics)
            }
        })
    }

    /// [`Space::hidden_backs`] around a probe.
    fn hidden_backs(&self, probe: &Probe) -> Option<f64> {
        let Loaded { scene, bvh, .. } = self.loaded;
        let surfaces = UnlitSurfaces::new(&scene.meshes);
        let space = Space { tracer: RayTracer { scene, bvh, surfaces: &surfaces, settings: self.rules } };
        let has_meshes = !scene.meshes.triangles.is_empty();
        has_meshes.then(|| space.hidden_backs(probe.position, &mut RayScratch::default()))
    }

    fn envmap(&self, settings: &BakeSettings) -> Result<u64> {
        self.trace(settings, &|_| None, |number, traced, _| {
            let Tracing { plan, output, .. } = *self.tracing;
            let probe = &plan.probes[number];
            output.write_envmap(number, probe, traced.cubemap)?;
            // Two cubemaps have become these files; they are known by what both depend on.
            self.tracing.keep(number, &Key::of("files of both", &self.tracing.key(probe)))
        })
    }

    /// Traces what is not known yet, keeps it, and hands it to `sink`, with the probe's number.
    fn trace(
        &self,
        settings: &BakeSettings,
        noise_of: &(dyn Fn(usize) -> Option<SurfaceNoise> + Sync),
        sink: impl Fn(usize, bake::Traced, Option<SurfaceNoise>) -> Result<()> + Sync,
    ) -> Result<u64> {
        let Tracing { job, plan, content, memory, digests, progress, cancel, .. } = *self.tracing;
        let site = Site {
            job,
            settings: *settings,
            rules: self.rules,
            encoding: plan.encoding,
            origin: plan.origin,
            background: content.background,
            scene: content.scene,
            parts: self.parts,
        };
        let probes: Vec<Probe> = self.numbers.iter().map(|&number| plan.probes[number].clone()).collect();
        // Probes that are known as they are, and their noise.
        let known = Mutex::new(BTreeMap::new());
        let earlier = |index: usize| {
            let (earlier, noise) = memory.earlier(&site, probes[index].position)?;
            if earlier.kept.iter().all(|kept| *kept)
                && let Ok(mut known) = known.lock()
            {
                known.insert(index, noise);
            }
            Some(earlier)
        };
        let scene = &self.loaded.scene;
        bake::rebake_probes(self.tracer, scene, &probes, settings, progress, cancel, &earlier, |index, traced| {
            scene.meshes.check_textures()?;
            // Images are decoded when a ray asks for them, so that an input can change until now.
            content.check(digests)?;
            let known = known.lock().ok().and_then(|known| known.get(&index).copied());
            let noise = known.unwrap_or_else(|| noise_of(self.numbers[index]));
            if known.is_none() {
                memory.put_traced(&site, probes[index].position, &traced, noise);
            }
            sink(self.numbers[index], traced, noise)
        })
    }
}

impl Job {
    /// What the probes' cubemaps are.
    fn bake_settings(&self) -> BakeSettings {
        BakeSettings {
            face_size: self.face_size,
            samples: self.samples,
            distance: self.distance || self.outputs.contains(&OutputKind::Moments),
            edge_texels: false,
        }
    }
}

/// What cubemaps with texels on the edges are.
fn edge_settings(settings: &BakeSettings) -> BakeSettings {
    BakeSettings { samples: settings.samples.next_multiple_of(2), distance: false, edge_texels: true, ..*settings }
}

/// What computes the radiance along the rays of `job`.
pub(crate) fn tracer<'a>(
    job: &Job,
    settings: TraceSettings,
    loaded: &'a Loaded,
    surfaces: &'a dyn Surfaces,
    counters: Option<&'a Counters>,
) -> Box<dyn TileTracer + 'a> {
    if job.calibration {
        return Box::new(Calibration);
    }
    let Loaded { scene, bvh, .. } = loaded;
    match job.tracer {
        Tracer::Beam => Box::new(BeamTracer { counters, ..BeamTracer::new(scene, bvh, surfaces, settings) }),
        Tracer::Ray => Box::new(RayTracer { scene, bvh, surfaces, settings }),
        Tracer::Reference => Box::new(ReferenceTracer { scene, surfaces, settings }),
    }
}
