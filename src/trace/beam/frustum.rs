//! Which of a node's children a tile sees, in which of its blocks, and from which key on.

use glam::DVec3;

use super::BLOCK_EDGE;
use crate::bvh::{Viewpoint, WIDTH, WideNode};
use crate::job::Order;
use crate::trace::{Face, Footprint, Tile};

/// Image coordinates in f32 are good to 1e-3 texels on faces up to 8192; boxes are widened by this many.
const TEXEL_SLACK: f32 = 1e-2;

/// Relative slack of lower bounds: depths in f32 carry a few roundings of 6e-8.
const KEY_SLACK: f32 = 1e-6;

/// Per axis of a face (right, down, look): which world axis it is, and 1 or -1 for its direction.
///
/// The face's axes are signed world axes, so a world box stays a box.
#[derive(Debug, Clone, Copy)]
pub(super) struct FaceAxes(pub [(usize, f64); 3]);

impl FaceAxes {
    pub fn new(face: Face) -> Self {
        let [right, up, look] = face.axes();
        Self([right, -up, look].map(|direction| {
            let world = (0..3).find(|&axis| direction[axis] != 0.0).unwrap_or(0);
            (world, direction[world])
        }))
    }

    pub fn face_from_world(&self, world: DVec3) -> DVec3 {
        DVec3::from_array(self.0.map(|(axis, sign)| world[axis] * sign))
    }
}

/// A tile as a frustum from the probe, in face coordinates.
pub(super) struct Frustum {
    axes: FaceAxes,
    viewpoint: Viewpoint,
    /// Texels per unit of x / z, and the image centre in texels from the tile's corner.
    scale: f32,
    centre: [f32; 2],
    /// Last column and row.
    last: [f32; 2],
    order: Order,
    /// [`Footprint::reach`].
    reach: f32,
}

/// What a tile sees of a node's children.
pub(super) struct Seen {
    /// Lower bounds on the sort keys below each child.
    pub keys: [f32; WIDTH],
    /// Blocks of the tile that each child's box may touch; 0 for none.
    pub blocks: [u64; WIDTH],
}

type Boxes = [f32; WIDTH];

impl Frustum {
    pub fn new(origin: DVec3, tile: &Tile, order: Order, footprint: Footprint) -> Self {
        let half = f64::from(tile.face_size) / 2.0;
        Self {
            axes: FaceAxes::new(tile.face),
            viewpoint: Viewpoint::new(origin),
            scale: half as f32,
            centre: [(half - f64::from(tile.x)) as f32, (half - f64::from(tile.y)) as f32],
            last: [(tile.width - 1) as f32, (tile.height - 1) as f32],
            order,
            reach: footprint.reach(),
        }
    }

    #[inline(always)]
    pub fn meet(&self, node: &WideNode) -> Seen {
        let grown;
        let reached = if self.reach > 0.0 {
            grown = self.viewpoint.grown(node, self.reach);
            &grown
        } else {
            node
        };
        let [near, far] = self.extent(reached, 2);
        let (mut key, mut seen) = ([0.0; WIDTH], [true; WIDTH]);
        for k in 0..WIDTH {
            key[k] = if near[k] > 0.0 { near[k] } else { 0.0 };
            // What lies behind the face's plane is seen by other faces. An absent child's box ends at -inf.
            seen[k] = far[k] > 0.0;
        }
        let columns = self.texels(reached, 0, &key, &far);
        let rows = self.texels(reached, 1, &key, &far);
        let mut blocks = [0; WIDTH];
        for k in 0..WIDTH {
            if seen[k] & (columns[0][k] <= columns[1][k]) & (rows[0][k] <= rows[1][k]) {
                let block = |texel: f32| texel as u32 / BLOCK_EDGE;
                let ends = |texels: &[Boxes; 2]| [block(texels[0][k]), block(texels[1][k])];
                blocks[k] = block_mask(ends(&columns), ends(&rows));
            }
        }
        let keys = match self.order {
            Order::RayHitDistance => key.map(|near| near * (1.0 - KEY_SLACK)),
            // Of means, which no footprint moves.
            Order::CameraDistance => self.viewpoint.distances(node).map(|distance| distance * (1.0 - KEY_SLACK)),
        };
        Seen { keys, blocks }
    }

    /// The children's extents along a face axis, from the probe: lower ends, upper ends.
    #[inline(always)]
    fn extent(&self, node: &WideNode, face_axis: usize) -> [Boxes; 2] {
        let (axis, sign) = self.axes.0[face_axis];
        let (from_low, from_high) = (self.viewpoint.low[axis], self.viewpoint.high[axis]);
        let (mut low, mut high) = ([0.0; WIDTH], [0.0; WIDTH]);
        for k in 0..WIDTH {
            low[k] = node.min[axis][k] - from_high;
            high[k] = node.max[axis][k] - from_low;
        }
        if sign > 0.0 {
            return [low, high];
        }
        for k in 0..WIDTH {
            (low[k], high[k]) = (-high[k], -low[k]);
        }
        [low, high]
    }

    /// First and last column or row of the tile whose centre the children may cover, given how near and far they reach;
    /// the first is the larger where there is none.
    #[inline(always)]
    fn texels(&self, node: &WideNode, image_axis: usize, near: &Boxes, far: &Boxes) -> [Boxes; 2] {
        let [low, high] = self.extent(node, image_axis);
        let (centre, last) = (self.centre[image_axis] - 0.5, self.last[image_axis]);
        let (mut first, mut final_) = ([0.0; WIDTH], [0.0; WIDTH]);
        for k in 0..WIDTH {
            let left = low[k] / if low[k] < 0.0 { near[k] } else { far[k] };
            let texel = (left * self.scale + (centre - TEXEL_SLACK)).ceil();
            // In this form, NaN (0 / 0: the probe on the box's side) gives the tile's own end.
            first[k] = if texel > 0.0 { texel } else { 0.0 };
        }
        for k in 0..WIDTH {
            let right = high[k] / if high[k] > 0.0 { near[k] } else { far[k] };
            let texel = (right * self.scale + (centre + TEXEL_SLACK)).floor();
            final_[k] = if texel < last { texel } else { last };
        }
        [first, final_]
    }
}

/// The blocks between two columns and two rows of a tile's 8 x 8, inclusive.
#[inline(always)]
pub(super) fn block_mask(columns: [u32; 2], rows: [u32; 2]) -> u64 {
    let row_bits = (0xffu64 >> (7 - columns[1])) & (0xff << columns[0]);
    let all_rows = row_bits * 0x0101_0101_0101_0101;
    all_rows & (u64::MAX << (8 * rows[0])) & (u64::MAX >> (8 * (7 - rows[1])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_mask_holds_exactly_the_blocks_between_its_corners() {
        assert_eq!(block_mask([0, 0], [0, 0]), 1);
        assert_eq!(block_mask([7, 7], [0, 0]), 1 << 7);
        assert_eq!(block_mask([0, 7], [1, 1]), 0xff00);
        assert_eq!(block_mask([0, 7], [0, 7]), u64::MAX);
        assert_eq!(block_mask([2, 3], [6, 7]), 0x0c0c_0000_0000_0000);
    }
}
