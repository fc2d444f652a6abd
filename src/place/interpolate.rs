//! What a runtime shows between probes: the one definition, for engines, for placement and for tests.
//!
//! 1. Levels: those whose storey the position is in, else those of the nearest storey; between two levels the share is
//!    linear in height, beyond the outermost it is theirs.
//! 2. The triangle that the position lies in, in the plan, gives the barycentric weights of its vertices; outside of all
//!    triangles the nearest point of them counts. From the heaviest corner down, of equal ones from the first, a corner
//!    counts unless a blocked edge joins it to one that counts.
//! 3. Every vertex is a blend of probes.
//! 4. A probe is looked up in the direction from where it was taken to where the ray leaves its proxy box (Lagarde &
//!    Zanuttini 2012, "Local image-based lighting with parallax-corrected cubemap").

use glam::{DVec2, DVec3, Vec3};

use super::triangulation::{Level, Share};
use crate::scene::{Bounds, LinearRgb};

/// What a runtime needs to blend probes: the manifest's part without images.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Network {
    /// Per probe: where it was taken, and its proxy box.
    pub probes: Vec<(DVec3, Bounds)>,
    /// The levels, from the lowest up.
    pub levels: Vec<Level>,
}

/// Linear radiance at `position` (metres, world space) from `direction` (unit length) at a perceptual roughness in [0, 1]:
/// the blend of `radiance(probe, direction, roughness)` of the probes around it.
pub fn interpolate(
    network: &Network,
    radiance: impl Fn(usize, DVec3, f64) -> LinearRgb,
    position: DVec3,
    direction: DVec3,
    roughness: f64,
) -> LinearRgb {
    let looked_up = network.weights(position).into_iter().map(|Share { probe, weight }| {
        let (taken_at, proxy) = &network.probes[probe as usize];
        let corrected = parallax_corrected(*taken_at, proxy, position, direction);
        radiance(probe as usize, corrected, roughness).0 * weight as f32
    });
    LinearRgb(looked_up.sum::<Vec3>())
}

/// Unit direction from `taken_at` to where the ray from `position` leaves `proxy`; a position outside is first moved to
/// the nearest point of the box.
pub fn parallax_corrected(taken_at: DVec3, proxy: &Bounds, position: DVec3, direction: DVec3) -> DVec3 {
    let inside = position.clamp(proxy.min, proxy.max);
    let distance = exit_distance(proxy, inside, direction);
    (inside + direction * distance - taken_at).try_normalize().unwrap_or(direction)
}

/// How far a ray from `inside` the box is from leaving it, in metres.
pub fn exit_distance(proxy: &Bounds, inside: DVec3, direction: DVec3) -> f64 {
    (0..3)
        .map(|axis| match direction[axis] {
            d if d > 0.0 => (proxy.max[axis] - inside[axis]) / d,
            d if d < 0.0 => (proxy.min[axis] - inside[axis]) / d,
            _ => f64::INFINITY,
        })
        .fold(f64::INFINITY, f64::min)
        .max(0.0)
}

impl Network {
    /// The probes blended at a position, by ascending index; their weights sum to 1. None where there are no probes.
    pub fn weights(&self, position: DVec3) -> Vec<Share> {
        let away = |level: &Level| {
            let height = &level.height;
            (height.floor - position.y).max(position.y - height.ceiling).max(0.0)
        };
        let served = |level: &&Level| !level.triangles.is_empty();
        let least = self.levels.iter().filter(served).map(away).fold(f64::INFINITY, f64::min);
        let storey: Vec<&Level> = self.levels.iter().filter(served).filter(|level| away(level) == least).collect();
        let above = storey.partition_point(|level| level.height.y <= position.y);
        let below = above.checked_sub(1).map(|i| storey[i]);
        let mut shares = Vec::new();
        match (below, storey.get(above)) {
            (Some(below), Some(above)) => {
                let up = (position.y - below.height.y) / (above.height.y - below.height.y);
                add_level(below, position, 1.0 - up, &mut shares);
                add_level(above, position, up, &mut shares);
            }
            (Some(level), None) => add_level(level, position, 1.0, &mut shares),
            (None, Some(level)) => add_level(level, position, 1.0, &mut shares),
            (None, None) => {}
        }
        shares.sort_by_key(|share| share.probe);
        shares.dedup_by(|later, kept| {
            let same = later.probe == kept.probe;
            if same {
                kept.weight += later.weight;
            }
            same
        });
        shares.retain(|share| share.weight > 0.0);
        shares
    }
}

fn add_level(level: &Level, position: DVec3, weight: f64, shares: &mut Vec<Share>) {
    let (triangle, weights) = level.locate(DVec2::new(position.x, position.z));
    for (vertex, corner) in level.triangles[triangle].into_iter().zip(level.unblocked(triangle, weights)) {
        let blend = &level.vertices[vertex as usize].blend;
        shares.extend(blend.iter().map(|share| Share { weight: share.weight * corner * weight, ..*share }));
    }
}

