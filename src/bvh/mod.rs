//! One tree over the boxes of Gaussians and triangles.
//!
//! obvhs builds a binary tree (PLOC, Meister and Bittner 2018, with parallel reinsertion, 2022) over small clusters of
//! neighbouring primitives; [`build`] widens it to eight children per node, the shape that SIMD traversal wants, and
//! sorts the scene's primitives so that those of a node are neighbours in memory. A leaf is one primitive: eight exact
//! boxes are tested as fast as one, and far faster than the primitives themselves. Tracers walk [`WideNode`]s themselves: a
//! probe's beam and a single ray need different orders, and obvhs's own traversal ignores a ray's near end.

mod boxes;
mod build;

use glam::{DVec3, Vec3};

pub use boxes::{Box3, gaussian_box};

/// Children per node.
pub const WIDTH: usize = 8;

/// Lanes of the root that mesh inputs have; the first lane is the Gaussians'.
pub const MESH_LANES: usize = WIDTH - 1;

/// The tree. Leaves refer to [`crate::scene::Splats`] and [`crate::scene::Meshes::triangles`], which
/// [`Bvh::build`] has put in leaf order.
#[derive(Debug, Default)]
pub struct Bvh {
    /// Nodes; the root is the first. Empty for an empty scene.
    pub nodes: Vec<WideNode>,
}

/// Eight boxes side by side, lane by lane, in metres relative to the scene origin.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub struct WideNode {
    /// Lower corners: x, y, z, each for all children. Positive infinity where there is no child.
    pub min: [[f32; WIDTH]; 3],
    /// Upper corners; negative infinity where there is no child.
    pub max: [[f32; WIDTH]; 3],
    /// Node or primitive of each child.
    pub index: [u32; WIDTH],
    /// Bit by bit, which children are nodes.
    pub nodes: u8,
    /// Which are Gaussians.
    pub gaussians: u8,
    /// Which are triangles. A lane in none of the three has no child.
    pub triangles: u8,
}

/// What is under one lane of a [`WideNode`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Child {
    /// An inner node, by index.
    Node(u32),
    /// A Gaussian, by index.
    Gaussian(u32),
    /// A triangle, by index.
    Triangle(u32),
}

impl WideNode {
    const EMPTY: Self = Self {
        min: [[f32::INFINITY; WIDTH]; 3],
        max: [[f32::NEG_INFINITY; WIDTH]; 3],
        index: [0; WIDTH],
        nodes: 0,
        gaussians: 0,
        triangles: 0,
    };

    /// The child in `lane`. Meaningful only where the lane's box is not empty.
    #[inline]
    pub fn child(&self, lane: usize) -> Child {
        let index = self.index[lane];
        match (self.nodes >> lane & 1, self.gaussians >> lane & 1) {
            (1, _) => Child::Node(index),
            (_, 1) => Child::Gaussian(index),
            _ => Child::Triangle(index),
        }
    }

    /// The box in `lane`, or `None` where there is no child.
    pub fn lane_box(&self, lane: usize) -> Option<Box3> {
        let corner = |corners: &[[f32; WIDTH]; 3]| glam::Vec3::from_array(corners.map(|axis| axis[lane]));
        let lane_box = Box3 { min: corner(&self.min), max: corner(&self.max) };
        (lane_box.min.x <= lane_box.max.x).then_some(lane_box)
    }

    fn set(&mut self, lane: usize, child_box: Box3, child: Child) {
        for axis in 0..3 {
            self.min[axis][lane] = child_box.min[axis];
            self.max[axis][lane] = child_box.max[axis];
        }
        let (kind, index) = match child {
            Child::Node(index) => (&mut self.nodes, index),
            Child::Gaussian(index) => (&mut self.gaussians, index),
            Child::Triangle(index) => (&mut self.triangles, index),
        };
        *kind |= 1 << lane;
        self.index[lane] = index;
    }
}

/// A point as the two f32 points around it, so that f32 differences to it bound the true ones.
#[derive(Debug, Clone, Copy)]
pub struct Viewpoint {
    /// Rounded down along every axis, in metres relative to the scene origin.
    pub low: Vec3,
    /// Rounded up.
    pub high: Vec3,
}

impl Viewpoint {
    /// The point at `origin`, in metres relative to the scene origin.
    pub fn new(origin: DVec3) -> Self {
        let rounded = origin.as_vec3();
        Self {
            low: Vec3::new(rounded.x.next_down(), rounded.y.next_down(), rounded.z.next_down()),
            high: Vec3::new(rounded.x.next_up(), rounded.y.next_up(), rounded.z.next_up()),
        }
    }

    /// Distances, in metres, to the nearest points of a node's boxes; 0 inside. Good to a few roundings.
    pub fn distances(&self, node: &WideNode) -> [f32; WIDTH] {
        let mut squared = [0.0f32; WIDTH];
        for axis in 0..3 {
            for (lane, squared) in squared.iter_mut().enumerate() {
                let outside = (node.min[axis][lane] - self.high[axis]).max(self.low[axis] - node.max[axis][lane]);
                *squared += outside.max(0.0).powi(2);
            }
        }
        squared.map(f32::sqrt)
    }

    /// The node with each box grown on all sides by `share` of the distance to its farthest point, good to a few roundings.
    /// Where there is no child, there still is none.
    pub fn grown(&self, node: &WideNode, share: f32) -> WideNode {
        let mut squared = [0.0f32; WIDTH];
        for axis in 0..3 {
            for (lane, squared) in squared.iter_mut().enumerate() {
                let farthest = (node.max[axis][lane] - self.low[axis]).max(self.high[axis] - node.min[axis][lane]);
                // Negative infinity for an absent child: grown by it, its box would become NaN.
                *squared += farthest.max(0.0).powi(2);
            }
        }
        let pads = squared.map(|squared| share * squared.sqrt());
        let mut grown = *node;
        for axis in 0..3 {
            for (lane, pad) in pads.iter().enumerate() {
                grown.min[axis][lane] -= pad;
                grown.max[axis][lane] += pad;
            }
        }
        grown
    }
}
