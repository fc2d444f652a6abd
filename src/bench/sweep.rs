//! Which values of which setting are tried.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::filter::prefilter;
use crate::job::{Footprint, Job, Preset, Surface, Tracer};

/// What a row changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum Axis {
    /// Nothing.
    Base,
    /// What traces.
    Tracer,
    /// Where rays end.
    TCutoff,
    /// How Gaussians are widened.
    Footprint,
    /// Rays per texel.
    Samples,
    /// Texels.
    FaceSize,
    /// Several at once.
    Preset,
    /// How surfaces are lit.
    Surface,
    /// Samples of a prefiltered texel.
    Prefilter,
}

/// A job that is measured, and what sets it apart.
pub(super) struct Variant {
    pub axis: Axis,
    pub label: String,
    pub job: Job,
}

/// The values. Those of the base are left out.
struct Values {
    tracers: &'static [Tracer],
    t_cutoffs: &'static [f32],
    footprints: &'static [Footprint],
    samples: &'static [u32],
    /// Of the base's face size: numerator and denominator. The largest is [`FINEST`].
    face_sizes: &'static [[u32; 2]],
    /// Most paths of a hit, with none ended before.
    paths: &'static [u32],
    /// Of the truth that those are measured against.
    truth_paths: u32,
    prefilter_samples: &'static [u32],
    /// Random texels that `reference` traces.
    rays: usize,
    /// By how much faces are smaller than asked.
    reduction: u32,
}

/// Powers of 2, as the default is: each is a bound of the error.
const FULL: Values = Values {
    tracers: &[Tracer::Beam, Tracer::Ray],
    t_cutoffs: &[0.0, 1.0 / 65536.0, 1.0 / 16384.0, 1.0 / 2048.0, 1.0 / 256.0, 1.0 / 64.0, 1.0 / 16.0],
    footprints: &[Footprint::None, Footprint::Pixel, Footprint::Train(1200.0)],
    samples: &[1, 2, 4, 8],
    face_sizes: &[[1, 8], [1, 4], [1, 2], [1, 1], [FINEST, 1]],
    paths: &[16, 64, 256],
    truth_paths: 4096,
    prefilter_samples: &[256, 512, 1024, 2048, 4096, 8192],
    rays: 512,
    reduction: 1,
};

const QUICK: Values = Values {
    tracers: &[Tracer::Beam, Tracer::Ray],
    t_cutoffs: &[0.0, 1.0 / 2048.0, 1.0 / 256.0, 1.0 / 16.0],
    footprints: &[Footprint::None, Footprint::Pixel],
    samples: &[1, 2, 4],
    face_sizes: &[[1, 4], [1, 2], [1, 1], [FINEST, 1]],
    paths: &[16, 64],
    truth_paths: 1024,
    prefilter_samples: &[512, 2048, 8192],
    rays: 128,
    reduction: 4,
};

/// Texels along an edge of the finest face that is looked at, over the base's.
const FINEST: u32 = 2;

/// Face sizes must be halves of each other down to an eighth, so that a truth serves them all.
const STEP: u32 = 8;

/// The least and the largest face size of the base. At the largest, the truth takes 400 million rays.
const FACE_SIZES: [u32; 2] = [16, 512];

/// A sweep about a job.
pub(super) struct Sweep {
    values: &'static Values,
    base: Job,
}

impl Sweep {
    /// About `job`, whose face size becomes a multiple of 8 from 16 to 512.
    pub fn about(job: &Job, is_quick: bool) -> Self {
        let values = if is_quick { &QUICK } else { &FULL };
        let [least, largest] = FACE_SIZES;
        let face_size = (job.face_size / values.reduction).clamp(least, largest) / STEP * STEP;
        Self { values, base: Job { face_size, ..job.clone() } }
    }

    /// What is varied, with surfaces that are not lit: these are [`Self::light`]'s.
    pub fn base(&self) -> Job {
        Job { surface: Surface::Unlit, ..self.base.clone() }
    }

    /// Texels along an edge of the finest face.
    pub fn finest(&self) -> u32 {
        self.base.face_size * FINEST
    }

    /// Random texels that `reference` traces.
    pub fn rays(&self) -> usize {
        self.values.rays
    }

