//! What tracers and their settings cost and lose, with surfaces that are not lit.
//!
//! The area truth is traced by `beam` nearly without a cut-off; how far that is from `reference` is the row of `t-cutoff 0`.
//! It is found once, at the finest face size: an area of a coarser texel is the mean of those in it.

use std::time::Instant;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::Bench;
use super::report::{Row, RowError, RowSettings, Truth, TruthRecord};
use super::site::Site;
use super::sweep::Variant;
use crate::compare::{ErrorNorms, ImageError, compare_colours, compare_cubemaps};
use crate::error::Result;
use crate::filter::{RgbCubemap, Sampler, prefilter};
use crate::job::{Footprint, Job, Tracer};
use crate::scene::LinearRgb;
use crate::shade::sampling::hash_all;
use crate::trace::{Face, Radiance, Tile, TileTracer};

/// Rays along an edge of a texel of the finest faces of the area truth: twice as many of a texel of the base's.
const SAMPLES: u32 = 8;

/// Transmittance at which the area truth's rays end. What that leaves out, at most a millionth of a colour, is far below what
/// any area errs by; following every ray through all walls to the end of the scene would take several times as long.
const T_CUTOFF: f32 = 1.0 / (1 << 20) as f32;

/// Another seed, other random texels.
const SEED: u32 = 9;

/// Adds the rows of all that is traced, and their truths.
pub(super) fn measure(bench: &mut Bench) -> Result<()> {
    let base = bench.sweep.base();
    // Memory is touched and caches are filled before anything is timed.
    bench.clock.run(|| bench.site.trace(&base))?;
    let mut rays = Rays::new(bench.site, &base, bench.sweep.rays());
    let areas = Areas::trace(bench, &base)?;
    let base_areas = areas.of(base.face_size)?;
    for Variant { axis, label, job } in bench.sweep.tracing() {
        let (cubemaps, seconds) = bench.clock.time(|| bench.site.trace(&job))?;
        let mut errors = Vec::new();
        if job.samples == 1 && job.face_size == base.face_size {
            errors.push(rays.error(bench, &job, &cubemaps)?);
        }
        if job.face_size == base.face_size {
            errors.push(image_error(Truth::Area, &base_areas, &cubemaps)?);
        }
        let shown: Vec<RgbCubemap> = cubemaps.iter().map(|cubemap| looked_up(cubemap, areas.size)).collect();
        errors.push(image_error(Truth::Image, &areas.cubemaps, &shown)?);
        let settings = RowSettings::new(&job, prefilter::SAMPLES);
        let edge = u64::from(job.face_size * job.samples);
        let rays = 6 * edge * edge * bench.site.probes.len() as u64;
        bench.add_row(Row { axis, label, settings, rays, seconds, errors });
    }
    rays.describe(bench);
    Ok(())
}

/// The error of cubemaps of all probes, pooled.
pub(super) fn image_error(truth: Truth, expected: &[RgbCubemap], found: &[RgbCubemap]) -> Result<RowError> {
    let pairs = expected.par_iter().zip(found);
    let errors: Vec<ImageError> =
        pairs.map(|(expected, found)| compare_cubemaps(expected, found)).collect::<Result<_>>()?;
    let share = 1.0 / errors.len() as f64;
    let norms = ErrorNorms::pooled(errors.iter().map(|error| error.display), &vec![share; errors.len()]);
    let flip = errors.iter().map(|error| error.flip * share).sum();
    Ok(RowError { truth, norms, flip: Some(flip), bound: None, on_front: false })
}

/// What random texels' rays see by `reference`, which depends on nothing but how Gaussians are widened.
struct Rays {
    /// Probe, and number of the texel in its cubemap.
    texels: Vec<(usize, usize)>,
    known: Vec<(Footprint, Vec<LinearRgb>)>,
    seconds: f64,
}

impl Rays {
    fn new(site: &Site, base: &Job, count: usize) -> Self {
        let all = 6 * u64::from(base.face_size).pow(2);
        let number = |i: usize| (u64::from(hash_all([SEED, i as u32])) * all) >> 32;
        let texels = (0..count).map(|i| (i % site.probes.len(), number(i) as usize)).collect();
        Self { texels, known: Vec::new(), seconds: 0.0 }
    }

