//! Light that tells where it comes from, to see whether a consumer looks a cubemap up as it should.

use glam::{DVec3, Vec3};

use crate::trace::{Face, Radiance, Tile, TileTracer};

/// Rows of the letters and signs of the faces' names, 5 dots wide, the leftmost in the highest bit.
const GLYPHS: [(char, [u8; 7]); 5] = [
    ('+', [0, 0b00100, 0b00100, 0b11111, 0b00100, 0b00100, 0]),
    ('-', [0, 0, 0, 0b11111, 0, 0, 0]),
    ('X', [0b10001, 0b10001, 0b01010, 0b00100, 0b01010, 0b10001, 0b10001]),
    ('Y', [0b10001, 0b10001, 0b01010, 0b00100, 0b00100, 0b00100, 0b00100]),
    ('Z', [0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b10000, 0b11111]),
];

/// An arrow that points up, with a barb on its right side only: turned and mirrored ones differ.
const ARROW: [u8; 7] = [0b00100, 0b00110, 0b00111, 0b00100, 0b00100, 0b00100, 0b00100];

/// Dots along an edge of a face.
const DOTS: f64 = 24.0;

/// The radiance from the unit direction d is (d + 1) / 2, and [`Calibration::MARK`] times as much where the name of the face
/// and an arrow to its upper edge are written, as seen from the probe. Everything is [`Calibration::DISTANCE`] away.
#[derive(Debug, Clone, Copy)]
pub struct Calibration;

impl Calibration {
    /// How much brighter marks are. What is not marked is at most 1, and the brightest channel of a mark is at least 1.69,
    /// so that either can be told from a texel alone.
    pub const MARK: f32 = 8.0;

    /// Distance of everything, in metres.
    pub const DISTANCE: f32 = 1.0;

    /// Radiance from the unit `direction`.
    pub fn radiance(direction: DVec3) -> Vec3 {
        let code = (direction.as_vec3() + 1.0) / 2.0;
        if is_marked(direction) { code * Self::MARK } else { code }
    }

    /// The direction that a radiance stands for.
    pub fn direction(radiance: Vec3) -> DVec3 {
        let code = if radiance.max_element() > 1.3 { radiance / Self::MARK } else { radiance };
        (code.as_dvec3() * 2.0 - 1.0).normalize_or_zero()
    }
}

impl TileTracer for Calibration {
    fn trace_tile(&self, _: DVec3, tile: &Tile, texels: &mut [Radiance]) {
        for (texel, direction) in texels.iter_mut().zip(tile.directions()) {
            *texel = Radiance {
                surface_sum: Self::radiance(direction),
                distance_sum: Self::DISTANCE,
                transmittance: 0.0,
                ..Radiance::default()
            };
        }
    }
}

/// Whether a dot of the face's name, in the middle, or of the arrow above it lies in `direction`.
fn is_marked(direction: DVec3) -> bool {
    let (face, place) = Face::of_direction(direction);
    let [x, y] = place.map(|share| (share * DOTS) as usize);
    let name = face.name().chars().zip([6, 13]).filter_map(|(letter, left)| {
        let glyph = GLYPHS.iter().find(|(known, _)| *known == letter)?;
        Some((glyph.1, left, 10))
    });
    name.chain([(ARROW, 10, 1)]).any(|(rows, left, top)| {
        let (column, row) = (x.wrapping_sub(left), y.wrapping_sub(top));
        column < 5 && row < 7 && rows[row] >> (4 - column) & 1 == 1
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_texel_says_where_it_comes_from() {
        let (mut marked, mut all) = (0, 0);
        for face in Face::ALL {
            let tile = Tile { face, face_size: 96, x: 0, y: 0, width: 64, height: 64 };
            let mut texels = vec![Radiance::default(); tile.len()];
            Calibration.trace_tile(DVec3::ZERO, &tile, &mut texels);
            for (texel, direction) in texels.iter().zip(tile.directions()) {
                let found = Calibration::direction(texel.surface_sum);
                assert!(found.dot(direction) > 1.0 - 1e-9, "{face:?}: {found} is not {direction}");
                marked += u32::from(texel.surface_sum.max_element() > 1.3);
                all += 1;
            }
        }
        assert!((all / 100..all / 5).contains(&marked), "{marked} of {all}");
    }
}
