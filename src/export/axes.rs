//! From the manifest's frame (right-handed, +Y up, metres) to an engine's.

use crate::scene::Bounds;
use glam::DVec3;

/// A frame that differs from the manifest's in the order and signs of its axes and in its unit.
#[derive(Debug, Clone, Copy)]
pub struct Axes {
    /// For each of the engine's axes, the manifest's axis that it is (0 to 2), and its sign.
    pub from: [(usize, f64); 3],
    /// The engine's units per metre.
    pub units_per_metre: f64,
}

impl Axes {
    /// A point in the engine's frame and unit.
    pub fn point(&self, point: DVec3) -> DVec3 {
        self.vector(point) * self.units_per_metre
    }

    /// A direction or another vector without a unit.
    pub fn vector(&self, vector: DVec3) -> DVec3 {
        DVec3::from(self.from.map(|(axis, sign)| vector[axis] * sign))
    }

    /// A box in the engine's frame and unit.
    pub fn bounds(&self, bounds: &Bounds) -> Bounds {
        let (a, b) = (self.point(bounds.min), self.point(bounds.max));
        Bounds { min: a.min(b), max: a.max(b) }
    }

    /// Lengths at the faces +X -X +Y -Y +Z -Z of a box, in the order of the engine's faces and in its unit.
    pub fn by_face(&self, lengths: [f64; 6]) -> [f64; 6] {
        std::array::from_fn(|face| {
            let (axis, sign) = self.from[face / 2];
            let is_low = (face % 2 == 1) != (sign < 0.0);
            lengths[2 * axis + usize::from(is_low)] * self.units_per_metre
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_and_their_faces_move_together() {
        // Blender: (x, -z, y).
        let axes = Axes { from: [(0, 1.0), (2, -1.0), (1, 1.0)], units_per_metre: 2.0 };
        let moved = axes.bounds(&Bounds { min: DVec3::new(1.0, 2.0, 3.0), max: DVec3::new(4.0, 6.0, 8.0) });
        assert_eq!(moved, Bounds { min: DVec3::new(2.0, -16.0, 4.0), max: DVec3::new(8.0, -6.0, 12.0) });
        // +Y of the engine is -Z.
        assert_eq!(axes.by_face([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), [2.0, 4.0, 12.0, 10.0, 6.0, 8.0]);
    }
}
