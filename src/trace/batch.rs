//! Gaussians side by side in f64 lanes, as kernels take them.

use glam::DVec3;
use pulp::Simd;

use crate::scene::Splats;

/// Gaussians in a batch: one AVX-512 vector of f64, two of AVX2.
pub(super) const BATCH: usize = 8;

/// A value per Gaussian of a batch, aligned to the widest vector.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub(super) struct Lanes(pub [f64; BATCH]);

impl Lanes {
    pub const ZERO: Self = Self([0.0; BATCH]);

    /// Vector `v` of `BATCH / S::F64_LANES`.
    #[inline(always)]
    pub fn get<S: Simd>(&self, v: usize) -> S::f64s {
        S::as_simd_f64s(&self.0).0[v]
    }

    #[inline(always)]
    pub fn set<S: Simd>(&mut self, v: usize, vector: S::f64s) {
        S::as_mut_simd_f64s(&mut self.0).0[v] = vector;
    }
}

/// Filled one Gaussian at a time, computed with at once. Lanes that were not filled hold what was there before.
pub(super) struct Batch {
    /// Metres from a common origin to each mean, by axis.
    pub mean_from_origin: [Lanes; 3],
    /// `M = S^-1 R^T`, column by column.
    pub unit_from_world: [Lanes; 9],
    pub opacity: Lanes,
    pub index: [u32; BATCH],
    filled: usize,
}

impl Default for Batch {
    fn default() -> Self {
        Self {
            mean_from_origin: [Lanes::ZERO; 3],
            unit_from_world: [Lanes::ZERO; 9],
            opacity: Lanes::ZERO,
            index: [0; BATCH],
            filled: 0,
        }
    }
}

impl Batch {
    /// Adds Gaussian `index`, seen from `origin`; true when that fills the batch.
    #[inline(always)]
    pub fn add(&mut self, splats: &Splats, index: u32, origin: DVec3) -> bool {
        let (lane, i) = (self.filled, index as usize);
        let mean_from_origin = splats.means[i].as_dvec3() - origin;
        for axis in 0..3 {
            self.mean_from_origin[axis].0[lane] = mean_from_origin[axis];
        }
        let unit_from_world = splats.unit_from_world[i].to_cols_array();
        for (lanes, entry) in self.unit_from_world.iter_mut().zip(unit_from_world) {
            lanes.0[lane] = f64::from(entry);
        }
        self.opacity.0[lane] = f64::from(splats.opacities[i]);
        self.index[lane] = index;
        self.filled += 1;
        self.filled == BATCH
    }

    pub fn len(&self) -> usize {
        self.filled
    }

    /// How many Gaussians the batch holds. It counts as empty from here on; its lanes stay until the next [`Self::add`].
    #[inline(always)]
    pub fn take(&mut self) -> usize {
        std::mem::take(&mut self.filled)
    }
}

/// Three components, each a vector over Gaussians.
pub(super) type Vector3<S> = [<S as Simd>::f64s; 3];

#[inline(always)]
pub(super) fn dot<S: Simd>(simd: S, a: Vector3<S>, b: Vector3<S>) -> S::f64s {
    simd.mul_add_e_f64s(a[0], b[0], simd.mul_add_e_f64s(a[1], b[1], simd.mul_f64s(a[2], b[2])))
}

/// `a b - c d`.
#[inline(always)]
pub(super) fn difference_of_products<S: Simd>(simd: S, a: S::f64s, b: S::f64s, c: S::f64s, d: S::f64s) -> S::f64s {
    simd.sub_f64s(simd.mul_f64s(a, b), simd.mul_f64s(c, d))
}

#[inline(always)]
pub(super) fn cross<S: Simd>(simd: S, a: Vector3<S>, b: Vector3<S>) -> Vector3<S> {
    [
        difference_of_products(simd, a[1], b[2], a[2], b[1]),
        difference_of_products(simd, a[2], b[0], a[0], b[2]),
        difference_of_products(simd, a[0], b[1], a[1], b[0]),
    ]
}

#[inline(always)]
pub(super) fn scaled<S: Simd>(simd: S, a: Vector3<S>, factor: S::f64s) -> Vector3<S> {
    [simd.mul_f64s(a[0], factor), simd.mul_f64s(a[1], factor), simd.mul_f64s(a[2], factor)]
}

/// `a + b factor`.
#[inline(always)]
pub(super) fn plus_scaled<S: Simd>(simd: S, a: Vector3<S>, b: Vector3<S>, factor: S::f64s) -> Vector3<S> {
    [
        simd.mul_add_e_f64s(b[0], factor, a[0]),
        simd.mul_add_e_f64s(b[1], factor, a[1]),
        simd.mul_add_e_f64s(b[2], factor, a[2]),
    ]
}
