//! The plan of a level: which cells of a lattice are free, and which neighbours see each other.
//!
//! The lattice is aligned with the world's axes and with zero, so that what happens far away moves no cell.

use std::collections::VecDeque;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::free_space::Space;
use crate::scene::Bounds;
use crate::trace::ray::RayScratch;

/// Edge of a cell, in metres, where the bounds do not ask for more.
const CELL: f64 = 0.25;

/// Most cells of a plan; larger bounds get larger cells.
const MAX_CELLS: f64 = 32_768.0;

/// A rectangle of square cells in the plan (x, z).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lattice {
    /// Edge of a cell, in metres: a power of two times a quarter.
    pub cell: f64,
    /// The first cell, counted in cells from the world's zero.
    pub first: [i64; 2],
    /// Cells along x and z.
    pub size: [usize; 2],
}

impl Lattice {
    /// Every cell whose centre lies in `bounds`; one cell at least.
    pub fn over(bounds: &Bounds) -> Self {
        let extent = bounds.extent();
        let mut cell = CELL;
        while (extent.x / cell + 1.0) * (extent.z / cell + 1.0) > MAX_CELLS {
            cell *= 2.0;
        }
        let first = |low: f64| (low / cell - 0.5).ceil() as i64;
        let size = |low: f64, high: f64| ((high / cell - 0.5).floor() as i64 - first(low) + 1).max(1) as usize;
        Self {
            cell,
            first: [first(bounds.min.x), first(bounds.min.z)],
            size: [size(bounds.min.x, bounds.max.x), size(bounds.min.z, bounds.max.z)],
        }
    }

    /// How many cells there are; their indices run along x first.
    pub fn cell_count(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// Column and row of cell `index`.
    pub fn at(&self, index: usize) -> [usize; 2] {
        [index % self.size[0], index / self.size[0]]
    }

    /// Centre of cell `index`: x and z, in metres.
    pub fn centre(&self, index: usize) -> DVec2 {
        let [x, z] = self.at(index);
        self.corner([x, z]) + self.cell / 2.0
    }

    /// Corner with the least x and z of the cell at a column and row, which may lie one beyond the last.
    pub fn corner(&self, [x, z]: [usize; 2]) -> DVec2 {
        DVec2::new((self.first[0] + x as i64) as f64, (self.first[1] + z as i64) as f64) * self.cell
    }

    /// The cell that a point of the plan lies in.
    pub fn cell_at(&self, point: DVec2) -> Option<usize> {
        let [x, z] = [0, 1].map(|axis| (point[axis] / self.cell).floor() - self.first[axis] as f64);
        let inside = x >= 0.0 && z >= 0.0 && x < self.size[0] as f64 && z < self.size[1] as f64;
        inside.then(|| z as usize * self.size[0] + x as usize)
    }

    /// The cell beside `index` toward +X (axis 0) or +Z (axis 1).
    pub fn after(&self, index: usize, axis: usize) -> Option<usize> {
        let at = self.at(index)[axis];
        (at + 1 < self.size[axis]).then(|| index + [1, self.size[0]][axis])
    }
}

/// Free cells at one height.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// The cells.
    pub lattice: Lattice,
    /// Height of the level, in metres.
    pub height: f64,
    /// Whether a cell's centre is free.
    pub free: Vec<bool>,
    /// Whether light passes from a cell to the next along +X and +Z; false unless both are free.
    pub open: [Vec<bool>; 2],
}

impl Plan {
    /// Traces the cells of `lattice` at `height`.
    pub fn trace(space: &Space, lattice: Lattice, height: f64) -> Self {
        let point = |index: usize| {
            let centre = lattice.centre(index);
            DVec3::new(centre.x, height, centre.y)
        };
        let cells = (0..lattice.cell_count()).into_par_iter();
        let free: Vec<bool> =
            cells.map_init(RayScratch::default, |scratch, index| space.is_free(point(index), scratch)).collect();
        let open = [0, 1].map(|axis| {
            let cells = (0..lattice.cell_count()).into_par_iter();
            let is_open = |scratch: &mut RayScratch, index: usize| {
                let next = lattice.after(index, axis).filter(|&next| free[index] && free[next]);
                next.is_some_and(|next| space.is_open(point(index), point(next), scratch))
            };
            cells.map_init(RayScratch::default, is_open).collect()
        });
        Self { lattice, height, free, open }
    }

    /// A cell's centre in space.
    pub fn point(&self, index: usize) -> DVec3 {
        let centre = self.lattice.centre(index);
        DVec3::new(centre.x, self.height, centre.y)
    }

    /// Whether light passes between two cells side by side, given in ascending order.
    pub fn passes(&self, index: usize, axis: usize) -> bool {
        self.open[axis][index]
    }

