//! A placement as a picture: the plan of every level with its walls, triangles and probes, expected error as colour.

use std::fmt::Write;

use glam::DVec2;
use image::{Rgba, RgbaImage};

use crate::place::plan::Plan;
use crate::place::triangulation::Level;

/// Longer edge of a picture, in pixels.
const EDGE: f64 = 1400.0;

/// Space around and between plans, in pixels.
const MARGIN: f64 = 20.0;

/// Colours of the least and the greatest error, and steps between.
const RAMP: [[u8; 3]; 4] = [[44, 110, 160], [120, 190, 150], [245, 220, 110], [200, 50, 40]];
const MATTER: [u8; 3] = [215, 215, 215];
const OUTSIDE: [u8; 3] = [255, 255, 255];
const WALL: [u8; 3] = [20, 20, 20];
const EDGE_COLOUR: [u8; 3] = [255, 255, 255];
const BLOCKED: [u8; 3] = [170, 0, 170];

/// A piece of the picture, in pixels from its top left.
enum Mark {
    Area(Vec<DVec2>, [u8; 3]),
    Line([DVec2; 2], f64, [u8; 3]),
    Disc(DVec2, f64, [u8; 3]),
}

/// The plans of a placement, drawn once for all formats.
pub struct PlanPicture {
    size: [u32; 2],
    marks: Vec<Mark>,
    greatest: f64,
}

impl PlanPicture {
    /// Draws `levels`, one below the other from the highest down, on their `plans` (a plan without a level of its height is
    /// left out). `errors` are the probes' expected errors.
    pub fn new(levels: &[Level], plans: &[Plan], errors: &[f64]) -> Self {
        let greatest = errors.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let pairs: Vec<(&Level, &Plan)> = levels
            .iter()
            .rev()
            .filter_map(|level| plans.iter().find(|plan| plan.height == level.height.y).map(|plan| (level, plan)))
            .collect();
        let metres =
            |plan: &Plan| DVec2::new(plan.lattice.size[0] as f64, plan.lattice.size[1] as f64) * plan.lattice.cell;
        let widest = pairs.iter().map(|(_, plan)| metres(plan).max_element()).fold(1.0, f64::max);
        let scale = (EDGE - 2.0 * MARGIN) / widest;
        let mut picture = Self { size: [0; 2], marks: Vec::new(), greatest };
        let (mut top, mut width) = (MARGIN, 0.0_f64);
        for (level, plan) in pairs {
            let corner = plan.lattice.corner([0, 0]);
            let pixel = |point: DVec2| DVec2::new(MARGIN, top) + (point - corner) * scale;
            picture.draw(level, plan, errors, scale, pixel);
            top += metres(plan).y * scale + MARGIN;
            width = width.max(metres(plan).x * scale);
        }
        picture.size = [(width + 2.0 * MARGIN).ceil() as u32, top.ceil() as u32];
        picture
    }

    fn draw(&mut self, level: &Level, plan: &Plan, errors: &[f64], scale: f64, pixel: impl Fn(DVec2) -> DVec2) {
        let half = plan.lattice.cell / 2.0;
        for cell in (0..plan.lattice.cell_count()).filter(|&cell| !plan.free[cell]) {
            let centre = plan.lattice.centre(cell);
            let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
            let square = corners.map(|corner| pixel(centre + DVec2::from(corner) * half));
            self.marks.push(Mark::Area(square.to_vec(), MATTER));
        }
        let at = |vertex: u32| pixel(level.vertices[vertex as usize].position);
        let line = |ends: [u32; 2], width: f64, colour| Mark::Line(ends.map(at), width, colour);
        for triangle in &level.triangles {
            let shares = triangle.iter().flat_map(|&vertex| &level.vertices[vertex as usize].blend);
            let error: f64 = shares.map(|share| share.weight * errors[share.probe as usize]).sum();
            self.marks.push(Mark::Area(triangle.map(at).to_vec(), self.colour(error / 3.0)));
        }
        for &[a, b, c] in &level.triangles {
            self.marks.extend([[a, b], [b, c], [c, a]].map(|ends| line(ends, 1.0, EDGE_COLOUR)));
        }
        self.marks.extend(level.blocked.iter().map(|&ends| line(ends, 2.5, BLOCKED)));
        self.marks.extend(level.walls.iter().map(|&ends| line(ends, 2.5, WALL)));
        let radius = (0.12 * scale).clamp(4.0, 12.0);
        for vertex in level.vertices.iter().filter(|vertex| vertex.is_probe) {
            let place = pixel(vertex.position);
            let error = vertex.blend.first().map_or(0.0, |share| errors[share.probe as usize]);
            self.marks.push(Mark::Disc(place, radius, WALL));
            self.marks.push(Mark::Disc(place, radius - 1.5, self.colour(error)));
        }
    }

    fn colour(&self, error: f64) -> [u8; 3] {
        let at = (error / self.greatest).clamp(0.0, 1.0) * (RAMP.len() - 1) as f64;
        let step = (at as usize).min(RAMP.len() - 2);
        let share = at - step as f64;
        let mix = |channel: usize| {
            f64::from(RAMP[step][channel]) * (1.0 - share) + f64::from(RAMP[step + 1][channel]) * share
        };
        [0, 1, 2].map(|channel| mix(channel).round() as u8)
    }

