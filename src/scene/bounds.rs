//! Boxes around points: exact, and robust against outliers.

use glam::{DVec3, Vec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// An axis-aligned box, in metres; the module that holds it says in which space.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Bounds {
    /// Least x, y, z.
    #[schemars(with = "[f64; 3]")]
    pub min: DVec3,
    /// Greatest x, y, z.
    #[schemars(with = "[f64; 3]")]
    pub max: DVec3,
}

/// At most this many points decide robust bounds.
const SAMPLES: usize = 1 << 18;

/// Share of the points that may lie outside at each end of each axis.
const TAIL: f64 = 0.01;

/// Widening at each end, as a share of the extent between the quantiles. Points spread evenly reach 1/98 further than
/// their quantiles; captures thin out, so that a little more is kept.
const MARGIN: f64 = 0.05;

impl Bounds {
    /// The box of all `points`; `None` when there are none.
    pub fn of(points: impl IntoIterator<Item = DVec3>) -> Option<Self> {
        points.into_iter().fold(None, |bounds: Option<Self>, point| {
            let bounds = bounds.unwrap_or(Self { min: point, max: point });
            Some(Self { min: bounds.min.min(point), max: bounds.max.max(point) })
        })
    }

    /// The middle.
    pub fn centre(&self) -> DVec3 {
        (self.min + self.max) / 2.0
    }

    /// Edge lengths.
    pub fn extent(&self) -> DVec3 {
        self.max - self.min
    }

    /// Whether `point` lies in the box or on its surface.
    pub fn contains(&self, point: DVec3) -> bool {
        point.cmpge(self.min).all() && point.cmple(self.max).all()
    }

    /// The box of both.
    pub fn union(&self, other: &Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// The same box moved by `offset`.
    pub fn translated(&self, offset: DVec3) -> Self {
        Self { min: self.min + offset, max: self.max + offset }
    }
}

/// The box that most of `points` fill, however far a few lie: per axis the 1st and 99th percentile, widened by 5 % of
/// their distance but not beyond the points themselves. `None` when there are no points.
///
/// Points must be finite. Below 100 points nothing counts as an outlier. At most about a quarter of a million points
/// at a fixed stride are looked at, so the answer is deterministic and the time linear.
pub fn robust_bounds(points: &[Vec3]) -> Option<Bounds> {
    let stride = points.len().div_ceil(SAMPLES).max(1);
    let sampled: Vec<Vec3> = points.iter().copied().step_by(stride).collect();
    let last = sampled.len().checked_sub(1)?;
    let tail = (last as f64 * TAIL) as usize;
    let range = |axis: usize| {
        let mut values: Vec<f32> = sampled.iter().map(|point| point[axis]).collect();
        let (below, &mut low, rest) = values.select_nth_unstable_by(tail, f32::total_cmp);
        let least = below.iter().copied().fold(low, f32::min);
        // Counted from `rest` on, which lacks what is below and the lower end itself.
        let (high, greatest) = match (last - tail).checked_sub(tail + 1) {
            Some(high) => {
                let (_, &mut high, above) = rest.select_nth_unstable_by(high, f32::total_cmp);
                (high, above.iter().copied().fold(high, f32::max))
            }
            None => (low, low),
        };
        let [least, low, high, greatest] = [least, low, high, greatest].map(f64::from);
        let margin = (high - low) * MARGIN;
        ((low - margin).max(least), (high + margin).min(greatest))
    };
    let (x, (y, z)) = rayon::join(|| range(0), || rayon::join(|| range(1), || range(2)));
    Some(Bounds { min: DVec3::new(x.0, y.0, z.0), max: DVec3::new(x.1, y.1, z.1) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_points_have_no_bounds() {
        assert_eq!(robust_bounds(&[]), None);
        assert_eq!(Bounds::of([]), None);
    }

    #[test]
    fn one_point_is_its_own_box() {
        let expected = Bounds { min: DVec3::new(1.0, 2.0, 3.0), max: DVec3::new(1.0, 2.0, 3.0) };
        assert_eq!(robust_bounds(&[Vec3::new(1.0, 2.0, 3.0)]), Some(expected));
    }

    #[test]
    fn points_without_outliers_keep_their_full_box() {
        let points: Vec<Vec3> =
            (0..10_000).map(|i| Vec3::new(i as f32, (i * 7 % 10_000) as f32, -(i as f32) / 2.0)).collect();
        let full = Bounds::of(points.iter().map(|point| point.as_dvec3()));
        assert_eq!(robust_bounds(&points), full);
    }

    #[test]
    fn half_a_percent_of_outliers_at_a_million_kilometres_does_not_stretch_the_box() {
        let mut points: Vec<Vec3> = (0..10_000).map(|i| Vec3::splat(i as f32 / 10_000.0)).collect();
        points.iter_mut().step_by(200).for_each(|point| *point = Vec3::splat(1e9));
        let bounds = robust_bounds(&points).expect("points");
        assert!(bounds.min.min_element() >= 0.0 && bounds.max.max_element() < 1.1, "{bounds:?}");
    }
}
