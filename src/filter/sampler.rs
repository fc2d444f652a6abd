//! Bilinear look-ups in a cubemap that are continuous across the edges of its faces.
//!
//! Each face has a border of one texel: along an edge the adjacent texels of the neighbour, at a corner the mean of the
//! three texels that meet there. Both sides of an edge then interpolate the same texels, as in hardware's seamless cube
//! maps (OpenGL 4.6, section 8.14.1.1), so that their values agree along it.

use glam::{Vec3, Vec4};

use super::cubemap::RgbCubemap;
use crate::trace::Face;

/// From 2^23 on, f32 holds whole numbers only: a smaller one added to this is rounded, and lies in the low 23 bits.
const INTEGERS: f32 = 8_388_608.0;

/// Directions that are looked up together.
pub(super) const LANES: usize = 16;

/// Directions or other vectors side by side, by axis.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(super) struct Lanes(pub [f32; LANES]);

/// A cubemap prepared for look-ups by direction.
#[derive(Debug, Clone)]
pub struct Sampler {
    size: u32,
    /// Six faces of `(size + 2)^2` texels, row by row; the fourth component is 0.
    texels: Vec<Vec4>,
}

impl Sampler {
    /// Prepares look-ups in `cubemap`.
    pub fn new(cubemap: &RgbCubemap) -> Self {
        let n = cubemap.size() as usize;
        let width = n + 2;
        let mut texels = Vec::with_capacity(6 * width * width);
        for face in Face::ALL {
            let own = cubemap.face(face);
            let start = texels.len();
            for y in 0..width {
                texels.extend((0..width).map(|x| match (x, y) {
                    (1.., 1..) if x <= n && y <= n => own[(y - 1) * n + x - 1].extend(0.0),
                    _ => neighbour(cubemap, face, x, y).extend(0.0),
                }));
            }
            // The corners are known once the borders beside them are.
            for (x, y) in [(0, 0), (n + 1, 0), (0, n + 1), (n + 1, n + 1)] {
                let (inner_x, inner_y) = (x.clamp(1, n), y.clamp(1, n));
                let at = |x: usize, y: usize| start + y * width + x;
                texels[at(x, y)] =
                    (texels[at(inner_x, inner_y)] + texels[at(inner_x, y)] + texels[at(x, inner_y)]) / 3.0;
            }
        }
        Self { size: cubemap.size(), texels }
    }

    /// Linear radiance from `direction`, which need not have unit length but must be finite and not 0.
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        let lanes = direction.to_array().map(|value| Lanes([value; LANES]));
        let located = self.locate(&lanes);
        self.bilinear(&located, 0).truncate()
    }

    /// Adds `weights` times the radiance from `directions` to `sum`, lane by lane.
    #[inline(always)]
    pub(super) fn add_weighted(&self, directions: &[Lanes; 3], weights: &Lanes, sum: &mut Vec4) {
        let located = self.locate(directions);
        for lane in 0..LANES {
            *sum += self.bilinear(&located, lane) * weights.0[lane];
        }
    }

    /// Where the directions meet the bordered faces. [`Face::axes`], written out so that the compiler runs it on vectors:
    /// nothing branches and nothing can overflow, which it would have to check in a debug build.
    #[inline(always)]
    fn locate(&self, [x, y, z]: &[Lanes; 3]) -> Located {
        let (n, width) = (self.size as f32, self.size + 2);
        let half = 0.5 * n;
        let mut located = Located { first: [0; LANES], fraction: [[0.0; LANES]; 2] };
        for i in 0..LANES {
            let (x, y, z) = (x.0[i], y.0[i], z.0[i]);
            let (ax, ay, az) = (x.abs(), y.abs(), z.abs());
            let is_x = (ax >= ay) & (ax >= az);
            let is_y = !is_x & (ay >= az);
            let depth = if is_x {
                ax
            } else if is_y {
                ay
            } else {
                az
            };
            let major = if is_x {
                x
            } else if is_y {
                y
            } else {
                z
            };
            let axis = if is_x {
                0_u32
            } else if is_y {
                2
            } else {
                4
            };
            let face = axis | major.to_bits() >> 31;
            let sign = 1_f32.copysign(major);
            let right = if is_x {
                z * sign
            } else if is_y {
                x
            } else {
                -x * sign
            };
            let up = if is_y { z * sign } else { y };
            // Rounding may leave the face by a little.
            let texels = |along: f32| {
                let place = along / depth * half + half;
                let place = if place > 0.0 { place } else { 0.0 };
                if place < n { place } else { n }
            };
            let (u, v) = (texels(right), texels(-up));
            // With the border, the texel whose centre lies before place p has the index of p rounded.
            let (rounded_u, rounded_v) = (u + INTEGERS, v + INTEGERS);
            let [column, row] = [rounded_u, rounded_v].map(|rounded| rounded.to_bits() & 0x7f_ffff);
            located.first[i] = face.wrapping_mul(width).wrapping_add(row).wrapping_mul(width).wrapping_add(column);
            located.fraction[0][i] = u + 0.5 - (rounded_u - INTEGERS);
            located.fraction[1][i] = v + 0.5 - (rounded_v - INTEGERS);
        }
        located
    }

    #[inline(always)]
    fn bilinear(&self, located: &Located, lane: usize) -> Vec4 {
        let width = self.size as usize + 2;
        let first = located.first[lane] as usize;
        let (fx, fy) = (located.fraction[0][lane], located.fraction[1][lane]);
        let texels = &self.texels[first..first + width + 2];
        let top = texels[0] + (texels[1] - texels[0]) * fx;
        let bottom = texels[width] + (texels[width + 1] - texels[width]) * fx;
        top + (bottom - top) * fy
    }
}