    /// The picture as SVG, its scale of errors in words.
    pub fn svg(&self) -> String {
        let [width, height] = self.size;
        let rgb = |[r, g, b]: [u8; 3]| format!("#{r:02x}{g:02x}{b:02x}");
        let point = |p: &DVec2| format!("{:.1},{:.1}", p.x, p.y);
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"{}\"/>\n\
             <title>Expected relative error: blue 0, red {:.3}. Purple: edges without sight.</title>\n",
            rgb(OUTSIDE),
            self.greatest
        );
        for mark in &self.marks {
            // Writing to a string does not fail.
            let _ = match mark {
                Mark::Area(points, colour) => {
                    let points: Vec<String> = points.iter().map(point).collect();
                    writeln!(svg, "<polygon points=\"{}\" fill=\"{}\"/>", points.join(" "), rgb(*colour))
                }
                Mark::Line([a, b], width, colour) => {
                    let (from, to) = (point(a), point(b));
                    writeln!(svg, "<path d=\"M{from}L{to}\" stroke-width=\"{width}\" stroke=\"{}\"/>", rgb(*colour))
                }
                Mark::Disc(centre, radius, colour) => writeln!(
                    svg,
                    "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{radius:.1}\" fill=\"{}\"/>",
                    centre.x,
                    centre.y,
                    rgb(*colour)
                ),
            };
        }
        svg.push_str("</svg>\n");
        svg
    }

    /// The picture as pixels, without smoothing.
    pub fn image(&self) -> RgbaImage {
        let rgba = |[r, g, b]: [u8; 3]| Rgba([r, g, b, 255]);
        let mut image = RgbaImage::from_pixel(self.size[0].max(1), self.size[1].max(1), rgba(OUTSIDE));
        for mark in &self.marks {
            match mark {
                Mark::Area(points, colour) => fill(&mut image, points, 0.0, rgba(*colour), |p| is_inside(points, p)),
                Mark::Line([a, b], width, colour) => {
                    let near = |p: DVec2| {
                        let along = ((p - *a).dot(*b - *a) / (*b - *a).length_squared().max(1e-9)).clamp(0.0, 1.0);
                        p.distance(*a + (*b - *a) * along) <= width / 2.0
                    };
                    fill(&mut image, &[*a, *b], *width, rgba(*colour), near);
                }
                Mark::Disc(centre, radius, colour) => {
                    fill(&mut image, &[*centre], *radius, rgba(*colour), |p| p.distance(*centre) <= *radius);
                }
            }
        }
        image
    }
}

/// Whether `p` lies in a convex area, whatever its direction of rotation.
fn is_inside(points: &[DVec2], p: DVec2) -> bool {
    let sides = (0..points.len()).map(|i| (points[(i + 1) % points.len()] - points[i]).perp_dot(p - points[i]));
    let (mut left, mut right) = (true, true);
    for side in sides {
        left &= side >= 0.0;
        right &= side <= 0.0;
    }
    left || right
}

/// Colours the pixels whose centres are `inside`, among those within `reach` of the box of `points`.
fn fill(image: &mut RgbaImage, points: &[DVec2], reach: f64, colour: Rgba<u8>, inside: impl Fn(DVec2) -> bool) {
    let low = points.iter().copied().fold(DVec2::INFINITY, DVec2::min) - reach;
    let high = points.iter().copied().fold(DVec2::NEG_INFINITY, DVec2::max) + reach;
    let range = |low: f64, high: f64, size: u32| (low.max(0.0) as u32)..(high.max(0.0).ceil() as u32).min(size);
    for y in range(low.y, high.y, image.height()) {
        for x in range(low.x, high.x, image.width()) {
            if inside(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)) {
                image.put_pixel(x, y, colour);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::place::levels::Height;
    use crate::place::plan::Lattice;
    use crate::place::triangulation::{Share, Vertex};

    #[test]
    fn a_triangle_has_its_probes_colours_and_lies_where_it_is() {
        let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
        let vertex = |(probe, position): (u32, [f64; 2])| Vertex {
            position: position.into(),
            blend: vec![Share { probe, weight: 1.0 }],
            is_probe: false,
        };
        let level = Level {
            height: Height { y: 1.0, floor: 0.0, ceiling: 2.0 },
            vertices: (0..).zip(corners).map(vertex).collect(),
            triangles: vec![[0, 1, 2]],
            neighbours: vec![[None; 3]],
            walls: vec![[1, 2]],
            blocked: Vec::new(),
        };
        let lattice = Lattice { cell: 0.25, first: [0, 0], size: [4, 4] };
        let plan = Plan { lattice, height: 1.0, free: vec![true; 16], open: [vec![true; 16], vec![true; 16]] };
        let picture = PlanPicture::new(&[level], &[plan], &[0.2, 0.2, 0.2]);
        let image = picture.image();
        assert_eq!(image.dimensions(), (1400, 1400));
        let [r, g, b] = RAMP[3];
        assert_eq!(image.get_pixel(200, 200).0, [r, g, b, 255]);
        assert_eq!(image.get_pixel(1300, 1300).0, [255; 4]);
        assert_eq!(image.get_pixel(700, 700).0, [20, 20, 20, 255]);
        assert!(picture.svg().contains("red 0.200") && picture.svg().ends_with("</svg>\n"));
    }
}
