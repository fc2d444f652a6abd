//! Influence boxes, for engines that know no triangulation.

use glam::{DVec2, DVec3};

use super::triangulation::{Level, Share};
use crate::scene::Bounds;

/// A probe's influence box and its blend distances in the order +X -X +Y -Y +Z -Z, in metres.
pub type Influence = (Bounds, [f64; 6]);

/// One box per probe: it holds every triangle in which the probe is a corner's heaviest, grown by `margin` metres in the plan for
/// what lies between the triangles' border and the walls, and reaches to the neighbouring levels' heights, the outermost to
/// `bounds`. So every free position lies in a box. Levels come from the lowest up.
///
/// Toward a side on which a probe shares triangles with another, its weight rises from the side to the probe itself; other
/// sides, and those of lone levels, end at once.
pub fn influences(probes: &[DVec3], levels: &[Level], margin: f64, bounds: &Bounds) -> Vec<Influence> {
    let mut influences: Vec<Influence> =
        probes.iter().map(|&position| (Bounds { min: position, max: position }, [0.0; 6])).collect();
    for (index, level) in levels.iter().enumerate() {
        let (low, high) = heights(levels, index, bounds);
        for triangle in &level.triangles {
            let corners = triangle.map(|vertex| &level.vertices[vertex as usize]);
            // Of a border's blend the heaviest: a probe's box need not hold all that it adds a little to.
            let heaviest = |a: &&Share, b: &&Share| a.weight.total_cmp(&b.weight).then(b.probe.cmp(&a.probe));
            let parts = || {
                corners
                    .iter()
                    .filter_map(|vertex| vertex.blend.iter().max_by(heaviest))
                    .map(|share| share.probe as usize)
            };
            for probe in parts() {
                let (influence, blend) = &mut influences[probe];
                for corner in corners {
                    let at = |y: f64| DVec3::new(corner.position.x, y, corner.position.y);
                    influence.min = influence.min.min(at(low) - DVec3::new(margin, 0.0, margin));
                    influence.max = influence.max.max(at(high) + DVec3::new(margin, 0.0, margin));
                }
                let own = DVec2::new(probes[probe].x, probes[probe].z);
                for other in parts().filter(|&other| other != probe) {
                    let offset = DVec2::new(probes[other].x, probes[other].z) - own;
                    // Marked here, measured below, once the box is known.
                    for (side, along) in [(0, offset.x), (1, -offset.x), (4, offset.y), (5, -offset.y)] {
                        if along > 0.0 {
                            blend[side] = 1.0;
                        }
                    }
                }
            }
        }
    }
    for ((influence, blend), position) in influences.iter_mut().zip(probes) {
        let reached = |y: f64| influence.min.y <= y && y <= influence.max.y;
        let level_at = |beyond: fn(&f64, &f64) -> bool| {
            f64::from(levels.iter().map(|level| level.height.y).any(|y| reached(y) && beyond(&y, &position.y)) as u8)
        };
        (blend[2], blend[3]) = (level_at(f64::gt), level_at(f64::lt));
        let (up, down) = (influence.max - *position, *position - influence.min);
        let depth = [up.x, down.x, up.y, down.y, up.z, down.z];
        blend.iter_mut().zip(depth).for_each(|(blend, depth)| *blend *= depth);
    }
    influences
}

/// From the level below to the level above; between storeys to the middle of the slab, and the outermost to the bounds.
fn heights(levels: &[Level], index: usize, bounds: &Bounds) -> (f64, f64) {
    let own = &levels[index].height;
    let below = levels[..index].iter().map(|level| &level.height).rfind(|height| height.y < own.y);
    let above = levels[index + 1..].iter().map(|level| &level.height).find(|height| height.y > own.y);
    let low = below.map_or(bounds.min.y.min(own.floor), |below| {
        if below.ceiling > own.floor { below.y } else { (below.ceiling + own.floor) / 2.0 }
    });
    let high = above.map_or(bounds.max.y.max(own.ceiling), |above| {
        if above.floor < own.ceiling { above.y } else { (above.floor + own.ceiling) / 2.0 }
    });
    (low, high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::place::Probe;
    use crate::place::contours::Contours;
    use crate::place::levels::Height;
    use crate::place::plan::{Plan, tests::drawn};
    use crate::place::triangulation::Ground;
    use crate::place::walls::Air;

    const BOUNDS: Bounds = Bounds { min: DVec3::new(0.0, -0.1, 0.0), max: DVec3::new(4.0, 5.8, 4.0) };

    fn level(plan: &Plan, y: f64, [floor, ceiling]: [f64; 2], probes: &[(u32, DVec3)]) -> Level {
        let all: Vec<usize> = (0..plan.lattice.cell_count()).collect();
        let parts = plan.groups(&all).iter().map(|group| plan.lattice.centre(group[0])).collect();
        Ground::new(Height { y, floor, ceiling }, &Contours::of(plan), parts).with_probes(probes, &Air)
    }

    #[test]
    fn boxes_cover_the_free_space_without_gaps() {
        let plan = drawn(&["..........", ".....|.....", ".###.|.....", ".....|..#..", "...##..##.", ".........."]);
        let points =
            [[0.3, 1.0, 0.3], [2.1, 1.0, 0.4], [0.4, 1.0, 1.3], [1.9, 1.0, 1.3], [0.7, 4.0, 0.3], [2.2, 4.0, 1.3]];
        let probes = points.map(DVec3::from);
        let numbered: Vec<(u32, DVec3)> = (0..).zip(probes).collect();
        let levels = [level(&plan, 1.0, [0.0, 2.5], &numbered[..4]), level(&plan, 4.0, [2.8, 5.5], &numbered[4..])];
        let influences = influences(&probes, &levels, plan.lattice.cell, &BOUNDS);
        let boxes: Vec<Probe> = influences
            .iter()
            .zip(probes)
            .map(|((influence, blend), position)| Probe {
                id: String::new(),
                position,
                influence: *influence,
                proxy: *influence,
                blend: *blend,
            })
            .collect();
        for probe in &boxes {
            assert!((probe.weight(probe.position) - 1.0).abs() < 1e-12, "{probe:?}");
        }
        let free = (0..plan.lattice.cell_count()).filter(|&cell| plan.free[cell]);
        for cell in free {
            for i in 0..36 {
                let offset = DVec2::new(f64::from(i % 6) / 5.0 - 0.5, f64::from(i / 6) / 5.0 - 0.5) * plan.lattice.cell;
                let at = plan.lattice.centre(cell) + offset;
                for y in [-0.05, 0.0, 0.9, 2.4, 2.6, 2.7, 5.7] {
                    let point = DVec3::new(at.x, y, at.y);
                    assert!(boxes.iter().any(|probe| probe.weight(point) > 0.0), "{point}");
                }
            }
        }
    }

    #[test]
    fn a_lone_probe_ends_at_once_on_all_sides() {
        let plan = drawn(&["....", "...."]);
        let probe = DVec3::new(0.4, 1.0, 0.2);
        let level = level(&plan, 1.0, [0.0, 2.5], &[(0, probe)]);
        assert_eq!(influences(&[probe], &[level], 0.25, &BOUNDS)[0].1, [0.0; 6]);
    }
}
