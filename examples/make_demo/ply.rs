//! Gaussians as 3DGS trainers write them (Kerbl et al. 2023): binary PLY.

use std::io::{Result, Write};

use glam::{DMat3, DQuat, DVec3};
use splatprobe::scene::Splats;

/// Writes a PLY file with logits of opacities, logarithms of standard deviations and quaternions w x y z.
///
/// Turning the frame would mix the coefficients of bands above 0: `splats` that have such stay in their frame.
pub fn write(splats: &Splats, file_from_canonical: DQuat, out: &mut impl Write) -> Result<()> {
    assert!(splats.sh_degree == 0 || file_from_canonical == DQuat::IDENTITY);
    let per_channel = splats.sh_stride() / 3;
    let rest: String = (0..3 * (per_channel - 1)).map(|i| format!("f_rest_{i} ")).collect();
    let names = format!("x y z f_dc_0 f_dc_1 f_dc_2 {rest}opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3");
    let properties: String = names.split(' ').map(|name| format!("property float {name}\n")).collect();
    let count = splats.len();
    write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{properties}end_header\n")?;
    for i in 0..count {
        let sds = splats.standard_deviations(i);
        let axes = (DMat3::from_diagonal(sds) * splats.unit_from_world[i].as_dmat3()).transpose();
        // The axes' signs are free: a mirrored basis is turned into a rotation.
        let mirror = DMat3::from_diagonal(DVec3::new(1.0, 1.0, axes.determinant().signum()));
        let DQuat { x, y, z, w } = file_from_canonical * DQuat::from_mat3(&(axes * mirror)).normalize();
        let mean = file_from_canonical * splats.means[i].as_dvec3();
        let sh = splats.sh_of(i);
        let rest = (0..sh.len()).filter(|k| k % per_channel != 0);
        let sh = (0..3).map(|channel| channel * per_channel).chain(rest).map(|k| f64::from(sh[k]));
        let opacity = f64::from(splats.opacities[i]);
        let logit = (opacity / (1.0 - opacity)).ln();
        let row =
            mean.to_array().into_iter().chain(sh).chain([logit]).chain(sds.to_array().map(f64::ln)).chain([w, x, y, z]);
        for value in row {
            out.write_all(&(value as f32).to_le_bytes())?;
        }
    }
    Ok(())
}
