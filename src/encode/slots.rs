//! Cube faces as graphics APIs and engines want them: in other slots, turned or mirrored.
//!
//! OpenEXR's faces are seen from inside and not mirrored. Cube maps of graphics APIs are left-handed (OpenGL 4.6, table
//! 8.19; the same in Vulkan and Direct3D), so that what an engine must store hangs on how it makes its look-up vector from
//! a direction in its world. No texel needs resampling.

use glam::Vec3;

use crate::filter::RgbCubemap;
use crate::trace::Face;

/// What is done to a face's image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Turn {
    /// Nothing.
    None,
    /// Half a turn.
    Half,
    /// Left and right change places.
    MirrorX,
    /// Top and bottom change places.
    MirrorY,
}

/// For each of a consumer's slots +X -X +Y -Y +Z -Z, the face whose image it holds and how that is turned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Slots(pub [(Face, Turn); 6]);

impl Slots {
    /// A cube map that is looked up by the direction (x, y, z) itself: Godot, Filament, and the meaning of a KTX2 file.
    pub const DIRECT: Self = Self([
        (Face::PosX, Turn::MirrorX),
        (Face::NegX, Turn::MirrorX),
        (Face::PosY, Turn::MirrorY),
        (Face::NegY, Turn::MirrorY),
        (Face::PosZ, Turn::MirrorX),
        (Face::NegZ, Turn::MirrorX),
    ]);

    /// Looked up by (x, y, -z): Bevy, and Unity where positions have z negated.
    pub const NEGATED_Z: Self = Self([
        (Face::PosX, Turn::None),
        (Face::NegX, Turn::None),
        (Face::PosY, Turn::None),
        (Face::NegY, Turn::None),
        (Face::NegZ, Turn::None),
        (Face::PosZ, Turn::None),
    ]);

    /// Looked up by (-x, y, z): three.js, PlayCanvas, and Unity where positions have x negated.
    pub const NEGATED_X: Self = Self([
        (Face::NegX, Turn::None),
        (Face::PosX, Turn::None),
        (Face::PosY, Turn::Half),
        (Face::NegY, Turn::Half),
        (Face::PosZ, Turn::None),
        (Face::NegZ, Turn::None),
    ]);

    /// The texels of `cubemap` in the order of the slots, each slot row by row from its first.
    pub fn texels(&self, cubemap: &RgbCubemap) -> Vec<Vec3> {
        let n = cubemap.size() as usize;
        let mut texels = Vec::with_capacity(cubemap.texels().len());
        for (face, turn) in self.0 {
            let source = cubemap.face(face);
            for y in 0..n {
                texels.extend((0..n).map(|x| match turn {
                    Turn::None => source[y * n + x],
                    Turn::Half => source[(n - 1 - y) * n + n - 1 - x],
                    Turn::MirrorX => source[y * n + n - 1 - x],
                    Turn::MirrorY => source[(n - 1 - y) * n + x],
                }));
            }
        }
        texels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The unit vector that an API's cube map finds texel (x, y) of a slot for: OpenGL 4.6, table 8.19, solved for the vector.
    fn api_vector(slot: usize, n: usize, x: usize, y: usize) -> Vec3 {
        let s = 2.0 * (x as f32 + 0.5) / n as f32 - 1.0;
        let t = 2.0 * (y as f32 + 0.5) / n as f32 - 1.0;
        let vector = match slot {
            0 => [1.0, -t, -s],
            1 => [-1.0, -t, s],
            2 => [s, 1.0, t],
            3 => [s, -1.0, -t],
            4 => [s, -t, 1.0],
            _ => [-s, -t, -1.0],
        };
        Vec3::from(vector).normalize()
    }

    #[test]
    fn every_consumer_finds_each_direction_where_it_looks_for_it() {
        let n = 4;
        let coded = RgbCubemap::from_fn(n as u32, |d| d.as_vec3());
        let consumers = [
            (Slots::DIRECT, Vec3::ONE),
            (Slots::NEGATED_Z, Vec3::new(1.0, 1.0, -1.0)),
            (Slots::NEGATED_X, Vec3::new(-1.0, 1.0, 1.0)),
        ];
        for (slots, signs) in consumers {
            for (i, texel) in slots.texels(&coded).into_iter().enumerate() {
                let (slot, x, y) = (i / (n * n), i % n, i / n % n);
                // A look-up vector is the direction with the consumer's signs, and the other way round.
                let direction = api_vector(slot, n, x, y) * signs;
                assert!((texel - direction).abs().max_element() < 1e-6, "{slots:?}: slot {slot}, {x} {y}");
            }
        }
    }
}
