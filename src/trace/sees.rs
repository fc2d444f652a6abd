//! Whether a tile can see a box at all: what is false here is false for every ray of the tile and every tracer.

use glam::DVec3;

use super::{Footprint, Tile};
use crate::scene::Bounds;

/// Texels by which the tile is taken to be larger. The tracers' own tests are good to a hundredth of one; a texel more
/// costs a tile here and there.
const MARGIN: f64 = 1.0;

/// Share of a coordinate by which boxes are taken to be larger: a few roundings of the f32 that tracers have them in.
const ROUNDING: f64 = 8.0 * f32::EPSILON as f64;

impl Tile {
    /// Whether a ray from `origin` through one of the tile's texels may meet `bounds`, both in metres relative to the scene
    /// origin, as `footprint` widens them.
    pub fn may_see(&self, origin: DVec3, bounds: &Bounds, footprint: Footprint) -> bool {
        let largest = bounds.min.abs().max(bounds.max.abs()).max(origin.abs()).max_element();
        let farthest = (bounds.min - origin).abs().max((bounds.max - origin).abs()).length();
        let pad = DVec3::splat(ROUNDING * largest + 1.01 * f64::from(footprint.reach()) * farthest);
        let (low, high) = (bounds.min - pad - origin, bounds.max + pad - origin);
        // Faces' axes are signed world axes, so that a box stays a box.
        let extent =
            |axis: DVec3| ((axis * low).min(axis * high).element_sum(), (axis * low).max(axis * high).element_sum());
        let [right, up, look] = self.face.axes();
        let (near, far) = extent(look);
        let near = near.max(0.0);
        let is_across = |axis: DVec3, first: i32, count: u32| {
            let (low, high) = extent(axis);
            let low = low / if low < 0.0 { near } else { far };
            let high = high / if high > 0.0 { near } else { far };
            let texel = |slope: f64| (slope + 1.0) / 2.0 * f64::from(self.face_size);
            texel(low) <= f64::from(first) + f64::from(count) + MARGIN && texel(high) >= f64::from(first) - MARGIN
        };
        far > 0.0 && is_across(right, self.x, self.width) && is_across(-up, self.y, self.height)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::Face;

    /// Whether the ray meets the box, by slabs.
    fn meets(origin: DVec3, direction: DVec3, bounds: &Bounds) -> bool {
        let (a, b) = ((bounds.min - origin) / direction, (bounds.max - origin) / direction);
        let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
        far >= near.max(0.0)
    }

    #[test]
    fn no_ray_of_a_tile_that_cannot_see_a_box_meets_it() {
        let along = |count: i32| (0..count).map(move |i| (f64::from(i) + 0.5) * 6.0 / f64::from(count) - 3.0);
        let centres = along(7).flat_map(|x| along(6).flat_map(move |y| along(5).map(move |z| DVec3::new(x, y, z))));
        let origin = DVec3::new(0.1, -0.2, 0.3);
        let (mut unseen, mut seen) = (0, 0);
        for (i, centre) in centres.enumerate() {
            let half = DVec3::new(0.05, 0.2, 0.6) * (1 + i % 3) as f64;
            let bounds = Bounds { min: centre - half, max: centre + half };
            for face in Face::ALL {
                for (x, y) in [(0, 0), (16, 0), (0, 16), (16, 16)] {
                    let tile = Tile { face, face_size: 32, x, y, width: 16, height: 16 };
                    let met = tile.directions().any(|direction| meets(origin, direction, &bounds));
                    let may_see = tile.may_see(origin, &bounds, Footprint::default());
                    assert!(may_see || !met, "{face:?} {x} {y}: {bounds:?}");
                    unseen += usize::from(!may_see);
                    seen += usize::from(may_see && !met);
                }
            }
        }
        // It says no where it can: most tiles see none of a box, and few are asked in vain.
        assert!(unseen > 4 * seen && unseen > 2000, "{unseen} not seen, {seen} seen in vain");
    }
}
