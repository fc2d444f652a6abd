//! The triangulation of a level: what a runtime blends by.
//!
//! A constrained Delaunay triangulation of the probes and of the borders of free space; triangles outside of the free space
//! are left out. A border has no probe, so every vertex states its own blend: a probe's is the probe, a border's is of the
//! probes that are nearest along the edges of the triangulation, so that it never reaches through a wall. Where a wall
//! thinner than a cell passes through a vertex, each of its sides has a vertex of its own. Levels of one storey share what
//! stands in it: a probe is a vertex of the others, too, where these have none of their own above or below it.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::{DVec2, DVec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use spade::handles::{FixedFaceHandle, InnerTag};
use spade::{ConstrainedDelaunayTriangulation, HasPosition, Point2, PositionInTriangulation, Triangulation};

use super::contours::Contours;
use super::levels::Height;
use super::walls::Openings;

/// A border is blended of so many probes, the nearest along edges, ...
const BORDER_PROBES: usize = 3;

/// ... each by its way's length to the minus this (Shepard 1968): measured, 2 is less accurate with few probes, and a
/// single probe makes steps in the middle of a wall.
const BORDER_POWER: i32 = 4;

/// A border's probes that would weigh less than this share of the nearest are left out: runtimes look up few at once.
const LEAST_SHARE: f64 = 0.1;

/// A probe's part in a blend.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Share {
    /// Index of the probe in the manifest's list.
    pub probe: u32,
    /// Its weight; the weights of a blend sum to 1.
    pub weight: f64,
}

/// A corner of triangles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct Vertex {
    /// x and z, in metres.
    #[schemars(with = "[f64; 2]")]
    pub position: DVec2,
    /// The probes that are blended here: of a probe's own vertex the probe alone.
    pub blend: Vec<Share>,
    /// Whether a probe stands here, at the level's height. One of another height of the storey may stand in.
    pub is_probe: bool,
}

/// How probes are blended at one height.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Level {
    /// Where the level's probes stand and which heights it serves.
    pub height: Height,
    /// Corners of the triangles.
    pub vertices: Vec<Vertex>,
    /// Triangles in the plan, by their vertices. A wall crosses none, or blocks the edges that it crosses.
    pub triangles: Vec<[u32; 3]>,
    /// Per triangle and corner: the triangle across the edge that is opposite to the corner; none behind a wall.
    pub neighbours: Vec<[Option<u32>; 3]>,
    /// Edges, by their vertices, that are borders of the free space.
    pub walls: Vec<[u32; 2]>,
    /// Edges, by their vertices, that nothing is blended along: their probes do not see each other, or a wall crosses them.
    pub blocked: Vec<[u32; 2]>,
}

/// Which corners of a triangle the edge opposite to each of them joins.
pub const EDGE_ENDS: [[usize; 2]; 3] = [[1, 2], [0, 2], [0, 1]];

impl Level {
    /// A level that serves nothing.
    fn empty(height: Height) -> Self {
        let (vertices, triangles, neighbours) = (Vec::new(), Vec::new(), Vec::new());
        Self { height, vertices, triangles, neighbours, walls: Vec::new(), blocked: Vec::new() }
    }
}

/// A point of the plan on its way into spade.
#[derive(Debug, Clone, Copy)]
struct Site {
    position: DVec2,
    probe: Option<u32>,
    /// Whether the probe stands at the level's own height.
    is_own: bool,
}

impl Site {
    fn border(position: DVec2) -> Self {
        Self { position, probe: None, is_own: false }
    }
}

impl HasPosition for Site {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        Point2::new(self.position.x, self.position.y)
    }
}

type Triangles = ConstrainedDelaunayTriangulation<Site>;

/// A level's free space, ready to be triangulated with any probes.
pub struct Ground {
    height: Height,
    triangles: Triangles,
    /// A free point of each connected part.
    parts: Vec<DVec2>,
}

