//! Light from infinitely far away, by direction.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use super::LinearRgb;

/// An image of all directions by latitude and longitude, with texels at pixel centres, oriented as OpenEXR's (ImfEnvmap.h):
/// +Y at the top, +Z in the middle, +X a quarter to its left.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvironmentMap {
    width: usize,
    height: usize,
    /// Row by row from the top.
    texels: Vec<Vec3>,
    /// Weights of each row's texels, summed up to and with each; brightness times solid angle.
    column_sums: Vec<f64>,
    /// Weights of rows, summed likewise.
    row_sums: Vec<f64>,
}

impl EnvironmentMap {
    /// An image of `width` texels by row, linear radiance row by row; negative values and those that are not finite are
    /// taken as 0. `None` if it has no texels or not as many as `width` and `height` say.
    pub fn new(width: usize, height: usize, mut texels: Vec<Vec3>) -> Option<Self> {
        if width == 0 || height == 0 || texels.len() != width.checked_mul(height)? {
            return None;
        }
        for texel in &mut texels {
            *texel = texel.map(|value| if value.is_finite() { value.max(0.0) } else { 0.0 });
        }
        let mut map = Self { width, height, texels, column_sums: Vec::new(), row_sums: Vec::new() };
        let mut total = 0.0;
        for row in 0..height {
            let sine = (PI * (row as f64 + 0.5) / height as f64).sin();
            let mut sum = 0.0;
            for column in 0..width {
                sum += f64::from(map.mean_over(column, row)) * sine;
                map.column_sums.push(sum);
            }
            total += sum;
            map.row_sums.push(total);
        }
        Some(map)
    }

    /// Mean brightness over a texel, into which its neighbours reach because radiance is linear between centres. Without
    /// them what is bright beside a dark texel would only be found by chance.
    fn mean_over(&self, column: usize, row: usize) -> f32 {
        let mut sum = 0.0;
        for (y, row_weight) in [(0, 0.125), (1, 0.75), (2, 0.125)] {
            let row = (row + y).saturating_sub(1).min(self.height - 1);
            for (x, column_weight) in [(self.width - 1, 0.125), (0, 0.75), (1, 0.125)] {
                let column = (column + x) % self.width;
                sum += row_weight * column_weight * self.texels[row * self.width + column].element_sum();
            }
        }
        sum
    }

    /// Radiance from `direction`, which points away from the scene; linear between texel centres.
    pub fn radiance(&self, direction: DVec3) -> LinearRgb {
        let [u, v] = self.place(direction);
        let (x, y) = (u * self.width as f64 - 0.5, v * self.height as f64 - 0.5);
        let (left, top) = (x.floor(), y.floor());
        let (right_weight, bottom_weight) = ((x - left) as f32, (y - top) as f32);
        let texel = |column: f64, row: f64| {
            let column = (column as i64).rem_euclid(self.width as i64) as usize;
            let row = (row as i64).clamp(0, self.height as i64 - 1) as usize;
            self.texels[row * self.width + column]
        };
        let upper = texel(left, top).lerp(texel(left + 1.0, top), right_weight);
        let lower = texel(left, top + 1.0).lerp(texel(left + 1.0, top + 1.0), right_weight);
        LinearRgb(upper.lerp(lower, bottom_weight))
    }

    /// Draws a direction in proportion to brightness; `random` lies in [0, 1)^2. `None` for a black image.
    pub fn sample(&self, random: [f32; 2]) -> Option<DVec3> {
        let total = *self.row_sums.last().filter(|total| **total > 0.0)?;
        let (row, y) = drawn(&self.row_sums, f64::from(random[0]) * total);
        let columns = &self.column_sums[row * self.width..][..self.width];
        let (column, x) = drawn(columns, f64::from(random[1]) * columns[self.width - 1]);
        let (u, v) = ((column as f64 + x) / self.width as f64, (row as f64 + y) / self.height as f64);
        let (longitude, latitude) = (PI * (1.0 - 2.0 * u), PI * (0.5 - v));
        let radius = latitude.cos();
        Some(DVec3::new(longitude.sin() * radius, latitude.sin(), longitude.cos() * radius))
    }

    /// Density of [`Self::sample`] per solid angle.
    pub fn density(&self, direction: DVec3) -> f32 {
        let [u, v] = self.place(direction);
        let column = ((u * self.width as f64) as usize).min(self.width - 1);
        let row = ((v * self.height as f64) as usize).min(self.height - 1);
        let index = row * self.width + column;
        let before = if column == 0 { 0.0 } else { self.column_sums[index - 1] };
        let probability = (self.column_sums[index] - before) / self.row_sums[self.height - 1].max(f64::MIN_POSITIVE);
        // The area of the image in (u, v) is 1, and the sphere's 2 pi^2 sin v there.
        let area = 2.0 * PI * PI * (PI * v).sin().max(1e-9);
        (probability * (self.width * self.height) as f64 / area) as f32
    }