    /// The base and all that is traced otherwise.
    pub fn tracing(&self) -> Vec<Variant> {
        let (base, values) = (self.base(), self.values);
        let mut variants = vec![Variant { axis: Axis::Base, label: self.base_label().into(), job: base.clone() }];
        let mut add = |axis: Axis, label: String, job: Job| {
            if job != base {
                variants.push(Variant { axis, label, job });
            }
        };
        for &tracer in values.tracers {
            add(Axis::Tracer, format!("tracer {}", tracer_name(tracer)), Job { tracer, ..base.clone() });
        }
        for &t_cutoff in values.t_cutoffs {
            add(Axis::TCutoff, format!("t-cutoff {}", reciprocal(t_cutoff)), Job { t_cutoff, ..base.clone() });
        }
        for &footprint in values.footprints {
            let label = format!("footprint {}", String::from(footprint));
            add(Axis::Footprint, label, Job { footprint, ..base.clone() });
        }
        for &samples in values.samples {
            add(Axis::Samples, format!("samples {samples}"), Job { samples, ..base.clone() });
        }
        for [times, over] in values.face_sizes {
            let face_size = base.face_size * times / over;
            add(Axis::FaceSize, format!("face-size {face_size}"), Job { face_size, ..base.clone() });
        }
        for preset in Preset::ALL {
            let asked = preset.job();
            // As large beside the base as the preset is beside the standard.
            let face_size = base.face_size * asked.face_size / Preset::Standard.job().face_size;
            let Job { samples, footprint, t_cutoff, noise, max_paths, .. } = asked;
            let job = Job { face_size, samples, footprint, t_cutoff, noise, max_paths, ..base.clone() };
            add(Axis::Preset, format!("preset {}", preset_name(preset)), job);
        }
        variants
    }

    /// What the light of surfaces is measured against: as many paths as there are for every hit.
    pub fn light_truth(&self) -> Job {
        Job { surface: Surface::Path, noise: 0.0, max_paths: self.values.truth_paths, ..self.light_base() }
    }

    /// Ways to light surfaces.
    pub fn light(&self) -> Vec<Variant> {
        let base = self.light_base();
        let path = |noise: f32, max_paths: u32| Job { surface: Surface::Path, noise, max_paths, ..base.clone() };
        // Paths that are most of the truth's would err by nothing.
        let truth_paths = self.values.truth_paths;
        let presets = Preset::ALL.into_iter().map(Preset::job).filter(|job| job.max_paths <= truth_paths / 4);
        let presets = presets
            .map(|Job { noise, max_paths, .. }| (format!("surface path, noise {noise}"), path(noise, max_paths)));
        let counts = self.values.paths.iter().map(|&paths| (format!("surface path, {paths} paths"), path(0.0, paths)));
        let others = [("surface unlit", Surface::Unlit), ("surface probe", Surface::Probe)];
        let others = others.map(|(label, surface)| (label.to_owned(), Job { surface, ..base.clone() }));
        let all = others.into_iter().chain(counts).chain(presets);
        all.map(|(label, job)| Variant { axis: Axis::Surface, label, job }).collect()
    }

    /// Samples of a prefiltered texel, the default's among them.
    pub fn prefilter_samples(&self) -> &'static [u32] {
        debug_assert!(self.values.prefilter_samples.contains(&prefilter::SAMPLES));
        self.values.prefilter_samples
    }

    /// Small, because its truth is slow.
    fn light_base(&self) -> Job {
        Job { face_size: (self.base.face_size / 4).max(FACE_SIZES[0]), samples: 1, ..self.base.clone() }
    }

    fn base_label(&self) -> &'static str {
        let standard = Preset::Standard.job();
        let settings = |job: &Job| (job.tracer, job.samples, job.footprint, job.t_cutoff);
        if settings(&self.base) == settings(&standard) { "default" } else { "as asked" }
    }
}

fn tracer_name(tracer: Tracer) -> &'static str {
    match tracer {
        Tracer::Beam => "beam",
        Tracer::Ray => "ray",
        Tracer::Reference => "reference",
    }
}

fn preset_name(preset: Preset) -> &'static str {
    match preset {
        Preset::Draft => "draft",
        Preset::Standard => "standard",
        Preset::Reference => "reference",
    }
}

/// A number from 0 to 1 as people write it.
fn reciprocal(value: f32) -> String {
    let whole = value.recip();
    if value > 0.0 && whole.fract() == 0.0 { format!("1/{whole}") } else { value.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_changes_one_setting_and_the_base_none() {
        let sweep = Sweep::about(&Job::default(), false);
        let base = sweep.base();
        assert_eq!(base, Job::default());
        for variant in sweep.tracing() {
            let Job { tracer, t_cutoff, footprint, samples, face_size, .. } = variant.job;
            let changed = [
                (Axis::Tracer, tracer != base.tracer),
                (Axis::TCutoff, t_cutoff != base.t_cutoff),
                (Axis::Footprint, footprint != base.footprint),
                (Axis::Samples, samples != base.samples),
                (Axis::FaceSize, face_size != base.face_size),
            ];
            if variant.axis != Axis::Preset {
                let expected: Vec<_> = changed.iter().map(|(axis, _)| (*axis, *axis == variant.axis)).collect();
                assert_eq!(changed[..], expected[..], "{}", variant.label);
            }
            assert!(sweep.finest().is_multiple_of(face_size), "{}", variant.label);
        }
        assert!(sweep.tracing().iter().any(|variant| variant.label == "t-cutoff 1/256"));
    }

    #[test]
    fn face_sizes_stay_within_reason_and_are_halves_of_each_other() {
        for (asked, expected) in [(1, 16), (100, 96), (8192, 512)] {
            assert_eq!(Sweep::about(&Job { face_size: asked, ..Job::default() }, false).base().face_size, expected);
        }
        assert_eq!(Sweep::about(&Job::default(), true).base().face_size, 64);
    }
}