/// Texels to interpolate between, and how far.
struct Located {
    /// Index of the top left of four texels.
    first: [u32; LANES],
    /// Position between left and right, and between top and bottom.
    fraction: [[f32; LANES]; 2],
}

/// The texel of another face that touches border texel (`x`, `y`) of `face`, counted with the border.
fn neighbour(cubemap: &RgbCubemap, face: Face, x: usize, y: usize) -> Vec3 {
    let n = cubemap.size() as usize;
    // Just beyond the edge, so that what lies there is the neighbour's outermost row: a millionth of a face is far less than
    // a texel, and far more than f64's rounding.
    let point = |i: usize| match i {
        0 => -1e-6,
        i if i > n => 1.0 + 1e-6,
        i => (i as f64 - 0.5) / n as f64,
    };
    let (other, place): (Face, [f64; 2]) = Face::of_direction(face.direction(1, point(x), point(y)));
    let [column, row] = place.map(|share| ((share * n as f64) as usize).min(n - 1));
    cubemap.face(other)[row * n + column]
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3Swizzles};

    use super::*;

    fn patterned(size: u32) -> RgbCubemap {
        RgbCubemap::from_fn(size, |d| ((d * 23.0).map(f64::sin) + d.zxy() * 2.0).as_vec3())
    }

    #[test]
    fn texel_centres_return_their_texels() {
        for size in [1, 3, 16] {
            let cubemap = patterned(size);
            let sampler = Sampler::new(&cubemap);
            let n = size as usize;
            for face in Face::ALL {
                for (x, y) in (0..n).flat_map(|y| (0..n).map(move |x| (x, y))) {
                    let direction = super::super::cubemap::direction(face, size, x, y);
                    let found = sampler.radiance(direction.as_vec3());
                    let expected = cubemap.face(face)[y * n + x];
                    // A direction in f32 is off by 1e-7 of a face; 3 is the steepest step between texels.
                    assert!((found - expected).abs().max_element() < 3e-5, "{face:?} {x} {y} of {size}");
                }
            }
        }
    }

    #[test]
    fn look_ups_on_both_sides_of_an_edge_agree() {
        for size in [1, 2, 8, 33] {
            let sampler = Sampler::new(&patterned(size));
            for step in 0..=400 {
                let t = step as f64 / 200.0 - 1.0;
                // Along the twelve edges, on both sides of each and, at the ends, in all faces that meet at a corner.
                for (axis, a, b) in (0..3)
                    .flat_map(|axis| [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)].map(|s| (axis, s.0, s.1)))
                {
                    let edge = |a: f64, b: f64| {
                        let mut d = [0.0; 3];
                        (d[axis], d[(axis + 1) % 3], d[(axis + 2) % 3]) = (t, a, b);
                        sampler.radiance(DVec3::from(d).as_vec3())
                    };
                    let close = 1.0 - 1e-6;
                    let difference = (edge(a, b * close) - edge(a * close, b)).abs().max_element();
                    assert!(difference < 2e-4, "size {size}, axis {axis}, {t}: {difference}");
                }
            }
        }
    }

    #[test]
    fn a_smooth_function_is_interpolated_to_second_order_everywhere() {
        let smooth = |d: DVec3| (d + 2.0).as_vec3();
        for size in [16, 64] {
            let sampler = Sampler::new(&RgbCubemap::from_fn(size, smooth));
            for i in 0..4000 {
                let z = 1.0 - (f64::from(i) + 0.5) / 2000.0;
                let (sine, cosine) = (f64::from(i) * 2.399_963).sin_cos();
                let r = (1.0 - z * z).sqrt();
                let d = DVec3::new(r * cosine, r * sine, z);
                let error = (sampler.radiance(d.as_vec3()) - smooth(d)).abs().max_element();
                // Where three faces meet there is no fourth texel; the error there is of first order in the texel's size.
                let texel = 2.0 / f64::from(size);
                assert!(f64::from(error) < 0.25 * texel, "size {size}, {d}: {error}");
            }
        }
    }
}