    /// Where a direction lies in the image, from the top left, in units of its edges.
    fn place(&self, direction: DVec3) -> [f64; 2] {
        let longitude = direction.x.atan2(direction.z);
        let latitude = (direction.y / direction.length()).clamp(-1.0, 1.0).asin();
        [0.5 - longitude / (2.0 * PI), 0.5 - latitude / PI]
    }
}

/// The element of a list of sums that `value` falls into, and how far into it, 0 to 1.
fn drawn(sums: &[f64], value: f64) -> (usize, f64) {
    let index = sums.partition_point(|sum| *sum <= value).min(sums.len() - 1);
    let before = if index == 0 { 0.0 } else { sums[index - 1] };
    let weight = sums[index] - before;
    (index, if weight > 0.0 { ((value - before) / weight).clamp(0.0, 1.0) } else { 0.5 })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Black but for the texels toward +X and, twice as bright, +Y.
    fn lamps() -> EnvironmentMap {
        let mut texels = vec![Vec3::ZERO; 64 * 32];
        texels[16 * 64 + 16] = Vec3::splat(300.0);
        texels[15 * 64 + 16] = Vec3::splat(300.0);
        texels[40] = Vec3::splat(600.0);
        EnvironmentMap::new(64, 32, texels).unwrap()
    }

    #[test]
    fn directions_lie_where_openexr_lays_them() {
        let texels = (0..8 * 4).map(|i| Vec3::new((i % 8) as f32, (i / 8) as f32, 0.0)).collect();
        let map = EnvironmentMap::new(8, 4, texels).unwrap();
        let at = |direction: DVec3| map.radiance(direction).0.truncate().to_array();
        assert_eq!(at(DVec3::Z), [3.5, 1.5]);
        assert_eq!(at(DVec3::X), [1.5, 1.5]);
        assert_eq!(at(DVec3::NEG_X), [5.5, 1.5]);
        assert_eq!(at(DVec3::Y)[1], 0.0);
        assert_eq!(at(DVec3::NEG_Y)[1], 3.0);
    }

    #[test]
    fn drawn_directions_and_their_density_agree() {
        let map = lamps();
        let (mut solid_angle, mut near_x, count) = (0.0, 0, 4096);
        for i in 0..count {
            let random = [(i as f32 + 0.5) / count as f32, (i as f32 * 0.618_034).fract()];
            let direction = map.sample(random).unwrap();
            let density = map.density(direction);
            assert!(density > 0.0);
            solid_angle += 1.0 / f64::from(density) / f64::from(count);
            near_x += i32::from(direction.x > 0.9);
        }
        // The mean of 1 / density is the solid angle of the texels that shine, with those around them.
        let texel =
            |row: usize| 2.0 * PI / 64.0 * ((PI * row as f64 / 32.0).cos() - (PI * (row + 1) as f64 / 32.0).cos());
        let expected = 3.0 * (texel(14) + texel(15) + texel(16) + texel(17) + texel(0) + texel(1));
        assert!((solid_angle / expected - 1.0).abs() < 0.05, "{solid_angle} {expected}");
        let sine = |row: usize| (PI * (row as f64 + 0.5) / 32.0).sin();
        let (sides, top) =
            (300.0 * 2.0 * (0.875 * sine(15) + 0.125 * sine(14)), 600.0 * (0.875 * sine(0) + 0.125 * sine(1)));
        let share = sides / (sides + top);
        assert!((f64::from(near_x) / f64::from(count) - share).abs() < 0.01, "{near_x} {share}");
        assert_eq!(map.density(DVec3::NEG_Z), 0.0);
    }

    #[test]
    fn broken_images_are_refused_or_dark() {
        assert!(EnvironmentMap::new(0, 4, vec![]).is_none());
        assert!(EnvironmentMap::new(2, 2, vec![Vec3::ONE; 3]).is_none());
        let map = EnvironmentMap::new(2, 1, vec![Vec3::new(f32::NAN, f32::INFINITY, -1.0); 2]).unwrap();
        assert_eq!(map.radiance(DVec3::X).0, Vec3::ZERO);
        assert!(map.sample([0.3, 0.4]).is_none());
        assert_eq!(map.density(DVec3::X), 0.0);
    }
}
