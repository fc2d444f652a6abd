//! Prefiltered cubemaps against brute force, furnaces and closed forms.

use std::f64::consts::PI;

use crate::common::Random;
use crate::lobes::{brute_force, ggx, relative_rmse, room, some_texels};
use glam::{DVec3, Vec3};
use splatprobe::filter::{Prefilter, RgbCubemap, ShRadiance};
use splatprobe::job::RoughnessCurve;
use splatprobe::trace::Face;

#[test]
fn every_mip_is_within_one_percent_of_brute_force() {
    let source = RgbCubemap::from_fn(64, room);
    let prefilter = Prefilter::new(source.clone());
    for curve in [RoughnessCurve::Linear, RoughnessCurve::Filament] {
        for mip in prefilter.chain(curve, 5).into_iter().skip(1) {
            // Narrow lobes are finer than a texel.
            let steps = if mip.roughness < 0.3 { 3 } else { 1 };
            let texels = some_texels(&mip.cubemap, 24);
            let error = relative_rmse(&texels, |d| brute_force(&source, d, steps, ggx(mip.roughness)));
            println!("{curve:?}, roughness {:.3} at {} px: {error:.5}", mip.roughness, mip.cubemap.size());
            assert!(error < 0.01, "{curve:?}, roughness {}: {error}", mip.roughness);
        }
    }
}

#[test]
fn irradiance_is_within_one_percent_of_brute_force() {
    let source = RgbCubemap::from_fn(64, room);
    let texels = some_texels(&Prefilter::new(source.clone()).irradiance(16), 24);
    let error = relative_rmse(&texels, |d| brute_force(&source, d, 1, |cosine| cosine.max(0.0)));
    assert!(error < 0.01, "{error}");
}

#[test]
fn a_white_furnace_stays_white() {
    let white = Vec3::new(1.0, 0.25, 3.0);
    for size in [1, 6, 32] {
        let prefilter = Prefilter::new(RgbCubemap::from_fn(size, |_| white));
        let roughnesses = [0.0, 0.01, 0.2, 0.5, 0.8, 1.0];
        let maps = roughnesses.map(|roughness| prefilter.specular(roughness, 8)).into_iter();
        for map in maps.chain([prefilter.irradiance(8)]) {
            let worst = map.texels().iter().map(|texel| (texel / white - 1.0).abs().max_element()).fold(0.0, f32::max);
            assert!(worst < 1e-5, "{size} px: {worst}");
        }
    }
}

/// The steps between adjacent texels across the edges of faces are no larger than those within faces: per texel pair, the
/// difference of prefiltered values, of which the largest of each kind is compared.
#[test]
fn no_mip_has_a_seam_between_faces() {
    // Smooth light, which has no steps of its own, and so fine that a mip without the neighbours' light would show it.
    let source = RgbCubemap::from_fn(64, |d| ((d * 3.0).map(f64::sin) + 1.5).as_vec3());
    let prefilter = Prefilter::new(source);
    let mips = prefilter.chain(RoughnessCurve::Linear, 6).into_iter().map(|mip| mip.cubemap);
    for mip in mips.chain([prefilter.irradiance(16)]) {
        let n = mip.size() as usize;
        let (mut within, mut across) = (0.0_f32, 0.0_f32);
        for face in Face::ALL {
            for (x, y) in (0..n).flat_map(|y| (0..n).map(move |x| (x as i64, y as i64))) {
                let own = mip.face(face)[y as usize * n + x as usize];
                for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                    let inside = (0..n as i64).contains(&(x + dx)) && (0..n as i64).contains(&(y + dy));
                    // Half a texel over the edge, the neighbour's outermost texel is the nearest.
                    let beyond = [(x, dx), (y, dy)]
                        .map(|(at, step)| at as f64 + 0.5 + step as f64 * if inside { 1.0 } else { 0.51 });
                    let (other, place) = Face::of_direction(face.direction(mip.size(), beyond[0], beyond[1]));
                    let [column, row] = place.map(|share| ((share * n as f64) as usize).min(n - 1));
                    let step = (mip.face(other)[row * n + column] - own).abs().max_element();
                    if inside { within = within.max(step) } else { across = across.max(step) }
                }
            }
        }
        assert!(across <= within, "{n} px: {across} across edges, {within} within faces");
    }
}

#[test]
fn chains_halve_and_carry_their_curves_roughness() {
    let prefilter = Prefilter::new(RgbCubemap::from_fn(48, room));
    let chain = prefilter.chain(RoughnessCurve::Filament, 4);
    assert_eq!(chain.iter().map(|mip| mip.cubemap.size()).collect::<Vec<_>>(), [48, 24, 12, 6]);
    assert_eq!((chain[0].roughness, chain[3].roughness), (0.0, 1.0));
    assert_eq!(chain[0].cubemap, RgbCubemap::from_fn(48, room));
    // No more mips than there are halves down to a texel.
    let longest = prefilter.chain(RoughnessCurve::Linear, 20);
    assert_eq!((longest.len(), longest[5].roughness), (6, 1.0));
}

