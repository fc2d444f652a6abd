//! Polygons to triangles: ears are cut off in the plane that the polygon lies in best.
//!
//! Meisters, Polygons have ears (1975). A corner is an ear when it is convex and no other corner lies in its triangle; a
//! polygon without holes has two at least, so that n - 2 are cut off.

use glam::{DVec2, DVec3};

/// Most corners of a polygon that is not convex: the work grows with their square.
pub const MAX_CONCAVE_CORNERS: usize = 1 << 12;

/// A polygon that is not convex has more than [`MAX_CONCAVE_CORNERS`].
#[derive(Debug, PartialEq, Eq)]
pub struct TooManyCorners;

/// Triangles of the polygon `corners` (three at least), as places in it, in its own winding.
///
/// A convex polygon becomes a fan. One that crosses itself is cut up as well as it can be: every corner is used, and there
/// are always two triangles fewer than corners.
pub fn triangulate(corners: &[DVec3]) -> Result<Vec<[usize; 3]>, TooManyCorners> {
    let count = corners.len();
    let fan = || (1..count.saturating_sub(1)).map(|i| [0, i, i + 1]).collect();
    if count <= 3 {
        return Ok(fan());
    }
    let mut ring = Ring::new(flattened(corners));
    // What is not finite turns nowhere; its triangles are dropped later.
    if (0..count).all(|corner| !(ring.turn(corner) < 0.0)) {
        return Ok(fan());
    }
    if count > MAX_CONCAVE_CORNERS {
        return Err(TooManyCorners);
    }
    let mut triangles = Vec::with_capacity(count - 2);
    let mut is_ear: Vec<bool> = (0..count).map(|corner| ring.is_ear(corner)).collect();
    let mut at = 0;
    for _ in 0..count - 3 {
        let found = ring.from(at).find(|&corner| is_ear[corner]);
        // Where nothing is known to be an ear, as in polygons that cross themselves, any corner has to do; flat ones first.
        let found = found.or_else(|| ring.from(at).find(|&corner| ring.is_ear(corner)));
        let found = found.or_else(|| ring.from(at).find(|&corner| ring.turn(corner) == 0.0));
        let corner = found.unwrap_or(at);
        let [before, _, after] = ring.around(corner);
        triangles.push([before, corner, after]);
        ring.remove(corner);
        // Only its neighbours' triangles have changed.
        is_ear[before] = ring.is_ear(before);
        is_ear[after] = ring.is_ear(after);
        at = after;
    }
    triangles.push(ring.around(at));
    Ok(triangles)
}

/// The corners that are left, each with its neighbours.
struct Ring {
    plane: Vec<DVec2>,
    before: Vec<usize>,
    after: Vec<usize>,
}

impl Ring {
    fn new(plane: Vec<DVec2>) -> Self {
        let count = plane.len();
        let before = (0..count).map(|i| (i + count - 1) % count).collect();
        let after = (0..count).map(|i| (i + 1) % count).collect();
        Self { plane, before, after }
    }

    fn around(&self, corner: usize) -> [usize; 3] {
        [self.before[corner], corner, self.after[corner]]
    }

    /// Every corner once, `first` first.
    fn from(&self, first: usize) -> impl Iterator<Item = usize> + '_ {
        let others = std::iter::successors(Some(self.after[first]), |&corner| Some(self.after[corner]));
        std::iter::once(first).chain(others.take_while(move |&corner| corner != first))
    }

    fn remove(&mut self, corner: usize) {
        let [before, _, after] = self.around(corner);
        self.after[before] = after;
        self.before[after] = before;
    }

    /// Positive where the ring turns left at `corner`.
    fn turn(&self, corner: usize) -> f64 {
        let [a, b, c] = self.around(corner).map(|i| self.plane[i]);
        (b - a).perp_dot(c - b)
    }

    fn is_ear(&self, corner: usize) -> bool {
        let ear = self.around(corner);
        self.turn(corner) > 0.0 && !self.from(corner).any(|p| !ear.contains(&p) && covers(&self.plane, ear, p))
    }
}

/// Whether corner `p` lies in the ear, its edges included; a corner at the place of one of the ear's does not count.
fn covers(plane: &[DVec2], ear: [usize; 3], p: usize) -> bool {
    let [a, b, c] = ear.map(|i| plane[i]);
    let p = plane[p];
    let inside = |from: DVec2, to: DVec2| (to - from).perp_dot(p - from) >= 0.0;
    p != a && p != b && p != c && inside(a, b) && inside(b, c) && inside(c, a)
}

