//! Where an ellipsoid lies in the image, and the affine forms that its responses are made from; Gaussians side by side.

use pulp::Simd;

use crate::trace::batch::{Lanes, Vector3, difference_of_products, dot, plus_scaled, scaled};

/// `M d` for the direction that is `at` right and down where its look component is 1.
#[inline(always)]
pub(super) fn through<S: Simd>(simd: S, [right, down, look]: [Vector3<S>; 3], at: [f64; 2]) -> Vector3<S> {
    plus_scaled(simd, plus_scaled(simd, look, right, simd.splat_f64s(at[0])), down, simd.splat_f64s(at[1]))
}

/// The affine form of a component of v.
#[inline(always)]
pub(super) fn set_forms<S: Simd>(
    simd: S,
    v: usize,
    forms: &mut [Lanes; 3],
    axis: Vector3<S>,
    v_parts: [Vector3<S>; 3],
) {
    forms[0].set::<S>(v, dot(simd, axis, v_parts[0]));
    forms[1].set::<S>(v, dot(simd, axis, v_parts[1]));
    forms[2].set::<S>(v, dot(simd, axis, v_parts[2]));
}

/// Ends of an ellipsoid's image, as ratios of right and down to look.
pub(super) struct ImageBounds<S: Simd> {
    pub x: [S::f64s; 2],
    pub y: [S::f64s; 2],
    /// Depth of its nearest point.
    pub nearest: S::f64s,
    /// Whether any of it lies in front of the plane through the probe.
    pub in_front: S::m64s,
}

/// The rectangle around the image of the ellipsoid `|M (p - mu)| <= r`, by its tangent planes through the probe; all of
/// the plane when it crosses the plane through the probe, where its image has no bounds that are worth having.
///
/// A plane with normal `N = e_x - k e_z` touches it where `(N.m)^2 = r^2 N^T Sigma N`, a quadratic in k. Rows of M are
/// `r_k / s_k` with unit r_k, so that Sigma is the sum of `row_k row_k^T / |row_k|^4`.
#[inline(always)]
pub(super) fn image_bounds<S: Simd>(
    simd: S,
    mean: Vector3<S>,
    columns: [Vector3<S>; 3],
    radius_squared: S::f64s,
) -> ImageBounds<S> {
    let zero = simd.splat_f64s(0.0);
    let [mut xx, mut xz, mut yy, mut yz, mut zz] = [zero; 5];
    let [right, down, look] = columns;
    for ((x, y), z) in right.into_iter().zip(down).zip(look) {
        let axis = scaled(simd, [x, y, z], simd.div_f64s(simd.splat_f64s(1.0), dot(simd, [x, y, z], [x, y, z])));
        xx = simd.mul_add_e_f64s(axis[0], axis[0], xx);
        xz = simd.mul_add_e_f64s(axis[0], axis[2], xz);
        yy = simd.mul_add_e_f64s(axis[1], axis[1], yy);
        yz = simd.mul_add_e_f64s(axis[1], axis[2], yz);
        zz = simd.mul_add_e_f64s(axis[2], axis[2], zz);
    }
    let zz = simd.mul_f64s(zz, radius_squared);
    let reach = simd.sqrt_f64s(simd.max_f64s(zz, zero));
    let z = mean[2];
    let leading = difference_of_products(simd, z, z, zz, simd.splat_f64s(1.0));
    let bounded = simd.and_m64s(simd.greater_than_f64s(leading, zero), simd.greater_than_f64s(z, zero));
    let inverse = simd.div_f64s(simd.splat_f64s(1.0), leading);
    let mut ends = [[zero; 2]; 2];
    let (squares, mixed) = ([xx, yy], [xz, yz]);
    for axis in 0..2 {
        let (x, square, mixed) = (mean[axis], squares[axis], mixed[axis]);
        let middle = difference_of_products(simd, x, z, mixed, radius_squared);
        let remainder = difference_of_products(simd, x, x, square, radius_squared);
        let discriminant = difference_of_products(simd, middle, middle, leading, remainder);
        let spread = simd.sqrt_f64s(simd.max_f64s(discriminant, zero));
        let low = simd.mul_f64s(simd.sub_f64s(middle, spread), inverse);
        let high = simd.mul_f64s(simd.add_f64s(middle, spread), inverse);
        ends[axis] = [
            simd.select_f64s(bounded, low, simd.splat_f64s(f64::NEG_INFINITY)),
            simd.select_f64s(bounded, high, simd.splat_f64s(f64::INFINITY)),
        ];
    }
    let in_front = simd
        .and_m64s(simd.greater_than_f64s(simd.add_f64s(z, reach), zero), simd.greater_than_f64s(radius_squared, zero));
    ImageBounds { x: ends[0], y: ends[1], nearest: simd.sub_f64s(z, reach), in_front }
}

/// What of `vector` is not along the unit vector `ahead`.
#[inline(always)]
fn without<S: Simd>(simd: S, vector: Vector3<S>, ahead: Vector3<S>) -> Vector3<S> {
    plus_scaled(simd, vector, ahead, simd.sub_f64s(simd.splat_f64s(0.0), dot(simd, ahead, vector)))
}

/// The unit vector across `ahead` in the plane that it spans with `toward`; any across `ahead` when the two are parallel
/// to a rounding.
#[inline(always)]
pub(super) fn unit_across<S: Simd>(simd: S, ahead: Vector3<S>, toward: Vector3<S>) -> Vector3<S> {
    let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
    // Twice: of a thin disc `toward` is all but parallel to `ahead`, and what one pass leaves of that, a rounding of
    // `toward`, would be as large as what lies across.
    let across = without(simd, without(simd, toward, ahead), ahead);
    let across_squared = dot(simd, across, across);
    // What is left of a vector parallel to `ahead` is roundings, 1e-32 of its square.
    let least = simd.mul_f64s(dot(simd, toward, toward), simd.splat_f64s(1e-28));
    let usable = simd.greater_than_f64s(across_squared, least);
    // Across `ahead` without cancellation: (-y, x, 0), or (0, -z, y) where that is short.
    let along_z = simd.greater_than_f64s(simd.mul_f64s(ahead[2], ahead[2]), simd.splat_f64s(0.5));
    let other = [
        simd.select_f64s(along_z, zero, simd.sub_f64s(zero, ahead[1])),
        simd.select_f64s(along_z, simd.sub_f64s(zero, ahead[2]), ahead[0]),
        simd.select_f64s(along_z, ahead[1], zero),
    ];
    let chosen = [
        simd.select_f64s(usable, across[0], other[0]),
        simd.select_f64s(usable, across[1], other[1]),
        simd.select_f64s(usable, across[2], other[2]),
    ];
    scaled(simd, chosen, simd.div_f64s(one, simd.sqrt_f64s(dot(simd, chosen, chosen))))
}
