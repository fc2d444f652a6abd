//! One Gaussian as a file gives it -> one Gaussian in the world, or the reason why it cannot be one.

use glam::{DAffine3, DMat3, DQuat, DVec3, Mat3, Vec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::job::{Crop, Frame, Transform};
use crate::scene::Splats;
use crate::scene::sh::{MAX_COEFFICIENTS, ShRotation, coefficient_count};
use crate::scene::splats::ALPHA_MIN;

/// A Gaussian in the file's own coordinates, with the format's encodings (logit, log) undone.
#[derive(Debug, Clone)]
pub(super) struct FileGaussian {
    /// Mean, in the file's coordinates and unit.
    pub mean: DVec3,
    /// Rotation, of any length.
    pub rotation: DQuat,
    /// Standard deviations along the principal axes, in the file's unit.
    pub standard_deviations: DVec3,
    /// Peak opacity, 0 to 1.
    pub opacity: f64,
    /// Red, green, blue, each `(degree + 1)^2` long; what follows has no meaning.
    pub coefficients: [f32; 3 * MAX_COEFFICIENTS],
}

impl Default for FileGaussian {
    fn default() -> Self {
        Self {
            mean: DVec3::ZERO,
            rotation: DQuat::IDENTITY,
            standard_deviations: DVec3::ONE,
            opacity: 1.0,
            coefficients: [0.0; 3 * MAX_COEFFICIENTS],
        }
    }
}

/// How many Gaussians were dropped, by the first reason that applied.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub struct Dropped {
    /// A value is NaN, infinite, or beyond 1e18 (metres or display colour). An infinite opacity logit is not among them.
    pub non_finite: u64,
    /// The rotation is the zero quaternion.
    pub zero_rotation: u64,
    /// A standard deviation is zero or overflows: outside 1e-18 to 1e18 metres. Merely thin Gaussians are kept.
    pub degenerate_scale: u64,
    /// The opacity is below 1/255, so that nothing of it is ever seen.
    pub transparent: u64,
    /// The opacity is below what the request asks for.
    pub below_min_opacity: u64,
    /// The mean lies outside of the region that the request asks for.
    pub cropped: u64,
}

impl Dropped {
    /// All reasons together.
    pub fn total(&self) -> u64 {
        self.non_finite
            + self.zero_rotation
            + self.degenerate_scale
            + self.transparent
            + self.below_min_opacity
            + self.cropped
    }

    pub(super) fn count(&mut self, reason: Reason) {
        *match reason {
            Reason::NonFinite => &mut self.non_finite,
            Reason::ZeroRotation => &mut self.zero_rotation,
            Reason::DegenerateScale => &mut self.degenerate_scale,
            Reason::Transparent => &mut self.transparent,
            Reason::BelowMinOpacity => &mut self.below_min_opacity,
            Reason::Cropped => &mut self.cropped,
        } += 1;
    }
}

impl std::ops::AddAssign for Dropped {
    fn add_assign(&mut self, other: Self) {
        self.non_finite += other.non_finite;
        self.zero_rotation += other.zero_rotation;
        self.degenerate_scale += other.degenerate_scale;
        self.transparent += other.transparent;
        self.below_min_opacity += other.below_min_opacity;
        self.cropped += other.cropped;
    }
}

/// Why a Gaussian is dropped; see the fields of [`Dropped`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reason {
    NonFinite,
    ZeroRotation,
    DegenerateScale,
    Transparent,
    BelowMinOpacity,
    Cropped,
}

/// What a request keeps of a file.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Selection {
    pub crop: Option<Crop>,
    pub min_opacity: f64,
}

impl Selection {
    /// Whether a Gaussian with its mean at `world`, in metres, and this peak opacity is kept, else why not.
    #[inline]
    pub fn check(&self, world: DVec3, opacity: f64) -> std::result::Result<(), Reason> {
        if opacity < self.min_opacity {
            return Err(Reason::BelowMinOpacity);
        }
        if self.crop.is_some_and(|crop| !crop.contains(world)) {
            return Err(Reason::Cropped);
        }
        Ok(())
    }
}

/// Magnitudes up to this, and from its inverse, stay finite and normal in f32 when squared.
pub(super) const LIMIT: f64 = 1e18;

/// A Gaussian as [`Splats`] stores it, without its coefficients.
pub(super) struct WorldGaussian {
    pub mean: Vec3,
    pub unit_from_world: Mat3,
    pub opacity: f32,
}

/// The affine map from a file's coordinates to the world, and what it does to Gaussians and to their colours.
#[derive(Debug)]
pub(super) struct WorldFromFile {
    linear: DMat3,
    /// Whether the map keeps angles, so that principal axes stay orthogonal: a rotation or mirror times a uniform scale.
    keeps_angles: bool,
    translation: DVec3,
    sh_rotation: ShRotation,
    sh_degree: u8,
}

