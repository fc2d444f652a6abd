//! Where probes might stand: free places at an even spacing, each judged by what surrounds it.

use glam::{DVec2, DVec3};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::contours::Contours;
use super::free_space::{Reason, Space};
use super::levels::Height;
use super::plan::{Lattice, Plan};
use super::triangulation::Ground;
use crate::trace::ray::RayScratch;

/// Most sites of a placement, about: the spacing doubles until there are fewer. Tracing a site is most of what placement
/// costs.
const MAX_SITES: f64 = 400.0;

/// Least number of cells between sites: half a metre beside a site its probe predicts nearly everything.
const LEAST_STRIDE: i64 = 2;

/// Closed free space smaller than this, in square metres, is the inside of furniture.
const POCKET: f64 = 1.0;

/// Sites are moved off their cell's centre by at most this share of a cell, each by its own fixed amount: points in regular
/// rows have several Delaunay triangulations, and which one comes out must not hang on what is far away.
const JITTER: f64 = 0.01;

/// A place that was considered and left out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Dropped {
    /// The place, in metres.
    #[schemars(with = "[f64; 3]")]
    pub position: DVec3,
    /// Why no probe stands there.
    pub reason: Reason,
}

/// A level's free space and the places in it.
pub struct LevelSites {
    /// The free cells.
    pub plan: Plan,
    /// What is triangulated.
    pub ground: Ground,
    /// Height and storey.
    pub height: Height,
    /// Places where probes may stand.
    pub sites: Vec<DVec3>,
    /// Sites that were moved out of matter.
    pub relocated: usize,
    /// Places that were left out.
    pub dropped: Vec<Dropped>,
}

/// Cells between sites, a power of two, so that `area` square metres hold at most about [`MAX_SITES`].
pub fn stride(cell: f64, area: f64) -> i64 {
    let mut stride = LEAST_STRIDE;
    while area / (stride as f64 * cell).powi(2) > MAX_SITES {
        stride *= 2;
    }
    stride
}

impl LevelSites {
    /// Sorts out which free cells of `plan` lie inside of the scene, and finds the sites. `reach` is more than the scene's
    /// size, in metres.
    pub fn new(space: &Space, mut plan: Plan, height: Height, stride: i64, reach: f64) -> Self {
        let mut dropped = Vec::new();
        let mut sites = Vec::new();
        let mut relocated = 0;
        let blocks = blocks(&plan.lattice, stride);
        // Parts of each block that light joins within it; each is judged by its cell nearest to the block's centre.
        let parts: Vec<Vec<(usize, Vec<usize>)>> = blocks
            .iter()
            .map(|block| {
                let central = |cells: &Vec<usize>| nearest_cell(&plan.lattice, cells, block.centre);
                plan.groups(&block.cells).into_iter().map(|cells| (central(&cells), cells)).collect()
            })
            .collect();
        let judged: Vec<Vec<Result<(), Reason>>> = parts
            .par_iter()
            .map_init(RayScratch::default, |scratch, parts| {
                parts.iter().map(|(cell, _)| space.surroundings(plan.point(*cell), reach, scratch)).collect()
            })
            .collect();
        for (block, (parts, judged)) in blocks.iter().zip(parts.into_iter().zip(judged)) {
            let central = nearest_cell(&plan.lattice, &block.cells, block.centre);
            if parts.is_empty() {
                dropped.push(Dropped { position: plan.point(central), reason: Reason::Matter });
            }
            for ((cell, cells), judgement) in parts.into_iter().zip(judged) {
                match judgement {
                    Ok(()) => sites.push((cell, cell != central)),
                    Err(reason) => {
                        dropped.push(Dropped { position: plan.point(cell), reason });
                        plan.block(&cells);
                    }
                }
            }
        }
        let pockets = pockets(&mut plan);
        sites.retain(|&(cell, moved)| {
            let kept = pockets.binary_search(&cell).is_err();
            if !kept {
                dropped.push(Dropped { position: plan.point(cell), reason: Reason::Pocket });
            }
            relocated += usize::from(kept && moved);
            kept
        });
        let all: Vec<usize> = (0..plan.lattice.cell_count()).collect();
        let groups = plan.groups(&all).iter().map(|group| plan.lattice.centre(group[0])).collect();
        let mut contours = Contours::of(&plan);
        for point in &mut contours.points {
            *point += jitter(*point, plan.lattice.cell);
        }
        let sites = sites.iter().map(|&(cell, _)| {
            let offset = jitter(plan.lattice.centre(cell), plan.lattice.cell);
            plan.point(cell) + DVec3::new(offset.x, 0.0, offset.y)
        });
        Self {
            height,
            sites: sites.collect(),
            relocated,
            dropped,
            ground: Ground::new(height, &contours, groups),
            plan,
        }
    }
}

