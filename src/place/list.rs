//! Probes at given points.

use glam::DVec3;

use super::{Probe, check_bounds, check_overlap, probe_id};
use crate::error::{Error, Result};
use crate::job::MAX_PROBES;
use crate::scene::Bounds;

/// How far a probe reaches along each axis when no bounds are given, in metres: a room of 10 m.
pub const DEFAULT_HALF_SIZE: f64 = 5.0;

/// Probes at `points` (world space, metres), in their order.
///
/// Arbitrary points do not divide a box, so every probe reaches to all of `bounds` (without bounds: to
/// [`DEFAULT_HALF_SIZE`] from its point), and blending decides between them: toward a side on which another point lies,
/// the weight falls off over the share `overlap` of the way from the face back to the probe. With `overlap` 1 it falls from
/// the probe itself, so that the nearer probe always counts more; with 0 all that reach a place count the same. Sides
/// without another point have blend 0.
///
/// Fails with [`Error::Request`] when there are no points or more than [`MAX_PROBES`], a point is not finite or outside
/// the bounds, the bounds are not a finite box with a volume, or `overlap` is outside [0, 1].
pub fn list(points: &[DVec3], bounds: Option<Bounds>, overlap: f64) -> Result<Vec<Probe>> {
    check_overlap(overlap)?;
    if let Some(bounds) = bounds {
        check_bounds(&bounds)?;
    }
    if points.is_empty() || points.len() > MAX_PROBES {
        return Err(Error::request("probe", format!("{} points given; 1 to {MAX_PROBES} are needed", points.len())));
    }
    if let Some(point) = points.iter().find(|point| !point.is_finite()) {
        return Err(Error::request("probe", format!("{point} is not a position: every coordinate must be finite")));
    }
    let extent = points.iter().fold((points[0], points[0]), |(min, max), &point| (min.min(point), max.max(point)));
    let probe = |(index, &position): (usize, &DVec3)| {
        let half_size = DVec3::splat(DEFAULT_HALF_SIZE);
        let influence = bounds.unwrap_or(Bounds { min: position - half_size, max: position + half_size });
        if !influence.contains(position) {
            let why = format!("{position} lies outside the bounds {} to {}", influence.min, influence.max);
            return Err(Error::request("probe", why));
        }
        let has_other_above = DVec3::select(extent.1.cmpgt(position), DVec3::ONE, DVec3::ZERO);
        let has_other_below = DVec3::select(extent.0.cmplt(position), DVec3::ONE, DVec3::ZERO);
        let above = (influence.max - position) * has_other_above * overlap;
        let below = (position - influence.min) * has_other_below * overlap;
        let blend = [above.x, below.x, above.y, below.y, above.z, below.z];
        Ok(Probe { id: probe_id(index, points.len()), position, influence, proxy: influence, blend })
    };
    points.iter().enumerate().map(probe).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROOM: Bounds = Bounds { min: DVec3::ZERO, max: DVec3::new(4.0, 3.0, 4.0) };

    #[test]
    fn a_lone_probe_has_full_weight_in_all_of_the_bounds() {
        let probes = list(&[DVec3::ONE], Some(ROOM), 1.0).unwrap();
        assert_eq!(probes[0].influence, ROOM);
        for corner in [ROOM.min, ROOM.max, DVec3::new(0.0, 3.0, 0.0)] {
            assert_eq!(probes[0].weight(corner), 1.0);
        }
    }

    #[test]
    fn the_nearer_of_two_probes_counts_more() {
        let probes = list(&[DVec3::new(1.0, 1.5, 2.0), DVec3::new(3.0, 1.5, 2.0)], Some(ROOM), 1.0).unwrap();
        assert_eq!(probes[0].blend, [3.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(probes[1].blend, [0.0, 3.0, 0.0, 0.0, 0.0, 0.0]);
        for x in [0.0, 0.5, 1.0, 1.9] {
            let [near, far] = [0, 1].map(|i| probes[i].weight(DVec3::new(x, 1.0, 3.0)));
            assert!(near > far, "{near} against {far} at {x}");
        }
        let middle = DVec3::new(2.0, 1.0, 3.0);
        assert_eq!(probes[0].weight(middle), probes[1].weight(middle));
    }

    #[test]
    fn without_bounds_a_probe_reaches_the_default_distance() {
        let position = DVec3::new(1e6, -3.0, 0.5);
        let probes = list(&[position], None, 0.5).unwrap();
        assert_eq!(probes[0].influence.min, position - DEFAULT_HALF_SIZE);
        assert_eq!(probes[0].influence.max, position + DEFAULT_HALF_SIZE);
    }

    #[test]
    fn wrong_points_are_request_errors() {
        let wrong: [&[DVec3]; 4] = [&[], &[DVec3::NAN], &[DVec3::INFINITY], &[DVec3::ONE, DVec3::splat(9.0)]];
        for points in wrong {
            let error = list(points, Some(ROOM), 0.5).unwrap_err();
            assert!(matches!(&error, Error::Request { field, .. } if field == "probe"), "{error}");
        }
    }
}
