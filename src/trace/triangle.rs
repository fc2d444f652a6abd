//! A watertight ray-triangle test in f64.
//!
//! The corners are projected along the ray and the edges tested in that plane (Woop, Benthin and Wald 2013). A corner's
//! projection depends on the ray and the corner alone and an edge's side on its two ends alone, so two triangles that
//! share an edge get exactly opposite values, whatever the rounding: no ray slips between them, not at their corners
//! either. A ray that meets an edge exactly belongs to one of the two, by the order of the edge's end points, so that a
//! blended surface is not counted twice along its diagonals.

use glam::{DVec2, DVec3, Vec2};

/// Where a ray meets a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TriangleHit {
    /// Distance in units of the direction's length.
    pub distance: f64,
    /// Barycentric weights of the second and third corner.
    pub barycentric: Vec2,
    /// Whether the corners run counter-clockwise as seen from the ray's origin.
    pub front: bool,
}

/// Meets the triangle whose corners lie at `corners` as seen from the ray's origin (metres). Hits behind the origin,
/// triangles seen edge-on and degenerate or non-finite ones are misses.
#[inline]
pub fn intersect(corners: [DVec3; 3], direction: DVec3) -> Option<TriangleHit> {
    let [a, b, c] = corners;
    // Lengths do not matter: only signs and ratios of areas do.
    let right = direction.any_orthogonal_vector();
    let up = direction.cross(right);
    let [pa, pb, pc] = corners.map(|corner| DVec2::new(corner.dot(right), corner.dot(up)));
    // Twice the areas of the triangles that the ray makes with the edges; positive inside when seen from the front.
    let areas = [pc.perp_dot(pb), pa.perp_dot(pc), pb.perp_dot(pa)];
    let sum = areas[0] + areas[1] + areas[2];
    let front = sum > 0.0;
    let inside = |area: f64, from: DVec3, to: DVec3| {
        let inward = if front { area } else { -area };
        inward > 0.0 || (inward == 0.0 && (precedes(from, to) == front))
    };
    if !(inside(areas[0], b, c) && inside(areas[1], c, a) && inside(areas[2], a, b)) || sum == 0.0 {
        return None;
    }
    let normal = (b - a).cross(c - a);
    let distance = normal.dot(a) / normal.dot(direction);
    (distance > 0.0 && distance.is_finite()).then(|| TriangleHit {
        distance,
        barycentric: Vec2::new((areas[1] / sum) as f32, (areas[2] / sum) as f32),
        front,
    })
}

fn precedes(p: DVec3, q: DVec3) -> bool {
    (p.x, p.y, p.z) < (q.x, q.y, q.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FACING: [DVec3; 3] = [DVec3::new(-1.0, -1.0, -2.0), DVec3::new(1.0, -1.0, -2.0), DVec3::new(0.0, 1.0, -2.0)];

    #[test]
    fn a_counter_clockwise_triangle_is_hit_from_the_front_at_its_distance() {
        let hit = intersect(FACING, DVec3::NEG_Z).expect("straight ahead");
        assert!(hit.front);
        assert_eq!(hit.distance, 2.0);
        assert_eq!(hit.barycentric, Vec2::new(0.25, 0.5));
        let back = intersect([FACING[0], FACING[2], FACING[1]], DVec3::NEG_Z).expect("from behind");
        assert!(!back.front);
        assert_eq!(back.barycentric, Vec2::new(0.5, 0.25));
    }

    #[test]
    fn what_lies_behind_or_beside_is_missed() {
        assert_eq!(intersect(FACING, DVec3::Z), None);
        assert_eq!(intersect(FACING, DVec3::new(1.0, 0.0, -1.0)), None);
        assert_eq!(intersect([DVec3::NEG_Z; 3], DVec3::NEG_Z), None);
        assert_eq!(intersect([DVec3::NAN; 3], DVec3::NEG_Z), None);
    }

    #[test]
    fn a_fan_of_triangles_covers_every_ray_exactly_once() {
        // A wobbly fan around a centre: rays through its interior, along its edges and through the centre itself.
        let centre = DVec3::new(0.1, -0.2, -3.0);
        let rim: Vec<DVec3> = (0..12)
            .map(|k| {
                let angle = f64::from(k) * std::f64::consts::TAU / 12.0;
                DVec3::new(angle.cos() * 2.0, angle.sin() * 2.0, -3.0 + 0.3 * (3.0 * angle).sin())
            })
            .collect();
        let mut directions: Vec<DVec3> = rim.iter().flat_map(|p| [0.1, 0.5, 0.9].map(|s| centre.lerp(*p, s))).collect();
        directions.push(centre);
        directions.extend((0..2000).map(|k| {
            let (angle, radius) = (f64::from(k) * 2.399_963, (f64::from(k) / 2000.0).sqrt() * 1.4);
            DVec3::new(angle.cos() * radius, angle.sin() * radius, -3.0)
        }));
        for direction in directions {
            let hits = (0..12).filter(|&k| intersect([centre, rim[k], rim[(k + 1) % 12]], direction).is_some()).count();
            assert_eq!(hits, 1, "{direction}");
        }
    }
}
