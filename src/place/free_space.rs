//! Where a probe may stand: statistics of rays around a point.
//!
//! DDGI moves and classifies probes by the share of rays that meet back faces (Majercik et al. 2019; RTXGI's probe
//! relocation and classification). Gaussians have no back: here opacity around the point and escaping rays decide.

use glam::DVec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::scene::Bounds;
use crate::shade::sampling::fibonacci;
use crate::trace::ray::RayScratch;
use crate::trace::{EverySurface, Ray, RayTracer, SurfaceHit};

/// A segment of which less passes is blocked.
pub const OPEN: f32 = 0.5;

/// Radius, in metres, of the ball around a point that must be nearly empty: a little more than half a thick wall, so that
/// the cavity between a wall's two faces is matter too.
const BODY: f64 = 0.15;

/// Mean share of light that passes from a free point to the surface of its ball. Haze of a capture holds back a few
/// percent; a wall a hand's breadth away takes a third of the directions.
const FREE: f32 = 0.7;

/// Rays of [`Space::surroundings`].
const RAYS: usize = 32;

/// Ellipsoids around the middle of a box, up to the one that touches its sides, on which [`Space::free_place`] looks.
const SHELLS: usize = 16;

/// A point with a larger share of escaping rays has nothing around it.
const ESCAPING: f64 = 0.8;

/// A floor is there if no more than one of so many rays downward escapes: beside a building's outer wall half of them do.
const ESCAPING_DOWN: usize = 4;

/// Why no probe stands at a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum Reason {
    /// Opacity surrounds the place, and no free place is near it.
    Matter,
    /// Most rays leave the scene.
    Outside,
    /// Nothing is below.
    NoFloor,
    /// The free space around it is closed and small: the inside of furniture.
    Pocket,
    /// The probes around it predict what a probe there would hold.
    Predicted,
}

/// The scene as placement asks it: how much light passes between two points. World space, metres.
pub struct Space<'a> {
    /// Rays with any origin.
    pub tracer: RayTracer<'a>,
}

impl Space<'_> {
    /// Share of light that passes from `from` to `to`.
    pub fn transmittance(&self, from: DVec3, to: DVec3, scratch: &mut RayScratch) -> f32 {
        let length = from.distance(to);
        if length == 0.0 {
            return 1.0;
        }
        let ray = Ray { origin: from - self.tracer.scene.origin, direction: (to - from) / length };
        let mut alpha = |hit: &SurfaceHit| self.tracer.surfaces.fragment(&ray, hit).alpha;
        self.tracer.transmittance(&ray, length, scratch, &mut alpha)
    }

    /// Whether most light passes from `from` to `to`.
    pub fn is_open(&self, from: DVec3, to: DVec3, scratch: &mut RayScratch) -> bool {
        self.transmittance(from, to, scratch) >= OPEN
    }

    /// Share of directions from `point` in which the nearest surface shows a back that no ray sees: 1 inside a closed mesh, whose
    /// walls a cubemap then misses. 0 where there are no surfaces.
    pub fn hidden_backs(&self, point: DVec3, scratch: &mut RayScratch) -> f64 {
        let tracer = RayTracer { surfaces: &EverySurface, ..self.tracer };
        let origin = point - tracer.scene.origin;
        let shows_back = |direction: DVec3, scratch: &mut RayScratch| {
            let mut nearest: Option<SurfaceHit> = None;
            tracer.transmittance(&Ray { origin, direction }, f64::INFINITY, scratch, &mut |hit| {
                if nearest.is_none_or(|nearest| hit.distance < nearest.distance) {
                    nearest = Some(*hit);
                }
                0.0
            });
            nearest.is_some_and(|hit| !hit.front && !self.tracer.surfaces.is_double_sided(hit.triangle))
        };
        let backs = (0..RAYS).filter(|&i| shows_back(fibonacci(i, RAYS), scratch)).count();
        backs as f64 / RAYS as f64
    }

    /// Whether little opacity surrounds `point`: along the axes and the diagonals.
    pub fn is_free(&self, point: DVec3, scratch: &mut RayScratch) -> bool {
        let mut passed = 0.0;
        for (i, direction) in body_directions().enumerate() {
            passed += self.transmittance(point, point + direction * BODY, scratch);
            // Even if all others pass.
            if passed + (BODY_RAYS - 1 - i) as f32 <= FREE * BODY_RAYS as f32 {
                return false;
            }
        }
        true
    }

    /// A place for a single probe in `bounds`, if a few hundred hold one: the free one inside of the scene that is nearest to
    /// the middle, by the bounds' own measure; of a scene without inside, the free one.
    pub fn free_place(&self, bounds: &Bounds) -> Option<DVec3> {
        let shell = |k: usize| (0..RAYS).map(move |i| fibonacci(i, RAYS) * (k as f64 / SHELLS as f64));
        let places = std::iter::once(DVec3::ZERO).chain((1..SHELLS).flat_map(shell));
        let mut scratch = RayScratch::default();
        let reach = 4.0 * bounds.extent().length();
        let mut free = None;
        for place in places.map(|offset| bounds.centre() + offset * bounds.extent() / 2.0) {
            if self.is_free(place, &mut scratch) {
                if self.surroundings(place, reach, &mut scratch).is_ok() {
                    return Some(place);
                }
                free = free.or(Some(place));
            }
        }
        free
    }

    /// Whether the point lies inside of the scene; else why not. Rays reach `reach` metres, more than the scene's size.
    pub fn surroundings(&self, point: DVec3, reach: f64, scratch: &mut RayScratch) -> Result<(), Reason> {
        let (mut escaping, mut down, mut escaping_down) = (0, 0, 0);
        for i in 0..RAYS {
            let direction = fibonacci(i, RAYS);
            let escapes = self.is_open(point, point + direction * reach, scratch);
            escaping += usize::from(escapes);
            // Within 60 degrees of straight down.
            if direction.y < -0.5 {
                down += 1;
                escaping_down += usize::from(escapes);
            }
        }
        if escaping as f64 > ESCAPING * RAYS as f64 {
            Err(Reason::Outside)
        } else if ESCAPING_DOWN * escaping_down > down || self.is_open(point, point + DVec3::NEG_Y * reach, scratch) {
            Err(Reason::NoFloor)
        } else {
            Ok(())
        }
    }
}

/// Rays of [`body_directions`].
const BODY_RAYS: usize = 14;

/// The six axes and the eight diagonals of the cube.
fn body_directions() -> impl Iterator<Item = DVec3> {
    let axes = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
    let sign = |bit: usize, i: usize| if i >> bit & 1 == 0 { 1.0 } else { -1.0 };
    let diagonals = (0..8).map(move |i| DVec3::new(sign(0, i), sign(1, i), sign(2, i)).normalize());
    axes.into_iter().chain(diagonals)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_unit_vectors_that_balance() {
        for directions in [body_directions().collect::<Vec<_>>(), (0..RAYS).map(|i| fibonacci(i, RAYS)).collect()] {
            assert!(directions.iter().all(|direction| (direction.length() - 1.0).abs() < 1e-12));
            let mean = directions.iter().sum::<DVec3>() / directions.len() as f64;
            assert!(mean.length() < 0.03, "{mean}");
        }
        assert_eq!(body_directions().count(), BODY_RAYS);
    }
}
