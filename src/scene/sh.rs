//! Real spherical harmonics as 3DGS and KHR_gaussian_splatting use them: bands 0 to 4, Condon-Shortley phase.
//!
//! `Y_lm = (-1)^m K_lm P_l^|m|(z) {sin |m|phi, 1, cos m phi}` for m below, at and above 0, with P without phase and K such
//! that the basis is orthonormal on the unit sphere. Bands 0 to 3 are the constants of Kerbl et al. 2023 (and of PlenOctrees
//! before); band 4 follows from the same formula. The tests check all of them against it.

use glam::{DMat3, DVec3, Vec3};

/// Highest degree that any input format carries.
pub const MAX_DEGREE: u8 = 4;

/// Coefficients per channel at [`MAX_DEGREE`].
pub const MAX_COEFFICIENTS: usize = coefficient_count(MAX_DEGREE);

/// Coefficients per channel up to and with `degree`.
pub const fn coefficient_count(degree: u8) -> usize {
    (degree as usize + 1) * (degree as usize + 1)
}

/// Band 0 of the basis, the same in every direction: a Gaussian of one colour has the coefficient `(colour - 1/2) / C0`.
pub const C0: f64 = 0.282_094_791_773_878_14;
const C1: f64 = 0.488_602_511_902_919_9;
const C2: [f64; 3] = [1.092_548_430_592_079_2, 0.315_391_565_252_520_05, 0.546_274_215_296_039_6];
const C3: [f64; 5] = [
    0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    1.445_305_721_320_277,
];
const C4: [f64; 7] = [
    2.503_342_941_796_704_6,
    1.770_130_769_779_930_4,
    0.946_174_695_757_560_1,
    0.669_046_543_557_289_2,
    0.105_785_546_915_204_31,
    0.473_087_347_878_780_04,
    0.625_835_735_449_176_1,
];

macro_rules! define_basis {
    ($(#[$doc:meta])* $name:ident, $float:ty, $vector:ty) => {
        $(#[$doc])*
        pub fn $name(degree: u8, direction: $vector, out: &mut [$float; MAX_COEFFICIENTS]) {
            let (x, y, z) = (direction.x, direction.y, direction.z);
            out[0] = C0 as $float;
            if degree == 0 {
                return;
            }
            let c1 = C1 as $float;
            out[1] = -c1 * y;
            out[2] = c1 * z;
            out[3] = -c1 * x;
            if degree == 1 {
                return;
            }
            let (xx, yy, zz, xy) = (x * x, y * y, z * z, x * y);
            let c2 = C2.map(|c| c as $float);
            out[4] = c2[0] * xy;
            out[5] = -c2[0] * y * z;
            out[6] = c2[1] * (2.0 * zz - xx - yy);
            out[7] = -c2[0] * x * z;
            out[8] = c2[2] * (xx - yy);
            if degree == 2 {
                return;
            }
            let c3 = C3.map(|c| c as $float);
            out[9] = -c3[0] * y * (3.0 * xx - yy);
            out[10] = c3[1] * xy * z;
            out[11] = -c3[2] * y * (4.0 * zz - xx - yy);
            out[12] = c3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
            out[13] = -c3[2] * x * (4.0 * zz - xx - yy);
            out[14] = c3[4] * z * (xx - yy);
            out[15] = -c3[0] * x * (xx - 3.0 * yy);
            if degree == 3 {
                return;
            }
            let c4 = C4.map(|c| c as $float);
            out[16] = c4[0] * xy * (xx - yy);
            out[17] = -c4[1] * y * z * (3.0 * xx - yy);
            out[18] = c4[2] * xy * (7.0 * zz - 1.0);
            out[19] = -c4[3] * y * z * (7.0 * zz - 3.0);
            out[20] = c4[4] * (zz * (35.0 * zz - 30.0) + 3.0);
            out[21] = -c4[3] * x * z * (7.0 * zz - 3.0);
            out[22] = c4[5] * (xx - yy) * (7.0 * zz - 1.0);
            out[23] = -c4[1] * x * z * (xx - 3.0 * yy);
            out[24] = c4[6] * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy));
        }
    };
}

define_basis! {
    /// The basis in the unit `direction`, ordered by band and then by m from -l to l. Writes the first
    /// [`coefficient_count`]`(degree)` entries of `out` and leaves the others as they are; `degree` is at most 4.
    basis, f32, Vec3
}

