//! The box that a probe's reflections are corrected against, fitted to what the probe sees.
//!
//! Seen from a displacement d beside the probe, a reflection corrected against distance b instead of the true a is off by
//! about |d| |1/a - 1/b| radians: so the box is the one whose inverse distances are nearest to the seen ones. Absolute
//! differences instead of squares, so that what stands in a room does not pull at the walls.

use glam::DVec3;

use super::interpolate::exit_distance;
use crate::scene::Bounds;

/// One ray of a probe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Unit direction.
    pub direction: DVec3,
    /// Metres to what was seen; infinite where nothing was.
    pub distance: f64,
    /// Solid angle, in any unit.
    pub weight: f64,
}

/// Walls are not nearer to a probe than this, in metres, nor farther than [`FARTHEST`].
const NEAREST: f64 = 0.05;
const FARTHEST: f64 = 1000.0;

/// Places tried for each wall in each round: quantiles of where the rays toward it end, from the nearest to the farthest;
/// of a corridor's far end there are only a few rays.
const CANDIDATES: usize = 16;

/// Rounds over the six walls; after three, a room's walls move no more.
const ROUNDS: usize = 3;

/// The box around `position` whose walls lie where most of `seen` ends.
pub fn fit(position: DVec3, seen: &[Seen]) -> Bounds {
    let candidates: [Vec<f64>; 6] = std::array::from_fn(|side| candidates(side, seen));
    let middle = |side: usize| candidates[side][candidates[side].len() / 2];
    let mut walls: [f64; 6] = std::array::from_fn(middle);
    for _ in 0..ROUNDS {
        for side in 0..6 {
            let cost = |distance: f64| {
                let mut walls = walls;
                walls[side] = distance;
                error(&bounds(walls), seen)
            };
            let best = candidates[side].iter().map(|&distance| (cost(distance), distance));
            // The first of equals: the nearer wall.
            if let Some((_, distance)) = best.min_by(|a, b| a.0.total_cmp(&b.0)) {
                walls[side] = distance;
            }
        }
    }
    bounds(walls).translated(position)
}

/// Mean difference of inverse distances: radians per metre of displacement. The box is relative to the probe.
fn error(walls: &Bounds, seen: &[Seen]) -> f64 {
    let term = |ray: &Seen| {
        let distance = exit_distance(walls, DVec3::ZERO, ray.direction);
        ray.weight * (1.0 / distance - 1.0 / ray.distance.max(NEAREST)).abs()
    };
    seen.iter().map(term).sum()
}

/// Distances from the probe to its walls in the order +X -X +Y -Y +Z -Z, as a box.
fn bounds([px, nx, py, ny, pz, nz]: [f64; 6]) -> Bounds {
    Bounds { min: DVec3::new(-nx, -ny, -nz), max: DVec3::new(px, py, pz) }
}

/// Where a wall may stand: quantiles of how far rays that lean toward it reach along its axis. Never empty.
fn candidates(side: usize, seen: &[Seen]) -> Vec<f64> {
    let axis = side / 2;
    let toward = |direction: DVec3| if side.is_multiple_of(2) { direction[axis] } else { -direction[axis] };
    // Rays within 73 degrees: flatter ones end on other walls.
    let mut reached: Vec<f64> = seen
        .iter()
        .filter(|ray| toward(ray.direction) > 0.3)
        .map(|ray| (ray.distance * toward(ray.direction)).clamp(NEAREST, FARTHEST))
        .collect();
    if reached.is_empty() {
        return vec![FARTHEST];
    }
    reached.sort_by(f64::total_cmp);
    let mut quantiles: Vec<f64> =
        (0..CANDIDATES).map(|i| reached[i * (reached.len() - 1) / (CANDIDATES - 1)]).collect();
    quantiles.dedup();
    quantiles
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shade::sampling::fibonacci;

    const ROOM: Bounds = Bounds { min: DVec3::new(-2.0, 0.0, -1.0), max: DVec3::new(9.0, 2.7, 1.2) };

    fn seen(position: DVec3, distance: impl Fn(usize, DVec3) -> f64) -> Vec<Seen> {
        let ray = |i: usize| {
            let direction = fibonacci(i, 400);
            Seen {
                direction,
                distance: distance(i, exit_distance(&ROOM, position, direction) * direction),
                weight: 1.0,
            }
        };
        (0..400).map(ray).collect()
    }

    fn far_off(found: Bounds) -> f64 {
        (found.min - ROOM.min).abs().max((found.max - ROOM.max).abs()).max_element()
    }

    #[test]
    fn a_corridors_walls_are_found_from_anywhere_in_it() {
        for position in [DVec3::new(0.0, 1.5, 0.0), DVec3::new(6.0, 1.2, 0.4)] {
            let found = fit(position, &seen(position, |_, to_wall| to_wall.length()));
            assert!(far_off(found) < 1e-9, "{found:?}");
        }
    }

    #[test]
    fn a_quarter_of_the_view_full_of_furniture_moves_no_wall() {
        let position = DVec3::new(1.0, 1.3, 0.0);
        let furnished = seen(position, |i, to_wall| to_wall.length() * if i % 4 == 0 { 0.5 } else { 1.0 });
        assert!(far_off(fit(position, &furnished)) < 0.02);
    }

    #[test]
    fn under_the_open_sky_the_walls_are_far_and_the_ground_is_not() {
        let position = DVec3::new(0.0, 1.5, 0.0);
        let ray = |i: usize| {
            let direction = fibonacci(i, 400);
            Seen {
                direction,
                distance: if direction.y < 0.0 { -1.5 / direction.y } else { f64::INFINITY },
                weight: 1.0,
            }
        };
        let found = fit(position, &(0..400).map(ray).collect::<Vec<_>>());
        assert!(found.min.y.abs() < 1e-9 && found.max.y > 100.0 && found.max.x > 10.0, "{found:?}");
        assert_eq!(fit(position, &[]).max, position + FARTHEST);
    }
}
