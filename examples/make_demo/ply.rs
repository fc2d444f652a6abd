//! Gaussians as 3DGS trainers write them (Kerbl et al. 2023): binary PLY, +Y down, +Z forward.

use glam::{DMat3, DQuat};
use splatprobe::scene::Splats;

/// The bytes of a PLY file with logits of opacities, logarithms of standard deviations and quaternions w x y z.
///
/// `splats` are of degree 0: turning the frame would mix the coefficients of higher bands.
pub fn encode(splats: &Splats) -> Vec<u8> {
    assert_eq!(splats.sh_degree, 0);
    let names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let properties: String = names.split(' ').map(|name| format!("property float {name}\n")).collect();
    let header =
        format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n{properties}end_header\n", splats.len());
    let mut bytes = header.into_bytes();
    // From +Y up, +Z back to +Y down, +Z forward: half a turn about X.
    let file_from_canonical = DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0);
    for i in 0..splats.len() {
        let sds = splats.standard_deviations(i);
        let rotation_transposed = DMat3::from_diagonal(sds) * splats.unit_from_world[i].as_dmat3();
        let rotation = file_from_canonical * DQuat::from_mat3(&rotation_transposed.transpose()).normalize();
        let mean = file_from_canonical * splats.means[i].as_dvec3();
        let opacity = f64::from(splats.opacities[i]);
        let logit = (opacity / (1.0 - opacity)).ln();
        let [scale_0, scale_1, scale_2] = sds.to_array().map(f64::ln);
        let DQuat { x, y, z, w } = rotation;
        for value in [mean.x, mean.y, mean.z] {
            bytes.extend_from_slice(&(value as f32).to_le_bytes());
        }
        bytes.extend(splats.sh_of(i).iter().flat_map(|coefficient| coefficient.to_le_bytes()));
        for value in [logit, scale_0, scale_1, scale_2, w, x, y, z] {
            bytes.extend_from_slice(&(value as f32).to_le_bytes());
        }
    }
    bytes
}