    /// The cells that light reaches from `index` in one step.
    pub fn neighbours(&self, index: usize) -> impl Iterator<Item = usize> + '_ {
        [0, 1].into_iter().flat_map(move |axis| {
            let step = [1, self.lattice.size[0]][axis];
            let before = (self.lattice.at(index)[axis] > 0).then(|| index - step);
            let before = before.filter(|&before| self.open[axis][before]);
            let after = self.open[axis][index].then_some(index + step);
            before.into_iter().chain(after)
        })
    }

    /// Takes cells out.
    pub fn block(&mut self, cells: &[usize]) {
        for &index in cells {
            self.free[index] = false;
            for axis in 0..2 {
                self.open[axis][index] = false;
                if self.lattice.at(index)[axis] > 0 {
                    self.open[axis][index - [1, self.lattice.size[0]][axis]] = false;
                }
            }
        }
    }

    /// Groups of `cells` that light joins within `cells`, each in ascending order, the groups by their first cell. `cells`
    /// must ascend.
    pub fn groups(&self, cells: &[usize]) -> Vec<Vec<usize>> {
        let mut seen = vec![false; cells.len()];
        let mut groups = Vec::new();
        for start in 0..cells.len() {
            if seen[start] || !self.free[cells[start]] {
                continue;
            }
            seen[start] = true;
            let mut group = vec![cells[start]];
            let mut queue = VecDeque::from([cells[start]]);
            while let Some(index) = queue.pop_front() {
                for next in self.neighbours(index) {
                    if let Ok(place) = cells.binary_search(&next)
                        && !seen[place]
                    {
                        seen[place] = true;
                        group.push(next);
                        queue.push_back(next);
                    }
                }
            }
            group.sort_unstable();
            groups.push(group);
        }
        groups
    }

    /// Free square metres.
    pub fn area(&self) -> f64 {
        self.free.iter().filter(|free| **free).count() as f64 * self.lattice.cell.powi(2)
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// A plan drawn with letters: `#` is matter, `|` after a cell a thin wall toward +X, anything else is free.
    pub fn drawn(rows: &[&str]) -> Plan {
        let cells: Vec<Vec<(char, bool)>> = rows
            .iter()
            .map(|row| {
                let mut cells: Vec<(char, bool)> = Vec::new();
                for c in row.chars() {
                    match (c, cells.last_mut()) {
                        ('|', Some(last)) => last.1 = true,
                        _ => cells.push((c, false)),
                    }
                }
                cells
            })
            .collect();
        let size = [cells[0].len(), cells.len()];
        let lattice = Lattice { cell: 0.25, first: [0, 0], size };
        let flat: Vec<(char, bool)> = cells.into_iter().flatten().collect();
        assert_eq!(flat.len(), lattice.cell_count());
        let free: Vec<bool> = flat.iter().map(|cell| cell.0 != '#').collect();
        let open = [0, 1].map(|axis| {
            let passes = |index: usize| {
                let both = lattice.after(index, axis).is_some_and(|next| free[index] && free[next]);
                both && !(axis == 0 && flat[index].1)
            };
            (0..lattice.cell_count()).map(passes).collect()
        });
        Plan { lattice, height: 1.5, free, open }
    }

    #[test]
    fn cells_lie_at_multiples_of_their_edge_wherever_the_bounds_begin() {
        let bounds = |x: f64| Bounds { min: DVec3::new(x, 0.0, -1.1), max: DVec3::new(3.0, 1.0, 1.1) };
        let [near, far] = [-0.3, -7.9].map(|x| Lattice::over(&bounds(x)));
        let centre = near.centre(0);
        assert_eq!(far.cell_at(centre).map(|index| far.centre(index)), Some(centre));
        assert_eq!((centre / near.cell).fract().abs(), DVec2::splat(0.5));
    }

    #[test]
    fn a_continent_has_no_more_cells_than_a_plan_may_hold() {
        let bounds = Bounds { min: DVec3::splat(-1e9), max: DVec3::splat(1e9) };
        assert!(Lattice::over(&bounds).cell_count() <= MAX_CELLS as usize);
        let point = Bounds { min: DVec3::splat(0.1), max: DVec3::splat(0.1) };
        assert_eq!(Lattice::over(&point).cell_count(), 1);
    }

    #[test]
    fn a_thin_wall_parts_two_groups_and_a_blocked_cell_ends_its_links() {
        let mut plan = drawn(&["..|..", "..|..", "##|.."]);
        let all: Vec<usize> = (0..plan.lattice.cell_count()).collect();
        assert_eq!(plan.groups(&all), [vec![0, 1, 4, 5], vec![2, 3, 6, 7, 10, 11]]);
        plan.block(&[6, 7]);
        assert_eq!(plan.groups(&all), [vec![0, 1, 4, 5], vec![2, 3], vec![10, 11]]);
    }
}
