//! Gaussians as arrays, in the form that every tracer reads.

use glam::{DMat3, DQuat, DVec3, Mat3, Vec3};

use super::sh;

/// A response below this is not a contribution (3DGS: Kerbl et al. 2023, the rasteriser's alpha test).
pub const ALPHA_MIN: f64 = 1.0 / 255.0;

/// A response is clamped to this, so that no single Gaussian is fully opaque (3DGS, same place).
pub const ALPHA_MAX: f64 = 0.99;

/// Gaussians, one entry per array element, in the canonical frame.
///
/// A Gaussian with mean mu, rotation R, standard deviations S responds at a point p with
/// `opacity * exp(-|M (p - mu)|^2 / 2)` where `M = S^-1 R^T`.
#[derive(Debug, Default, Clone)]
pub struct Splats {
    /// Means, in metres relative to the scene origin.
    pub means: Vec<Vec3>,
    /// `M = S^-1 R^T`: takes an offset from the mean, in metres, to standard deviations along the principal axes.
    pub unit_from_world: Vec<Mat3>,
    /// Peak opacities in [0, 1], linear (not logits).
    pub opacities: Vec<f32>,
    /// Highest spherical harmonics degree stored, 0 to 4.
    pub sh_degree: u8,
    /// Spherical harmonics coefficients: per Gaussian red, green, blue, each `(sh_degree + 1)^2` values ordered
    /// by band and then by order m from -l to l. See [`sh`] for the basis. Colour is `max(0, 1/2 + sum)`.
    pub sh: Vec<f32>,
    /// For each Gaussian, whether its colour is linear light although [`Scene::encoding`](super::Scene::encoding) is a
    /// display's. Empty when that is so for none.
    pub linear: Vec<bool>,
}

impl Splats {
    /// How many Gaussians there are.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Bytes that a Gaussian of SH degree `degree` takes.
    pub fn bytes_each(degree: u8) -> u64 {
        (size_of::<Vec3>() + size_of::<Mat3>() + (1 + 3 * sh::coefficient_count(degree)) * size_of::<f32>()) as u64
    }

    /// Coefficients per Gaussian: three channels of `(degree + 1)^2`.
    pub fn sh_stride(&self) -> usize {
        3 * sh::coefficient_count(self.sh_degree)
    }

    /// The coefficients of Gaussian `i`: red, green, blue, each `(degree + 1)^2` long.
    pub fn sh_of(&self, i: usize) -> &[f32] {
        let stride = self.sh_stride();
        &self.sh[i * stride..(i + 1) * stride]
    }

    /// Whether Gaussian `i` adds to linear light by itself, apart from the blended display colour.
    #[inline]
    pub fn is_linear(&self, i: usize) -> bool {
        self.linear.get(i).is_some_and(|&linear| linear)
    }

    /// `S^-1 R^T` from a rotation and three standard deviations in metres, formed in f64.
    pub fn unit_from_world(rotation: DQuat, standard_deviations: DVec3) -> Mat3 {
        let rotation_transposed = DMat3::from_quat(rotation).transpose();
        (DMat3::from_diagonal(standard_deviations.recip()) * rotation_transposed).as_mat3()
    }

    /// `S^-1 R^T` from the principal axes: columns that are orthogonal to each other, as long as their standard deviation
    /// in metres. They may be left-handed. Formed in f64.
    pub fn unit_from_axes(axes: DMat3) -> Mat3 {
        let unit = |axis: DVec3| axis * axis.length_squared().recip();
        DMat3::from_cols(unit(axes.x_axis), unit(axes.y_axis), unit(axes.z_axis)).transpose().as_mat3()
    }

    /// Keeps only the bands up to `degree` (at most [`Self::sh_degree`]) and gives the memory of the others back.
    pub fn lower_sh_degree(&mut self, degree: u8) {
        let (stored, kept) = (sh::coefficient_count(self.sh_degree), sh::coefficient_count(degree));
        if kept == stored {
            return;
        }
        for channel in 0..3 * self.len() {
            self.sh.copy_within(channel * stored..channel * stored + kept, channel * kept);
        }
        self.sh.truncate(3 * self.len() * kept);
        self.sh.shrink_to_fit();
        self.sh_degree = degree;
    }

