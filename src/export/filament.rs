//! Filament: what its tool cmgen deploys, a folder per probe, and a list of the probes.
//!
//! Filament's world is the manifest's frame, and cube maps are looked up by the direction as it is. A scene has one
//! indirect light: an application takes the probe nearest to what it shows.

use glam::DVec3;
use serde_json::json;

use super::bake::Bake;
use super::output::Output;
use crate::Result;
use crate::encode::ktx1;
use crate::filter::{Prefilter, RgbCubemap, mip_count};
use crate::job::RoughnessCurve;
use crate::manifest::ShRecord;

/// Largest faces: cmgen makes 256 px.
const MAX_FACE_SIZE: u32 = 2048;

/// Faces of the roughest mip, as cmgen's default; a chain that begins no larger goes down to a texel.
const MIN_LOD_SIZE: u32 = 16;

/// Intensity, in lux, at which Filament's default camera (f/16, 1/125 s, ISO 100) shows a stored 1 as 1: the inverse of its
/// exposure 1 / (1.2 * 16^2 * 125).
const INTENSITY: f64 = 38_400.0;

/// From raw coefficients of radiance to those of the shader's polynomial for irradiance over pi: the clamped cosine's bands
/// over pi, 1, 2/3 and 1/4, times the constants of the bases (CubemapSH.cpp, "pre-scaled").
const PRE_SCALED: [f64; 9] = [0.282095, 0.325735, 0.325735, 0.325735, 0.273137, 0.273137, 0.078848, 0.273137, 0.136569];

const NAMES: [&str; 9] = ["L00", "L1-1", "L10", "L11", "L2-2", "L2-1", "L20", "L21", "L22"];

/// Writes the bake for Filament.
pub fn write(bake: &Bake, output: &mut Output) -> Result<()> {
    let mut probes = Vec::with_capacity(bake.manifest.probes.len());
    for probe in &bake.manifest.probes {
        let id = &probe.id;
        let cubemap = output.power_of_two(id, bake.cubemap(probe)?, MAX_FACE_SIZE);
        let sh = pre_scaled(&probe.sh);
        let lines: Vec<String> = sh.iter().map(|c| format!("{} {} {}\n", c.x, c.y, c.z)).collect();
        ktx1::write(&output.path(&format!("{id}/{id}_skybox.ktx"))?, &[&cubemap], &[])?;
        let chain = Prefilter::new(cubemap.clone()).chain(RoughnessCurve::Filament, levels(cubemap.size()));
        let mips: Vec<&RgbCubemap> = chain.iter().map(|mip| &mip.cubemap).collect();
        ktx1::write(&output.path(&format!("{id}/{id}_ibl.ktx"))?, &mips, &[("sh", &lines.concat())])?;
        output.file(&format!("{id}/sh.txt"), sh_text(&sh))?;
        probes.push(json!({
            "id": id,
            "ibl": format!("{id}/{id}_ibl.ktx"),
            "skybox": format!("{id}/{id}_skybox.ktx"),
            "position": probe.position,
            "influence": probe.influence,
            "proxy": probe.proxy,
            "priority": probe.priority,
            "roughness": chain.iter().map(|mip| mip.roughness).collect::<Vec<_>>(),
        }));
    }
    let document = json!({
        "generator": bake.manifest.generator,
        "colour": bake.manifest.colour,
        "intensityAtDefaultExposure": INTENSITY,
        "probes": probes,
    });
    output.json("probes.json", &document)
}

/// Mips of a chain from `size` as cmgen counts them.
fn levels(size: u32) -> u32 {
    mip_count(size, if size > MIN_LOD_SIZE { MIN_LOD_SIZE } else { 1 })
}

/// The windowed coefficients, where the bake has them: cmgen takes rings out too.
fn pre_scaled(sh: &ShRecord) -> Vec<DVec3> {
    let coefficients = sh.windowed.as_ref().map_or(&sh.coefficients, |windowed| &windowed.coefficients);
    coefficients.iter().zip(PRE_SCALED).map(|(&coefficient, factor)| DVec3::from(coefficient) * factor).collect()
}

fn sh_text(sh: &[DVec3]) -> String {
    let line = |(c, name): (&DVec3, &str)| {
        format!("({:18.15}, {:18.15}, {:18.15}); // {name}, irradiance, pre-scaled base\n", c.x, c.y, c.z)
    };
    sh.iter().zip(NAMES).map(line).collect()
}
