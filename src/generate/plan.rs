//! The building: rooms on a grid, joined by doorways, each with its own colours and furniture.

use glam::{DVec2, DVec3};

use super::paint::{Lamp, Paint, from_hue};
use super::random::Random;

/// Distance between the walls' middle planes along x and z, and the rooms' height, in metres.
pub const ROOM: DVec3 = DVec3::new(5.0, 2.7, 4.2);
const WALL_THICKNESS: f64 = 0.14;
const DOOR: DVec2 = DVec2::new(0.95, 2.05);

/// What Gaussians cover.
#[derive(Debug, Clone, Copy)]
pub enum Shape {
    /// A rectangle: its lower left corner and its edges to the right and up. Their cross product is the normal.
    Rectangle(DVec3, [DVec3; 2]),
    /// An ellipsoid filled with Gaussians of any orientation from a share of its radius outward.
    Blob {
        /// Centre, in metres.
        centre: DVec3,
        /// Radii along x, y, z, in metres.
        radii: DVec3,
        /// Share of the radius inside of which nothing lies.
        hollow: f64,
    },
}

/// One painted piece of the building.
#[derive(Debug, Clone, Copy)]
pub struct Part {
    /// Where its Gaussians lie.
    pub shape: Shape,
    /// Their colour.
    pub paint: Paint,
    /// Index of the room whose lamp lights it.
    pub room: usize,
    /// Factor on the sizes of its Gaussians: small where there is detail.
    pub grain: f64,
    /// Factor on their opacities.
    pub opacity: f64,
    /// Its share of the Gaussians, relative to other parts': covered square metres over grain squared.
    pub weight: f64,
}

/// A whole building.
#[derive(Debug, Default)]
pub struct Building {
    /// Everything that Gaussians cover.
    pub parts: Vec<Part>,
    /// One lamp per room.
    pub lamps: Vec<Lamp>,
}

impl Building {
    /// `rooms` along x and z, from the origin towards +X and +Z, with the floor at y = 0; no wall between those `joined`.
    pub fn new(rooms: [usize; 2], joined: &[[[usize; 2]; 2]], seed: u64) -> Self {
        let mut building = Self::default();
        for z in 0..rooms[1] {
            for x in 0..rooms[0] {
                building.add_room(rooms, joined, [x, z], seed);
            }
        }
        building.add_strays(rooms);
        building
    }

    fn add_room(&mut self, rooms: [usize; 2], joined: &[[[usize; 2]; 2]], [x, z]: [usize; 2], seed: u64) {
        let room = self.lamps.len();
        let mut random = Random::new(seed, room as u64);
        let is_joined = |other: Option<[usize; 2]>| {
            other.is_some_and(|other| joined.contains(&[[x, z], other]) || joined.contains(&[other, [x, z]]))
        };
        // Toward -X, +X, -Z, +Z.
        let open = [
            is_joined(x.checked_sub(1).map(|x| [x, z])),
            is_joined(Some([x + 1, z])),
            is_joined(z.checked_sub(1).map(|z| [x, z])),
            is_joined(Some([x, z + 1])),
        ];
        let inset = open.map(|open| if open { 0.0 } else { WALL_THICKNESS / 2.0 });
        let corner = DVec3::new(x as f64, 0.0, z as f64) * ROOM;
        let low = corner + DVec3::new(inset[0], 0.0, inset[2]);
        let high = corner + ROOM - DVec3::new(inset[1], 0.0, inset[3]);
        // From the middle between the walls to the middle of the room's cell, where doorways are.
        let to_cell = DVec3::new(inset[1] - inset[0], 0.0, inset[3] - inset[2]) / 2.0;
        let centre = (low + high) / 2.0;

        // Hues a golden section apart differ for any number of rooms.
        let hue = (0.05 + 0.618_034 * room as f64 + (seed % 97) as f64 / 97.0).fract();
        let wall = from_hue(hue, 0.5, 0.8);
        let accent = from_hue(hue + 0.45, 0.7, 0.7);
        self.lamps.push(Lamp {
            position: DVec3::new(centre.x, high.y - 0.45, centre.z),
            tint: from_hue(random.range(0.08, 0.16), 0.25, 1.0),
        });

        let floor = match room % 3 {
            0 => Paint::Planks(DVec3::new(0.55, 0.38, 0.24), 0.18),
            1 => Paint::Tiles([DVec3::splat(0.72), wall * 0.5], 0.5),
            _ => Paint::Plain(accent * 0.6 + 0.1),
        };
        let [w, h, d] = (high - low).to_array();
        self.rectangle(low, [DVec3::Z * d, DVec3::X * w], floor, room, 1.0);
        self.rectangle(low + DVec3::Y * h, [DVec3::X * w, DVec3::Z * d], Paint::Plain(DVec3::splat(0.85)), room, 1.0);

        let paint = if room.is_multiple_of(2) { Paint::Plain(wall) } else { Paint::Stripes([wall, wall * 0.82], 0.25) };
        // Each wall: its lower left corner seen from inside, its direction to the right, and the neighbour behind it.
        let walls = [
            (DVec3::new(low.x, 0.0, high.z), DVec3::NEG_Z, d, x > 0, [x, z, 0]),
            (DVec3::new(high.x, 0.0, low.z), DVec3::Z, d, x + 1 < rooms[0], [x + 1, z, 0]),
            (low, DVec3::X, w, z > 0, [x, z, 1]),
            (high.with_y(0.0), DVec3::NEG_X, w, z + 1 < rooms[1], [x, z + 1, 1]),
        ];
        for ((origin, right, length, has_neighbour, [edge_x, edge_z, axis]), open) in walls.into_iter().zip(open) {
            if open {
                continue;
            }
            let positive = right.element_sum() > 0.0;
            if has_neighbour {
                // Both rooms of a doorway see it at the same place; neighbouring doorways do not line up.
                let offset = if (edge_x + edge_z + axis).is_multiple_of(2) { 0.55 } else { -0.55 };
                let middle = length / 2.0 + to_cell.dot(right);
                let left = middle - DOOR.x / 2.0 + if positive { offset } else { -offset };
                self.wall_with_door(origin, right, length, left, paint, room);
                if !positive {
                    self.door_frame(origin + right * left, right, room);
                }
            } else {
                self.rectangle(origin, [right * length, DVec3::Y * h], paint, room, 1.0);
                let inward = right.cross(DVec3::Y) * 0.03;
                if random.unit() < 0.6 {
                    let middle = origin + inward + right * (length / 2.0 - 0.85) + DVec3::Y * 0.95;
                    self.rectangle(middle, [right * 1.7, DVec3::Y * 1.2], Paint::Window, room, 0.6);
                }
                let picture = origin + inward + right * 0.3 + DVec3::Y * 1.2;
                let colours = [from_hue(random.unit(), 0.5, 0.9), accent, from_hue(random.unit(), 0.6, 0.5)];
                self.rectangle(picture, [right * 0.75, DVec3::Y * 0.55], Paint::Picture(colours), room, 0.4);
            }
        }
        self.furnish(room, [low, high], accent, &mut random);
    }

