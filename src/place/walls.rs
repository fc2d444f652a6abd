//! Walls in a triangulation: edges that they cross are blocked, so that nothing is blended through them.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use glam::DVec3;
use rayon::prelude::*;

use super::free_space::Space;
use super::triangulation::{EDGE_ENDS, Level, sorted};
use crate::trace::ray::RayScratch;

/// Walls are looked for between points so far from a triangle's centre toward its corners, which lie on walls.
const BETWEEN: [f64; 3] = [0.45, 0.6, 0.75];

/// They are checked for elsewhere.
const CHECKED_BETWEEN: f64 = 2.0 / 3.0;

/// Where light passes, in world space.
pub trait Openings: Sync {
    /// Whether most light passes between two points.
    fn is_open(&self, from: DVec3, to: DVec3) -> bool;

    /// Whether little opacity surrounds a point.
    fn is_free(&self, point: DVec3) -> bool;
}

/// Nothing is in the way.
pub struct Air;

impl Openings for Air {
    fn is_open(&self, _: DVec3, _: DVec3) -> bool {
        true
    }

    fn is_free(&self, _: DVec3) -> bool {
        true
    }
}

/// Openings that are traced once each.
pub struct Traced<'a> {
    space: &'a Space<'a>,
    /// By the bits of both ends; of a point's surroundings both are the point.
    known: Mutex<BTreeMap<[[u64; 3]; 2], bool>>,
}

impl<'a> Traced<'a> {
    /// Nothing is traced yet.
    pub fn new(space: &'a Space<'a>) -> Self {
        Self { space, known: Mutex::default() }
    }

    fn known(&self, ends: [DVec3; 2], trace: impl FnOnce([DVec3; 2], &mut RayScratch) -> bool) -> bool {
        let mut keys = ends.map(|end| end.to_array().map(f64::to_bits));
        let mut ends = ends;
        // Both ways must give one answer, whichever is asked for first.
        if keys[1] < keys[0] {
            keys.swap(0, 1);
            ends.swap(0, 1);
        }
        let known = || self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let found = known().get(&keys).copied();
        found.unwrap_or_else(|| {
            let traced = trace(ends, &mut RayScratch::default());
            known().insert(keys, traced);
            traced
        })
    }
}

impl Openings for Traced<'_> {
    fn is_open(&self, from: DVec3, to: DVec3) -> bool {
        self.known([from, to], |[from, to], scratch| self.space.is_open(from, to, scratch))
    }

    fn is_free(&self, point: DVec3) -> bool {
        self.known([point; 2], |[point, _], scratch| self.space.is_free(point, scratch))
    }
}

impl Level {
    /// Blocks the edges of this level whose probes do not see each other, and those of triangles that a wall parts. `probes`
    /// are those of the storey, by index.
    pub fn block_walls(&mut self, probes: &[(u32, DVec3)], openings: &dyn Openings) {
        let at = |vertex: usize| {
            let probe = self.vertices[vertex].blend.first()?.probe;
            probes.iter().find(|(index, _)| *index == probe).map(|(_, position)| *position)
        };
        let blocked = (0..self.triangles.len()).into_par_iter().flat_map_iter(|triangle| {
            let corners = self.triangles[triangle];
            let positions = corners.map(|vertex| at(vertex as usize));
            let parted = BETWEEN.map(|outward| self.parted(triangle, outward, openings));
            let parted = [0, 1, 2].map(|edge| parted.iter().any(|parted| parted[edge]));
            EDGE_ENDS.into_iter().zip(parted).filter_map(move |([a, b], parted)| {
                let is_hidden = || positions[a].zip(positions[b]).is_some_and(|(a, b)| !openings.is_open(a, b));
                (parted || is_hidden()).then(|| sorted([corners[a], corners[b]]))
            })
        });
        self.blocked = blocked.collect();
        self.blocked.sort_unstable();
        self.blocked.dedup();
    }

    /// Whether a place in a triangle takes something from a corner beyond a wall.
    pub fn blends_across(&self, triangle: usize, openings: &dyn Openings) -> bool {
        let parted = self.parted(triangle, CHECKED_BETWEEN, openings);
        let sides = EDGE_ENDS.into_iter().zip(parted).filter(|(_, parted)| *parted);
        sides.flat_map(|([a, b], _)| [(a, b), (b, a)]).any(|(here, beyond)| {
            let mut weights = [(1.0 - CHECKED_BETWEEN) / 3.0; 3];
            weights[here] += CHECKED_BETWEEN;
            self.unblocked(triangle, weights)[beyond] > 0.0
        })
    }