    fn error(&mut self, bench: &Bench, job: &Job, cubemaps: &[RgbCubemap]) -> Result<RowError> {
        let known = match self.known.iter().position(|(footprint, _)| *footprint == job.footprint) {
            Some(known) => known,
            None => {
                let begun = Instant::now();
                let seen = bench.clock.run(|| self.trace(bench.site, job))?;
                self.seconds += begun.elapsed().as_secs_f64();
                self.known.push((job.footprint, seen));
                self.known.len() - 1
            }
        };
        let found: Vec<LinearRgb> =
            self.texels.iter().map(|&(probe, texel)| LinearRgb(cubemaps[probe].texels()[texel])).collect();
        let norms = compare_colours(&self.known[known].1, &found);
        let bound = Some(f64::from(job.t_cutoff));
        Ok(RowError { truth: Truth::Ray, norms, flip: None, bound, on_front: false })
    }

    fn trace(&self, site: &Site, job: &Job) -> Result<Vec<LinearRgb>> {
        let job = Job { tracer: Tracer::Reference, ..job.clone() };
        let (scene, origins) = (&site.loaded.scene, site.origins());
        let size = job.face_size as usize;
        let seen = |tracer: &dyn TileTracer, (probe, texel): (usize, usize)| {
            let (x, y) = ((texel % size) as i32, (texel / size % size) as i32);
            let face = Face::ALL[texel / (size * size)];
            let tile = Tile { face, face_size: job.face_size, x, y, width: 1, height: 1 };
            let mut radiance = [Radiance::default()];
            tracer.trace_tile(origins[probe], &tile, &mut radiance);
            radiance[0].to_linear(scene.encoding, scene.background_along(tile.direction(0, 0)))
        };
        site.with_tracer(&job, |tracer| {
            Ok(self.texels.par_iter().with_max_len(1).map(|&place| seen(tracer, place)).collect())
        })
    }

    fn describe(&self, bench: &mut Bench) {
        let description = format!("reference tracer along the rays of {} random texels", self.texels.len());
        bench.scene.truths.insert(0, TruthRecord { truth: Truth::Ray, description, seconds: self.seconds });
    }
}

/// What texels see as areas.
struct Areas {
    /// Texels along an edge of a face.
    size: u32,
    /// One per probe.
    cubemaps: Vec<RgbCubemap>,
}

impl Areas {
    fn trace(bench: &mut Bench, base: &Job) -> Result<Self> {
        let (size, samples) = (bench.sweep.finest(), SAMPLES);
        bench.say(&format!("truth: {size} px, {samples} x {samples} rays per texel"));
        let tracer = Tracer::Beam;
        let footprint = Footprint::None;
        let job = Job { face_size: size, samples, t_cutoff: T_CUTOFF, tracer, footprint, ..base.clone() };
        let begun = Instant::now();
        let cubemaps = bench.clock.run(|| bench.site.trace(&job))?;
        let seconds = begun.elapsed().as_secs_f64();
        let rays = samples * size / base.face_size;
        let area = format!("texels of {} px faces as areas: {rays} x {rays} rays each", base.face_size);
        let image = format!("texels of {size} px faces as areas, looked up: {samples} x {samples} rays each");
        for (truth, description) in [(Truth::Area, area), (Truth::Image, image)] {
            bench.scene.truths.push(TruthRecord { truth, description, seconds });
        }
        Ok(Self { size, cubemaps })
    }

    /// For faces of `size` texels, of which the finest have a multiple.
    fn of(&self, size: u32) -> Result<Vec<RgbCubemap>> {
        self.cubemaps.iter().map(|cubemap| averaged(cubemap, (self.size / size) as usize)).collect()
    }
}

/// Means of squares of `factor` texels: of their rays, as a bake with more samples forms them.
fn averaged(cubemap: &RgbCubemap, factor: usize) -> Result<RgbCubemap> {
    let from = cubemap.size() as usize;
    let size = from / factor;
    let texel = |i: usize| {
        let (face, y, x) = (&cubemap.texels()[i / (size * size) * from * from..], i / size % size, i % size);
        let block = (0..factor * factor).map(|k| face[(y * factor + k / factor) * from + x * factor + k % factor]);
        (block.map(Vec3::as_dvec3).sum::<DVec3>() / (factor * factor) as f64).as_vec3()
    };
    RgbCubemap::new(size as u32, (0..6 * size * size).into_par_iter().map(texel).collect())
}

/// What a look-up in `cubemap` finds at the texels of faces of `size`.
fn looked_up(cubemap: &RgbCubemap, size: u32) -> RgbCubemap {
    if cubemap.size() == size {
        return cubemap.clone();
    }
    let sampler = Sampler::new(cubemap);
    RgbCubemap::from_fn(size, |direction| sampler.radiance(direction.as_vec3()))
}