define_basis! {
    /// [`basis`] in f64.
    basis_f64, f64, DVec3
}

/// Colour that leaves a Gaussian in the unit `direction`: `max(0, 1/2 + sum)` per channel, in the splats' encoding.
///
/// `coefficients` are red, green, blue, each [`coefficient_count`]`(degree)` long.
pub fn evaluate(degree: u8, coefficients: &[f32], direction: Vec3) -> Vec3 {
    let count = coefficient_count(degree);
    let mut values = [0.0; MAX_COEFFICIENTS];
    basis(degree, direction, &mut values);
    let channel = |c: usize| -> f32 {
        coefficients[c * count..(c + 1) * count]
            .iter()
            .zip(&values)
            .map(|(coefficient, value)| coefficient * value)
            .sum()
    };
    (Vec3::new(channel(0), channel(1), channel(2)) + 0.5).max(Vec3::ZERO)
}

/// What a rotation or mirror O does to coefficients: afterwards `f'(O d) = f(d)` for every direction d.
#[derive(Debug, Clone)]
pub struct ShRotation {
    degree: u8,
    action: Action,
}

/// The cheapest exact form of a rotation.
#[derive(Debug, Clone)]
enum Action {
    /// Coefficients stay as they are, bit by bit.
    Identity,
    /// A mirror or half turn about the axes only flips signs: one factor per coefficient.
    Signs(Vec<f32>),
    /// Per band from 0, a row-major matrix of (2l + 1)^2.
    Matrices(Vec<Vec<f32>>),
}

/// Matrix entries this near to -1, 0 or 1 are that; f64 rounding in the quadrature stays below 1e-14.
const SNAP: f64 = 1e-12;

impl ShRotation {
    /// The action of `orthogonal` (determinant 1 or -1) on coefficients of `degree`.
    ///
    /// Bands do not mix under rotation, and band l's matrix is the projection `D_mn = integral Y_m(O d) Y_n(d) dd`. The
    /// integrand is a polynomial of degree at most 8, for which the quadrature used is exact: 5 Gauss-Legendre nodes in
    /// z (exact to degree 9) times 10 uniform azimuths (exact to order 9).
    pub fn new(orthogonal: DMat3, degree: u8) -> Self {
        let count = coefficient_count(degree);
        let mut full = [[0.0; MAX_COEFFICIENTS]; MAX_COEFFICIENTS];
        for (direction, weight) in quadrature() {
            let (mut before, mut after) = ([0.0; MAX_COEFFICIENTS], [0.0; MAX_COEFFICIENTS]);
            basis_f64(degree, direction, &mut before);
            basis_f64(degree, orthogonal * direction, &mut after);
            for (row, after) in full.iter_mut().zip(after).take(count) {
                row.iter_mut().zip(before).for_each(|(entry, before)| *entry += weight * after * before);
            }
        }
        let snapped = |entry: f64| if (entry - entry.round()).abs() < SNAP { entry.round() } else { entry } as f32;
        let matrices: Vec<Vec<f32>> = (0..=usize::from(degree))
            .map(|l| {
                let band = l * l..(l + 1) * (l + 1);
                full[band.clone()].iter().flat_map(|row| row[band.clone()].iter().map(|&e| snapped(e))).collect()
            })
            .collect();
        let diagonal = |matrix: &Vec<f32>| {
            let width = matrix.len().isqrt();
            matrix.iter().enumerate().all(|(i, &e)| if i / width == i % width { e.abs() == 1.0 } else { e == 0.0 })
        };
        let action = if matrices.iter().all(diagonal) {
            let signs: Vec<f32> =
                matrices.iter().flat_map(|matrix| matrix.iter().copied().step_by(matrix.len().isqrt() + 1)).collect();
            if signs.iter().all(|&sign| sign == 1.0) { Action::Identity } else { Action::Signs(signs) }
        } else {
            Action::Matrices(matrices)
        };
        Self { degree, action }
    }