    /// Which edges of a triangle a wall crosses: it stands between points so far from the centre toward their ends.
    fn parted(&self, triangle: usize, outward: f64, openings: &dyn Openings) -> [bool; 3] {
        let corners = self.triangles[triangle].map(|vertex| self.vertices[vertex as usize].position);
        let centre = (corners[0] + corners[1] + corners[2]) / 3.0;
        let points = corners.map(|corner| {
            let at = centre.lerp(corner, outward);
            DVec3::new(at.x, self.height.y, at.y)
        });
        let hidden = EDGE_ENDS.map(|[a, b]| !openings.is_open(points[a], points[b]));
        if hidden == [false; 3] {
            return hidden;
        }
        let free = points.map(|point| openings.is_free(point));
        let parted = EDGE_ENDS.map(|[a, b]| free[a] && free[b]);
        let sights = parted.into_iter().filter(|both_free| *both_free).count();
        let parted = [0, 1, 2].map(|edge| parted[edge] && hidden[edge]);
        // A wall parts two sides of three; a pole stands in one.
        let is_wall = parted.into_iter().filter(|parted| *parted).count() + 1 >= sights;
        parted.map(|parted| parted && is_wall)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::*;
    use crate::place::contours::Contours;
    use crate::place::levels::Height;
    use crate::place::plan::tests::drawn;
    use crate::place::triangulation::Ground;

    /// A wall at an x.
    struct Wall(f64);

    impl Openings for Wall {
        fn is_open(&self, from: DVec3, to: DVec3) -> bool {
            (from.x < self.0) == (to.x < self.0)
        }

        fn is_free(&self, _: DVec3) -> bool {
            true
        }
    }

    const HEIGHT: Height = Height { y: 1.5, floor: 0.0, ceiling: 2.5 };

    fn ground() -> Ground {
        let plan = drawn(&["........"; 4]);
        Ground::new(HEIGHT, &Contours::of(&plan), vec![plan.lattice.centre(0)])
    }

    const PROBES: [(u32, DVec3); 2] = [(0, DVec3::new(0.4, 1.5, 0.5)), (1, DVec3::new(1.6, 1.5, 0.52))];

    #[test]
    fn what_a_wall_parts_is_blended_across_it_until_its_edges_are_blocked() {
        let wall = Wall(1.0);
        let mut level = ground().with_probes(&PROBES, &Air);
        assert!(level.blocked.is_empty());
        let across = |level: &Level| (0..level.triangles.len()).filter(|&i| level.blends_across(i, &wall)).count();
        assert!(across(&level) > 0);
        level.block_walls(&PROBES, &wall);
        assert_eq!(across(&level), 0);
    }

    #[test]
    fn nothing_reaches_through_a_wall_that_the_plan_has_missed() {
        let level = ground().with_probes(&PROBES, &Wall(1.0));
        for vertex in &level.vertices {
            let own = u32::from(vertex.position.x > 1.0);
            assert!(vertex.blend.iter().all(|share| share.probe == own), "{vertex:?}");
        }
        let network = crate::place::interpolate::Network { probes: Vec::new(), levels: vec![level] };
        for place in [DVec2::new(0.3, 0.2), DVec2::new(0.6, 0.5), DVec2::new(1.4, 0.5), DVec2::new(1.9, 0.9)] {
            let weights = network.weights(DVec3::new(place.x, 1.0, place.y));
            let heaviest = weights.iter().max_by(|a, b| a.weight.total_cmp(&b.weight)).unwrap();
            assert_eq!((heaviest.probe, heaviest.weight), (u32::from(place.x > 1.0), 1.0), "{place}");
        }
    }

    #[test]
    fn a_pole_parts_no_triangle() {
        /// Only what passes near the middle of the plan is stopped.
        struct Pole;
        impl Openings for Pole {
            fn is_open(&self, from: DVec3, to: DVec3) -> bool {
                let at = DVec3::new(1.0, from.y, 0.31);
                let along = ((at - from).dot(to - from) / (to - from).length_squared()).clamp(0.0, 1.0);
                from.lerp(to, along).distance(at) > 0.02
            }

            fn is_free(&self, _: DVec3) -> bool {
                true
            }
        }
        assert_eq!(ground().with_probes(&PROBES[..1], &Pole).blocked, [[0; 2]; 0]);
    }
}
