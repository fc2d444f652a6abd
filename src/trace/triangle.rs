//! A watertight ray-triangle test in f64.
//!
//! Signed volumes of the ray with the triangle's edges (Pluecker form). An edge's volume is formed from its two end
//! points alone, so two triangles that share an edge get exactly opposite values, whatever the rounding: no ray slips
//! between them. A ray that meets an edge exactly belongs to one of the two, by the order of the edge's end points, so
//! that a blended surface is not counted twice along its diagonals.

use glam::{DVec3, Vec2};

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
    // From the front, each volume is positive when the ray passes on the inner side of that edge.
    let volumes = [edge_volume(b, c, direction), edge_volume(c, a, direction), edge_volume(a, b, direction)];
    let sum = volumes[0] + volumes[1] + volumes[2];
    let front = sum > 0.0;
    let inside = |volume: f64, from: DVec3, to: DVec3| {
        let inward = if front { volume } else { -volume };
        inward > 0.0 || (inward == 0.0 && (precedes(from, to) == front))
    };
    if !(inside(volumes[0], b, c) && inside(volumes[1], c, a) && inside(volumes[2], a, b)) || sum == 0.0 {
        return None;
    }
    let normal = (b - a).cross(c - a);
    let distance = normal.dot(a) / normal.dot(direction);
    (distance > 0.0 && distance.is_finite()).then(|| TriangleHit {
        distance,
        barycentric: Vec2::new((volumes[1] / sum) as f32, (volumes[2] / sum) as f32),
        front,
    })
}

/// Six times the signed volume of the tetrahedron (origin, from, to, direction); exactly negated when the ends swap.
/// Positive for a ray on the inner side of an edge of a triangle that faces the origin.
#[inline]
fn edge_volume(from: DVec3, to: DVec3, direction: DVec3) -> f64 {
    direction.dot(to.cross(from))
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