#[test]
fn spherical_harmonics_of_known_light_are_known() {
    // L = 1/2 + x - 2 y + 3 z: the coefficient of a band-1 function c.d is c sqrt(4 pi / 3), that of a constant c sqrt(4 pi).
    let linear = |d: DVec3| Vec3::splat((0.5 + d.dot(DVec3::new(1.0, -2.0, 3.0))) as f32);
    let sh = ShRadiance::project(&RgbCubemap::from_fn(64, linear), 3);
    let band1 = (4.0 * PI / 3.0).sqrt();
    let expected = [0.5 * (4.0 * PI).sqrt(), -2.0 * band1, 3.0 * band1, band1];
    for (i, coefficient) in sh.coefficients().iter().enumerate() {
        let expected = expected.get(i).copied().unwrap_or(0.0);
        assert!((coefficient - expected).abs().max_element() < 2e-3, "{i}: {coefficient} is not {expected}");
    }
    // A Lambertian surface reflects 2/3 of a linear function's slope.
    let normal = DVec3::new(2.0, 3.0, 6.0) / 7.0;
    let expected = 0.5 + normal.dot(DVec3::new(1.0, -2.0, 3.0)) * 2.0 / 3.0;
    assert!((sh.irradiance(normal).x - expected).abs() < 1e-3);
    assert!((sh.radiance(normal).x - f64::from(linear(normal).x)).abs() < 2e-3);
}

#[test]
fn a_light_in_one_direction_has_the_basis_itself_as_coefficients() {
    // The basis of three.js's SphericalHarmonics3.getBasisAt, in its order and signs.
    let d = DVec3::new(0.6, -0.48, 0.64);
    let DVec3 { x, y, z } = d;
    let expected = [
        0.282095,
        0.488603 * y,
        0.488603 * z,
        0.488603 * x,
        1.092548 * x * y,
        1.092548 * y * z,
        0.315392 * (3.0 * z * z - 1.0),
        1.092548 * x * z,
        0.546274 * (x * x - y * y),
    ];
    let cone = |e: DVec3| Vec3::splat(if e.dot(d) > 0.9995 { 1.0 } else { 0.0 });
    let sh = ShRadiance::project(&RgbCubemap::from_fn(256, cone), 2);
    let scale = sh.coefficients()[0].x / expected[0];
    for (coefficient, expected) in sh.coefficients().iter().zip(expected) {
        assert!((coefficient.x / scale - expected).abs() < 2e-3, "{coefficient} is not {expected}");
    }
}

#[test]
fn irradiance_by_spherical_harmonics_is_within_one_percent_of_integration() {
    // Light that is six times as bright from one side, without edges: what bands above 2 add to the irradiance of a lamp is
    // a property of L2, not an error of the projection.
    let bright = DVec3::new(0.6, 0.64, 0.48);
    let source = RgbCubemap::from_fn(64, |d| (0.5 + 0.1 * d + 3.0 * (3.0 * (d.dot(bright) - 1.0)).exp()).as_vec3());
    let sh = ShRadiance::project(&source, 2);
    let texels = some_texels(&RgbCubemap::from_fn(16, |_| Vec3::ZERO), 24);
    let texels: Vec<_> = texels.into_iter().map(|(d, _)| (d, sh.irradiance(d))).collect();
    let error = relative_rmse(&texels, |d| brute_force(&source, d, 1, |cosine| cosine.max(0.0)));
    assert!(error < 0.01, "{error}");
}

#[test]
fn a_window_removes_negative_irradiance_and_changes_nothing_else() {
    let even = ShRadiance::project(&RgbCubemap::from_fn(16, |d| (d + 2.0).as_vec3()), 2);
    assert_eq!(even.windowed(), (even.clone(), None));
    let sun = DVec3::new(1.0, 2.0, -2.0) / 3.0;
    let raw =
        ShRadiance::project(&RgbCubemap::from_fn(64, |d| Vec3::splat(if d.dot(sun) > 0.99 { 1.0 } else { 0.0 })), 3);
    assert!(raw.irradiance(DVec3::NEG_X).x < 0.0);
    let (windowed, width) = raw.windowed();
    assert!(width.is_some_and(|width| (2.0..16.0).contains(&width)), "{width:?}");
    assert_eq!(windowed.coefficients()[0], raw.coefficients()[0]);
    let mut random = Random(7);
    // The window is fitted at 1536 normals; between them irradiance, of two bands, stays above a rounding.
    let least = (0..5000).map(|_| windowed.irradiance(random.direction()).x).fold(f64::INFINITY, f64::min);
    assert!(least > -1e-3 * windowed.irradiance(sun).x, "{least}");
}
