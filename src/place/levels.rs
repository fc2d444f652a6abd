//! Heights at which probes stand: storeys found between floors and ceilings.

use glam::DVec3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::free_space::Space;
use super::plan::Lattice;
use crate::error::{Error, Result};
use crate::scene::Bounds;
use crate::trace::ray::RayScratch;

/// Distance between the points of a column, in metres.
const STEP: f64 = 0.1;

/// How far a column reaches beyond the bounds, in metres: robust bounds may end on the floor itself.
const BEYOND: f64 = 0.5;

/// Most points of a column; higher bounds get longer steps.
const MAX_STEPS: f64 = 512.0;

/// Most columns, about.
const MAX_COLUMNS: f64 = 1024.0;

/// Least height of a storey, in metres; what is lower is a gap between boards.
const LEAST_HEIGHT: f64 = 1.5;

/// Where nothing is above, a storey ends this high, in metres.
const OPEN_HEIGHT: f64 = 3.0;

/// Floors that differ by less belong to one storey, in metres: carpets and steps, not tables.
const SAME_FLOOR: f64 = 0.5;

/// Least share of the columns that stand on a floor which makes a storey of its own.
const LEAST_SHARE: f64 = 0.1;

/// One level serves this much height, in metres.
const LEVEL_HEIGHT: f64 = 3.5;

/// A height at which probes stand, and the storey it belongs to; y, in metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Height {
    /// Where the probes stand.
    pub y: f64,
    /// The storey's floor.
    pub floor: f64,
    /// The storey's ceiling.
    pub ceiling: f64,
}

impl Height {
    /// Whether both belong to one storey.
    pub fn is_same_storey(&self, other: &Self) -> bool {
        self.floor == other.floor && self.ceiling == other.ceiling
    }
}

/// The given heights, ordered, each in the storey that was found around it, else in that of the bounds.
///
/// Fails with [`Error::Request`] when a height is outside `bounds`.
pub fn given(heights: &[f64], storeys: &[[f64; 2]], bounds: &Bounds) -> Result<Vec<Height>> {
    let mut levels = Vec::new();
    for &y in heights {
        if !(bounds.min.y..=bounds.max.y).contains(&y) {
            let why = format!("{y} lies outside the bounds, which reach from {} to {}", bounds.min.y, bounds.max.y);
            return Err(Error::request("--levels", why));
        }
        let storey = storeys.iter().find(|[floor, ceiling]| (*floor..=*ceiling).contains(&y));
        let [floor, ceiling] = storey.copied().unwrap_or([bounds.min.y, bounds.max.y]);
        levels.push(Height { y, floor, ceiling });
    }
    levels.sort_by(|a, b| a.y.total_cmp(&b.y));
    levels.dedup_by(|a, b| a.y == b.y);
    Ok(levels)
}

/// Levels spread evenly in each storey: one per [`LEVEL_HEIGHT`] metres.
pub fn spread(storeys: &[[f64; 2]]) -> Vec<Height> {
    let levels = storeys.iter().flat_map(|&[floor, ceiling]| {
        let count = ((ceiling - floor) / LEVEL_HEIGHT).ceil().max(1.0);
        let height = move |i: usize| floor + (ceiling - floor) * (i as f64 + 0.5) / count;
        (0..count as usize).map(move |i| Height { y: height(i), floor, ceiling })
    });
    levels.collect()
}

/// Floor and ceiling of every storey, from the lowest up: what most columns through the plan agree on.
pub fn storeys(space: &Space, lattice: &Lattice, bounds: &Bounds) -> Vec<[f64; 2]> {
    // A column for every square metre is enough to find a floor, and in large scenes fewer are.
    let mut stride = (1.0 / lattice.cell).round().max(1.0) as i64;
    while lattice.cell_count() as f64 / (stride * stride) as f64 > MAX_COLUMNS {
        stride *= 2;
    }
    let is_column = |index: &usize| {
        let at = lattice.at(*index);
        (0..2).all(|axis| (lattice.first[axis] + at[axis] as i64).rem_euclid(stride) == stride / 2)
    };
    let mut columns: Vec<usize> = (0..lattice.cell_count()).filter(is_column).collect();
    if columns.is_empty() {
        columns = (0..lattice.cell_count()).collect();
    }
    let runs = columns.par_iter().map_init(RayScratch::default, |scratch, &index| {
        let at = lattice.centre(index);
        column(space, DVec3::new(at.x, 0.0, at.y), bounds, scratch)
    });
    agreed(runs.flatten().collect())
}