    /// Squared Mahalanobis radius beyond which the Gaussian's response is under [`ALPHA_MIN`];
    /// negative when even the peak is.
    pub fn support_radius_squared(opacity: f32) -> f64 {
        2.0 * (f64::from(opacity) / ALPHA_MIN).ln()
    }

    /// The covariance `R S^2 R^T` of Gaussian `i`, in square metres.
    ///
    /// Rows of M are `r_k / s_k` with unit r_k, so `s_k = 1 / |row_k|` and the covariance is the sum of
    /// `row_k row_k^T / |row_k|^4`.
    pub fn covariance(&self, i: usize) -> DMat3 {
        let rows = self.unit_from_world[i].as_dmat3().transpose();
        [rows.x_axis, rows.y_axis, rows.z_axis].into_iter().fold(DMat3::ZERO, |sum, row| {
            let scaled = row / row.length_squared();
            sum + DMat3::from_cols(scaled * scaled.x, scaled * scaled.y, scaled * scaled.z)
        })
    }

    /// Standard deviations of Gaussian `i` along its principal axes, in metres, in stored order.
    pub fn standard_deviations(&self, i: usize) -> DVec3 {
        let rows = self.unit_from_world[i].as_dmat3().transpose();
        DVec3::new(rows.x_axis.length(), rows.y_axis.length(), rows.z_axis.length()).recip()
    }

    /// Puts the Gaussians in `order`: element k becomes what was element `order[k]`.
    ///
    /// `order` must be a permutation. Arrays move one after another and in place, so that no second copy of the
    /// colours, the largest of them, ever exists.
    pub fn reorder(&mut self, order: &[u32]) {
        let stride = self.sh_stride();
        permute(&mut self.means, 1, order);
        permute(&mut self.unit_from_world, 1, order);
        permute(&mut self.opacities, 1, order);
        permute(&mut self.sh, stride, order);
        if !self.linear.is_empty() {
            permute(&mut self.linear, 1, order);
        }
    }
}

/// Permutes runs of `stride` elements in place, following each cycle of `order` once.
fn permute<T: Copy>(values: &mut [T], stride: usize, order: &[u32]) {
    let mut moved = vec![false; order.len()];
    let mut held = Vec::with_capacity(stride);
    for start in 0..order.len() {
        if moved[start] {
            continue;
        }
        held.clear();
        held.extend_from_slice(&values[start * stride..(start + 1) * stride]);
        let mut hole = start;
        loop {
            moved[hole] = true;
            let source = order[hole] as usize;
            if source == start {
                values[hole * stride..(hole + 1) * stride].copy_from_slice(&held);
                break;
            }
            values.copy_within(source * stride..(source + 1) * stride, hole * stride);
            hole = source;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_give_the_same_matrix_as_rotation_and_standard_deviations() {
        let rotation = DQuat::from_xyzw(0.3, -0.1, 0.7, 0.2).normalize();
        let deviations = DVec3::new(1e-5, 0.02, 3.0);
        let axes = DMat3::from_quat(rotation) * DMat3::from_diagonal(deviations);
        let expected = Splats::unit_from_world(rotation, deviations);
        let difference = Splats::unit_from_axes(axes) * expected.inverse() - Mat3::IDENTITY;
        assert!(difference.abs().to_cols_array().into_iter().all(|entry| entry < 1e-3), "{difference}");
    }

    #[test]
    fn lowering_the_degree_keeps_the_first_coefficients_of_each_channel() {
        let mut splats = Splats { means: vec![Vec3::ZERO; 2], sh_degree: 1, ..Splats::default() };
        splats.sh = (0..24).map(|i| i as f32).collect();
        splats.lower_sh_degree(0);
        assert_eq!((splats.sh_degree, splats.sh), (0, vec![0.0, 4.0, 8.0, 12.0, 16.0, 20.0]));
    }
}
