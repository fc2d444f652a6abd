//! Responses of Gaussians along rays of one origin, eight side by side in f64 lanes.
//!
//! Which Gaussians share a batch is of no matter: each lane computes what [`gaussian::response`](crate::trace::gaussian::response)
//! defines. f64 because thin Gaussians (1e-5 m seen from 10 m) lose up to 0.2 standard deviations in f32.

use glam::DVec3;
use pulp::Simd;

use crate::job::Order;
use crate::scene::Splats;
use crate::scene::splats::ALPHA_MAX;
use crate::trace::Footprint;
use crate::trace::batch::{BATCH, Batch, Lanes, Vector3, cross, dot};
use crate::trace::gaussian::Response;

/// A batch of Gaussians and what it responds.
pub(super) struct Responses {
    batch: Batch,
    /// `M (mu - o)`: the model's g, negated, since it looks from the mean to the origin.
    g: [Lanes; 3],
    distance: Lanes,
    alpha: Lanes,
}

impl Default for Responses {
    fn default() -> Self {
        Self { batch: Batch::default(), g: [Lanes::ZERO; 3], distance: Lanes::ZERO, alpha: Lanes::ZERO }
    }
}

/// One Gaussian's response.
pub(super) struct LaneResponse {
    pub index: u32,
    pub response: Response,
    /// Metres from the ray's origin to the mean.
    pub mean_from_origin: DVec3,
}

impl LaneResponse {
    /// The sort key.
    #[inline(always)]
    pub fn key(&self, order: Order) -> f64 {
        match order {
            Order::RayHitDistance => self.response.distance,
            Order::CameraDistance => self.mean_from_origin.length(),
        }
    }
}

impl Responses {
    /// Adds Gaussian `index`; true when that fills the batch.
    #[inline(always)]
    pub fn add(&mut self, splats: &Splats, index: u32, origin: DVec3) -> bool {
        self.batch.add(splats, index, origin)
    }

    /// Computes what all rays share: call it when all have been added.
    #[inline(always)]
    pub fn prepare<S: Simd>(&mut self, simd: S, footprint: Footprint) {
        if !footprint.is_none() {
            footprint.widen(simd, &mut self.batch);
        }
        for v in 0..BATCH / S::F64_LANES {
            let [mx, my, mz] = &self.batch.mean_from_origin;
            let mean = [mx.get::<S>(v), my.get::<S>(v), mz.get::<S>(v)];
            for row in 0..3 {
                let g = dot(simd, self.row::<S>(row, v), mean);
                self.g[row].set::<S>(v, g);
            }
        }
    }

    /// Row of `M` of vector `v`.
    #[inline(always)]
    fn row<S: Simd>(&self, row: usize, v: usize) -> Vector3<S> {
        let m = &self.batch.unit_from_world;
        [m[row].get::<S>(v), m[3 + row].get::<S>(v), m[6 + row].get::<S>(v)]
    }

    /// Computes the responses of all lanes along `direction`, for [`Self::lane`]; false if certainly none contributes, and then
    /// they are not to be looked at.
    #[inline(always)]
    pub fn evaluate<S: Simd>(&mut self, simd: S, direction: DVec3) -> bool {
        let d = [simd.splat_f64s(direction.x), simd.splat_f64s(direction.y), simd.splat_f64s(direction.z)];
        let end = simd.splat_f64s(M2_MAX);
        let mut contributes = false;
        for v in 0..BATCH / S::F64_LANES {
            let g = [self.g[0].get::<S>(v), self.g[1].get::<S>(v), self.g[2].get::<S>(v)];
            let w = [
                dot(simd, self.row::<S>(0, v), d),
                dot(simd, self.row::<S>(1, v), d),
                dot(simd, self.row::<S>(2, v), d),
            ];
            let g_cross_w = cross(simd, g, w);
            let inverse = simd.div_f64s(simd.splat_f64s(1.0), dot(simd, w, w));
            let m2 = simd.mul_f64s(dot(simd, g_cross_w, g_cross_w), inverse);
            if simd.first_true_m64s(simd.less_than_f64s(m2, end)) == S::F64_LANES {
                self.alpha.set::<S>(v, simd.splat_f64s(0.0));
                continue;
            }
            contributes = true;
            let alpha = simd.mul_f64s(self.batch.opacity.get::<S>(v), exp_of_half_negated(simd, m2));
            self.alpha.set::<S>(v, simd.min_f64s(alpha, simd.splat_f64s(ALPHA_MAX)));
            self.distance.set::<S>(v, simd.mul_f64s(dot(simd, g, w), inverse));
        }
        contributes
    }

    /// How many Gaussians the batch holds.
    #[inline(always)]
    pub fn len(&self) -> usize {
        self.batch.len()
    }

    /// Empties the batch.
    #[inline(always)]
    pub fn clear(&mut self) {
        self.batch.take();
    }