impl Ground {
    /// The space within `contours`; `parts` holds a free point, half a cell from every border, of each connected part.
    pub fn new(height: Height, contours: &Contours, parts: Vec<DVec2>) -> Self {
        let mut triangles = Triangles::new();
        let insert = |triangles: &mut Triangles, position: DVec2| triangles.insert(Site::border(position)).ok();
        let handles: Vec<_> = contours.points.iter().map(|&point| insert(&mut triangles, point)).collect();
        for &[from, to] in &contours.edges {
            if let (Some(from), Some(to)) = (handles[from], handles[to]) {
                // Simplified borders can touch where they part; a split keeps both.
                let split = |at: Point2<f64>| Site::border(DVec2::new(at.x, at.y));
                triangles.add_constraint_and_split(from, to, split);
            }
        }
        Self { height, triangles, parts }
    }

    /// Triangulates with the `probes` of the storey, given by index and position; without any at this height there are no
    /// triangles. Where none of this height stands above or below another that is seen from here, that one stands in.
    pub fn with_probes(&self, probes: &[(u32, DVec3)], openings: &dyn Openings) -> Level {
        let mut level = Level::empty(self.height);
        let away = |position: DVec3| (position.y - self.height.y).abs();
        if probes.iter().all(|(_, position)| away(*position) > 0.0) {
            return level;
        }
        // The nearest last: of those at one place it stays.
        let mut by_distance = probes.to_vec();
        by_distance.sort_by(|a, b| away(b.1).total_cmp(&away(a.1)).then(a.0.cmp(&b.0)));
        let mut triangles = self.triangles.clone();
        for (probe, position) in by_distance {
            let (place, is_own) = (DVec2::new(position.x, position.z), away(position) == 0.0);
            if is_own || openings.is_open(position, position.with_y(self.height.y)) {
                // Positions come from the plan: finite, and not too small to be told from zero.
                let _ = triangles.insert(Site { position: place, probe: Some(probe), is_own });
            }
        }
        extract(&triangles, &inside(&triangles, &self.parts), &mut level);
        level.block_walls(probes, openings);
        blend_borders(&mut level, probes);
        level
    }
}

/// Per face of spade's: whether it lies in the same part as one of the points.
fn inside(triangles: &Triangles, parts: &[DVec2]) -> Vec<bool> {
    let mut inside = vec![false; triangles.num_all_faces()];
    let mut open: Vec<FixedFaceHandle<InnerTag>> = parts
        .iter()
        .filter_map(|part| match triangles.locate(Point2::new(part.x, part.y)) {
            PositionInTriangulation::OnFace(face) => Some(face),
            PositionInTriangulation::OnEdge(edge) => {
                triangles.directed_edge(edge).face().as_inner().map(|face| face.fix())
            }
            PositionInTriangulation::OnVertex(vertex) => {
                triangles.vertex(vertex).out_edges().find_map(|edge| edge.face().as_inner()).map(|face| face.fix())
            }
            _ => None,
        })
        .collect();
    while let Some(face) = open.pop() {
        if std::mem::replace(&mut inside[face.index()], true) {
            continue;
        }
        let edges = triangles.face(face).adjacent_edges().into_iter().filter(|edge| !edge.is_constraint_edge());
        open.extend(edges.filter_map(|edge| edge.rev().face().as_inner()).map(|face| face.fix()));
    }
    inside
}

fn edges_of(triangle: [u32; 3]) -> [[u32; 2]; 3] {
    EDGE_ENDS.map(|ends| ends.map(|corner| triangle[corner]))
}