/// Runs of open height above something in one column.
fn column(space: &Space, at: DVec3, bounds: &Bounds, scratch: &mut RayScratch) -> Vec<[f64; 2]> {
    let (low, high) = (bounds.min.y - BEYOND, bounds.max.y + BEYOND);
    let step = ((high - low) / MAX_STEPS).max(STEP);
    let steps = ((high - low) / step) as usize;
    let mut runs = Vec::new();
    // The run's beginning; none before a floor has been met.
    let mut begun: Option<f64> = None;
    for i in 0..steps {
        let y = low + step * i as f64;
        if space.is_open(at.with_y(y), at.with_y(y + step), scratch) {
            continue;
        }
        runs.extend(begun.filter(|begun| y - begun >= LEAST_HEIGHT).map(|begun| [begun, y]));
        begun = Some(y + step);
    }
    // Under the open sky.
    let end = begun.map(|begun| high.min(begun + OPEN_HEIGHT));
    runs.extend(begun.zip(end).filter(|(begun, end)| end - begun >= LEAST_HEIGHT).map(|(begun, end)| [begun, end]));
    runs
}

/// Storeys by agreement: the floor that most runs stand on takes those within [`SAME_FLOOR`], and so on with the rest.
fn agreed(mut runs: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    let least = (LEAST_SHARE * runs.len() as f64).max(1.0) as usize;
    let mut storeys: Vec<[f64; 2]> = Vec::new();
    while !runs.is_empty() {
        runs.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        let window = |start: usize| runs[start..].partition_point(|run| run[0] < runs[start][0] + SAME_FLOOR);
        let (start, count) = (0..runs.len())
            .map(|start| (start, window(start)))
            .max_by_key(|&(start, n)| (n, usize::MAX - start))
            .unwrap_or((0, 0));
        if count < least {
            break;
        }
        let taken: Vec<[f64; 2]> = runs.drain(start..start + count).collect();
        let mut ceilings: Vec<f64> = taken.iter().map(|run| run[1]).collect();
        ceilings.sort_by(f64::total_cmp);
        let storey = [taken[count / 2][0], ceilings[count / 2]];
        // What stands on tables reaches into a storey that is known.
        if storeys.iter().all(|known| storey[1] <= known[0] || storey[0] >= known[1]) {
            storeys.push(storey);
        }
    }
    storeys.sort_by(|a, b| a[0].total_cmp(&b[0]));
    storeys
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn storeys_are_what_most_columns_agree_on() {
        let mut runs = vec![[0.0, 2.5]; 20];
        // A table, a second storey, and a stray.
        runs.extend([[0.75, 2.5]; 5]);
        runs.extend([[3.0, 5.5]; 12]);
        runs.push([7.0, 9.0]);
        assert_eq!(agreed(runs), [[0.0, 2.5], [3.0, 5.5]]);
        assert_eq!(agreed(Vec::new()), [[0.0; 2]; 0]);
        assert_eq!(agreed(vec![[1.0, 3.0]]), [[1.0, 3.0]]);
    }

    #[test]
    fn a_room_has_one_level_in_its_middle_and_a_hall_several() {
        let heights = |storeys: &[[f64; 2]]| spread(storeys).iter().map(|level| level.y).collect::<Vec<_>>();
        assert_eq!(heights(&[[0.0, 2.5]]), [1.25]);
        assert_eq!(heights(&[[0.0, 2.5], [3.0, 12.0]]), [1.25, 4.5, 7.5, 10.5]);
        assert_eq!(heights(&[]), [0.0; 0]);
    }

    #[test]
    fn given_levels_are_ordered_and_must_lie_in_the_bounds() {
        let bounds = Bounds { min: DVec3::ZERO, max: DVec3::splat(4.0) };
        let levels = given(&[3.5, 1.0, 3.5], &[[0.2, 2.4]], &bounds).unwrap();
        assert_eq!(levels[0], Height { y: 1.0, floor: 0.2, ceiling: 2.4 });
        assert_eq!(levels[1], Height { y: 3.5, floor: 0.0, ceiling: 4.0 });
        assert_eq!(levels.len(), 2);
        let error = given(&[4.5], &[], &bounds).unwrap_err();
        assert!(error.to_string().starts_with("--levels: 4.5 lies outside the bounds"), "{error}");
    }
}