/// Takes closed free space below [`POCKET`] out of the plan, but never the largest part; returns its cells in order.
fn pockets(plan: &mut Plan) -> Vec<usize> {
    let all: Vec<usize> = (0..plan.lattice.cell_count()).collect();
    let groups = plan.groups(&all);
    let largest = groups.iter().map(Vec::len).max().unwrap_or(0);
    let is_pocket =
        |group: &Vec<usize>| group.len() < largest && (group.len() as f64) * plan.lattice.cell.powi(2) < POCKET;
    let mut cells: Vec<usize> = groups.into_iter().filter(is_pocket).flatten().collect();
    cells.sort_unstable();
    plan.block(&cells);
    cells
}

/// A square of cells.
struct Block {
    centre: DVec2,
    /// In ascending order; never empty.
    cells: Vec<usize>,
}

/// The lattice cut into squares of `stride` cells, which are aligned with the world's zero.
fn blocks(lattice: &Lattice, stride: i64) -> Vec<Block> {
    let spans = [0, 1].map(|axis| {
        let (first, size) = (lattice.first[axis], lattice.size[axis] as i64);
        let range = first.div_euclid(stride)..=(first + size - 1).div_euclid(stride);
        let span = move |block: i64| {
            let low = (block * stride - first).max(0) as usize;
            (block, low..((block + 1) * stride - first).min(size) as usize)
        };
        range.map(span).collect::<Vec<_>>()
    });
    let edge = stride as f64 * lattice.cell;
    let mut blocks = Vec::new();
    for (block_z, rows) in &spans[1] {
        for (block_x, columns) in &spans[0] {
            let cells = rows.clone().flat_map(|z| columns.clone().map(move |x| z * lattice.size[0] + x)).collect();
            // A little off the middle, so that of four cells around it one is nearest.
            let centre = (DVec2::new(*block_x as f64, *block_z as f64) + 0.499) * edge;
            blocks.push(Block { centre, cells });
        }
    }
    blocks
}

fn nearest_cell(lattice: &Lattice, cells: &[usize], point: DVec2) -> usize {
    let distance = |cell: usize| lattice.centre(cell).distance_squared(point);
    cells.iter().copied().min_by(|&a, &b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
}

/// A fixed small offset for a point of the plan.
fn jitter(point: DVec2, cell: f64) -> DVec2 {
    let mut bits = ((point.x / cell * 2.0).round() as i64 as u64) << 32
        ^ ((point.y / cell * 2.0).round() as i64 as u64 & 0xffff_ffff);
    let mut unit = || super::random(&mut bits) - 0.5;
    DVec2::new(unit(), unit()) * 2.0 * JITTER * cell
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Bounds;

    #[test]
    fn a_large_scene_has_as_many_sites_as_a_small_one() {
        assert_eq!(stride(0.25, 42.0), 2);
        assert_eq!(stride(0.25, 336.0), 4);
        assert!(1e12 / (stride(256.0, 1e12) as f64 * 256.0).powi(2) <= MAX_SITES);
    }

    #[test]
    fn blocks_hold_every_cell_once_and_keep_their_places_when_the_bounds_grow() {
        let bounds = |min: f64| Bounds { min: DVec3::new(min, 0.0, -2.3), max: DVec3::new(3.1, 1.0, 2.0) };
        let lattice = Lattice::over(&bounds(-1.3));
        let near = blocks(&lattice, 4);
        let mut cells: Vec<usize> = near.iter().flat_map(|block| block.cells.clone()).collect();
        cells.sort_unstable();
        assert!(cells.into_iter().eq(0..lattice.cell_count()));
        let far = blocks(&Lattice::over(&bounds(-9.1)), 4);
        assert!(near.iter().all(|block| far.iter().any(|other| other.centre == block.centre)));
    }

    #[test]
    fn jitter_is_small_fixed_and_differs_from_point_to_point() {
        let [a, b] = [DVec2::new(0.125, 0.375), DVec2::new(0.375, 0.125)].map(|point| jitter(point, 0.25));
        assert!(a != b && a.length() < 0.25 * 0.02 && a == jitter(DVec2::new(0.125, 0.375), 0.25));
    }
}
