//! The six faces of a cubemap: OpenEXR's order and orientation, pixel-centre texels.
//!
//! OpenEXR ImfEnvmap, as seen from inside, right-handed and not mirrored (right = look x up):
//! +X right +Z, -X right -Z, +Y right +X up +Z, -Y right +X up -Z, +Z right -X, -Z right +X; the sides' up is +Y.

use glam::DVec3;

/// A face of the cube, in file order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Face {
    /// Looks along +X.
    PosX,
    /// Looks along -X.
    NegX,
    /// Looks along +Y.
    PosY,
    /// Looks along -Y.
    NegY,
    /// Looks along +Z.
    PosZ,
    /// Looks along -Z.
    NegZ,
}

impl Face {
    /// All faces in file order: +X -X +Y -Y +Z -Z.
    pub const ALL: [Self; 6] = [Self::PosX, Self::NegX, Self::PosY, Self::NegY, Self::PosZ, Self::NegZ];

    /// Unit vectors (right, up, look) of the face as an image seen from inside the cube.
    pub fn axes(self) -> [DVec3; 3] {
        match self {
            Self::PosX => [DVec3::Z, DVec3::Y, DVec3::X],
            Self::NegX => [DVec3::NEG_Z, DVec3::Y, DVec3::NEG_X],
            Self::PosY => [DVec3::X, DVec3::Z, DVec3::Y],
            Self::NegY => [DVec3::X, DVec3::NEG_Z, DVec3::NEG_Y],
            Self::PosZ => [DVec3::NEG_X, DVec3::Y, DVec3::Z],
            Self::NegZ => [DVec3::X, DVec3::Y, DVec3::NEG_Z],
        }
    }

    /// Direction, not normalised, through the image point `x` pixels from the left edge and `y` pixels below the top
    /// edge of a face of `size` pixels; pixel centres are at half integers. Its component along `look` is 1.
    pub fn direction(self, size: u32, x: f64, y: f64) -> DVec3 {
        let [right, up, look] = self.axes();
        let scale = 2.0 / f64::from(size);
        look + right * (x * scale - 1.0) + up * (1.0 - y * scale)
    }

    /// The face that `direction` leaves through, and the image point in units of the face's width: (0, 0) top left.
    pub fn of_direction(direction: DVec3) -> (Self, [f64; 2]) {
        let [face, ..] = {
            let mut faces = Self::ALL;
            faces.sort_by(|a, b| b.axes()[2].dot(direction).total_cmp(&a.axes()[2].dot(direction)));
            faces
        };
        let [right, up, look] = face.axes();
        let depth = look.dot(direction);
        let point = [right.dot(direction) / depth, up.dot(direction) / depth];
        (face, [(point[0] + 1.0) / 2.0, (1.0 - point[1]) / 2.0])
    }

    /// Short name as file names and messages use it.
    pub fn name(self) -> &'static str {
        match self {
            Self::PosX => "+X",
            Self::NegX => "-X",
            Self::PosY => "+Y",
            Self::NegY => "-Y",
            Self::PosZ => "+Z",
            Self::NegZ => "-Z",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_are_right_handed_and_not_mirrored() {
        for face in Face::ALL {
            let [right, up, look] = face.axes();
            assert_eq!(look.cross(up), right, "{}", face.name());
        }
    }

    #[test]
    fn a_direction_returns_to_the_texel_it_came_from() {
        for face in Face::ALL {
            for (x, y) in [(0.5, 0.5), (7.5, 0.5), (3.25, 6.75), (4.0, 4.0)] {
                let (found, [u, v]) = Face::of_direction(face.direction(8, x, y));
                assert_eq!(found, face);
                assert!((u * 8.0 - x).abs() < 1e-12 && (v * 8.0 - y).abs() < 1e-12);
            }
        }
    }
}
