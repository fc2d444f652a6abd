//! three.js, Babylon.js and PlayCanvas: ES modules that load a bake's cube maps, and blend and correct them in the engines' own
//! materials.
//!
//! What the engines can do by themselves is one box around the point of capture for a whole material. So their shaders'
//! look-ups into the environment are replaced by the manifest's own (`crate::place::interpolate`): per object the probes
//! and their weights, per pixel the parallax. The modules differ in how they reach into a shader and share everything else.
//!
//! three.js and PlayCanvas look cube maps up by (-x, y, z) of a world direction. So does Babylon.js here: in its left-handed
//! world, glTF's x is negated, and it looks up by the world's direction.

use serde_json::{Value, json};

use super::bake::Bake;
use super::output::Output;
use crate::Result;
use crate::encode::ktx2::{Supercompression, file};
use crate::encode::slots::Slots;
use crate::filter::{Prefilter, ROUGHEST_SIZE, RgbCubemap, mip_count};
use crate::job::{HdrEncoding, RoughnessCurve};
use crate::manifest::ProbeRecord;

/// Which probes count at a position: an ES module.
pub const PROBES_JS: &str = include_str!("probes.js");

/// How a probe is looked up: GLSL for WebGL 2.
pub const PROBES_GLSL: &str = include_str!("probes.glsl");

const LOAD_JS: &str = include_str!("load.js");
const BLEND_GLSL: &str = include_str!("blend.glsl");

/// Larger faces take more memory than a browser gives.
const MAX_FACE_SIZE: u32 = 1024;

/// Writes the bake for three.js.
pub fn three(bake: &Bake, output: &mut Output) -> Result<()> {
    write(bake, output, "splatprobe-three.js", include_str!("three.js"), include_str!("three.html"))
}

/// Writes the bake for Babylon.js.
pub fn babylon(bake: &Bake, output: &mut Output) -> Result<()> {
    write(bake, output, "splatprobe-babylon.js", include_str!("babylon.js"), include_str!("babylon.html"))
}

/// Writes the bake for PlayCanvas.
pub fn playcanvas(bake: &Bake, output: &mut Output) -> Result<()> {
    write(bake, output, "splatprobe-playcanvas.js", include_str!("playcanvas.js"), include_str!("playcanvas.html"))
}

/// Cube maps, what the modules need of the manifest, the modules, and a page that shows balls in the bake.
fn write(bake: &Bake, output: &mut Output, name: &str, module: &str, example: &str) -> Result<()> {
    let manifest = &bake.manifest;
    let mut probes = Vec::with_capacity(manifest.probes.len());
    for probe in &manifest.probes {
        let cubemap = output.power_of_two(&probe.id, bake.cubemap(probe)?, MAX_FACE_SIZE);
        let name = format!("{}/specular.ktx2", probe.id);
        let count = mip_count(cubemap.size(), ROUGHEST_SIZE);
        let chain = Prefilter::new(cubemap).chain(RoughnessCurve::Linear, count);
        let mips: Vec<&RgbCubemap> = chain.iter().map(|mip| &mip.cubemap).collect();
        output.file(&name, file(&mips, &Slots::NEGATED_X, HdrEncoding::Rgba16f, Supercompression::None))?;
        probes.push(record(probe, &name));
    }
    let document = json!({
        "format": "splatprobe web 1",
        "generator": manifest.generator,
        "colour": manifest.colour,
        "probes": probes,
        "placement": manifest.placement.as_ref().map(|placement| json!({ "levels": placement.levels })),
    });
    output.json("probes.json", &document)?;
    output.file("probes.js", PROBES_JS)?;
    output.file("load.js", LOAD_JS)?;
    output.file(name, module.replace("{{glsl}}", &format!("{PROBES_GLSL}\n{BLEND_GLSL}")))?;
    output.file("example.html", example)
}

fn record(probe: &ProbeRecord, specular: &str) -> Value {
    json!({
        "id": probe.id,
        "position": probe.position,
        "influence": probe.influence,
        "proxy": probe.proxy,
        "sh": probe.sh,
        "specular": specular,
    })
}
