//! Random numbers that depend on a seed and an index only, so that any thread may make any element.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3};

/// SplitMix64 (Steele, Lea, Flood 2014), started at a place of its own for every index.
pub struct Random(u64);

impl Random {
    /// The stream of element `index` under `seed`.
    pub fn new(seed: u64, index: u64) -> Self {
        Self(mix(seed ^ mix(index.wrapping_add(GOLDEN))))
    }

    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(GOLDEN);
        mix(self.0)
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Uniform in [low, high).
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Uniform in the logarithm between two positive ends.
    pub fn log_range(&mut self, low: f64, high: f64) -> f64 {
        self.range(low.ln(), high.ln()).exp()
    }

    /// Standard normal, by Box and Muller.
    pub fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.unit()).ln()).sqrt() * (TAU * self.unit()).cos()
    }

    /// Three independent standard normals.
    pub fn normal3(&mut self) -> DVec3 {
        DVec3::new(self.normal(), self.normal(), self.normal())
    }

    /// Uniform on the unit sphere.
    pub fn direction(&mut self) -> DVec3 {
        self.normal3().try_normalize().unwrap_or(DVec3::Y)
    }

    /// Uniform among all rotations.
    pub fn rotation(&mut self) -> DQuat {
        let axis_part = self.normal3();
        DQuat::from_vec4(axis_part.extend(self.normal())).normalize()
    }

    /// A value drawn from the distribution whose quantile function is `quantiles`: (share, value), ascending,
    /// straight in between.
    pub fn quantile(&mut self, quantiles: &[(f64, f64)]) -> f64 {
        let share = self.unit();
        let after = quantiles.partition_point(|&(q, _)| q <= share).clamp(1, quantiles.len() - 1);
        let [(q0, v0), (q1, v1)] = [quantiles[after - 1], quantiles[after]];
        v0 + (v1 - v0) * (share - q0) / (q1 - q0)
    }
}

const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_have_mean_zero_and_variance_one() {
        let mut random = Random::new(1, 2);
        let draws: Vec<f64> = (0..100_000).map(|_| random.normal()).collect();
        let mean = draws.iter().sum::<f64>() / 1e5;
        let variance = draws.iter().map(|x| x * x).sum::<f64>() / 1e5;
        // Five standard errors: 1 / sqrt(n) and sqrt(2 / n).
        assert!(mean.abs() < 0.016 && (variance - 1.0).abs() < 0.023, "{mean} {variance}");
    }

    #[test]
    fn neighbouring_indices_are_uncorrelated() {
        let pairs = (0..100_000).map(|i| [Random::new(7, i).unit() - 0.5, Random::new(7, i + 1).unit() - 0.5]);
        let covariance = pairs.map(|[a, b]| a * b).sum::<f64>() / 1e5;
        assert!(covariance.abs() < 5.0 / 12.0 / 1e5_f64.sqrt(), "{covariance}");
    }

    #[test]
    fn a_quantile_table_returns_its_own_quantiles() {
        let table = [(0.0, -1.0), (0.25, 0.0), (1.0, 6.0)];
        let mut random = Random::new(3, 4);
        let mut draws: Vec<f64> = (0..100_000).map(|_| random.quantile(&table)).collect();
        draws.sort_by(f64::total_cmp);
        assert!((draws[25_000]).abs() < 0.05 && (draws[62_500] - 3.0).abs() < 0.1);
        assert!(draws[0] >= -1.0 && draws[99_999] <= 6.0);
    }
}