impl WorldFromFile {
    /// The map of a part of an input with `frame` and `transform`, for coefficients of `sh_degree`.
    ///
    /// Colours turn with the orthogonal polar factor of the map's linear part: the rotation or mirror nearest to it. For
    /// uniform scale that is exact; under non-uniform scale the captured directions have no exact counterpart.
    ///
    /// # Errors
    /// [`Error::Request`] in `field` when the map is singular or not finite.
    pub fn new(
        field: &str,
        frame: Frame,
        transform: &Transform,
        file_from_part: DAffine3,
        sh_degree: u8,
    ) -> Result<Self> {
        let canonical_from_file = DAffine3::from_mat3(frame.canonical_from_file());
        let world_from_part = transform.world_from_file() * canonical_from_file * file_from_part;
        let DAffine3 { matrix3: linear, translation } = world_from_part;
        let determinant = linear.determinant();
        if !(linear.is_finite() && translation.is_finite() && determinant.is_normal()) {
            let why = "the transform must be finite, with a rotation that is not zero and no scale factor of 0";
            return Err(Error::request(field, why));
        }
        let sh_rotation = ShRotation::new(orthogonal_factor(linear), sh_degree);
        let keeps_angles = keeps_angles(linear);
        Ok(Self { linear, keeps_angles, translation, sh_rotation, sh_degree })
    }

    /// World position, in metres, of a point of the file.
    pub fn position(&self, file: DVec3) -> DVec3 {
        self.linear * file + self.translation
    }

    /// `gaussian` in the world, relative to `origin`; its coefficients are turned in place.
    ///
    /// With standard deviations S along R, `Sigma' = L R S (L R S)^T`; the principal axes of that are the columns of
    /// `L R S` once they are made orthogonal.
    pub fn place(&self, gaussian: &mut FileGaussian, origin: DVec3) -> std::result::Result<WorldGaussian, Reason> {
        let within = |value: f64| value.abs() <= LIMIT;
        let length_squared = gaussian.rotation.length_squared();
        if !length_squared.is_finite() {
            return Err(Reason::NonFinite);
        }
        if length_squared == 0.0 {
            return Err(Reason::ZeroRotation);
        }
        if gaussian.standard_deviations.is_nan() || gaussian.opacity.is_nan() {
            return Err(Reason::NonFinite);
        }
        let mean = self.position(gaussian.mean) - origin;
        if !mean.to_array().into_iter().all(within) {
            return Err(Reason::NonFinite);
        }
        let rotation = DMat3::from_quat(gaussian.rotation / length_squared.sqrt());
        let mut axes = self.linear * rotation * DMat3::from_diagonal(gaussian.standard_deviations);
        if !self.keeps_angles {
            axes = orthogonal_columns(axes);
        }
        let usable = |axis: DVec3| (LIMIT.powi(-2)..=LIMIT.powi(2)).contains(&axis.length_squared());
        if gaussian.standard_deviations.min_element() <= 0.0
            || ![axes.x_axis, axes.y_axis, axes.z_axis].into_iter().all(usable)
        {
            return Err(Reason::DegenerateScale);
        }
        let coefficients = &mut gaussian.coefficients[..3 * coefficient_count(self.sh_degree)];
        self.sh_rotation.apply(coefficients);
        // Without a way out on the first, so that the loop takes many at a time.
        if !coefficients.iter().fold(true, |all, coefficient| all & (coefficient.abs() <= LIMIT as f32)) {
            return Err(Reason::NonFinite);
        }
        if gaussian.opacity < ALPHA_MIN {
            return Err(Reason::Transparent);
        }
        Ok(WorldGaussian {
            mean: mean.as_vec3(),
            unit_from_world: Splats::unit_from_axes(axes),
            opacity: gaussian.opacity.min(1.0) as f32,
        })
    }
}

/// The orthogonal factor O of `linear = O P` with P symmetric and positive: Newton's iteration for the polar
/// decomposition (Higham 1986), which converges quadratically and keeps the sign of the determinant.
fn orthogonal_factor(linear: DMat3) -> DMat3 {
    let mut factor = linear * linear.determinant().abs().cbrt().recip();
    for _ in 0..64 {
        let next = (factor + factor.inverse().transpose()) * 0.5;
        let done = next.abs_diff_eq(factor, 1e-15);
        factor = next;
        if done {
            break;
        }
    }
    factor
}

/// Whether the columns of `linear` are orthogonal and of one length, to the precision that [`orthogonal_columns`] aims at.
fn keeps_angles(linear: DMat3) -> bool {
    let gram = linear.transpose() * linear;
    let square = (gram.x_axis.x + gram.y_axis.y + gram.z_axis.z) / 3.0;
    gram.abs_diff_eq(DMat3::from_diagonal(DVec3::splat(square)), 1e-14 * square)
}

