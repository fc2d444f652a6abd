//! What was read: the answer of `inspect`, and the inputs of the manifest.

use std::ops::Range;
use std::path::PathBuf;

use glam::DVec3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::gltf::MeshReport;
use super::sanitize::Dropped;
use crate::job::{Frame, Order};
use crate::scene::bounds::{Bounds, robust_bounds};
use crate::scene::sh::coefficient_count;
use crate::scene::{SplatEncoding, Splats};

/// What a splat input holds and how it was understood.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub struct SplatReport {
    /// The file, as the request names it.
    pub path: PathBuf,
    /// All files that were read for it.
    #[serde(skip)]
    pub files: Vec<PathBuf>,
    /// Format and variant.
    pub format: String,
    /// Gaussians in the file.
    pub count: u64,
    /// Gaussians in the scene.
    pub kept: u64,
    /// The others, by reason.
    pub dropped: Dropped,
    /// Spherical harmonics degree in the file.
    pub sh_degree: u8,
    /// Highest band that any kept Gaussian uses; bands that are zero everywhere are not stored.
    pub sh_degree_used: u8,
    /// Mean square of what each band adds to a colour, from band 0 to [`Self::sh_degree_used`]: over all directions, kept
    /// Gaussians and channels.
    pub sh_energy: Vec<f64>,
    /// What the colours mean, as asked or by the format's default.
    pub encoding: SplatEncoding,
    /// What the file's axes point at, as asked or by the format's default.
    pub frame: Frame,
    /// The blending order that the file asks for.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub order: Option<Order>,
    /// Box of the kept means, in world metres.
    pub bounds: Bounds,
    /// The box that most kept means fill, without outliers, in world metres.
    pub robust_bounds: Bounds,
    /// Peak opacities of the kept Gaussians, 0 to 1.
    pub opacity: Quantiles,
    /// Largest standard deviation of each kept Gaussian, in world metres.
    pub scale: Quantiles,
}

/// What all inputs of a scene hold.
#[derive(Debug, Default, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub struct SceneReport {
    /// One per splat input, in their order; then one per mesh input whose file holds splats that no splat input names.
    pub splats: Vec<SplatReport>,
    /// One per mesh input, in their order; then one per splat input whose file holds meshes that no mesh input names.
    pub meshes: Vec<MeshReport>,
}

impl SceneReport {
    /// The box that most of the scene fills, in world metres; `None` for a scene without anything in it.
    ///
    /// The Gaussians decide: meshes stand among them, and a backdrop must not stretch the box. Without any, the meshes do.
    pub fn robust_bounds(&self) -> Option<Bounds> {
        let splats = self.splats.iter().map(|report| report.robust_bounds).reduce(|a, b| a.union(&b));
        splats.or_else(|| self.mesh_bounds())
    }

    /// The blending order that the splat files ask for: those that ask for one agree.
    pub fn order(&self) -> Option<Order> {
        let mut asked = self.splats.iter().filter_map(|report| report.order);
        let first = asked.next()?;
        asked.all(|order| order == first).then_some(first)
    }

    /// The box of all meshes, in world metres.
    pub(super) fn mesh_bounds(&self) -> Option<Bounds> {
        self.meshes.iter().filter_map(|report| report.bounds).reduce(|a, b| a.union(&b))
    }
}

/// A distribution by its percentiles: the value that so many per cent of the Gaussians do not exceed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub struct Quantiles {
    /// 1 %.
    pub p1: f64,
    /// 10 %.
    pub p10: f64,
    /// 50 %: the median.
    pub p50: f64,
    /// 90 %.
    pub p90: f64,
}

/// At most this many Gaussians decide a distribution, taken at a fixed stride.
const SAMPLES: usize = 1 << 18;

impl Quantiles {
    /// Percentiles by nearest rank; `None` without values.
    fn of(mut values: Vec<f64>) -> Option<Self> {
        let last = values.len().checked_sub(1)?;
        // From the highest on, each among the values up to the one before it.
        let mut end = values.len();
        let [p90, p50, p10, p1] = [0.9, 0.5, 0.1, 0.01].map(|share| {
            let rank = (last as f64 * share).round() as usize;
            let (_, &mut value, _) = values[..end].select_nth_unstable_by(rank, f64::total_cmp);
            end = rank + 1;
            value
        });
        Some(Self { p1, p10, p50, p90 })
    }
}

