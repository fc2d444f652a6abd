//! The triangulation of a level: what a runtime blends by.
//!
//! A constrained Delaunay triangulation of the probes and of the borders of free space; triangles outside of the free space
//! are left out. A border has no probe, so every vertex states its own blend: a probe's is the probe, a border's is the
//! probe that is nearest along the edges of the triangulation, so that it never reaches through a wall. Where a wall
//! thinner than a cell passes through a vertex, each of its sides has a vertex of its own.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use glam::{DVec2, DVec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use spade::handles::{FixedFaceHandle, InnerTag};
use spade::{ConstrainedDelaunayTriangulation, HasPosition, Point2, PositionInTriangulation, Triangulation};

use super::contours::Contours;
use super::levels::Height;

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
    /// Whether a probe stands here.
    pub is_probe: bool,
}

/// The probes of one height, and how they are blended between.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Level {
    /// Where the level's probes stand and which heights it serves.
    pub height: Height,
    /// Corners of the triangles.
    pub vertices: Vec<Vertex>,
    /// Triangles in the plan, by their vertices. No triangle crosses a wall.
    pub triangles: Vec<[u32; 3]>,
    /// Per triangle and corner: the triangle across the edge that is opposite to the corner; none behind a wall.
    pub neighbours: Vec<[Option<u32>; 3]>,
    /// Edges, by their vertices, that are borders of the free space.
    pub walls: Vec<[u32; 2]>,
    /// Edges, by their vertices, whose probes do not see each other all the same.
    pub blocked: Vec<[u32; 2]>,
}

