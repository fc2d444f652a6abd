//! What lit surfaces cost, and how far they are from many paths.
//!
//! Paths of a row are the first of the truth's, so that the error of N paths against M is understated by the factor
//! sqrt(1 - N / M): 3 % at a sixteenth, 13 % at a quarter, which is the most that is tried.

use std::time::Instant;

use super::Bench;
use super::report::{Row, RowSettings, Truth, TruthRecord};
use super::sweep::Variant;
use super::tracing::image_error;
use crate::error::Result;
use crate::filter::prefilter;

/// Adds the rows of lit surfaces, and their truth; none for a scene without meshes.
pub(super) fn measure(bench: &mut Bench) -> Result<()> {
    if bench.scene.triangles == 0 {
        return Ok(());
    }
    let job = bench.sweep.light_truth();
    let description = format!("surfaces by {} paths for every hit, at {} px", job.max_paths, job.face_size);
    bench.say(&format!("truth: {description}"));
    let begun = Instant::now();
    let truth = bench.clock.run(|| bench.site.trace(&job))?;
    let seconds = begun.elapsed().as_secs_f64();
    bench.scene.truths.push(TruthRecord { truth: Truth::Light, description, seconds });
    for Variant { axis, label, job } in bench.sweep.light() {
        let (cubemaps, seconds) = bench.clock.time(|| bench.site.trace(&job))?;
        let errors = vec![image_error(Truth::Light, &truth, &cubemaps)?];
        let settings = RowSettings::new(&job, prefilter::SAMPLES);
        let rays = 6 * u64::from(job.face_size).pow(2) * bench.site.probes.len() as u64;
        bench.add_row(Row { axis, label, settings, rays, seconds, errors });
    }
    Ok(())
}