/// What a report derives from the Gaussians kept.
pub(super) struct Statistics {
    pub bounds: Bounds,
    pub robust_bounds: Bounds,
    pub opacity: Quantiles,
    pub scale: Quantiles,
    pub sh_energy: Vec<f64>,
}

impl Statistics {
    /// Of the Gaussians in `range`, with positions relative to `origin`; `None` when there are none.
    pub fn of(splats: &Splats, range: Range<usize>, origin: DVec3) -> Option<Self> {
        let means = &splats.means[range.clone()];
        let stride = range.len().div_ceil(SAMPLES).max(1);
        let sampled = || (0..range.len().div_ceil(stride)).into_par_iter().map(|i| range.start + i * stride);
        let opacities = || sampled().map(|i| f64::from(splats.opacities[i])).collect();
        let scales = || sampled().map(|i| splats.standard_deviations(i).max_element()).collect();
        let ((bounds, robust_bounds), (opacity, scale)) = rayon::join(
            || (Bounds::of(means.iter().map(|mean| mean.as_dvec3())), robust_bounds(means)),
            || rayon::join(|| Quantiles::of(opacities()), || Quantiles::of(scales())),
        );
        Some(Self {
            bounds: bounds?.translated(origin),
            robust_bounds: robust_bounds?.translated(origin),
            opacity: opacity?,
            scale: scale?,
            sh_energy: sh_energy(splats, range, stride),
        })
    }
}

/// Gaussians whose energies are summed one after another: the sums do not depend on how many threads share them.
const ENERGY_CHUNK: usize = 4096;

/// Mean over Gaussians and channels of each band's mean square over directions. The basis is orthonormal, so that the
/// latter is the sum of the band's squared coefficients over the sphere's area.
fn sh_energy(splats: &Splats, range: Range<usize>, stride: usize) -> Vec<f64> {
    let count = range.len().div_ceil(stride);
    let bands = || vec![0.0; usize::from(splats.sh_degree) + 1];
    let chunks = (0..count).into_par_iter().step_by(ENERGY_CHUNK);
    let sums = chunks.map(|first| {
        let mut energy = bands();
        for i in first..count.min(first + ENERGY_CHUNK) {
            let coefficients = splats.sh_of(range.start + i * stride);
            for channel in coefficients.chunks_exact(coefficient_count(splats.sh_degree)) {
                for (l, band) in energy.iter_mut().enumerate() {
                    let coefficients = &channel[l * l..(l + 1) * (l + 1)];
                    *band += coefficients.iter().map(|&c| f64::from(c) * f64::from(c)).sum::<f64>();
                }
            }
        }
        energy
    });
    let sums: Vec<Vec<f64>> = sums.collect();
    let divisor = 3.0 * count as f64 * 4.0 * std::f64::consts::PI;
    let mut energy = bands();
    for sum in sums {
        energy.iter_mut().zip(sum).for_each(|(energy, sum)| *energy += sum / divisor);
    }
    energy
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn energy_of_a_band_is_its_mean_square_over_directions() {
        let mut splats = Splats { means: vec![Default::default(); 2], sh_degree: 1, ..Splats::default() };
        splats.sh = vec![0.0; 24];
        // Red of the first Gaussian: 3 Y_00 + 2 Y_10.
        (splats.sh[0], splats.sh[2]) = (3.0, 2.0);
        let area = 4.0 * std::f64::consts::PI;
        assert_eq!(sh_energy(&splats, 0..2, 1), [9.0 / (6.0 * area), 4.0 / (6.0 * area)]);
    }

    #[test]
    fn quantiles_of_0_to_100_are_their_percentages() {
        let values = (0..=100).rev().map(f64::from).collect();
        assert_eq!(Quantiles::of(values), Some(Quantiles { p1: 1.0, p10: 10.0, p50: 50.0, p90: 90.0 }));
        assert_eq!(Quantiles::of(Vec::new()), None);
        assert_eq!(Quantiles::of(vec![7.0]), Some(Quantiles { p1: 7.0, p10: 7.0, p50: 7.0, p90: 7.0 }));
    }
}
