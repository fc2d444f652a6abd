//! Look-ups as graphics APIs and engines define them.

use glam::{DVec3, Vec3};

/// The texel that a cube map's look-up by `v` finds in faces of `n` texels: slot +X -X +Y -Y +Z -Z, column, row.
///
/// OpenGL 4.6, table 8.19 with equation 8.15 (Direct3D's "Cube mapping" has the same table): the axis of the largest
/// magnitude picks the face, s = (sc / |ma| + 1) / 2 and t = (tc / |ma| + 1) / 2 from the first row.
pub fn cube_texel(v: DVec3, n: usize) -> (usize, usize, usize) {
    let a = v.abs();
    let (slot, sc, tc, ma) = if a.x >= a.y && a.x >= a.z {
        if v.x > 0.0 { (0, -v.z, -v.y, a.x) } else { (1, v.z, -v.y, a.x) }
    } else if a.y >= a.z {
        if v.y > 0.0 { (2, v.x, v.z, a.y) } else { (3, v.x, -v.z, a.y) }
    } else if v.z > 0.0 {
        (4, v.x, -v.y, a.z)
    } else {
        (5, -v.x, -v.y, a.z)
    };
    let texel = |c: f64| (((c / ma + 1.0) / 2.0 * n as f64) as usize).min(n - 1);
    (slot, texel(sc), texel(tc))
}

/// Bilinear look-up in an image by shares of its width and height, pixels at their centres; wraps horizontally.
pub fn bilinear(width: usize, pixels: &[Vec3], u: f64, v: f64) -> Vec3 {
    let height = pixels.len() / width;
    let (x, y) = (u * width as f64 - 0.5, v * height as f64 - 0.5);
    let (fx, fy) = ((x - x.floor()) as f32, (y - y.floor()) as f32);
    let at = |dx: i64, dy: i64| {
        let column = (x.floor() as i64 + dx).rem_euclid(width as i64) as usize;
        let row = (y.floor() as i64 + dy).clamp(0, height as i64 - 1) as usize;
        pixels[row * width + column]
    };
    let row = |dy| at(0, dy) * (1.0 - fx) + at(1, dy) * fx;
    row(0) * (1.0 - fy) + row(1) * fy
}

#[test]
fn a_cube_maps_axes_are_in_the_middle_of_their_slots() {
    let axes = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
    for (slot, axis) in axes.into_iter().enumerate() {
        assert_eq!(cube_texel(axis, 5), (slot, 2, 2));
    }
    // Up is in the first rows of the sides.
    assert_eq!(cube_texel(DVec3::new(1.0, 0.9, 0.0), 5).2, 0);
}
