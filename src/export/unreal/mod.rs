//! Unreal: a panorama per probe, and an editor script that makes reflection captures with them.
//!
//! Unreal is left-handed, +Z up, centimetres. Its glTF importer takes (x, y, z) to (x, z, y), and so does this. A panorama
//! becomes a cube by u = 1/2 + atan2(x, -y) / 2 pi of Unreal's axes (TextureCompressorModule.cpp), with the manifest's -Z in
//! the middle: half a turn from OpenEXR's. It takes whole pixels for their centres, and so does this.

use glam::DVec3;
use serde_json::{Value, json};

use super::axes::Axes;
use super::bake::{Bake, influence, is_proxy_the_influence, uniformly_blended};
use super::output::Output;
use crate::Result;
use crate::encode::latlong::Latlong;
use crate::filter::Sampler;
use crate::manifest::ProbeRecord;

const AXES: Axes = Axes { from: [(0, 1.0), (2, 1.0), (1, 1.0)], units_per_metre: 100.0 };

/// Unreal fades a box capture from half the transition distance inside of its faces over this share of the distance
/// (ReflectionEnvironmentShared.ush).
const FADE: f64 = 0.7;

/// Least transition distance, in centimetres: the shader divides by it.
const MIN_TRANSITION: f64 = 1.0;

const SCRIPT: &str = include_str!("import_probes.py");

/// Writes the bake for Unreal.
pub fn write(bake: &Bake, output: &mut Output) -> Result<()> {
    let mut probes = Vec::with_capacity(bake.manifest.probes.len());
    for probe in &bake.manifest.probes {
        let cubemap = bake.cubemap(probe)?;
        let name = format!("{}.hdr", probe.id);
        Latlong::of_corners(&Sampler::new(&cubemap), 2 * cubemap.size()).turned(2).write_hdr(&output.path(&name)?)?;
        probes.push(record(probe, &name));
    }
    let document = json!({
        "generator": bake.manifest.generator,
        "colour": bake.manifest.colour,
        // Brightness 1 leaves radiance as it is stored.
        "brightness": 1.0,
        "probes": probes,
    });
    output.json("probes.json", &document)?;
    output.file("import_probes.py", SCRIPT)
}

/// A box where the proxy is the influence box, on which Unreal projects; else a sphere around the influence box, since a
/// wrong box distorts more.
fn record(probe: &ProbeRecord, panorama: &str) -> Value {
    let position = AXES.point(probe.position.into());
    let mut record = json!({
        "id": probe.id,
        "panorama": panorama,
        "position": position,
        "priority": probe.priority,
    });
    if is_proxy_the_influence(probe) {
        let (uniform, blend) = uniformly_blended(probe);
        let (uniform, blend) = (AXES.bounds(&uniform), blend * AXES.units_per_metre);
        let transition = (blend / FADE).max(MIN_TRANSITION);
        let half = (uniform.extent() / 2.0 - blend + transition / 2.0).max(DVec3::splat(MIN_TRANSITION));
        record["box"] = json!({
            "centre": uniform.centre(), "halfSize": half, "transitionDistance": transition,
        });
    } else {
        let influence = AXES.bounds(&influence(probe));
        let radius = (influence.max - position).abs().max((influence.min - position).abs()).length();
        record["sphere"] = json!({ "radius": radius });
    }
    record
}
