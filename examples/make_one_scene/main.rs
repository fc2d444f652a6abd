//! Writes the scene that `tests/one_scene.rs` reads in every format: `cargo run --example make_one_scene -- FILE.ply`.
//!
//! A thousand Gaussians all around the origin, without any symmetry: no mirror or turn of space, and no change of sign or
//! order among the spherical harmonics, leaves what is seen as it is. Values are such that 8 bits hold them where a format
//! has no more, so that what a comparison shows is a reader's mistake and not a writer's rounding.

use std::f64::consts::TAU;
use std::path::PathBuf;

use glam::{DQuat, DVec3};

const GAUSSIANS: usize = 1000;

/// Gaussians that lie together share their spherical harmonics, so that those do not average out along a ray.
const PATCHES: usize = 40;

/// Colour of a band 0 coefficient of 1: `1 / (2 sqrt(pi))`.
const DC: f64 = 0.282_094_791_773_878_14;

fn main() -> std::io::Result<()> {
    let path = std::env::args_os().nth(1).map_or_else(|| "scene.ply".into(), PathBuf::from);
    std::fs::write(path, ply())
}

/// The scene as 3DGS trainers write it: binary PLY, degree 3.
pub fn ply() -> Vec<u8> {
    let names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2"].map(str::to_owned).into_iter();
    let names = names.chain((0..45).map(|k| format!("f_rest_{k}"))).chain(["opacity".to_owned()]);
    let names = names.chain((0..3).map(|k| format!("scale_{k}"))).chain((0..4).map(|k| format!("rot_{k}")));
    let properties: String = names.map(|name| format!("property float {name}\n")).collect();
    let mut bytes =
        format!("ply\nformat binary_little_endian 1.0\nelement vertex {GAUSSIANS}\n{properties}end_header\n")
            .into_bytes();
    for i in 0..GAUSSIANS {
        bytes.extend(row(i).iter().flat_map(|&value| (value as f32).to_le_bytes()));
    }
    bytes
}

/// Gaussian `i`'s values in the order of the file.
fn row(i: usize) -> Vec<f64> {
    let mut random = Random(i as u64);
    // Evenly around the origin along a spiral, whose neighbours are far apart in `i`, at distances that differ by direction.
    let z = 1.0 - (2.0 * i as f64 + 1.0) / GAUSSIANS as f64;
    let angle = i as f64 * TAU * 0.618_033_988_749_894_9;
    let direction = DVec3::new((1.0 - z * z).sqrt() * angle.cos(), (1.0 - z * z).sqrt() * angle.sin(), z);
    let mean = direction * (2.2 + 0.6 * direction.x + 0.4 * direction.y * direction.z + random.between(-0.4, 0.4));

    let turn = DVec3::from_array([(); 3].map(|()| random.between(-1.0, 1.0)));
    let DQuat { x, y, z, w } = DQuat::from_axis_angle(turn.normalize(), random.between(0.5, 3.0));
    let log_deviations = [(); 3].map(|()| random.between(-3.0, -1.2));

    let patch = patch_of(direction);
    // Red rises along +x, green along +y, blue along +z, unlike one another.
    let trend = DVec3::new(0.35 * direction.x, 0.25 * direction.y, 0.3 * direction.z) + 0.55;
    let dc = trend.to_array().map(|colour| (byte(colour + random.between(-0.1, 0.1)) - 0.5) / DC);
    let opacity = byte(random.between(0.3, 0.95));

    let mut row = mean.to_array().to_vec();
    row.extend(dc);
    row.extend((0..45).map(|k| coefficient(patch, k)));
    row.push((opacity / (1.0 - opacity)).ln());
    row.extend(log_deviations);
    row.extend([w, x, y, z]);
    row
}

/// The patch around `direction`: the nearest of directions that are spread at random.
fn patch_of(direction: DVec3) -> u64 {
    let centre = |patch: u64| {
        let mut random = Random(1_000_000 + patch);
        DVec3::from_array([(); 3].map(|()| random.between(-1.0, 1.0))).normalize()
    };
    let nearness = |patch: &u64| direction.dot(centre(*patch));
    (0..PATCHES as u64).max_by(|a, b| nearness(a).total_cmp(&nearness(b))).unwrap_or_default()
}

/// Coefficient `k` above band 0, all of red's before green's and blue's: -3/8 to 3/8 in steps of 1/8, never 0. SPZ's 4 bits
/// hold them, and within a band they differ from coefficient to coefficient.
fn coefficient(patch: u64, k: u64) -> f64 {
    let step = 1 + Random(2_000_000 + patch * 45 + k).bits() % 3;
    // Mostly of one sign over the scene, which neighbours in a band do not share: a wrong sign or order shows everywhere.
    let mostly = if (k % 15).is_multiple_of(2) { 1.0 } else { -1.0 };
    let sign = if Random(3_000_000 + patch * 45 + k).bits().is_multiple_of(4) { -mostly } else { mostly };
    sign * step as f64 / 8.0
}

/// The largest multiple of 1/255 up to `share`, and a little: writers round down as well as to the nearest.
fn byte(share: f64) -> f64 {
    ((share * 255.0).floor().clamp(1.0, 253.0) + 0.02) / 255.0
}

/// Splitmix64: the same numbers on every machine.
struct Random(u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }
}
