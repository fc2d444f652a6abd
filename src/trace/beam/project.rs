//! A Gaussian or triangle as one tile sees it. Formed in f64, stored in f32 relative to the tile.
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

use glam::{DMat3, DVec3};

use super::CELL_EDGE;
use super::frustum::cell_mask;
use crate::job::Order;
use crate::scene::{Meshes, Splats};
use crate::trace::Tile;

/// Image positions are formed in f64; a texel's centre this close to an ellipse's edge counts as inside.
const TEXEL_SLACK: f64 = 1e-3;

/// Lower bounds round down by this much when they become f32: the forms they are made from carry a few roundings.
const KEY_SLACK: f64 = 2e-6;

/// What a block needs to evaluate a Gaussian or a triangle at its texels. (x, y) are texels from the tile's corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    /// `u = u[0] + u[1] x + u[2] y`, likewise the others; all three share one scale, which cancels.
    pub u: [f32; 3],
    pub s: [f32; 2],
    pub h: [f32; 3],
    /// `|p|^2 log2(e) / 2`: the response is `2^(log2_opacity - falloff (u^2 + s^2) / (v.v))`.
    pub falloff: f32,
    pub log2_opacity: f32,
    /// `|p|` in the scale of h: the depth of the strongest response is `depth h / (v.v)`.
    pub depth: f32,
    /// `depth (1 - r^2 / |p|^2)`, or 0: the least depth of a response is at least this over the largest h, and at least
    /// `nearest`. For a thin disc that is its plane, however oblique.
    depth_low: f32,
    nearest: f32,
    /// A lower bound on the sort keys of its contributions, and for `cameraDistance` the key itself.
    pub key_low: f32,
    pub colour: [f32; 3],
    /// Into the scene's Gaussians, or its triangles when [`Candidate::TRIANGLE`] is set.
    pub index: u32,
    /// Texels it may touch: first column, first row, last column, last row.
    pub bounds: [i16; 4],
    /// Cells it may touch.
    pub cells: u64,
}

impl Candidate {
    /// Marks `index` as a triangle's; scenes of 2^31 primitives do not fit in memory.
    const TRIANGLE: u32 = 1 << 31;

    pub fn is_gaussian(&self) -> bool {
        self.index & Self::TRIANGLE == 0
    }

    pub fn triangle(&self) -> u32 {
        self.index & !Self::TRIANGLE
    }

    /// A lower bound on the depths of its contributions in a cell, given by its first texel.
    #[inline(always)]
    pub fn depth_low_in(&self, x: u32, y: u32) -> f32 {
        self.depth_low_between([x as f32, y as f32], CELL_EDGE as f32)
    }

    #[inline(always)]
    fn depth_low_between(&self, corner: [f32; 2], edge: f32) -> f32 {
        // Where it responds, u^2 + s^2 <= r^2 v.v / |p|^2, so v.v <= h^2 / (1 - r^2 / |p|^2), and the depth
        // |p| h / v.v is at least |p| (1 - r^2 / |p|^2) / h.
        let [h0, hx, hy] = self.h;
        let steepest = h0 + hx * corner[0] + hy * corner[1] + edge * (hx.max(0.0) + hy.max(0.0));
        let plane = if steepest > 0.0 { self.depth_low / steepest } else { 0.0 };
        if plane > self.nearest { plane } else { self.nearest }
    }
}

/// A probe's view through one tile.
pub(super) struct Projection {
    pub origin: DVec3,
    /// Direction through the tile's corner, and its change per texel to the right and down.
    corner: DVec3,
    right: DVec3,
    down: DVec3,
    /// Direction through the tile's centre, where the affine forms are scaled to 1.
    centre: DVec3,
    /// Face axes in world coordinates.
    look: DVec3,
    tile: Tile,
    order: Order,
}

impl Projection {
    pub fn new(origin: DVec3, tile: &Tile, order: Order) -> Self {
        let [right, up, look] = tile.face.axes();
        let texel = 2.0 / f64::from(tile.face_size);
        let corner = tile.face.direction(tile.face_size, f64::from(tile.x), f64::from(tile.y));
        let (right, down) = (right * texel, -up * texel);
        let centre = corner + right * f64::from(tile.width) / 2.0 + down * f64::from(tile.height) / 2.0;
        Self { origin, corner, right, down, centre, look, tile: *tile, order }
    }

    /// `None` when no texel centre of the tile can see it.
    #[inline]
    pub fn gaussian(&self, splats: &Splats, index: u32) -> Option<Candidate> {
        let i = index as usize;
        let mean = splats.means[i].as_dvec3() - self.origin;
        let radius_squared = Splats::support_radius_squared(splats.opacities[i]);
        let covariance = splats.covariance(i);
        let view = self.image_bounds(mean, &covariance, radius_squared)?;

        let m = splats.unit_from_world[i].as_dmat3();
        let p = m * mean;
        let p_length = p.length();
        let ahead = p / p_length;
        if !ahead.is_finite() {
            // The probe sits on the mean: the strongest response is at distance 0 and never counts.
            return None;
        }
        let scale = (m * self.centre).length().recip();
        let [v0, vx, vy] = [self.corner, self.right, self.down].map(|d| m * d * scale);
        let across = vx - ahead * ahead.dot(vx);
        let u_axis = if across.length_squared() > 0.0 { across.normalize() } else { ahead.any_orthonormal_vector() };
        let s_axis = ahead.cross(u_axis);
        let forms = |axis: DVec3| [axis.dot(v0) as f32, axis.dot(vx) as f32, axis.dot(vy) as f32];
        let s = forms(s_axis);
        let h = forms(ahead);
        let depth = p_length * scale;
        let mut candidate = Candidate {
            u: forms(u_axis),
            s: [s[0], s[2]],
            h,
            falloff: (p_length * p_length * std::f64::consts::LOG2_E / 2.0) as f32,
            log2_opacity: f64::from(splats.opacities[i]).log2() as f32,
            depth: depth as f32,
            depth_low: (depth * (1.0 - radius_squared / (p_length * p_length)).max(0.0) * (1.0 - KEY_SLACK)) as f32,
            nearest: (view.nearest.max(0.0) * (1.0 - KEY_SLACK)) as f32,
            key_low: 0.0,
            colour: [0.0; 3],
            index,
            bounds: view.bounds,
            cells: view.cells,
        };
        candidate.key_low = match self.order {
            Order::RayHitDistance => candidate.depth_low_between([0.0; 2], Tile::EDGE as f32),
            Order::CameraDistance => mean.length() as f32,
        };
        Some(candidate)
    }