    fn wall_with_door(&mut self, origin: DVec3, right: DVec3, length: f64, left: f64, paint: Paint, room: usize) {
        let beside = left + DOOR.x;
        let up = DVec3::Y * ROOM.y;
        self.rectangle(origin, [right * left, up], paint, room, 1.0);
        self.rectangle(origin + right * beside, [right * (length - beside), up], paint, room, 1.0);
        let lintel = origin + right * left + DVec3::Y * DOOR.y;
        self.rectangle(lintel, [right * DOOR.x, DVec3::Y * (ROOM.y - DOOR.y)], paint, room, 1.0);
    }

    /// Sill, jambs and head of a doorway through the wall behind `foot`, its lower left corner.
    fn door_frame(&mut self, foot: DVec3, right: DVec3, room: usize) {
        let through = DVec3::Y.cross(right) * WALL_THICKNESS;
        let [across, up] = [right * DOOR.x, DVec3::Y * DOOR.y];
        let paint = Paint::Plain(DVec3::new(0.9, 0.88, 0.82));
        self.rectangle(foot, [across, through], paint, room, 0.7);
        self.rectangle(foot + up, [through, across], paint, room, 0.7);
        self.rectangle(foot, [through, up], paint, room, 0.7);
        self.rectangle(foot + across, [up, through], paint, room, 0.7);
    }

