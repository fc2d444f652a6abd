//! Real spherical harmonics as 3DGS and KHR_gaussian_splatting use them: bands 0 to 4, Condon-Shortley phase.

/// Highest degree that any input format carries.
pub const MAX_DEGREE: u8 = 4;

/// Coefficients per channel up to and with `degree`.
pub const fn coefficient_count(degree: u8) -> usize {
    (degree as usize + 1) * (degree as usize + 1)
}
