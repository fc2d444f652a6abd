//! What surfaces look like: patterns in display-encoded colour, and the light of a room.

use glam::{DVec2, DVec3};

use super::random::Random;

/// A pattern over a surface, in display-encoded colour.
#[derive(Debug, Clone, Copy)]
pub enum Paint {
    /// One colour.
    Plain(DVec3),
    /// Vertical bands of two colours, so many metres wide.
    Stripes([DVec3; 2], f64),
    /// A checkerboard of two colours, tiles of so many metres.
    Tiles([DVec3; 2], f64),
    /// Floor boards of so many metres, each a little lighter or darker.
    Planks(DVec3, f64),
    /// A framed picture: sky, disc, hills.
    Picture([DVec3; 3]),
    /// A window with glazing bars onto a bright sky; shines by itself.
    Window,
    /// A lamp; shines by itself.
    Glow(DVec3),
    /// Every Gaussian its own shade of one colour.
    Leaves(DVec3),
}

impl Paint {
    /// Whether the colour is light of its own, which the room's lamp does not change.
    pub fn shines(&self) -> bool {
        matches!(self, Self::Window | Self::Glow(_))
    }

    /// Colour at `at` metres from the lower left corner of a surface of `size` metres.
    pub fn colour(&self, at: DVec2, size: DVec2, random: &mut Random) -> DVec3 {
        let share = at / size;
        match *self {
            Self::Plain(colour) | Self::Glow(colour) => colour,
            Self::Stripes(colours, width) => colours[parity(at.x / width)],
            Self::Tiles(colours, width) => colours[parity((at.x / width).floor() + (at.y / width).floor())],
            Self::Planks(colour, width) => colour * Random::new(0, (at.y / width) as u64).range(0.75, 1.1),
            Self::Picture([sky, disc, hills]) => {
                let rim = share.min(1.0 - share) * size;
                if rim.min_element() < 0.05 {
                    DVec3::splat(0.12)
                } else if share.y < 0.35 + 0.12 * (share.x * 9.0).sin() {
                    hills
                } else if ((share - DVec2::new(0.65, 0.68)) * size).length() < 0.16 * size.min_element() {
                    disc
                } else {
                    sky * (1.2 - 0.5 * share.y)
                }
            }
            Self::Window => {
                let bars = (share * 2.0).fract();
                if bars.min(1.0 - bars).cmplt(DVec2::new(0.04, 0.06)).any() {
                    DVec3::splat(0.8)
                } else {
                    DVec3::new(0.85, 1.0, 1.2).lerp(DVec3::new(1.25, 1.2, 1.1), 1.0 - share.y)
                }
            }
            Self::Leaves(colour) => colour * random.range(0.5, 1.4),
        }
    }
}

fn parity(cell: f64) -> usize {
    (cell.floor() as i64).rem_euclid(2) as usize
}

/// A colour by hue in [0, 1), saturation and value.
pub fn from_hue(hue: f64, saturation: f64, value: f64) -> DVec3 {
    let ramp = DVec3::new(0.0, 2.0 / 3.0, 1.0 / 3.0) + hue;
    let pure = ((ramp.fract() * 6.0 - 3.0).abs() - 1.0).clamp(DVec3::ZERO, DVec3::ONE);
    DVec3::ONE.lerp(pure, saturation) * value
}

/// A room's lamp, for the shading that a capture of a lit room would hold.
#[derive(Debug, Clone, Copy)]
pub struct Lamp {
    /// Position, in metres.
    pub position: DVec3,
    /// Tint of its light.
    pub tint: DVec3,
}

impl Lamp {
    /// Factor on a painted colour at `point` with unit `normal`: ambient light, and the lamp's, falling with
    /// distance and angle.
    pub fn shade(&self, point: DVec3, normal: DVec3) -> DVec3 {
        let to_lamp = self.position - point;
        let distance = to_lamp.length().max(0.1);
        // Wrapped cosine: light bounces around a room, so that nothing is black.
        let facing = 0.5 + 0.5 * normal.dot(to_lamp / distance);
        DVec3::splat(0.45) + self.tint * (1.0 * facing / (1.0 + distance * distance / 9.0))
    }

    /// Direction from a viewer to `point` in which a glossy surface shows the lamp.
    pub fn highlight(&self, point: DVec3, normal: DVec3) -> DVec3 {
        let incoming = (point - self.position).try_normalize().unwrap_or(DVec3::NEG_Y);
        -incoming.reflect(normal)
    }
}