/// A point of the plan on its way into spade.
#[derive(Debug, Clone, Copy)]
struct Site {
    position: DVec2,
    probe: Option<u32>,
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
        let insert = |triangles: &mut Triangles, position: DVec2| triangles.insert(Site { position, probe: None }).ok();
        let handles: Vec<_> = contours.points.iter().map(|&point| insert(&mut triangles, point)).collect();
        for &[from, to] in &contours.edges {
            if let (Some(from), Some(to)) = (handles[from], handles[to]) {
                // Simplified borders can touch where they part; a split keeps both.
                let split = |at: Point2<f64>| Site { position: DVec2::new(at.x, at.y), probe: None };
                triangles.add_constraint_and_split(from, to, split);
            }
        }
        Self { height, triangles, parts }
    }

    /// Triangulates with `probes`, given by index and position. `sees` says whether two of them see each other.
    pub fn with_probes(&self, probes: &[(u32, DVec3)], mut sees: impl FnMut(u32, u32) -> bool) -> Level {
        let mut triangles = self.triangles.clone();
        for &(probe, position) in probes {
            // Positions come from the plan: finite, and not too small to be told from zero.
            let _ = triangles.insert(Site { position: DVec2::new(position.x, position.z), probe: Some(probe) });
        }
        let inside = inside(&triangles, &self.parts);
        let mut level = extract(&triangles, &inside, self.height);
        let probe_of: BTreeMap<u32, u32> = (0..)
            .zip(&level.vertices)
            .filter_map(|(i, vertex)| vertex.blend.first().map(|share| (i, share.probe)))
            .collect();
        blend_borders(&mut level, probes);
        let mut edges: Vec<[u32; 2]> = level.triangles.iter().flat_map(|&t| edges_of(t)).map(sorted).collect();
        edges.sort_unstable();
        edges.dedup();
        edges.retain(|[a, b]| match (probe_of.get(a), probe_of.get(b)) {
            (Some(&a), Some(&b)) => !sees(a, b),
            _ => false,
        });
        level.blocked = edges;
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

fn edges_of([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[b, c], [c, a], [a, b]]
}

fn sorted([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// The triangles inside with vertices of their own: corners are one vertex where their triangles share an open edge.
fn extract(triangles: &Triangles, inside: &[bool], height: Height) -> Level {
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
    let mut vertices = Vec::new();
    for corner in 0..same.len() {
        let root = root(&mut same, corner);
        if vertex_of[root] == u32::MAX {
            vertex_of[root] = vertices.len() as u32;
            let site = *faces[corner / 3].vertices()[corner % 3].data();
            let blend = site.probe.map(|probe| Share { probe, weight: 1.0 });
            let (position, is_probe) = (site.position, blend.is_some());
            vertices.push(Vertex { position, blend: blend.into_iter().collect(), is_probe });
        }
        vertex_of[corner] = vertex_of[root];
    }
    let triangles = (0..faces.len()).map(|i| [0, 1, 2].map(|k| vertex_of[3 * i + k])).collect();
    let mut walls: Vec<[u32; 2]> = walls.into_iter().map(|ends| sorted(ends.map(|corner| vertex_of[corner]))).collect();
    walls.sort_unstable();
    walls.dedup();
    Level { height, vertices, triangles, neighbours, walls, blocked: Vec::new() }
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

/// Gives vertices without a probe that of the nearest along edges; parts without any probe take the nearest as the crow
/// flies.
fn blend_borders(level: &mut Level, probes: &[(u32, DVec3)]) {
    let mut links = vec![Vec::new(); level.vertices.len()];
    for [a, b] in level.triangles.iter().flat_map(|&triangle| edges_of(triangle)) {
        links[a as usize].push(b);
        links[b as usize].push(a);
    }
    // Bits of a length order as the length does; equal lengths go to the lower probe.
    let mut nearest: Vec<Option<u32>> = vec![None; level.vertices.len()];
    let own = |vertex: &Vertex| vertex.blend.first().map(|share| share.probe);
    let mut queue: BinaryHeap<Reverse<(u64, u32, u32)>> = (0..)
        .zip(&level.vertices)
        .filter_map(|(i, vertex)| own(vertex).map(|probe| Reverse((0.0_f64.to_bits(), probe, i))))
        .collect();
    while let Some(Reverse((bits, probe, vertex))) = queue.pop() {
        if nearest[vertex as usize].is_some() {
            continue;
        }
        nearest[vertex as usize] = Some(probe);
        let from = level.vertices[vertex as usize].position;
        for &next in &links[vertex as usize] {
            let length = f64::from_bits(bits) + from.distance(level.vertices[next as usize].position);
            queue.push(Reverse((length.to_bits(), probe, next)));
        }
    }
    for (vertex, nearest) in level.vertices.iter_mut().zip(nearest) {
        let at = DVec3::new(vertex.position.x, level.height.y, vertex.position.y);
        let crow = || probes.iter().min_by(|a, b| a.1.distance_squared(at).total_cmp(&b.1.distance_squared(at)));
        let probe = nearest.or_else(|| crow().map(|probe| probe.0));
        vertex.blend = probe.map(|probe| Share { probe, weight: 1.0 }).into_iter().collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::place::plan::tests::drawn;

    const HEIGHT: Height = Height { y: 1.5, floor: 0.0, ceiling: 2.5 };

    fn level(rows: &[&str], probes: &[[f64; 2]]) -> Level {
        let plan = drawn(rows);
        let all: Vec<usize> = (0..plan.lattice.cell_count()).collect();
        let parts = plan.groups(&all).iter().map(|group| plan.lattice.centre(group[0])).collect();
        let probes: Vec<_> = (0..).zip(probes.iter().map(|&[x, z]| DVec3::new(x, 1.5, z))).collect();
        Ground::new(HEIGHT, &Contours::of(&plan), parts).with_probes(&probes, |_, _| true)
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
    fn an_edge_whose_probes_do_not_see_each_other_is_blocked() {
        let plan = drawn(&["........"; 4]);
        let ground = Ground::new(HEIGHT, &Contours::of(&plan), vec![plan.lattice.centre(0)]);
        let probes = [(0, DVec3::new(0.5, 1.5, 0.5)), (1, DVec3::new(1.5, 1.5, 0.52))];
        assert_eq!(ground.with_probes(&probes, |_, _| true).blocked.len(), 0);
        let level = ground.with_probes(&probes, |_, _| false);
        let [[a, b]] = level.blocked[..] else { panic!("{:?}", level.blocked) };
        let ends = [a, b].map(|vertex| level.vertices[vertex as usize].blend[0].probe);
        assert!(ends == [0, 1] || ends == [1, 0]);
    }
}
