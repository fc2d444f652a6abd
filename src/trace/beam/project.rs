//! From Gaussians and triangles to candidates of a tile: formed in f64, stored in f32 relative to the tile.
//!
//! All rays of a probe share their origin x, so with `p = M (mu - x)` and a ray `v = M d(px, py)`, d affine in the texel
//! position, everything the response needs is affine too. Split v along p: `h = p^.v`, and two components (u, s) across
//! it, in a basis turned so that s does not depend on px. Then
//!
//! ```text
//! |g x v|^2 = |p|^2 (u^2 + s^2),   v.v = u^2 + s^2 + h^2,   m2 = |p|^2 (u^2 + s^2) / (v.v),   depth = |p| h / (v.v)
//! ```
//!
//! which is the ray tracer's own value, not an approximation; holds for Gaussians in front of, around and behind the
//! face's plane alike; and cancels only to first order (DESIGN: the conic's quadratic form loses twice the digits).

use glam::DVec3;
use pulp::Simd;

use super::BLOCK_EDGE;
use super::candidate::Candidate;
use super::frustum::{FaceAxes, block_mask};
use super::image::{image_bounds, set_forms, through, unit_across};
use super::lanes::QUAD;
use crate::job::Order;
use crate::scene::{Meshes, Splats};
use crate::trace::batch::{BATCH, Batch, Lanes, cross, dot, plus_scaled, scaled};
use crate::trace::{Footprint, Tile};

/// Image positions are formed in f64; a texel's centre this close to an ellipse's edge counts as inside.
const TEXEL_SLACK: f64 = 1e-3;

/// Lower bounds round down by this much when they become f32: the forms they are made from carry a few roundings.
const KEY_SLACK: f64 = 2e-6;

/// Of a cone's slopes and of its constants, by which its width grows: either carries a few roundings of 6e-8 in f32, and
/// slopes are multiplied by up to 64 texels.
const SLOPE_SLACK: f64 = 1e-3;
const CONSTANT_SLACK: f64 = 1e-6;

/// A probe's view through one tile; Gaussians pass through it in batches.
pub(super) struct Projection {
    pub origin: DVec3,
    tile: Tile,
    order: Order,
    footprint: Footprint,
    axes: FaceAxes,
    /// Direction through the tile's corner and its centre, right and down, where the look component is 1.
    corner: [f64; 2],
    centre: [f64; 2],
    /// Change of direction per texel.
    texel: f64,
    batch: Batch,
    lanes: Box<ProjectedLanes>,
}

/// A batch, projected; the names are those of [`Candidate`]'s fields.
struct ProjectedLanes {
    u: [Lanes; 3],
    s: [Lanes; 2],
    h: [Lanes; 3],
    falloff: Lanes,
    log2_opacity: Lanes,
    depth: Lanes,
    cone: [Lanes; 3],
    depth_low: Lanes,
    nearest: Lanes,
    mean_distance: Lanes,
    /// Texels between which it is seen; the last is smaller than the first where nothing is.
    columns: [Lanes; 2],
    rows: [Lanes; 2],
}

impl Projection {
    pub fn new(origin: DVec3, tile: &Tile, order: Order, footprint: Footprint) -> Self {
        let texel = 2.0 / f64::from(tile.face_size);
        let corner = [f64::from(tile.x) * texel - 1.0, f64::from(tile.y) * texel - 1.0];
        let edges = [f64::from(tile.width), f64::from(tile.height)];
        let centre = [corner[0] + 0.5 * texel * edges[0], corner[1] + 0.5 * texel * edges[1]];
        let lanes = Box::new(ProjectedLanes {
            u: [Lanes::ZERO; 3],
            s: [Lanes::ZERO; 2],
            h: [Lanes::ZERO; 3],
            falloff: Lanes::ZERO,
            log2_opacity: Lanes::ZERO,
            depth: Lanes::ZERO,
            cone: [Lanes::ZERO; 3],
            depth_low: Lanes::ZERO,
            nearest: Lanes::ZERO,
            mean_distance: Lanes::ZERO,
            columns: [Lanes::ZERO; 2],
            rows: [Lanes::ZERO; 2],
        });
        let axes = FaceAxes::new(tile.face);
        let batch = Batch::default();
        Self { origin, tile: *tile, order, footprint, axes, corner, centre, texel, batch, lanes }
    }

    /// Adds Gaussian `index` to the batch; true when that fills it.
    #[inline(always)]
    pub fn add(&mut self, splats: &Splats, index: u32) -> bool {
        self.batch.add(splats, index, self.origin)
    }

