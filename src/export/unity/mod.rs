//! Unity: a strip of faces per probe with import settings, and an editor script that makes reflection probes of them.
//!
//! Unity is left-handed, +Y up, metres. glTF importers for it negate x, and so does this: positions are (-x, y, z), and a
//! world direction, which Unity looks cubemaps up by as it is, is the manifest's with x negated.
//!
//! Faces lie side by side, +X -X +Y -Y +Z -Z, as Unity writes its own baked probes ("6 frames layout").

use glam::DVec3;
use serde_json::{Value, json};

use super::axes::Axes;
use super::bake::{Bake, influence, is_proxy_the_influence, uniformly_blended};
use super::output::Output;
use crate::Result;
use crate::encode::slots::Slots;
use crate::filter::RgbCubemap;
use crate::manifest::{Manifest, ProbeRecord};

const AXES: Axes = Axes { from: [(0, -1.0), (1, 1.0), (2, 1.0)], units_per_metre: 1.0 };

/// Six of these side by side are the widest texture that Unity imports, 16384 pixels.
const MAX_FACE_SIZE: u32 = 2048;

const SCRIPT: &str = include_str!("SplatprobeImporter.cs");
const ASSEMBLY: &str = include_str!("Splatprobe.Editor.asmdef");
const META: &str = include_str!("cubemap.exr.meta");

/// Writes the bake for Unity.
pub fn write(bake: &Bake, output: &mut Output) -> Result<()> {
    let manifest = &bake.manifest;
    let mut probes = Vec::with_capacity(manifest.probes.len());
    for probe in &manifest.probes {
        let cubemap = output.power_of_two(&probe.id, bake.cubemap(probe)?, MAX_FACE_SIZE);
        let width = 6 * cubemap.size();
        let name = format!("{}.exr", probe.id);
        output.exr(&name, width, &side_by_side(&cubemap), manifest.settings.pixel)?;
        let meta = META
            .replace("{guid}", &guid(manifest, probe))
            .replace("{size}", &width.next_power_of_two().max(2048).to_string());
        output.file(&format!("{name}.meta"), meta)?;
        probes.push(record(probe, &name));
    }
    let colour = &manifest.colour;
    let document = json!({
        "generator": manifest.generator,
        "exposure": colour.exposure,
        "paperWhite": colour.paper_white,
        "matchTonemapper": colour.match_tonemapper,
        // Radiance is stored as Unity shows it: white walls of a radiance of 1 are white.
        "intensity": 1.0,
        "probes": probes,
    });
    output.json("probes.json", &document)?;
    output.file("Editor/SplatprobeImporter.cs", SCRIPT)?;
    output.file("Editor/Splatprobe.Editor.asmdef", ASSEMBLY)
}

fn side_by_side(cubemap: &RgbCubemap) -> Vec<glam::Vec3> {
    let n = cubemap.size() as usize;
    let slots = Slots::NEGATED_X.texels(cubemap);
    let row = |y: usize| (0..6).flat_map(move |slot| (slot * n + y) * n..(slot * n + y + 1) * n);
    (0..n).flat_map(row).map(|texel| slots[texel]).collect()
}

/// A name for the asset that stays the same when the scene is changed and baked anew, so that scenes keep their references,
/// and that differs between bakes of files of other names or of probes that stand elsewhere.
fn guid(manifest: &Manifest, probe: &ProbeRecord) -> String {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"splatprobe unity ");
    for input in &manifest.inputs {
        hasher.update(input.path.as_bytes());
    }
    hasher.update(probe.id.as_bytes());
    for value in probe.position {
        hasher.update(&value.to_le_bytes());
    }
    hasher.finalize().to_hex()[..32].to_owned()
}

fn record(probe: &ProbeRecord, cubemap: &str) -> Value {
    let [influence, proxy] = [influence(probe), probe.proxy].map(|bounds| AXES.bounds(&bounds));
    let blend = AXES.by_face(probe.influence.blend);
    let (uniform, distance) = uniformly_blended(probe);
    let uniform = AXES.bounds(&uniform);
    let position = AXES.point(probe.position.into());
    let side = |low: usize| xyz(DVec3::new(blend[low], blend[low + 2], blend[low + 4]));
    json!({
        "id": probe.id,
        "cubemap": cubemap,
        "position": xyz(position),
        "importance": probe.priority,
        "box": {
            "centre": xyz(uniform.centre()), "size": xyz(uniform.extent()),
            "blendDistance": distance, "isProjected": is_proxy_the_influence(probe),
        },
        "influence": {
            "centre": xyz(influence.centre()), "size": xyz(influence.extent()),
            "blendPositive": side(0), "blendNegative": side(1),
        },
        "proxy": { "centre": xyz(proxy.centre()), "size": xyz(proxy.extent()) },
    })
}

/// A vector as Unity's JsonUtility reads it.
fn xyz(vector: DVec3) -> Value {
    json!({ "x": vector.x, "y": vector.y, "z": vector.z })
}
