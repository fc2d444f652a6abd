//! .splat.

use splatprobe::scene::sh::C0;

use super::Known;

pub fn file(gaussians: &[Known]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for gaussian in gaussians {
        let floats = [gaussian.mean, gaussian.deviations].map(|vector| vector.to_array());
        bytes.extend(floats.as_flattened().iter().flat_map(|&value| (value as f32).to_le_bytes()));
        bytes.extend([0, 1, 2].map(|c| ((0.5 + C0 * gaussian.sh[c]) * 255.0).round() as u8));
        bytes.push((gaussian.opacity * 255.0).round() as u8);
        let [x, y, z, w] = gaussian.rotation.to_array();
        bytes.extend([w, x, y, z].map(|q| (q * 128.0 + 128.0).round().clamp(0.0, 255.0) as u8));
    }
    bytes
}