    /// Projects the batch and empties it; [`Self::candidate`] then gives the first `n` returned.
    #[inline(always)]
    pub fn project<S: Simd>(&mut self, simd: S) -> usize {
        if self.batch.len() == 0 {
            return 0;
        }
        if !self.footprint.is_none() {
            self.footprint.widen(simd, &mut self.batch);
        }
        let lanes = &mut *self.lanes;
        for (log2, opacity) in lanes.log2_opacity.0.iter_mut().zip(self.batch.opacity.0) {
            *log2 = log2_of(opacity);
        }
        let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
        for v in 0..BATCH / S::F64_LANES {
            // In face coordinates: right, down, look.
            let mut mean = [zero; 3];
            let mut columns = [[zero; 3]; 3];
            for axis in 0..3 {
                let (world, sign) = self.axes.0[axis];
                let sign = simd.splat_f64s(sign);
                mean[axis] = simd.mul_f64s(self.batch.mean_from_origin[world].get::<S>(v), sign);
                for (row, entry) in columns[axis].iter_mut().enumerate() {
                    *entry = simd.mul_f64s(self.batch.unit_from_world[3 * world + row].get::<S>(v), sign);
                }
            }
            let [right, down, look] = columns;
            let log2_opacity = lanes.log2_opacity.get::<S>(v);
            // 2 ln(opacity / ALPHA_MIN)
            let radius_squared = simd.mul_f64s(
                simd.sub_f64s(log2_opacity, simd.splat_f64s(LOG2_ALPHA_MIN)),
                simd.splat_f64s(2.0 * std::f64::consts::LN_2),
            );
            let image = image_bounds(simd, mean, [right, down, look], radius_squared);

            let p = plus_scaled(simd, plus_scaled(simd, scaled(simd, right, mean[0]), down, mean[1]), look, mean[2]);
            let p_squared = dot(simd, p, p);
            let p_length = simd.sqrt_f64s(p_squared);
            let ahead = scaled(simd, p, simd.div_f64s(one, p_length));
            let corner = through(simd, columns, self.corner);
            let centre = through(simd, columns, self.centre);
            let scale = simd.div_f64s(one, simd.sqrt_f64s(dot(simd, centre, centre)));
            let v0 = scaled(simd, corner, scale);
            let texel = simd.mul_f64s(scale, simd.splat_f64s(self.texel));
            let (vx, vy) = (scaled(simd, right, texel), scaled(simd, down, texel));
            let u_axis = unit_across(simd, ahead, vx);
            let s_axis = cross(simd, ahead, u_axis);
            set_forms(simd, v, &mut lanes.u, u_axis, [v0, vx, vy]);
            set_forms(simd, v, &mut lanes.h, ahead, [v0, vx, vy]);
            lanes.s[0].set::<S>(v, dot(simd, s_axis, v0));
            lanes.s[1].set::<S>(v, dot(simd, s_axis, vy));

            let depth = simd.mul_f64s(p_length, scale);
            let slack = simd.splat_f64s(1.0 - KEY_SLACK);
            let reach = simd.div_f64s(radius_squared, p_squared);
            let in_front = simd.max_f64s(simd.sub_f64s(one, reach), zero);
            set_cone(simd, v, lanes, reach, in_front);
            lanes.falloff.set::<S>(v, simd.mul_f64s(p_squared, simd.splat_f64s(std::f64::consts::LOG2_E / 2.0)));
            lanes.depth.set::<S>(v, depth);
            lanes.depth_low.set::<S>(v, simd.mul_f64s(simd.mul_f64s(depth, in_front), slack));
            lanes.nearest.set::<S>(v, simd.mul_f64s(simd.max_f64s(image.nearest, zero), slack));
            lanes.mean_distance.set::<S>(v, simd.sqrt_f64s(dot(simd, mean, mean)));

            // On the mean, the strongest response is at distance 0 and never counts.
            let seen = simd.and_m64s(image.in_front, simd.greater_than_f64s(p_squared, zero));
            let half = simd.splat_f64s(0.5 * f64::from(self.tile.face_size));
            let nothing = simd.splat_f64s(f64::NEG_INFINITY);
            let left = simd.sub_f64s(half, simd.splat_f64s(f64::from(self.tile.x)));
            let top = simd.sub_f64s(half, simd.splat_f64s(f64::from(self.tile.y)));
            lanes.columns[0].set::<S>(v, simd.mul_add_e_f64s(image.x[0], half, left));
            let last_column = simd.mul_add_e_f64s(image.x[1], half, left);
            lanes.columns[1].set::<S>(v, simd.select_f64s(seen, last_column, nothing));
            lanes.rows[0].set::<S>(v, simd.mul_add_e_f64s(image.y[0], half, top));
            lanes.rows[1].set::<S>(v, simd.mul_add_e_f64s(image.y[1], half, top));
        }
        self.batch.take()
    }