/// The corners in the plane across their mean normal (Newell's), turning counter-clockwise as a whole.
fn flattened(corners: &[DVec3]) -> Vec<DVec2> {
    let edges = corners.iter().zip(corners.iter().cycle().skip(1));
    let normal: DVec3 = edges.map(|(a, b)| (a - corners[0]).cross(b - corners[0])).sum();
    // Dropping the axis that the normal is longest along is exact, and keeps points on lines.
    let [x, y, z] = normal.abs().to_array();
    let (dropped, u, v) = if z >= x && z >= y {
        (2, 0, 1)
    } else if y >= x {
        (1, 2, 0)
    } else {
        (0, 1, 2)
    };
    let mirror = normal[dropped].signum();
    corners.iter().map(|corner| DVec2::new(corner[u] * mirror, corner[v])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn polygon(corners: &[[f64; 2]], place: impl Fn(DVec2) -> DVec3) -> Vec<DVec3> {
        corners.iter().map(|&corner| place(DVec2::from(corner))).collect()
    }

    /// The triangles' areas along the polygon's normal: all positive when none is turned over.
    fn areas(corners: &[DVec3]) -> Vec<f64> {
        let edges = corners.iter().zip(corners.iter().cycle().skip(1));
        let normal = edges.map(|(a, b)| a.cross(*b)).sum::<DVec3>().normalize();
        let triangles = triangulate(corners).unwrap();
        assert_eq!(triangles.len(), corners.len() - 2);
        let area = |[a, b, c]: [usize; 3]| (corners[b] - corners[a]).cross(corners[c] - corners[a]).dot(normal) / 2.0;
        triangles.into_iter().map(area).collect()
    }

    #[test]
    fn concave_polygons_are_covered_once_in_any_plane_and_winding() {
        let l_shape = [[0., 0.], [3., 0.], [3., 1.], [1., 1.], [1., 3.], [0., 3.]];
        let arrow = [[0., 0.], [4., -2.], [1., 0.], [4., 2.]];
        let spiral = [
            [0., 0.],
            [5., 0.],
            [5., 5.],
            [1., 5.],
            [1., 2.],
            [3., 2.],
            [3., 3.],
            [2., 3.],
            [2., 4.],
            [4., 4.],
            [4., 1.],
            [0., 1.],
        ];
        // A square with a square hole, cut open along one edge that is passed twice.
        let keyhole =
            [[0., 0.], [4., 0.], [4., 4.], [0., 4.], [0., 0.], [1., 1.], [1., 3.], [3., 3.], [3., 1.], [1., 1.]];
        let comb: Vec<[f64; 2]> =
            (0..40).map(|i| [f64::from(i), f64::from(i % 2) * 10.0]).chain([[39.0, -1.0], [0.0, -1.0]]).rev().collect();
        let planes: [fn(DVec2) -> DVec3; 4] = [
            |p| p.extend(1.0),
            |p| DVec3::new(2.0, p.x, p.y),
            |p| DVec3::new(p.y, -1.0, p.x),
            |p| DVec3::new(p.x + p.y, p.x - 0.3 * p.y, 0.5 * p.x + p.y),
        ];
        for corners in [&l_shape[..], &arrow, &spiral, &keyhole, &comb] {
            for place in planes {
                for reversed in [false, true] {
                    let mut corners = polygon(corners, place);
                    if reversed {
                        corners.reverse();
                    }
                    let areas = areas(&corners);
                    let whole = {
                        let edges = corners.iter().zip(corners.iter().cycle().skip(1));
                        edges.map(|(a, b)| a.cross(*b)).sum::<DVec3>().length() / 2.0
                    };
                    // Exact up to rounding: a triangle that were turned over, or covered another, would break the sum of sizes.
                    assert!(areas.iter().all(|&area| area >= -1e-12), "{areas:?}");
                    assert!((areas.iter().map(|a| a.abs()).sum::<f64>() / whole - 1.0).abs() < 1e-12, "{areas:?}");
                }
            }
        }
    }

    #[test]
    fn convex_polygons_are_fans_of_any_size() {
        let circle: Vec<DVec3> = (0..10_000).map(|i| DVec2::from_angle(f64::from(i) * 6.28e-4).extend(3.0)).collect();
        assert_eq!(triangulate(&circle).unwrap()[7], [0, 8, 9]);
        let mut dented = circle;
        dented[5] *= 0.9;
        assert_eq!(triangulate(&dented), Err(TooManyCorners));
    }

    #[test]
    fn polygons_that_cross_themselves_or_are_no_polygons_still_end() {
        let bow_tie = polygon(&[[0., 0.], [1., 1.], [1., 0.], [0., 1.]], |p| p.extend(0.0));
        let star: Vec<DVec3> = (0..25).map(|i| DVec2::from_angle(f64::from(i) * 11.0).extend(0.0)).collect();
        let nan = vec![DVec3::NAN, DVec3::X, DVec3::Y, DVec3::Z, DVec3::ONE];
        for corners in [bow_tie, star, nan, vec![DVec3::ONE; 9]] {
            assert_eq!(triangulate(&corners).unwrap().len(), corners.len() - 2);
        }
    }
}