pub fn sorted([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// The triangles inside with vertices of their own: corners are one vertex where their triangles share an open edge.
fn extract(triangles: &Triangles, inside: &[bool], level: &mut Level) {
    let faces: Vec<_> = triangles.inner_faces().filter(|face| inside[face.fix().index()]).collect();
    let mut number = vec![u32::MAX; inside.len()];
    (0..).zip(&faces).for_each(|(i, face)| number[face.fix().index()] = i);
    // Corner k of triangle i is corner 3 i + k; each points to another of the same vertex, or to itself.
    let mut same: Vec<usize> = (0..3 * faces.len()).collect();
    let mut neighbours = vec![[None; 3]; faces.len()];
    let mut walls = Vec::new();
    for (i, face) in faces.iter().enumerate() {
        let corners = face.vertices().map(|vertex| vertex.fix());
        for edge in face.adjacent_edges() {
            let place = |vertex| corners.iter().position(|&corner| corner == vertex).unwrap_or(0);
            let (from, to) = (place(edge.from().fix()), place(edge.to().fix()));
            let across = edge.rev().face().as_inner().filter(|face| inside[face.fix().index()]);
            match across.filter(|_| !edge.is_constraint_edge()) {
                Some(face) => {
                    let other = number[face.fix().index()];
                    neighbours[i][3 - from - to] = Some(other);
                    let others = face.vertices().map(|vertex| vertex.fix());
                    for (k, corner) in [from, to].map(|k| (k, corners[k])) {
                        let twin = others.iter().position(|&other| other == corner).unwrap_or(0);
                        join(&mut same, 3 * i + k, 3 * other as usize + twin);
                    }
                }
                None => walls.push([3 * i + from, 3 * i + to]),
            }
        }
    }
    let mut vertex_of = vec![u32::MAX; same.len()];
    for corner in 0..same.len() {
        let root = root(&mut same, corner);
        if vertex_of[root] == u32::MAX {
            vertex_of[root] = level.vertices.len() as u32;
            let site = *faces[corner / 3].vertices()[corner % 3].data();
            let blend = site.probe.map(|probe| Share { probe, weight: 1.0 });
            let blend = blend.into_iter().collect();
            level.vertices.push(Vertex { position: site.position, blend, is_probe: site.is_own });
        }
        vertex_of[corner] = vertex_of[root];
    }
    level.triangles = (0..faces.len()).map(|i| [0, 1, 2].map(|k| vertex_of[3 * i + k])).collect();
    level.neighbours = neighbours;
    level.walls = walls.into_iter().map(|ends| sorted(ends.map(|corner| vertex_of[corner]))).collect();
    level.walls.sort_unstable();
    level.walls.dedup();
}

/// The corner that stands for all that are one vertex with `corner`: the least of them.
fn root(same: &mut [usize], mut corner: usize) -> usize {
    while same[corner] != corner {
        same[corner] = same[same[corner]];
        corner = same[corner];
    }
    corner
}

fn join(same: &mut [usize], a: usize, b: usize) {
    let (a, b) = (root(same, a), root(same, b));
    same[a.max(b)] = a.min(b);
}

/// Gives vertices without a probe a blend of the nearest along edges that are not blocked; parts without any probe take the nearest as the crow
/// flies.
fn blend_borders(level: &mut Level, probes: &[(u32, DVec3)]) {
    let mut links = vec![Vec::new(); level.vertices.len()];
    let edges = level.triangles.iter().flat_map(|&triangle| edges_of(triangle));
    for [a, b] in edges.filter(|&edge| level.blocked.binary_search(&sorted(edge)).is_err()) {
        links[a as usize].push(b);
        links[b as usize].push(a);
    }
    // Per vertex the probes that reach it first, with the lengths of their ways. Bits of a length order as the length does;
    // equal lengths go to the lower probe.
    let mut reached: Vec<Vec<(u32, f64)>> = vec![Vec::new(); level.vertices.len()];
    let own = |vertex: &Vertex| vertex.blend.first().map(|share| share.probe);
    let mut queue: BinaryHeap<Reverse<(u64, u32, u32)>> = (0..)
        .zip(&level.vertices)
        .filter_map(|(i, vertex)| own(vertex).map(|probe| Reverse((0.0_f64.to_bits(), probe, i))))
        .collect();
    while let Some(Reverse((bits, probe, vertex))) = queue.pop() {
        let probes = &mut reached[vertex as usize];
        if probes.len() == BORDER_PROBES || probes.iter().any(|(known, _)| *known == probe) {
            continue;
        }
        let way = f64::from_bits(bits);
        probes.push((probe, way));
        let from = level.vertices[vertex as usize].position;
        for &next in &links[vertex as usize] {
            let length = way + from.distance(level.vertices[next as usize].position);
            queue.push(Reverse((length.to_bits(), probe, next)));
        }
    }
    for (vertex, reached) in level.vertices.iter_mut().zip(reached) {
        if !vertex.blend.is_empty() {
            continue;
        }
        let at = DVec3::new(vertex.position.x, level.height.y, vertex.position.y);
        let crow = || probes.iter().min_by(|a, b| a.1.distance_squared(at).total_cmp(&b.1.distance_squared(at)));
        let least = reached.first().map_or(1.0, |first| first.1);
        let shares = reached.iter().map(|&(probe, way)| Share { probe, weight: (least / way).powi(BORDER_POWER) });
        let mut blend: Vec<Share> = shares.filter(|share| share.weight >= LEAST_SHARE).collect();
        if blend.is_empty() {
            blend.extend(crow().map(|probe| Share { probe: probe.0, weight: 1.0 }));
        }
        let sum: f64 = blend.iter().map(|share| share.weight).sum();
        blend.iter_mut().for_each(|share| share.weight /= sum);
        vertex.blend = blend;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::place::plan::tests::drawn;
    use crate::place::walls::Air;

    const HEIGHT: Height = Height { y: 1.5, floor: 0.0, ceiling: 2.5 };

    fn level(rows: &[&str], probes: &[[f64; 2]]) -> Level {
        let plan = drawn(rows);
        let all: Vec<usize> = (0..plan.lattice.cell_count()).collect();
        let parts = plan.groups(&all).iter().map(|group| plan.lattice.centre(group[0])).collect();
        let probes: Vec<_> = (0..).zip(probes.iter().map(|&[x, z]| DVec3::new(x, 1.5, z))).collect();
        Ground::new(HEIGHT, &Contours::of(&plan), parts).with_probes(&probes, &Air)
    }

    fn corners(level: &Level, triangle: [u32; 3]) -> [DVec2; 3] {
        triangle.map(|vertex| level.vertices[vertex as usize].position)
    }

    fn area(level: &Level) -> f64 {
        let twice = level.triangles.iter().map(|&triangle| {
            let [a, b, c] = corners(level, triangle);
            (b - a).perp_dot(c - a)
        });
        twice.sum::<f64>() / 2.0
    }

    #[test]
    fn triangles_fill_the_free_cells_and_nothing_else() {
        for (rows, cells) in [
            (&["#####", "#...#", "#.#.#", "#####"][..], 5),
            (&["."][..], 1),
            (&["....."][..], 5),
            (&["...", ".#.", "..."][..], 8),
            (&["..|..", "..|.."][..], 8),
            (&[".#", "#."][..], 2),
        ] {
            let level = level(rows, &[[0.13, 0.12]]);
            assert!((area(&level) - f64::from(cells) * 0.0625).abs() < 1e-12, "{rows:?}");
            assert!(level.vertices.iter().all(|vertex| vertex.blend.len() == 1));
        }
    }

    #[test]
    fn no_triangle_crosses_a_thin_wall_and_its_sides_take_their_own_probes() {
        let level = level(&["....|....", "....|....", "....|...."], &[[0.4, 0.3], [1.6, 0.3]]);
        for &triangle in &level.triangles {
            let sides: Vec<f64> = corners(&level, triangle).iter().map(|corner| corner.x - 1.0).collect();
            assert!(sides.iter().all(|x| *x <= 0.0) || sides.iter().all(|x| *x >= 0.0), "{sides:?}");
            let own = u32::from(sides.iter().sum::<f64>() > 0.0);
            for vertex in triangle {
                assert_eq!(level.vertices[vertex as usize].blend[0].probe, own);
            }
        }
        assert!(level.neighbours.iter().flatten().flatten().count() > 0);
    }

    #[test]
    fn neighbours_share_the_edge_that_faces_the_corner() {
        let level = level(&["......", "......", "...###"], &[[0.4, 0.3], [1.1, 0.2], [0.3, 0.6]]);
        for (i, (triangle, neighbours)) in level.triangles.iter().zip(&level.neighbours).enumerate() {
            for (edge, neighbour) in edges_of(*triangle).into_iter().zip(neighbours) {
                match neighbour {
                    Some(other) => {
                        let edges = edges_of(level.triangles[*other as usize]).map(sorted);
                        let across = edges.iter().position(|other| *other == sorted(edge)).unwrap();
                        assert_eq!(level.neighbours[*other as usize][across], Some(i as u32));
                    }
                    None => assert!(level.walls.contains(&sorted(edge))),
                }
            }
        }
    }

    #[test]
    fn a_part_without_a_probe_takes_the_nearest_probe_of_all() {
        let level = level(&["..#..", "..#.."], &[[0.2, 0.3]]);
        assert!(level.vertices.iter().all(|vertex| vertex.blend == [Share { probe: 0, weight: 1.0 }]));
    }

    #[test]
    fn borders_are_blended_of_the_probes_nearest_along_edges() {
        // A corridor one cell wide: ways run along it.
        let level = level(&["................"], &[[0.5, 0.12], [2.0, 0.12], [3.5, 0.12]]);
        for vertex in level.vertices.iter().filter(|vertex| !vertex.is_probe) {
            let sum: f64 = vertex.blend.iter().map(|share| share.weight).sum();
            assert!((sum - 1.0).abs() < 1e-12);
            let nearest = if vertex.position.x < 2.0 { 0 } else { 2 };
            let heaviest = vertex.blend.iter().max_by(|a, b| a.weight.total_cmp(&b.weight)).unwrap();
            assert_eq!(heaviest.probe, nearest, "{vertex:?}");
            // Half a metre against two at the least, by the fourth power.
            assert!(vertex.position.x > 1.0 && vertex.position.x < 3.0 || heaviest.weight == 1.0);
        }
        let level = self::level(&["........"], &[[0.5, 0.12], [1.5, 0.12]]);
        let beside = level.vertices.iter().find(|vertex| vertex.position.x < 0.1 && vertex.position.y < 0.1).unwrap();
        // The way to the other is 1 m longer.
        let way = DVec2::new(0.5, 0.12).distance(beside.position);
        assert!((1.0 + 1.0 / way).powi(-4) < LEAST_SHARE && beside.blend.len() == 1, "{beside:?}");
    }

    #[test]
    fn a_probe_above_stands_in_where_a_level_has_none_and_nowhere_else() {
        let plan = drawn(&["........"; 4]);
        let ground = |y| {
            let height = Height { y, ..HEIGHT };
            Ground::new(height, &Contours::of(&plan), vec![plan.lattice.centre(0)])
        };
        let at = |x: f64, y: f64| DVec3::new(x, y, 0.5);
        let probes = [(0, at(0.5, 0.6)), (1, at(1.5, 0.6)), (2, at(1.5, 1.6)), (3, at(1.0, 1.6)), (4, at(1.0, 2.6))];
        let stands = |y: f64| -> Vec<(u32, bool)> {
            let level = ground(y).with_probes(&probes, &Air);
            let places = level.vertices.iter().filter(|vertex| vertex.position.y == 0.5);
            let mut stands: Vec<_> = places.map(|vertex| (vertex.blend[0].probe, vertex.is_probe)).collect();
            stands.sort_unstable();
            stands
        };
        assert_eq!(stands(0.6), [(0, true), (1, true), (3, false)]);
        assert_eq!(stands(1.6), [(0, false), (2, true), (3, true)]);
        assert_eq!(stands(2.6), [(0, false), (2, false), (4, true)]);
        // Without a probe of its own a level has nothing to add.
        assert_eq!(ground(1.1).with_probes(&probes, &Air), Level::empty(Height { y: 1.1, ..HEIGHT }));
    }
}