    /// The Gaussian in `lane`, valid between [`Self::project`] and the next [`Self::add`]; `None` when no texel centre of
    /// the tile can see it.
    #[inline(always)]
    pub fn candidate(&self, lane: usize) -> Option<Candidate> {
        let lanes = &*self.lanes;
        let at = |value: &Lanes| value.0[lane];
        let view =
            self.view([at(&lanes.columns[0]), at(&lanes.columns[1])], [at(&lanes.rows[0]), at(&lanes.rows[1])])?;
        let [u, h, cone] =
            [&lanes.u, &lanes.h, &lanes.cone].map(|[a, b, c]| [at(a) as f32, at(b) as f32, at(c) as f32]);
        let mut candidate = Candidate {
            u,
            s: [at(&lanes.s[0]) as f32, at(&lanes.s[1]) as f32],
            h,
            falloff: at(&lanes.falloff) as f32,
            log2_opacity: at(&lanes.log2_opacity) as f32,
            depth: at(&lanes.depth) as f32,
            cone,
            depth_low: at(&lanes.depth_low) as f32,
            nearest: at(&lanes.nearest) as f32,
            key_low: at(&lanes.mean_distance) as f32,
            colour: [0.0; 3],
            linear: false,
            index: self.batch.index[lane],
            columns: view.columns,
            rows: view.rows,
            blocks: view.blocks,
        };
        if self.order == Order::RayHitDistance {
            candidate.key_low = candidate.depth_low_in(0.0, 0.0, self.tile.width.max(self.tile.height) as f32);
        }
        Some(candidate)
    }

    /// `None` when the tile cannot see the triangle.
    pub fn triangle(&self, meshes: &Meshes, index: u32) -> Option<Candidate> {
        let corners = meshes.corners(index as usize).map(|corner| corner.as_dvec3() - self.origin);
        let in_face = corners.map(|corner| self.axes.face_from_world(corner));
        let depths = in_face.map(|corner| corner.z);
        let nearest = depths[0].min(depths[1]).min(depths[2]);
        if !(depths[0].max(depths[1]).max(depths[2]) > 0.0) {
            return None;
        }
        let view = if nearest > 0.0 {
            let half = f64::from(self.tile.face_size) / 2.0;
            let ends = |axis: usize, first: i32| {
                let values = in_face.map(|corner| half + half * corner[axis] / corner.z - f64::from(first));
                [values[0].min(values[1]).min(values[2]), values[0].max(values[1]).max(values[2])]
            };
            self.view(ends(0, self.tile.x), ends(1, self.tile.y))?
        } else {
            self.view([f64::NEG_INFINITY, f64::INFINITY], [f64::NEG_INFINITY, f64::INFINITY])?
        };
        let key_low = match self.order {
            Order::RayHitDistance => nearest.max(0.0) * (1.0 - KEY_SLACK),
            // The distance of the triangle's plane bounds that of every point on it.
            Order::CameraDistance => {
                let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
                normal.dot(corners[0]).abs() * (1.0 - KEY_SLACK)
            }
        };
        Some(Candidate {
            u: [0.0; 3],
            s: [0.0; 2],
            h: [0.0; 3],
            falloff: 0.0,
            log2_opacity: 0.0,
            depth: 0.0,
            cone: [1.0, 0.0, 0.0],
            depth_low: 0.0,
            nearest: (nearest.max(0.0) * (1.0 - KEY_SLACK)) as f32,
            key_low: key_low as f32,
            colour: [0.0; 3],
            linear: false,
            index: index | Candidate::TRIANGLE,
            columns: view.columns,
            rows: view.rows,
            blocks: view.blocks,
        })
    }

    /// The texels whose centres lie within `columns` and `rows`; `None` when there is none.
    #[inline(always)]
    fn view(&self, columns: [f64; 2], rows: [f64; 2]) -> Option<View> {
        // `as` saturates, so infinite ends become the tile's own.
        let first = |end: f64| ((end - 0.5 - TEXEL_SLACK).ceil() as i32).max(0);
        let last = |end: f64, size: u32| ((end - 0.5 + TEXEL_SLACK).floor() as i32).min(size as i32 - 1);
        let (left, right) = (first(columns[0]), last(columns[1], self.tile.width));
        let (top, bottom) = (first(rows[0]), last(rows[1], self.tile.height));
        if left > right || top > bottom {
            return None;
        }
        let block = |texel: i32| texel as u32 / BLOCK_EDGE;
        let blocks = block_mask([block(left), block(right)], [block(top), block(bottom)]);
        Some(View { columns: [left as i16, right as i16], rows: [top as i16, bottom as i16], blocks })
    }
}