    /// The response in `lane` along the direction that was evaluated last.
    #[inline(always)]
    pub fn lane(&self, lane: usize) -> LaneResponse {
        let [x, y, z] = &self.batch.mean_from_origin;
        LaneResponse {
            index: self.batch.index[lane],
            response: Response { distance: self.distance.0[lane], alpha: self.alpha.0[lane] },
            mean_from_origin: DVec3::new(x.0[lane], y.0[lane], z.0[lane]),
        }
    }
}

/// Responses are under 1/255 from here on, at any opacity up to 1: `2 ln 255` is 11.08.
const M2_MAX: f64 = 11.1;

/// `exp(-m2 / 2)`, to 1e-14 relative, for m2 up to [`M2_MAX`]; from there on its value at [`M2_MAX`], which is under
/// every threshold as well. NaN gives that, too.
///
/// `exp(y)` for y in [-M2_MAX / 32, 0] by its Taylor series to degree 12 (remainder 0.35^13 / 13! = 2e-16), squared four
/// times, which multiplies its roundings by 16.
#[inline(always)]
fn exp_of_half_negated<S: Simd>(simd: S, m2: S::f64s) -> S::f64s {
    const INVERSE_FACTORIALS: [f64; 13] = {
        let mut inverse = [1.0; 13];
        let mut k = 1;
        while k < 13 {
            inverse[k] = inverse[k - 1] / k as f64;
            k += 1;
        }
        inverse
    };
    let end = simd.splat_f64s(M2_MAX);
    let within = simd.select_f64s(simd.less_than_f64s(m2, end), m2, end);
    let y = simd.mul_f64s(within, simd.splat_f64s(-1.0 / 32.0));
    let mut power = simd.splat_f64s(INVERSE_FACTORIALS[12]);
    let mut k = 12;
    while k > 0 {
        k -= 1;
        power = simd.mul_add_e_f64s(power, y, simd.splat_f64s(INVERSE_FACTORIALS[k]));
    }
    let mut squarings = 0;
    while squarings < 4 {
        power = simd.mul_f64s(power, power);
        squarings += 1;
    }
    power
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, Vec3};
    use pulp::WithSimd;

    use super::*;
    use crate::generate::random::Random;
    use crate::scene::splats::ALPHA_MIN;
    use crate::trace::{Level, gaussian};

    struct Evaluate<'a>(&'a mut Responses, DVec3, Footprint);

    impl WithSimd for Evaluate<'_> {
        type Output = usize;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> usize {
            let count = self.0.len();
            self.0.prepare(simd, self.2);
            self.0.evaluate(simd, self.1);
            count
        }
    }

    /// Gaussians from round to a million times longer than thick, 0.1 to 30 m away, and rays that pass them closely.
    #[test]
    fn every_level_computes_distances_to_1e_minus_12_and_responses_to_1e_minus_9() {
        let mut random = Random::new(1, 0);
        let mut uniform = || random.unit();
        let mut strong = 0;
        for _ in 0..500 {
            let mut splats = Splats::default();
            let distance = 0.1 * 300f64.powf(uniform());
            for _ in 0..BATCH {
                let rotation =
                    DQuat::from_xyzw(uniform() - 0.5, uniform() - 0.5, uniform() - 0.5, uniform()).normalize();
                let deviations = DVec3::new(1e-6f64.powf(uniform()), 0.1, 0.02 + uniform());
                splats.means.push(Vec3::new(uniform() as f32, uniform() as f32, distance as f32));
                splats.unit_from_world.push(Splats::unit_from_world(rotation, deviations));
                splats.opacities.push(uniform() as f32);
            }
            let origin = DVec3::new(0.4 + 0.2 * uniform(), 0.5, 0.0);
            let direction = DVec3::new(0.02 * uniform(), 0.02 * uniform(), 1.0).normalize();
            let footprint = [
                Footprint::default(),
                Footprint { sigma_per_metre: 0.1 * uniform(), keeps_energy: true },
                Footprint { sigma_per_metre: 0.1 * uniform(), keeps_energy: false },
            ][(3.0 * uniform()) as usize];
            for level in Level::available() {
                let mut responses = Responses::default();
                for index in 0..BATCH as u32 {
                    assert_eq!(responses.add(&splats, index, origin), index as usize == BATCH - 1);
                }
                assert_eq!(level.run(Evaluate(&mut responses, direction, footprint)), BATCH);
                for lane in 0..BATCH {
                    let seen = responses.lane(lane).response;
                    let (m, mean) = (splats.unit_from_world[lane].as_dmat3(), splats.means[lane].as_dvec3() - origin);
                    let (m, opacity) = footprint.widened(&m, f64::from(splats.opacities[lane]), mean);
                    let exact = gaussian::response(&m, opacity, mean, direction);
                    // What is too weak to contribute has no distance.
                    if seen.alpha < ALPHA_MIN && exact.alpha < ALPHA_MIN {
                        continue;
                    }
                    strong += 1;
                    assert!((seen.distance - exact.distance).abs() <= 1e-12 * exact.distance.abs().max(1.0));
                    assert!((seen.alpha - exact.alpha).abs() < 1e-9, "{} {}", seen.alpha, exact.alpha);
                }
            }
        }
        assert!(strong > 1000, "{strong} of some thousands that contribute");
    }
}
