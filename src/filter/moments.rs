//! Distance moments: how far what a probe sees is away by direction, for blending that does not leak through walls.
//!
//! Mean distance and mean squared distance bound, by Chebyshev's inequality, the chance that something lies between a
//! point and the probe (Majercik et al. 2019, "Dynamic Diffuse Global Illumination with Ray-Traced Irradiance Fields",
//! section 3; the sharpness is RTXGI's default `probeDistanceExponent`).

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::cubemap::{RgbCubemap, direction, solid_angles};
use crate::error::Result;
use crate::trace::Face;

/// Edge of the octahedral map, in texels.
pub const MOMENTS_SIZE: u32 = 16;

/// Faces larger than this are averaged down before: a texel is then still a third of the map's.
const FACE_SIZE: u32 = 32;

/// Mean distance and mean squared distance, in metres, for [`MOMENTS_SIZE`]^2 directions, row by row: see
/// [`octahedral_direction`]. Each is the mean over the sphere weighted by the 50th power of the cosine.
///
/// `distances` and `coverages` are those of the texels of six faces of `size`. No distance counts for more than
/// `max_distance`, and where nothing is seen that is the distance. Fails as [`RgbCubemap::new`].
pub fn distance_moments(
    size: u32,
    distances: &[f32],
    coverages: impl Iterator<Item = f32>,
    max_distance: f32,
) -> Result<Vec<[f32; 2]>> {
    let moments = distances.iter().zip(coverages).map(|(&distance, coverage)| {
        let seen = distance.min(max_distance);
        let mean = |seen: f32, open: f32| coverage * seen + (1.0 - coverage) * open;
        Vec3::new(mean(seen, max_distance), mean(seen * seen, max_distance * max_distance), 0.0)
    });
    let moments = RgbCubemap::new(size, moments.collect())?.reduced(size.min(FACE_SIZE));
    let n = moments.size() as usize;
    let angles = solid_angles(moments.size());
    let texels: Vec<(DVec3, f64, DVec3)> = Face::ALL
        .into_iter()
        .flat_map(|face| (0..n * n).map(move |i| (face, i)))
        .map(|(face, i)| (direction(face, n as u32, i % n, i / n), angles[i], moments.face(face)[i].as_dvec3()))
        .collect();
    let texel = |i: u32| {
        let [u, v] = [i % MOMENTS_SIZE, i / MOMENTS_SIZE].map(|at| (f64::from(at) + 0.5) / f64::from(MOMENTS_SIZE));
        let axis = octahedral_direction([u, v]);
        let (mut sum, mut total) = (DVec3::ZERO, 0.0);
        for &(direction, angle, moments) in &texels {
            let weight = direction.dot(axis).max(0.0).powi(50) * angle;
            sum += moments * weight;
            total += weight;
        }
        let mean = sum / total;
        [mean.x as f32, mean.y as f32]
    };
    Ok((0..MOMENTS_SIZE * MOMENTS_SIZE).into_par_iter().map(texel).collect())
}

/// Unit direction of a place in an octahedral map, in shares of its width and height from its first texel's corner: +Z in
/// the middle, -Z in the corners, +X at the right, +Y at the end of the rows (Cigolle et al. 2014, "A Survey of Efficient
/// Representations for Independent Unit Vectors", listing 2).
pub fn octahedral_direction(place: [f64; 2]) -> DVec3 {
    let [x, y] = place.map(|share| 2.0 * share - 1.0);
    let z = 1.0 - x.abs() - y.abs();
    let folded = if z < 0.0 {
        DVec3::new((1.0 - y.abs()).copysign(x), (1.0 - x.abs()).copysign(y), z)
    } else {
        DVec3::new(x, y, z)
    };
    folded.normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A distance for the direction of every texel.
    fn distances(size: u32, distance: impl Fn(DVec3) -> f64) -> Vec<f32> {
        let n = size as usize;
        let texels =
            Face::ALL.into_iter().flat_map(|face| (0..n * n).map(move |i| direction(face, size, i % n, i / n)));
        texels.map(|d| distance(d) as f32).collect()
    }

    #[test]
    fn octahedral_directions_have_their_axes_where_the_map_says() {
        let middle =
            [([0.5, 0.5], DVec3::Z), ([1.0, 0.5], DVec3::X), ([0.5, 1.0], DVec3::Y), ([0.0, 0.5], DVec3::NEG_X)];
        for (place, expected) in
            middle.into_iter().chain([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]].map(|p| (p, DVec3::NEG_Z)))
        {
            assert!((octahedral_direction(place) - expected).length() < 1e-12, "{place:?}");
        }
    }

    #[test]
    fn a_sphere_is_at_its_radius_everywhere_and_has_no_variance() {
        let seen = distances(64, |_| 3.0);
        for [mean, mean_square] in distance_moments(64, &seen, std::iter::repeat_n(1.0, seen.len()), 10.0).unwrap() {
            assert!((mean - 3.0).abs() < 1e-5 && (mean_square - 9.0).abs() < 1e-4, "{mean} {mean_square}");
        }
    }

    #[test]
    fn what_is_open_is_at_the_largest_distance_and_what_is_half_open_between() {
        let seen = distances(8, |_| 2.0);
        for (coverage, expected) in [(0.0, [10.0, 100.0]), (0.5, [6.0, 52.0])] {
            let coverages = std::iter::repeat_n(coverage, seen.len());
            for found in distance_moments(8, &seen, coverages, 10.0).unwrap() {
                assert!((found[0] - expected[0]).abs() < 1e-4 && (found[1] - expected[1]).abs() < 1e-3, "{found:?}");
            }
        }
    }

    #[test]
    fn a_wall_is_nearest_where_it_is_faced() {
        // A wall 1 m along +X; all else is 5 m away.
        let seen = distances(64, |d| if d.x > 0.0 { (1.0 / d.x).min(5.0) } else { 5.0 });
        let moments = distance_moments(64, &seen, std::iter::repeat_n(1.0, seen.len()), 50.0).unwrap();
        for (i, [mean, mean_square]) in moments.into_iter().enumerate() {
            let n = MOMENTS_SIZE as usize;
            let axis = octahedral_direction([i % n, i / n].map(|at| (at as f64 + 0.5) / n as f64));
            assert!(mean_square >= mean * mean * (1.0 - 1e-5));
            if axis.x > 0.95 {
                assert!(mean < 1.2, "{axis}: {mean}");
            } else if axis.x < -0.5 {
                assert!((mean - 5.0).abs() < 1e-3, "{axis}: {mean}");
            }
        }
    }
}