impl Level {
    /// The triangle that a point of the plan lies in and the weights of its corners; outside of all triangles those of
    /// their nearest point. There must be a triangle.
    pub fn locate(&self, point: DVec2) -> (usize, [f64; 3]) {
        let mut nearest = (f64::INFINITY, 0, [1.0, 0.0, 0.0]);
        for (i, triangle) in self.triangles.iter().enumerate() {
            let corners = triangle.map(|vertex| self.vertices[vertex as usize].position);
            let [low, high] = [DVec2::min, DVec2::max].map(|pick| pick(pick(corners[0], corners[1]), corners[2]));
            if point.clamp(low, high).distance_squared(point) >= nearest.0 {
                continue;
            }
            let weights = nearest_weights(corners, point);
            let at = corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2];
            let distance = at.distance_squared(point);
            if distance < nearest.0 {
                nearest = (distance, i, weights);
            }
            if distance == 0.0 {
                break;
            }
        }
        (nearest.1, nearest.2)
    }

    /// Weights of the corners that no blocked edge keeps from a heavier one that counts.
    pub(super) fn unblocked(&self, triangle: usize, weights: [f64; 3]) -> [f64; 3] {
        let corners = self.triangles[triangle];
        let is_blocked = |a: usize, b: usize| {
            let edge = [corners[a].min(corners[b]), corners[a].max(corners[b])];
            self.blocked.binary_search(&edge).is_ok()
        };
        let mut heaviest_first = [0, 1, 2];
        heaviest_first.sort_by(|&a, &b| weights[b].total_cmp(&weights[a]));
        let mut kept = [0.0; 3];
        for corner in heaviest_first {
            if (0..3).all(|other| kept[other] == 0.0 || !is_blocked(corner, other)) {
                kept[corner] = weights[corner];
            }
        }
        let sum: f64 = kept.iter().sum();
        kept.map(|weight| weight / sum)
    }
}

