//! What roughness chains cost, and how far they are from every texel under the lobe.

use std::time::Instant;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::report::{Row, RowError, RowSettings, Truth, TruthRecord};
use super::{Axis, Bench};
use crate::compare::compare_colours;
use crate::error::Result;
use crate::filter::cubemap::solid_angles;
use crate::filter::prefilter::RoughnessMip;
use crate::filter::{Prefilter, RgbCubemap, Sampler};
use crate::job::{Job, RoughnessCurve};
use crate::scene::LinearRgb;
use crate::shade::sampling::hash_all;
use crate::trace::Face;

/// Texels of each mip that are compared.
const TEXELS: u32 = 24;

/// Least texels along an edge of what the truth adds up: lobes of the second mip are as wide as a few of them.
const FINE: u32 = 192;

/// Adds the rows of prefiltering the first probe's base cubemap, and their truth.
pub(super) fn measure(bench: &mut Bench) -> Result<()> {
    let base = bench.sweep.base();
    let mips = Job::default().mips;
    let cubemaps = bench.clock.run(|| bench.site.trace(&base))?;
    let Some(source) = cubemaps.into_iter().next() else { return Ok(()) };
    let chain = |samples: u32| Prefilter::new(source.clone()).with_samples(samples).chain(RoughnessCurve::Linear, mips);

    let begun = Instant::now();
    // Samples do not change where mips and texels are; roughness 0 is the source itself.
    let any = chain(1);
    let places: Vec<(usize, usize)> =
        any.iter().enumerate().skip(1).flat_map(|(i, mip)| texels(&mip.cubemap).map(move |texel| (i, texel))).collect();
    let fine = FineSource::new(&source);
    let truth = bench.clock.run(|| Ok(places.par_iter().map(|&(i, texel)| fine.seen(&any[i], texel)).collect()))?;
    let truth: Vec<LinearRgb> = truth;
    let seconds = begun.elapsed().as_secs_f64();
    let description = format!("all texels under the lobe, at {TEXELS} random texels of each mip of a chain of {mips}");
    bench.scene.truths.push(TruthRecord { truth: Truth::Lobe, description, seconds });

    for &samples in bench.sweep.prefilter_samples() {
        let (chain, seconds) = bench.clock.time(|| Ok(chain(samples)))?;
        let found: Vec<LinearRgb> =
            places.iter().map(|&(i, texel)| LinearRgb(chain[i].cubemap.texels()[texel])).collect();
        let norms = compare_colours(&truth, &found);
        let errors = vec![RowError { truth: Truth::Lobe, norms, flip: None, bound: None, on_front: false }];
        let settings = RowSettings::new(&base, samples);
        let label = format!("prefilter {samples}");
        bench.add_row(Row { axis: Axis::Prefilter, label, settings, rays: 0, seconds, errors });
    }
    Ok(())
}

/// Random texels of a mip.
fn texels(mip: &RgbCubemap) -> impl Iterator<Item = usize> + use<> {
    let (size, count) = (mip.size(), mip.texels().len() as u64);
    (0..TEXELS).map(move |i| ((u64::from(hash_all([size, i])) * count) >> 32) as usize)
}

/// A cubemap as a lobe sees it: looked up at the middles of pieces of its texels.
struct FineSource {
    directions: Vec<Vec3>,
    /// Radiance times solid angle, and the solid angle.
    pieces: Vec<(Vec3, f32)>,
}

impl FineSource {
    fn new(source: &RgbCubemap) -> Self {
        let size = source.size() * FINE.div_ceil(source.size());
        let sampler = Sampler::new(source);
        let (angles, n) = (solid_angles(size), size as usize);
        let place = |i: usize| (Face::ALL[i / (n * n)], (i % n) as f64 + 0.5, (i / n % n) as f64 + 0.5);
        let directions: Vec<Vec3> = (0..6 * n * n)
            .into_par_iter()
            .map(|i| {
                let (face, x, y) = place(i);
                face.direction(size, x, y).normalize().as_vec3()
            })
            .collect();
        let piece = |(i, direction): (usize, &Vec3)| {
            let angle = angles[i % (n * n)] as f32;
            (sampler.radiance(*direction) * angle, angle)
        };
        let pieces = directions.par_iter().enumerate().map(piece).collect();
        Self { directions, pieces }
    }

    /// The mean over GGX's lobe for N = V = R around a texel's direction, weighted by the cosine: as
    /// [`Prefilter::specular`] defines it, by its density `D(h) / 4` instead of by samples.
    fn seen(&self, mip: &RoughnessMip, texel: usize) -> LinearRgb {
        let n = mip.cubemap.size() as usize;
        let (face, x, y) = (Face::ALL[texel / (n * n)], texel % n, texel / n % n);
        let normal = face.direction(mip.cubemap.size(), x as f64 + 0.5, y as f64 + 0.5).normalize().as_vec3();
        let alpha_squared = mip.roughness.powi(4);
        let (mut sum, mut total) = (DVec3::ZERO, 0.0);
        for (direction, (light, angle)) in self.directions.iter().zip(&self.pieces) {
            let cosine = f64::from(direction.dot(normal));
            if cosine <= 0.0 {
                continue;
            }
            // 1 at the lobe's axis; what is a hundred-millionth of that adds nothing.
            let half_squared = (1.0 + cosine) / 2.0;
            let lobe = (alpha_squared / (half_squared * (alpha_squared - 1.0) + 1.0)).powi(2) * cosine;
            if lobe > 1e-8 {
                sum += light.as_dvec3() * lobe;
                total += f64::from(*angle) * lobe;
            }
        }
        LinearRgb((sum / total).as_vec3())
    }
}
