//! Rays of one origin against the eight boxes of a node.

use glam::DVec3;

use crate::bvh::{Viewpoint, WIDTH, WideNode};
use crate::job::Order;
use crate::trace::{Footprint, Ray};

/// Slab distances in f32 carry a few roundings of relative size 6e-8 each; this covers them with room to spare.
const SLAB_SLACK: f32 = 1e-6;

/// Rays of one origin prepared for testing boxes: eight at a time, in f32, conservatively.
pub(super) struct Slabs {
    viewpoint: Viewpoint,
    axes: [Axis; 3],
    order: Order,
    /// [`Footprint::reach`].
    reach: f32,
}

/// The rays' directions along one axis.
struct Axis {
    /// Inverses of the least and the greatest component.
    inverse: [f32; 2],
    /// Whether some rays go one way and some the other.
    straddles: bool,
}

impl Axis {
    fn new(components: impl Iterator<Item = f64> + Clone) -> Self {
        let least = components.clone().fold(f64::INFINITY, f64::min);
        let greatest = components.fold(f64::NEG_INFINITY, f64::max);
        // A component of 1e-20 is as good as 0: over 1e15 m, the end of all boxes, it moves 1e-5 m.
        let inverse =
            [least, greatest].map(|d| 1.0 / if d.abs() < 1e-20 { 1e-20f32.copysign(d as f32) } else { d as f32 });
        Self { inverse, straddles: inverse[0] < 0.0 && inverse[1] > 0.0 }
    }
}

/// The children of a node that the rays may meet.
pub(super) struct Reached {
    /// For each child, a lower bound on the sort keys inside.
    pub keys: [f32; WIDTH],
    /// Bit by bit, the children that a ray may meet and that begin inside the window.
    pub now: u8,
    /// Those that begin behind it.
    pub later: u8,
}

impl Slabs {
    pub fn new(origin: DVec3, rays: &[Ray], order: Order, footprint: Footprint) -> Self {
        let axes = std::array::from_fn(|axis| Axis::new(rays.iter().map(move |ray| ray.direction[axis])));
        let viewpoint = Viewpoint::new(origin);
        Self { viewpoint, axes, order, reach: footprint.reach() }
    }

    /// Which of a node's children some ray may meet: those whose boxes the rays' directions reach along each axis.
    #[inline(always)]
    pub fn meet(&self, node: &WideNode, window: f32) -> Reached {
        let grown;
        let reached = if self.reach > 0.0 {
            grown = self.viewpoint.grown(node, self.reach);
            &grown
        } else {
            node
        };
        let mut enter = [0.0f32; WIDTH];
        let mut exit = [f32::INFINITY; WIDTH];
        for axis in 0..3 {
            let (low, high) = (self.viewpoint.low[axis], self.viewpoint.high[axis]);
            let Axis { inverse: [first, second], straddles } = self.axes[axis];
            let (mut to_min, mut to_max) = ([0.0f32; WIDTH], [0.0f32; WIDTH]);
            for (distance, min) in to_min.iter_mut().zip(&reached.min[axis]) {
                *distance = min - high;
            }
            for (distance, max) in to_max.iter_mut().zip(&reached.max[axis]) {
                *distance = max - low;
            }
            if straddles {
                // A box on one side is reached soonest by the ray that goes there the fastest; none is ever left.
                for k in 0..WIDTH {
                    enter[k] = larger(larger(to_min[k] * second, to_max[k] * first), enter[k]);
                }
                continue;
            }
            let (mut near, mut far) = ([0.0f32; WIDTH], [0.0f32; WIDTH]);
            for k in 0..WIDTH {
                near[k] = smaller(to_min[k] * first, to_max[k] * first);
                far[k] = larger(to_min[k] * first, to_max[k] * first);
            }
            if first != second {
                for k in 0..WIDTH {
                    near[k] = smaller(near[k], smaller(to_min[k] * second, to_max[k] * second));
                    far[k] = larger(far[k], larger(to_min[k] * second, to_max[k] * second));
                }
            }
            for k in 0..WIDTH {
                enter[k] = larger(near[k], enter[k]);
                exit[k] = smaller(far[k], exit[k]);
            }
        }
        let enter = enter.map(|distance| distance * (1.0 - SLAB_SLACK));
        let keys = match self.order {
            Order::RayHitDistance => enter,
            // Of means, which no footprint moves.
            Order::CameraDistance => self.viewpoint.distances(node).map(|distance| distance * (1.0 - SLAB_SLACK)),
        };
        let (mut inside, mut behind) = ([0.0; WIDTH], [0.0; WIDTH]);
        for k in 0..WIDTH {
            inside[k] = exit[k] * (1.0 + SLAB_SLACK) - enter[k];
            behind[k] = keys[k] - window;
        }
        let present = node.nodes | node.gaussians | node.triangles;
        let (hits, begun) = (present & !sign_bits(inside), sign_bits(behind));
        Reached { keys, now: hits & begun, later: hits & !begun }
    }
}

/// In one instruction, unlike `f32::min`: the second where the first is NaN.
#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Bit by bit, which values are negative.
#[inline(always)]
fn sign_bits(values: [f32; WIDTH]) -> u8 {
    // The compiler takes masks of comparisons apart, bit by bit; this it understands.
    #[cfg(target_arch = "x86_64")]
    if let Some(sse) = pulp::core_arch::x86::Sse::try_new() {
        let [low, high] = bytemuck::cast::<_, [[f32; 4]; 2]>(values);
        return (sse._mm_movemask_ps(bytemuck::cast(low)) | sse._mm_movemask_ps(bytemuck::cast(high)) << 4) as u8;
    }
    values.iter().rev().fold(0, |bits, value| bits << 1 | u8::from(value.is_sign_negative()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sign_bits_are_in_the_order_of_the_lanes() {
        assert_eq!(sign_bits([-1.0, 2.0, -3.0, 0.0, f32::INFINITY, f32::NEG_INFINITY, 1.0, -1e-40]), 0b1010_0101);
    }
}
