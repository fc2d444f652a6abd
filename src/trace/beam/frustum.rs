//! Which of a node's children a tile sees, in which of its cells, and from which key on.

use glam::DVec3;

use super::CELL_EDGE;
use crate::bvh::{Viewpoint, WIDTH, WideNode};
use crate::job::Order;
use crate::trace::Tile;

/// Image coordinates in f32 are good to 1e-3 texels on faces up to 8192; boxes are widened by this many.
const TEXEL_SLACK: f32 = 1e-2;

/// Relative slack of lower bounds: depths in f32 carry a few roundings of 6e-8.
const KEY_SLACK: f32 = 1e-6;

/// A tile as a frustum from the probe, in the face's own coordinates: x right, y down, z along the look axis.
///
/// The face's axes are signed world axes, so a world box stays a box.
pub(super) struct Frustum {
    /// Per face axis: the world axis, and whether it runs the other way.
    axes: [(usize, bool); 3],
    viewpoint: Viewpoint,
    /// Texels per unit of x / z, and the image centre in texels from the tile's corner.
    scale: f32,
    centre: [f32; 2],
    size: [f32; 2],
    order: Order,
}

/// What a tile sees of a node's children.
pub(super) struct Seen {
    /// Lower bounds on the sort keys below each child.
    pub keys: [f32; WIDTH],
    /// Cells of the tile that each child's box may touch; 0 for none.
    pub cells: [u64; WIDTH],
}

impl Frustum {
    pub fn new(origin: DVec3, tile: &Tile, order: Order) -> Self {
        let [right, up, look] = tile.face.axes();
        let axis = |direction: DVec3| {
            let world = (0..3).find(|&a| direction[a] != 0.0).unwrap_or(0);
            (world, direction[world] < 0.0)
        };
        let half = f64::from(tile.face_size) / 2.0;
        Self {
            axes: [axis(right), axis(-up), axis(look)],
            viewpoint: Viewpoint::new(origin),
            scale: half as f32,
            centre: [(half - f64::from(tile.x)) as f32, (half - f64::from(tile.y)) as f32],
            size: [tile.width as f32, tile.height as f32],
            order,
        }
    }

    #[inline]
    pub fn meet(&self, node: &WideNode) -> Seen {
        let [x, y, z] = [0, 1, 2].map(|axis| self.extent(node, axis));
        let mut seen = Seen { keys: [0.0; WIDTH], cells: [0; WIDTH] };
        for lane in 0..WIDTH {
            let (near, far) = (z[0][lane].max(0.0), z[1][lane]);
            // Absent children have inverted boxes; what lies behind the face's plane is seen by other faces.
            if !(far > 0.0) || node.min[0][lane] > node.max[0][lane] {
                continue;
            }
            let columns = self.texels(0, x[0][lane], x[1][lane], near, far);
            let rows = self.texels(1, y[0][lane], y[1][lane], near, far);
            seen.cells[lane] = cell_mask(columns, rows, self.size);
            seen.keys[lane] = near * (1.0 - KEY_SLACK);
        }
        if self.order == Order::CameraDistance {
            seen.keys = self.viewpoint.distances(node).map(|distance| distance * (1.0 - KEY_SLACK));
        }
        seen
    }

    /// The children's extents along a face axis, from the probe: lower ends, upper ends.
    #[inline]
    fn extent(&self, node: &WideNode, face_axis: usize) -> [[f32; WIDTH]; 2] {
        let (axis, flipped) = self.axes[face_axis];
        let low = node.min[axis].map(|corner| corner - self.viewpoint.high[axis]);
        let high = node.max[axis].map(|corner| corner - self.viewpoint.low[axis]);
        if flipped { [high.map(|x| -x), low.map(|x| -x)] } else { [low, high] }
    }

    /// The texels, from the tile's corner, between which a box from `low` to `high` across and `near` to `far` deep
    /// projects.
    #[inline]
    fn texels(&self, image_axis: usize, low: f32, high: f32, near: f32, far: f32) -> [f32; 2] {
        let left = low / if low < 0.0 { near } else { far };
        let right = high / if high > 0.0 { near } else { far };
        [
            left * self.scale + self.centre[image_axis] - TEXEL_SLACK,
            right * self.scale + self.centre[image_axis] + TEXEL_SLACK,
        ]
    }
}

/// The cells between two columns and two rows of texels (as positions, inclusive); 0 when they miss the tile.
#[inline]
pub(super) fn cell_mask(columns: [f32; 2], rows: [f32; 2], size: [f32; 2]) -> u64 {
    if !(columns[1] >= 0.0 && columns[0] <= size[0] && rows[1] >= 0.0 && rows[0] <= size[1]) {
        return 0;
    }
    // `as` saturates at 0 and takes infinities to the ends.
    let cell = |texel: f32| (texel * (1.0 / CELL_EDGE as f32)).min(7.0) as u32;
    let (first, last) = (cell(columns[0]), cell(columns[1]));
    let row_bits = (0xffu64 >> (7 - last)) & (0xff << first);
    let (top, bottom) = (cell(rows[0]), cell(rows[1]));
    let all_rows = row_bits * 0x0101_0101_0101_0101;
    all_rows & (u64::MAX << (8 * top)) & (u64::MAX >> (8 * (7 - bottom)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_mask_holds_exactly_the_cells_between_its_corners() {
        let size = [64.0, 64.0];
        assert_eq!(cell_mask([0.0, 0.0], [0.0, 0.0], size), 1);
        assert_eq!(cell_mask([60.0, 63.0], [0.0, 7.9], size), 1 << 7);
        assert_eq!(cell_mask([0.0, 63.0], [8.0, 15.0], size), 0xff00);
        assert_eq!(cell_mask([f32::NEG_INFINITY, f32::INFINITY], [f32::NEG_INFINITY, f32::INFINITY], size), u64::MAX);
        assert_eq!(cell_mask([-9.0, -1.0], [0.0, 63.0], size), 0);
        assert_eq!(cell_mask([65.0, 70.0], [0.0, 63.0], size), 0);
    }
}