    /// Rotates the coefficients of one Gaussian: red, green, blue, each [`coefficient_count`] of the degree long.
    pub fn apply(&self, coefficients: &mut [f32]) {
        for channel in coefficients.chunks_exact_mut(coefficient_count(self.degree)) {
            match &self.action {
                Action::Identity => {}
                Action::Signs(signs) => channel.iter_mut().zip(signs).for_each(|(c, sign)| *c *= sign),
                Action::Matrices(matrices) => {
                    let mut rest = channel;
                    for matrix in matrices {
                        let width = matrix.len().isqrt();
                        let (band, above) = rest.split_at_mut(width);
                        let mut before = [0.0; 2 * MAX_DEGREE as usize + 1];
                        before[..width].copy_from_slice(band);
                        for (c, row) in band.iter_mut().zip(matrix.chunks_exact(width)) {
                            *c = row.iter().zip(&before).map(|(entry, before)| entry * before).sum();
                        }
                        rest = above;
                    }
                }
            }
        }
    }
}

/// Directions and weights on the unit sphere, exact for polynomials up to degree 9; weights sum to 4 pi.
fn quadrature() -> impl Iterator<Item = (DVec3, f64)> {
    const AZIMUTHS: u32 = 10;
    let inner = (5.0 - 2.0 * (10.0_f64 / 7.0).sqrt()).sqrt() / 3.0;
    let outer = (5.0 + 2.0 * (10.0_f64 / 7.0).sqrt()).sqrt() / 3.0;
    let inner_weight = (322.0 + 13.0 * 70.0_f64.sqrt()) / 900.0;
    let outer_weight = (322.0 - 13.0 * 70.0_f64.sqrt()) / 900.0;
    let heights = [
        (0.0, 128.0 / 225.0),
        (inner, inner_weight),
        (-inner, inner_weight),
        (outer, outer_weight),
        (-outer, outer_weight),
    ];
    heights.into_iter().flat_map(|(z, weight)| {
        let radius = (1.0 - z * z).sqrt();
        (0..AZIMUTHS).map(move |i| {
            let step = std::f64::consts::TAU / f64::from(AZIMUTHS);
            let (sine, cosine) = (f64::from(i) * step).sin_cos();
            (DVec3::new(radius * cosine, radius * sine, z), weight * step)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    /// The defining formula: associated Legendre polynomials by their recurrence, norms by factorials.
    fn by_formula(l: i32, m: i32, direction: DVec3) -> f64 {
        let k = m.abs();
        let factorial = |n: i32| (1..=n).map(f64::from).product::<f64>();
        let (z, radius) = (direction.z, direction.truncate().length());
        let mut below = 0.0;
        let mut legendre = (0..k).map(|i| f64::from(2 * i + 1) * radius).product::<f64>();
        for n in k + 1..=l {
            let next = (f64::from(2 * n - 1) * z * legendre - f64::from(n + k - 1) * below) / f64::from(n - k);
            (below, legendre) = (legendre, next);
        }
        let norm = (f64::from(2 * l + 1) / (4.0 * std::f64::consts::PI) * factorial(l - k) / factorial(l + k)).sqrt();
        let phi = f64::from(k) * direction.y.atan2(direction.x);
        let phase = if k % 2 == 1 { -1.0 } else { 1.0 };
        let azimuthal = match m {
            0 => 1.0,
            1.. => std::f64::consts::SQRT_2 * phi.cos(),
            _ => std::f64::consts::SQRT_2 * phi.sin(),
        };
        phase * norm * legendre * azimuthal
    }

    /// Directions that repeat in no symmetry: the golden spiral.
    fn spiral(count: u32) -> impl Iterator<Item = DVec3> {
        (0..count).map(move |i| {
            let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(count);
            let (sine, cosine) = (f64::from(i) * 2.399_963_229_728_653).sin_cos();
            DVec3::new((1.0 - z * z).sqrt() * cosine, (1.0 - z * z).sqrt() * sine, z)
        })
    }

    fn coefficients(degree: u8) -> Vec<f32> {
        (0..3 * coefficient_count(degree)).map(|i| ((i * 37 % 101) as f32 - 50.0) / 400.0).collect()
    }

    fn orthogonal_matrices() -> Vec<DMat3> {
        let turn = |x, y, z, w| DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let mirror = DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0));
        vec![
            turn(0.1, -0.7, 0.3, 0.5),
            turn(0.9, 0.2, -0.1, 0.05) * mirror,
            DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)),
            DMat3::from_diagonal(DVec3::NEG_ONE),
            DMat3::from_cols(DVec3::Y, DVec3::NEG_Z, DVec3::X),
        ]
    }

    #[test]
    fn basis_is_the_defining_formula_in_all_bands() {
        for direction in spiral(200) {
            let mut values = [0.0; MAX_COEFFICIENTS];
            basis_f64(MAX_DEGREE, direction, &mut values);
            let mut single = [0.0; MAX_COEFFICIENTS];
            basis(MAX_DEGREE, direction.as_vec3(), &mut single);
            let orders = (0..=4).flat_map(|l| (-l..=l).map(move |m| (l, m)));
            for (i, (l, m)) in orders.enumerate() {
                assert!((values[i] - by_formula(l, m, direction)).abs() < 1e-13, "l {l} m {m} at {direction}");
                assert!((f64::from(single[i]) - values[i]).abs() < 2e-6, "f32, l {l} m {m} at {direction}");
            }
        }
    }

    #[test]
    fn basis_is_orthonormal_under_a_quadrature_exact_to_degree_9() {
        let mut gram = [[0.0; MAX_COEFFICIENTS]; MAX_COEFFICIENTS];
        for (direction, weight) in quadrature() {
            let mut values = [0.0; MAX_COEFFICIENTS];
            basis_f64(MAX_DEGREE, direction, &mut values);
            for (row, a) in gram.iter_mut().zip(values) {
                row.iter_mut().zip(values).for_each(|(entry, b)| *entry += weight * a * b);
            }
        }
        for (i, row) in gram.iter().enumerate() {
            for (j, &entry) in row.iter().enumerate() {
                assert!((entry - f64::from(u8::from(i == j))).abs() < 1e-14, "<{i}, {j}> = {entry}");
            }
        }
    }

    #[test]
    fn lower_degrees_write_only_their_own_coefficients() {
        for degree in 0..=MAX_DEGREE {
            let mut values = [7.0; MAX_COEFFICIENTS];
            basis(degree, Vec3::new(0.6, 0.0, 0.8), &mut values);
            assert!(values[coefficient_count(degree)..].iter().all(|&value| value == 7.0));
            assert!(values[..coefficient_count(degree)].iter().all(|&value| value != 7.0));
        }
    }

    #[test]
    fn evaluation_adds_one_half_and_cuts_negative_light() {
        let black = [-10.0, 0.0, 1.0];
        let colour = evaluate(0, &black, Vec3::Z);
        assert_eq!(colour, Vec3::new(0.0, 0.5, 0.5 + C0 as f32));
    }

    #[test]
    fn rotated_coefficients_give_the_old_colour_in_the_rotated_direction() {
        for orthogonal in orthogonal_matrices() {
            for degree in 0..=MAX_DEGREE {
                let before = coefficients(degree);
                let mut after = before.clone();
                ShRotation::new(orthogonal, degree).apply(&mut after);
                for direction in spiral(50) {
                    let expected = evaluate(degree, &before, direction.as_vec3());
                    let found = evaluate(degree, &after, (orthogonal * direction).as_vec3());
                    assert!((expected - found).abs().max_element() < 3e-6, "degree {degree}, {orthogonal}");
                }
            }
        }
    }

    #[test]
    fn identity_keeps_every_bit() {
        let mut values = vec![f32::from_bits(1), -0.0, 1e30, 0.1];
        values.resize(3 * MAX_COEFFICIENTS, 1.0 / 3.0);
        let before: Vec<u32> = values.iter().map(|value| value.to_bits()).collect();
        ShRotation::new(DMat3::IDENTITY, MAX_DEGREE).apply(&mut values);
        assert_eq!(values.iter().map(|value| value.to_bits()).collect::<Vec<_>>(), before);
    }

    #[test]
    fn mirrors_and_half_turns_about_the_axes_only_flip_signs() {
        for diagonal in [DVec3::new(1.0, -1.0, -1.0), DVec3::new(-1.0, 1.0, 1.0), DVec3::NEG_ONE] {
            let before = coefficients(MAX_DEGREE);
            let mut after = before.clone();
            ShRotation::new(DMat3::from_diagonal(diagonal), MAX_DEGREE).apply(&mut after);
            assert!(before.iter().zip(&after).all(|(a, b)| a.abs() == b.abs()), "{diagonal}");
            assert_ne!(before, after);
        }
    }
}