/// The form [`Candidate::cone`], for `reach = r^2 / |p|^2` and `in_front = 1 - reach`, from the forms u, s and h.
///
/// A texel responds where `(u^2 + s^2) / (v.v) <= reach`, that is, where `sqrt(u^2 + s^2) <= h sqrt(reach / in_front)`.
/// From a quad's middle to its texels, both sides change by no more than their slopes allow.
#[inline(always)]
fn set_cone<S: Simd>(simd: S, v: usize, lanes: &mut ProjectedLanes, reach: S::f64s, in_front: S::f64s) {
    // What is around the probe, or nearly, responds everywhere.
    let least = simd.splat_f64s(1e-6);
    let everywhere = simd.less_than_f64s(in_front, least);
    let factor = simd.sqrt_f64s(simd.div_f64s(reach, simd.max_f64s(in_front, least)));
    let mut h = [factor; 3];
    for (scaled, form) in h.iter_mut().zip(&lanes.h) {
        *scaled = simd.mul_f64s(factor, form.get::<S>(v));
    }
    let (ux, uy, sy) = (lanes.u[1].get::<S>(v), lanes.u[2].get::<S>(v), lanes.s[1].get::<S>(v));
    let down = simd.sqrt_f64s(simd.mul_add_e_f64s(uy, uy, simd.mul_f64s(sy, sy)));
    let slopes =
        simd.add_f64s(simd.add_f64s(simd.abs_f64s(ux), down), simd.add_f64s(simd.abs_f64s(h[1]), simd.abs_f64s(h[2])));
    let constants = simd.add_f64s(
        simd.add_f64s(simd.abs_f64s(lanes.u[0].get::<S>(v)), simd.abs_f64s(lanes.s[0].get::<S>(v))),
        simd.abs_f64s(h[0]),
    );
    let half_quad = simd.splat_f64s(0.5 * f64::from(QUAD - 1) * (1.0 + SLOPE_SLACK));
    let slack = simd.mul_add_e_f64s(slopes, half_quad, simd.mul_f64s(constants, simd.splat_f64s(CONSTANT_SLACK)));
    // Wider than any form, and with a square that f32 holds.
    let widest = [simd.splat_f64s(1e15), simd.splat_f64s(0.0), simd.splat_f64s(0.0)];
    h[0] = simd.add_f64s(h[0], slack);
    for ((form, cone), wide) in lanes.cone.iter_mut().zip(h).zip(widest) {
        form.set::<S>(v, simd.select_f64s(everywhere, wide, cone));
    }
}

/// Where in a tile something may be seen.
struct View {
    columns: [i16; 2],
    rows: [i16; 2],
    blocks: u64,
}

/// log2(1/255).
pub(super) const LOG2_ALPHA_MIN: f64 = -7.994_353_436_858_858;

/// log2 of a positive number that f32 holds, to 1e-10: the exponent, and a series in (m - 1) / (m + 1) for a mantissa m
/// between the roots of 1/2 and 2. Inlined where eight are taken at once.
#[inline(always)]
fn log2_of(opacity: f64) -> f64 {
    let bits = (opacity as f32).to_bits() as i32;
    let exponent = (bits - 0x3f35_04f3) >> 23;
    let mantissa = f64::from(f32::from_bits((bits - (exponent << 23)) as u32));
    let t = (mantissa - 1.0) / (mantissa + 1.0);
    let tt = t * t;
    // t is at most 0.1716: the first term left out is 2 t^13 / 13 = 1.7e-11.
    let mut series = 1.0 / 11.0;
    for odd in [9.0, 7.0, 5.0, 3.0, 1.0] {
        series = series * tt + 1.0 / odd;
    }
    f64::from(exponent) + 2.0 * std::f64::consts::LOG2_E * t * series
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::splats::ALPHA_MIN;

    #[test]
    fn log2_of_opacities_is_good_to_1e_minus_10() {
        for opacity in (1..=4000).map(|i| i as f32 / 4000.0).chain([ALPHA_MIN as f32, f32::MIN_POSITIVE]) {
            let opacity = f64::from(opacity);
            assert!((log2_of(opacity) - opacity.log2()).abs() < 1e-10, "{opacity}");
        }
        assert!((LOG2_ALPHA_MIN - ALPHA_MIN.log2()).abs() < 1e-14);
    }
}