/// Turns the columns of `a` into ones that are orthogonal to each other with the same `a a^T`: one-sided Jacobi (Hestenes
/// 1958), which finds short axes to full relative precision. Columns that are orthogonal already stay as they are.
fn orthogonal_columns(a: DMat3) -> DMat3 {
    let mut columns = a.to_cols_array_2d().map(DVec3::from);
    for _sweep in 0..16 {
        let mut done = true;
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            let (p, q) = (columns[i], columns[j]);
            let (pp, qq, pq) = (p.length_squared(), q.length_squared(), p.dot(q));
            if pq * pq <= 1e-28 * pp * qq || !pq.is_finite() {
                continue;
            }
            done = false;
            let zeta = (qq - pp) / (2.0 * pq);
            let tangent = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
            let cosine = (1.0 + tangent * tangent).sqrt().recip();
            let sine = cosine * tangent;
            columns[i] = p * cosine - q * sine;
            columns[j] = p * sine + q * cosine;
        }
        if done {
            break;
        }
    }
    DMat3::from_cols(columns[0], columns[1], columns[2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::sh;

    fn close(a: DMat3, b: DMat3, tolerance: f64) -> bool {
        (a - b).abs().to_cols_array().into_iter().all(|entry| entry <= tolerance)
    }

    /// A transform with a rotation that no axis shares.
    fn turned(scale: [f64; 3]) -> Transform {
        let rotation = DQuat::from_xyzw(0.2, -0.5, 0.4, 0.6).normalize().to_array();
        Transform { translation: [1.0, -2.0, 30.0], rotation, scale }
    }

    fn gaussian() -> FileGaussian {
        let mut gaussian = FileGaussian {
            mean: DVec3::new(0.5, 0.25, -2.0),
            rotation: DQuat::from_xyzw(0.1, 0.7, -0.3, 0.9),
            standard_deviations: DVec3::new(0.02, 1.0, 0.01),
            opacity: 0.75,
            ..FileGaussian::default()
        };
        for (i, coefficient) in gaussian.coefficients.iter_mut().enumerate() {
            *coefficient = ((i * 37 % 101) as f32 - 50.0) / 400.0;
        }
        gaussian
    }

    fn placed(map: &WorldFromFile, mut gaussian: FileGaussian) -> std::result::Result<WorldGaussian, Reason> {
        map.place(&mut gaussian, DVec3::ZERO)
    }

    #[test]
    fn response_at_a_mapped_point_is_the_response_before_under_any_linear_map() {
        let file = gaussian();
        let rotation = DMat3::from_quat(file.rotation.normalize());
        for scale in [[1.0; 3], [2.0; 3], [-0.5, 0.5, 0.5], [3.0, 0.2, -1.0]] {
            for frame in [Frame::RUB, Frame::RDF] {
                let map =
                    WorldFromFile::new("transform", frame, &turned(scale), DAffine3::IDENTITY, 0).expect("regular");
                let world = placed(&map, file.clone()).expect("kept");
                for unit in [DVec3::X, DVec3::Y, DVec3::Z, DVec3::new(1.0, -2.0, 0.5)] {
                    let point = file.mean + rotation * (file.standard_deviations * unit);
                    let offset = map.position(point) - map.position(file.mean);
                    let found = (world.unit_from_world.as_dmat3() * offset).length_squared();
                    assert!((found / unit.length_squared() - 1.0).abs() < 1e-3, "{scale:?}: {found}");
                }
            }
        }
    }

    #[test]
    fn colour_in_a_mapped_direction_is_the_colour_before_under_rotation_mirror_and_uniform_scale() {
        let file = gaussian();
        for scale in [[1.0; 3], [2.5; 3], [-2.0, 2.0, 2.0]] {
            for frame in [Frame::RUB, Frame::RDF, "luf".parse().expect("frame")] {
                let map =
                    WorldFromFile::new("transform", frame, &turned(scale), DAffine3::IDENTITY, 4).expect("regular");
                let mut turned = file.clone();
                map.place(&mut turned, DVec3::ZERO).expect("kept");
                for direction in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::new(0.6, -0.48, 0.64)] {
                    let expected = sh::evaluate(4, &file.coefficients, direction);
                    let world = (map.linear * direction.as_dvec3()).normalize().as_vec3();
                    let found = sh::evaluate(4, &turned.coefficients, world);
                    assert!((found - expected).abs().max_element() < 3e-6, "{scale:?} {direction}");
                }
            }
        }
    }

    #[test]
    fn principal_axes_are_orthogonal_and_keep_the_covariance_under_shear() {
        let sheared =
            DMat3::from_cols(DVec3::new(1.0, 0.1, 0.0), DVec3::new(2.0, 1.0, 1e-3), DVec3::new(0.0, 5.0, 1e-6));
        let axes = orthogonal_columns(sheared);
        assert!(close(axes * axes.transpose(), sheared * sheared.transpose(), 1e-13));
        let [x, y, z] = [axes.x_axis, axes.y_axis, axes.z_axis].map(DVec3::normalize);
        assert!(x.dot(y).abs() < 1e-13 && x.dot(z).abs() < 1e-13 && y.dot(z).abs() < 1e-13);
    }

    #[test]
    fn rotations_mirrors_and_uniform_scale_keep_angles_and_nothing_else_does() {
        for scale in [[1.0; 3], [-1e-3; 3], [250.0, -250.0, 250.0]] {
            let linear = turned(scale).world_from_file().matrix3;
            assert!(keeps_angles(linear), "{scale:?}");
            let mut axes = linear * DMat3::from_quat(gaussian().rotation.normalize());
            axes *= DMat3::from_diagonal(gaussian().standard_deviations);
            assert_eq!(orthogonal_columns(axes), axes, "{scale:?}");
        }
        for scale in [[1.0, 1.0, 1.0 + 1e-12], [2.0, 1.0, 1.0], [1e-3, 1.0, -1.0]] {
            assert!(!keeps_angles(turned(scale).world_from_file().matrix3), "{scale:?}");
        }
    }

    #[test]
    fn orthogonal_factor_of_a_scaled_mirror_is_the_mirror() {
        let rotation = DMat3::from_quat(DQuat::from_xyzw(0.2, -0.5, 0.4, 0.6).normalize());
        let mirror = rotation * DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0));
        assert!(close(orthogonal_factor(mirror * 17.0), mirror, 1e-14));
        let stretch = rotation.transpose() * DMat3::from_diagonal(DVec3::new(0.01, 1.0, 300.0)) * rotation;
        assert!(close(orthogonal_factor(mirror * stretch), mirror, 1e-9));
    }

    #[test]
    fn a_singular_transform_is_a_wrong_request() {
        for transform in [
            turned([1.0, 0.0, 1.0]),
            turned([f64::NAN; 3]),
            Transform { rotation: [0.0; 4], ..Transform::default() },
            Transform { translation: [f64::INFINITY; 3], ..Transform::default() },
        ] {
            let error = WorldFromFile::new("splats[0].transform", Frame::RDF, &transform, DAffine3::IDENTITY, 0)
                .expect_err("singular");
            assert!(matches!(error, Error::Request { .. }), "{error}");
        }
    }

    #[test]
    fn each_defect_is_dropped_for_its_own_reason() {
        let map =
            WorldFromFile::new("transform", Frame::RDF, &Transform::default(), DAffine3::IDENTITY, 1).expect("regular");
        type Spoil = fn(&mut FileGaussian);
        let defects: [(Reason, Spoil); 12] = [
            (Reason::NonFinite, |g| g.mean.y = f64::NAN),
            (Reason::NonFinite, |g| g.mean.x = 1e19),
            (Reason::NonFinite, |g| g.rotation.w = f64::INFINITY),
            (Reason::NonFinite, |g| g.opacity = f64::NAN),
            (Reason::NonFinite, |g| g.standard_deviations.z = f64::NAN),
            (Reason::NonFinite, |g| g.coefficients[11] = f32::NEG_INFINITY),
            (Reason::ZeroRotation, |g| g.rotation = DQuat::from_xyzw(0.0, -0.0, 0.0, 0.0)),
            (Reason::DegenerateScale, |g| g.standard_deviations.x = 0.0),
            (Reason::DegenerateScale, |g| g.standard_deviations.x = -1.0),
            (Reason::DegenerateScale, |g| g.standard_deviations.x = f64::INFINITY),
            (Reason::Transparent, |g| g.opacity = 0.0039),
            (Reason::Transparent, |g| g.opacity = 0.0),
        ];
        for (i, (reason, spoil)) in defects.into_iter().enumerate() {
            let mut broken = gaussian();
            spoil(&mut broken);
            assert_eq!(placed(&map, broken).err(), Some(reason), "case {i}");
        }
    }

    #[test]
    fn thin_far_and_opaque_gaussians_are_kept() {
        let map =
            WorldFromFile::new("transform", Frame::RDF, &Transform::default(), DAffine3::IDENTITY, 1).expect("regular");
        let mut extreme = gaussian();
        extreme.standard_deviations = DVec3::new(1e-12, 1.0, 1e-7);
        extreme.mean = DVec3::new(1e9, 0.0, 0.0);
        extreme.opacity = 1.0;
        extreme.coefficients[12] = f32::NAN;
        let world = placed(&map, extreme).expect("kept: the NaN lies beyond degree 1");
        assert!(world.unit_from_world.is_finite());
    }
}