    /// Furniture along the corners, so that doorways and the middle, where probes stand, stay free.
    fn furnish(&mut self, room: usize, [low, high]: [DVec3; 2], accent: DVec3, random: &mut Random) {
        // Rooms are mirrored at random; `at` takes metres from the room's (mirrored) corner.
        let mirror = [random.unit() < 0.5, random.unit() < 0.5];
        let at = |x: f64, y: f64, z: f64| {
            let x = if mirror[0] { high.x - x } else { low.x + x };
            let z = if mirror[1] { high.z - z } else { low.z + z };
            DVec3::new(x, y, z)
        };
        let [w, h, d] = (high - low).to_array();
        let wood = Paint::Plain(from_hue(random.range(0.05, 0.1), 0.55, random.range(0.35, 0.75)));

        let [table_x, table_z] = [w * 0.5 - 0.6, d * 0.5 - 0.45];
        self.cuboid([at(table_x, 0.7, table_z), at(table_x + 1.2, 0.75, table_z + 0.9)], wood, room, 0.6);
        for [x, z] in [[0.05, 0.05], [1.1, 0.05], [0.05, 0.8], [1.1, 0.8]] {
            let [x, z] = [table_x + x, table_z + z];
            self.cuboid([at(x, 0.0, z), at(x + 0.05, 0.7, z + 0.05)], wood, room, 0.5);
        }
        for _ in 0..6 {
            let [x, z] = [table_x + random.range(0.1, 1.0), table_z + random.range(0.1, 0.7)];
            let size = DVec3::new(random.range(0.05, 0.15), random.range(0.03, 0.2), random.range(0.05, 0.15));
            let paint = Paint::Plain(from_hue(random.unit(), 0.8, 0.9));
            self.cuboid([at(x, 0.75, z), at(x + size.x, 0.75 + size.y, z + size.z)], paint, room, 0.35);
        }

        let shelf = 1.1;
        for board in 0..5 {
            let y = 0.45 * f64::from(board);
            self.cuboid([at(0.02, y, 0.02), at(shelf, y + 0.03, 0.3)], wood, room, 0.5);
            let mut x = 0.04;
            while board < 4 && x < shelf - 0.15 {
                let width = random.range(0.03, 0.1);
                let book = Paint::Plain(from_hue(random.unit(), 0.6, random.range(0.3, 0.9)));
                let top = y + 0.03 + random.range(0.2, 0.36);
                self.cuboid([at(x, y + 0.03, 0.04), at(x + width, top, 0.26)], book, room, 0.45);
                x += width + random.range(0.005, 0.12);
            }
        }

        let sofa = Paint::Plain(accent);
        self.cuboid([at(w - 1.5, 0.08, 0.1), at(w - 0.1, 0.42, 0.9)], sofa, room, 0.8);
        self.cuboid([at(w - 1.5, 0.42, 0.1), at(w - 0.1, 0.85, 0.3)], sofa, room, 0.8);

        let leaves = Paint::Leaves(DVec3::new(0.22, 0.5, 0.16));
        self.cuboid([at(0.3, 0.0, d - 0.7), at(0.7, 0.4, d - 0.3)], Paint::Plain(accent * 0.7), room, 0.6);
        self.blob(at(0.5, 0.9, d - 0.5), DVec3::new(0.4, 0.55, 0.4), 0.0, leaves, room, 0.6);

        let [x, z] = [w - 0.5, d - 0.5];
        let glow = Paint::Glow(DVec3::new(1.3, 1.15, 0.85));
        self.cuboid([at(x - 0.02, 0.0, z - 0.02), at(x + 0.02, 1.4, z + 0.02)], wood, room, 0.5);
        self.blob(at(x, 1.5, z), DVec3::splat(0.18), 0.9, glow, room, 0.5);
        self.blob(at(w / 2.0, h - 0.35, d / 2.0), DVec3::splat(0.2), 0.9, glow, room, 0.5);

        // Haze: captures leave faint Gaussians in the air.
        let air = Part {
            shape: Shape::Blob { centre: (low + high) / 2.0, radii: (high - low) * 0.48, hollow: 0.0 },
            paint: Paint::Leaves(DVec3::splat(0.6)),
            room,
            grain: 1.0,
            opacity: 0.15,
            weight: 0.015 * w * h * d,
        };
        self.parts.push(air);
    }

    /// Huge faint Gaussians far outside, as every capture has.
    fn add_strays(&mut self, rooms: [usize; 2]) {
        let extent = DVec3::new(rooms[0] as f64, 1.0, rooms[1] as f64) * ROOM;
        let total: f64 = self.parts.iter().map(|part| part.weight).sum();
        self.parts.push(Part {
            shape: Shape::Blob { centre: extent / 2.0, radii: extent / 2.0 + 80.0, hollow: 0.6 },
            paint: Paint::Leaves(DVec3::new(0.5, 0.6, 0.7)),
            room: 0,
            grain: 120.0,
            opacity: 0.1,
            weight: 2e-5 * total,
        });
    }

    fn rectangle(&mut self, corner: DVec3, edges: [DVec3; 2], paint: Paint, room: usize, grain: f64) {
        let area = edges[0].cross(edges[1]).length();
        let shape = Shape::Rectangle(corner, edges);
        self.parts.push(Part { shape, paint, room, grain, opacity: 1.0, weight: area / (grain * grain) });
    }

    /// The six sides of the box between any two opposite corners.
    fn cuboid(&mut self, corners: [DVec3; 2], paint: Paint, room: usize, grain: f64) {
        let low = corners[0].min(corners[1]);
        let size = corners[0].max(corners[1]) - low;
        let [x, y, z] = [DVec3::X * size.x, DVec3::Y * size.y, DVec3::Z * size.z];
        for (foot, edges) in
            [(low, [y, x]), (low + z, [x, y]), (low, [z, y]), (low + x, [y, z]), (low, [x, z]), (low + y, [z, x])]
        {
            self.rectangle(foot, edges, paint, room, grain);
        }
    }

    fn blob(&mut self, centre: DVec3, radii: DVec3, hollow: f64, paint: Paint, room: usize, grain: f64) {
        let surface = 4.0 * std::f64::consts::PI * radii.x * radii.y;
        let shape = Shape::Blob { centre, radii, hollow };
        self.parts.push(Part { shape, paint, room, grain, opacity: 1.0, weight: surface / (grain * grain) });
    }
}