/// Barycentric weights of the point of a triangle that is nearest to `point`. A triangle without area counts as its
/// edges.
fn nearest_weights([a, b, c]: [DVec2; 3], point: DVec2) -> [f64; 3] {
    let area = (b - a).perp_dot(c - a);
    if area > 0.0 {
        let weights =
            [(b - point).perp_dot(c - point), (c - point).perp_dot(a - point), (a - point).perp_dot(b - point)];
        if weights.iter().all(|weight| *weight >= 0.0) {
            return weights.map(|weight| weight / area);
        }
    }
    let on_edge = |from: DVec2, to: DVec2| {
        let edge = to - from;
        let squared = edge.length_squared();
        if squared > 0.0 { ((point - from).dot(edge) / squared).clamp(0.0, 1.0) } else { 0.0 }
    };
    let [ab, bc, ca] = [on_edge(a, b), on_edge(b, c), on_edge(c, a)];
    let candidates = [[1.0 - ab, ab, 0.0], [0.0, 1.0 - bc, bc], [ca, 0.0, 1.0 - ca]];
    let distance = |w: &[f64; 3]| (a * w[0] + b * w[1] + c * w[2]).distance_squared(point);
    let nearest = candidates.into_iter().min_by(|v, w| distance(v).total_cmp(&distance(w)));
    nearest.unwrap_or([1.0, 0.0, 0.0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::place::levels::Height;
    use crate::place::triangulation::Vertex;

    const ROOM: Bounds = Bounds { min: DVec3::new(-2.0, 0.0, -3.0), max: DVec3::new(4.0, 2.5, 3.0) };

    /// One triangle of three probes at `y`, whose indices begin at `first`.
    fn level(y: f64, [floor, ceiling]: [f64; 2], first: u32) -> Level {
        let corners = [DVec2::new(0.0, 0.0), DVec2::new(2.0, 0.0), DVec2::new(0.0, 2.0)];
        let vertices = corners.into_iter().zip(first..);
        Level {
            height: Height { y, floor, ceiling },
            vertices: vertices
                .map(|(position, probe)| Vertex { position, blend: vec![Share { probe, weight: 1.0 }], is_probe: true })
                .collect(),
            triangles: vec![[0, 1, 2]],
            neighbours: vec![[None; 3]],
            walls: vec![[0, 1], [0, 2], [1, 2]],
            blocked: Vec::new(),
        }
    }

    fn network(levels: Vec<Level>) -> Network {
        Network { probes: vec![(DVec3::ONE, ROOM); 3 * levels.len()], levels }
    }

    fn weights(network: &Network, position: DVec3) -> Vec<(u32, f64)> {
        network.weights(position).iter().map(|share| (share.probe, share.weight)).collect()
    }

    #[test]
    fn a_room_painted_on_its_own_proxy_is_seen_without_error_from_everywhere() {
        // Radiance is where on the walls the ray ends: exact under parallax correction, for any blend.
        let network = network(vec![level(1.0, [0.0, 2.5], 0)]);
        let wall = |from: DVec3, direction: DVec3| from + direction * exit_distance(&ROOM, from, direction);
        let radiance =
            |probe: usize, direction: DVec3, _| LinearRgb(wall(network.probes[probe].0, direction).as_vec3());
        for i in 0..200 {
            let at = f64::from(i);
            let direction = DVec3::new(at.sin(), (at * 0.7).cos(), (at * 1.3).cos()).normalize();
            let position = DVec3::new(0.1 + (at * 0.37).fract(), 0.2 + (at * 0.21).fract() * 2.0, (at * 0.73).fract());
            let seen = interpolate(&network, radiance, position, direction, 0.3).0;
            assert!((seen - wall(position, direction).as_vec3()).length() < 1e-5, "{position} {direction}");
        }
    }

    #[test]
    fn weights_are_barycentric_within_a_triangle_and_linear_between_levels() {
        let one = network(vec![level(1.0, [0.0, 2.5], 0)]);
        assert_eq!(weights(&one, DVec3::new(0.5, 9.0, 1.0)), [(0, 0.25), (1, 0.25), (2, 0.5)]);
        let two = network(vec![level(1.0, [0.0, 5.0], 0), level(3.0, [0.0, 5.0], 3)]);
        assert_eq!(weights(&two, DVec3::new(0.0, 1.5, 0.0)), [(0, 0.75), (3, 0.25)]);
        assert_eq!(weights(&two, DVec3::new(0.0, 4.5, 0.0)), [(3, 1.0)]);
    }

    #[test]
    fn storeys_do_not_blend_into_each_other() {
        let two = network(vec![level(1.0, [0.0, 2.5], 0), level(4.0, [2.8, 5.0], 3)]);
        assert_eq!(weights(&two, DVec3::new(0.0, 2.4, 0.0)), [(0, 1.0)]);
        assert_eq!(weights(&two, DVec3::new(0.0, 2.7, 0.0)), [(3, 1.0)]);
    }

    #[test]
    fn outside_the_nearest_point_of_the_triangles_counts() {
        let one = network(vec![level(1.0, [0.0, 2.5], 0)]);
        assert_eq!(weights(&one, DVec3::new(-3.0, 1.0, -1.0)), [(0, 1.0)]);
        assert_eq!(weights(&one, DVec3::new(1.0, 1.0, -5.0)), [(0, 0.5), (1, 0.5)]);
        assert_eq!(weights(&one, DVec3::new(2.0, 1.0, 2.0)), [(1, 0.5), (2, 0.5)]);
    }

    #[test]
    fn a_blocked_edge_carries_no_weight() {
        let mut blocked = level(1.0, [0.0, 2.5], 0);
        blocked.blocked = vec![[0, 1]];
        let blocked = network(vec![blocked]);
        assert_eq!(weights(&blocked, DVec3::new(0.5, 1.0, 0.0)), [(0, 1.0)]);
        assert_eq!(weights(&blocked, DVec3::new(1.5, 1.0, 0.0)), [(1, 1.0)]);
        // (0.625, 0.125, 0.25) without the second.
        let kept = weights(&blocked, DVec3::new(0.25, 1.0, 0.5));
        assert!((kept[0].1 - 0.625 / 0.875).abs() < 1e-12 && kept[1].0 == 2 && kept.len() == 2, "{kept:?}");
    }

    #[test]
    fn corners_that_are_all_kept_apart_leave_the_heaviest_and_of_equal_ones_the_first() {
        let mut apart = level(1.0, [0.0, 2.5], 0);
        apart.blocked = vec![[0, 1], [0, 2], [1, 2]];
        let apart = network(vec![apart]);
        assert_eq!(weights(&apart, DVec3::new(1.2, 1.0, 0.4)), [(1, 1.0)]);
        for equal in [DVec3::new(2.0 / 3.0, 1.0, 2.0 / 3.0), DVec3::new(1.0, 1.0, 0.0), DVec3::new(0.0, 1.0, 1.0)] {
            assert_eq!(weights(&apart, equal), [(0, 1.0)], "{equal}");
        }
        // The third is kept from the second alone, which is kept from the first.
        let mut chain = level(1.0, [0.0, 2.5], 0);
        chain.blocked = vec![[0, 1], [1, 2]];
        let chained = weights(&network(vec![chain]), DVec3::new(0.5, 1.0, 0.25));
        assert_eq!(chained.iter().map(|share| share.0).collect::<Vec<_>>(), [0, 2]);
    }

    #[test]
    fn a_position_outside_the_proxy_looks_from_its_surface() {
        let outside = DVec3::new(9.0, 1.0, 1.0);
        let corrected = parallax_corrected(DVec3::ONE, &ROOM, outside, DVec3::NEG_X);
        assert_eq!(corrected, DVec3::NEG_X);
        let corrected = parallax_corrected(DVec3::ONE, &ROOM, outside, DVec3::Z);
        assert!((corrected - DVec3::new(3.0, 0.0, 2.0).normalize()).length() < 1e-12);
    }
}
