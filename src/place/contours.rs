//! The borders of a plan's free space, as lines between cells.
//!
//! A border runs where light does not pass from a free cell to the next: around blocked space, and along a wall that is
//! thinner than a cell.

use glam::DVec2;

use super::plan::Plan;

/// How far a simplified border may leave the lines between cells, in cells. Cell centres are half a cell away from
/// every border: below that no centre changes sides.
const TOLERANCE: f64 = 0.45;

/// Borders as straight pieces between points.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Contours {
    /// Points in the plan, x and z, in metres.
    pub points: Vec<DVec2>,
    /// Pieces, by indices of their ends.
    pub edges: Vec<[usize; 2]>,
}

impl Contours {
    /// The borders of all free cells of `plan`.
    pub fn of(plan: &Plan) -> Self {
        let graph = Graph::of(plan);
        let mut point_of = vec![usize::MAX; graph.edges.len()];
        let mut contours = Self::default();
        for chain in graph.chains() {
            let places: Vec<DVec2> = chain.iter().map(|&corner| plan.lattice.corner(graph.at(corner))).collect();
            let kept = simplified(&places, TOLERANCE * plan.lattice.cell);
            let kept: Vec<usize> = kept
                .into_iter()
                .map(|i| {
                    let point = &mut point_of[chain[i]];
                    if *point == usize::MAX {
                        *point = contours.points.len();
                        contours.points.push(places[i]);
                    }
                    *point
                })
                .collect();
            contours.edges.extend(kept.windows(2).map(|ends| [ends[0], ends[1]]));
        }
        contours
    }
}

/// Corners of cells and the borders between them.
struct Graph {
    /// Corners along x.
    width: usize,
    /// Per corner: whether a border leaves toward +X, +Z, -X, -Z.
    edges: Vec<[bool; 4]>,
}

impl Graph {
    fn of(plan: &Plan) -> Self {
        let [columns, rows] = plan.lattice.size;
        let width = columns + 1;
        let mut edges = vec![[false; 4]; width * (rows + 1)];
        for z in 0..rows {
            for x in 0..columns {
                let cell = z * columns + x;
                if !plan.free[cell] {
                    continue;
                }
                let corner = z * width + x;
                // Each side: whether light passes, the side's first corner, and its direction.
                let sides = [
                    (x > 0 && plan.open[0][cell - 1], corner, 1),
                    (plan.open[0][cell], corner + 1, 1),
                    (z > 0 && plan.open[1][cell - columns], corner, 0),
                    (plan.open[1][cell], corner + width, 0),
                ];
                for (_, from, direction) in sides.into_iter().filter(|side| !side.0) {
                    edges[from][direction] = true;
                    edges[from + [1, width][direction]][direction + 2] = true;
                }
            }
        }
        Self { width, edges }
    }

    fn at(&self, corner: usize) -> [usize; 2] {
        [corner % self.width, corner / self.width]
    }

    fn step(&self, corner: usize, direction: usize) -> usize {
        match direction {
            0 => corner + 1,
            1 => corner + self.width,
            2 => corner - 1,
            _ => corner - self.width,
        }
    }

    /// Paths from one corner where other than two borders meet to the next, then closed loops, whose first corner is
    /// also their last.
    fn chains(&self) -> Vec<Vec<usize>> {
        let mut left = self.edges.clone();
        let mut chains = Vec::new();
        let degree = |corner: usize| self.edges[corner].iter().filter(|edge| **edge).count();
        let mut walk = |start: usize, direction: usize, left: &mut Vec<[bool; 4]>| {
            let mut chain = vec![start];
            let (mut corner, mut direction) = (start, direction);
            loop {
                left[corner][direction] = false;
                corner = self.step(corner, direction);
                left[corner][(direction + 2) % 4] = false;
                chain.push(corner);
                match (0..4).find(|&next| left[corner][next]) {
                    Some(next) if corner != start && degree(corner) == 2 => direction = next,
                    _ => break,
                }
            }
            chains.push(chain);
        };
        for ends_only in [true, false] {
            for start in 0..self.edges.len() {
                for direction in 0..4 {
                    if left[start][direction] && (!ends_only || degree(start) != 2) {
                        walk(start, direction, &mut left);
                    }
                }
            }
        }
        chains
    }
}

/// Indices of the points that a line needs to stay within `tolerance` of all (Ramer 1972, Douglas & Peucker 1973). The
/// ends stay; of a closed line also the point farthest from its beginning.
fn simplified(points: &[DVec2], tolerance: f64) -> Vec<usize> {
    let last = points.len() - 1;
    let mut kept = vec![false; points.len()];
    kept[0] = true;
    kept[last] = true;
    let mut open = vec![(0, last)];
    while let Some((from, to)) = open.pop() {
        let (a, b) = (points[from], points[to]);
        let distance = |i: usize| {
            let along =
                if a == b { 0.0 } else { ((points[i] - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0) };
            points[i].distance(a + (b - a) * along)
        };
        let farthest = (from + 1..to).max_by(|&i, &j| distance(i).total_cmp(&distance(j)).then(j.cmp(&i)));
        if let Some(farthest) = farthest.filter(|&i| distance(i) > tolerance) {
            kept[farthest] = true;
            open.extend([(from, farthest), (farthest, to)]);
        }
    }
    (0..points.len()).filter(|&i| kept[i]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::place::plan::tests::drawn;

    /// Length of all borders, in cells.
    fn length(contours: &Contours) -> f64 {
        contours.edges.iter().map(|&[a, b]| contours.points[a].distance(contours.points[b])).sum::<f64>() / 0.25
    }

    #[test]
    fn a_room_is_four_walls() {
        let contours = Contours::of(&drawn(&["#####", "#...#", "#...#", "#####"]));
        assert_eq!((contours.points.len(), contours.edges.len()), (4, 4));
        assert_eq!(length(&contours), 10.0);
    }

    #[test]
    fn a_pillar_and_the_edge_of_the_lattice_are_borders() {
        let contours = Contours::of(&drawn(&[".....", "..#..", "....."]));
        assert_eq!((contours.points.len(), contours.edges.len()), (8, 8));
        assert_eq!(length(&contours), 16.0 + 4.0);
    }

    #[test]
    fn a_thin_wall_is_one_line_between_its_rooms() {
        let contours = Contours::of(&drawn(&["..|..", "..|..", "...."]));
        // Its upper end meets the outer border, its lower end is free.
        assert_eq!((contours.points.len(), contours.edges.len()), (6, 6));
        assert_eq!(length(&contours), 14.0 + 2.0);
    }

    #[test]
    fn a_chessboard_corner_and_one_cell_alone_have_their_borders() {
        assert_eq!(length(&Contours::of(&drawn(&[".#", "#."]))), 8.0);
        assert_eq!(length(&Contours::of(&drawn(&["."]))), 4.0);
        assert_eq!(Contours::of(&drawn(&["#"])), Contours::default());
    }
}