    /// `None` when the tile cannot see the triangle.
    pub fn triangle(&self, meshes: &Meshes, index: u32) -> Option<Candidate> {
        let corners = meshes.corners(index as usize).map(|corner| corner.as_dvec3() - self.origin);
        let depths = corners.map(|corner| corner.dot(self.look));
        let nearest = depths[0].min(depths[1]).min(depths[2]);
        if !(depths[0].max(depths[1]).max(depths[2]) > 0.0) {
            return None;
        }
        let view = if nearest > 0.0 {
            let points = corners.map(|corner| self.image_point(corner));
            let ends = |axis: usize| {
                let values = points.map(|point| point[axis]);
                [values[0].min(values[1]).min(values[2]), values[0].max(values[1]).max(values[2])]
            };
            self.view(ends(0), ends(1), nearest)?
        } else {
            self.view([f64::NEG_INFINITY, f64::INFINITY], [f64::NEG_INFINITY, f64::INFINITY], 0.0)?
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
            depth_low: 0.0,
            nearest: (nearest.max(0.0) * (1.0 - KEY_SLACK)) as f32,
            key_low: key_low as f32,
            colour: [0.0; 3],
            index: index | Candidate::TRIANGLE,
            bounds: view.bounds,
            cells: view.cells,
        })
    }

    /// A point in front of the face's plane, in texels from the tile's corner.
    fn image_point(&self, point: DVec3) -> [f64; 2] {
        let [right, up, look] = self.tile.face.axes();
        let half = f64::from(self.tile.face_size) / 2.0;
        let depth = point.dot(look);
        [
            half + half * point.dot(right) / depth - f64::from(self.tile.x),
            half - half * point.dot(up) / depth - f64::from(self.tile.y),
        ]
    }

    /// The rectangle around the image of the ellipsoid `|M (p - mu)| <= r`, by its tangent planes through the probe.
    ///
    /// A plane with normal `N = e_x - k e_z` touches it where `(N.m)^2 = r^2 N^T Sigma N`, a quadratic in k.
    fn image_bounds(&self, mean: DVec3, covariance: &DMat3, radius_squared: f64) -> Option<View> {
        if !(radius_squared > 0.0) {
            return None;
        }
        let [right, up, look] = self.tile.face.axes();
        let sigma_look = *covariance * look;
        let (z, zz) = (mean.dot(look), radius_squared * look.dot(sigma_look));
        let reach = zz.sqrt();
        if !(z + reach > 0.0) {
            return None;
        }
        let leading = z * z - zz;
        let nearest = z - reach;
        if !(leading > 0.0 && z > 0.0) {
            // It crosses the plane through the probe: its image has no bounds that are worth having.
            return self.view([f64::NEG_INFINITY, f64::INFINITY], [f64::NEG_INFINITY, f64::INFINITY], nearest);
        }
        let half = f64::from(self.tile.face_size) / 2.0;
        let ends = |axis: DVec3, first: u32| {
            let sigma_axis = *covariance * axis;
            let (x, xx, xz) =
                (mean.dot(axis), radius_squared * axis.dot(sigma_axis), radius_squared * axis.dot(sigma_look));
            let middle = x * z - xz;
            let spread = (middle * middle - leading * (x * x - xx)).max(0.0).sqrt();
            [(middle - spread) / leading, (middle + spread) / leading].map(|k| half + half * k - f64::from(first))
        };
        self.view(ends(right, self.tile.x), ends(-up, self.tile.y), nearest)
    }

    /// The texels whose centres lie within `columns` and `rows`; `None` when there is none.
    fn view(&self, columns: [f64; 2], rows: [f64; 2], nearest: f64) -> Option<View> {
        // `as` saturates, so infinite ends become the tile's own.
        let first = |end: f64| ((end - 0.5 - TEXEL_SLACK).ceil() as i64).max(0);
        let last = |end: f64, size: u32| ((end - 0.5 + TEXEL_SLACK).floor() as i64).min(i64::from(size) - 1);
        let (left, right) = (first(columns[0]), last(columns[1], self.tile.width));
        let (top, bottom) = (first(rows[0]), last(rows[1], self.tile.height));
        if left > right || top > bottom {
            return None;
        }
        let size = [self.tile.width as f32, self.tile.height as f32];
        Some(View {
            nearest,
            bounds: [left as i16, top as i16, right as i16, bottom as i16],
            cells: cell_mask([left as f32, right as f32], [top as f32, bottom as f32], size),
        })
    }
}

/// Where in a tile something may be seen, and its nearest depth.
struct View {
    nearest: f64,
    bounds: [i16; 4],
    cells: u64,
}
