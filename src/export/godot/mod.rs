//! Godot 4: cubemaps by the engine's own importer, and a scene of reflection probes.
//!
//! Godot's world is the manifest's frame, and cubemaps are looked up by the direction as it is. Reflection probes take no
//! images; they capture what is on their layers. So each stands around a small box on a layer of its own that shows the
//! baked cubemap and nothing else, and captures that once.

use std::fmt::Write;

use super::bake::{Bake, is_proxy_the_influence, uniformly_blended};
use super::output::Output;
use crate::Result;
use crate::encode::slots::Slots;
use crate::manifest::ProbeRecord;

/// Largest faces: a strip of six is 12288 pixels high, and Godot's images end at 16384.
const MAX_FACE_SIZE: u32 = 2048;

const SCENE: &str = include_str!("probes.tscn");
const PROBE: &str = include_str!("probe.tscn");
const SHADER: &str = include_str!("radiance.gdshader");
const IMPORT: &str = include_str!("cubemap.exr.import");

/// Writes the bake for Godot.
pub fn write(bake: &Bake, output: &mut Output) -> Result<()> {
    let (mut resources, mut materials, mut nodes) = (String::new(), String::new(), String::new());
    for probe in &bake.manifest.probes {
        let id = &probe.id;
        let cubemap = output.power_of_two(id, bake.cubemap(probe)?, MAX_FACE_SIZE);
        let name = format!("{id}.exr");
        output.exr(&name, cubemap.size(), &Slots::DIRECT.texels(&cubemap), bake.manifest.settings.pixel)?;
        output.file(&format!("{name}.import"), IMPORT)?;
        // Writing to a string does not fail.
        let _ = writeln!(resources, "[ext_resource type=\"Cubemap\" path=\"{name}\" id=\"{id}\"]");
        let _ = write!(
            materials,
            "[sub_resource type=\"ShaderMaterial\" id=\"{id}\"]\nshader = ExtResource(\"shader\")\n\
             shader_parameter/radiance = ExtResource(\"{id}\")\n\n"
        );
        nodes += &node(probe);
    }
    output.file("radiance.gdshader", SHADER)?;
    let colour = &bake.manifest.colour;
    let scene = SCENE
        .replace("{exposure}", &colour.exposure.to_string())
        .replace("{paper_white}", &colour.paper_white.to_string())
        .replace("{resources}", &resources)
        .replace("{materials}", &materials)
        .replace("{probes}", &nodes);
    output.file("probes.tscn", scene)
}

fn node(probe: &ProbeRecord) -> String {
    let (bounds, blend) = uniformly_blended(probe);
    let (centre, size) = (bounds.centre(), bounds.extent());
    let offset = glam::DVec3::from(probe.position) - centre;
    let numbers = |v: glam::DVec3| format!("{}, {}, {}", v.x, v.y, v.z);
    PROBE
        .replace("{id}", &probe.id)
        .replace("{centre}", &numbers(centre))
        .replace("{size}", &numbers(size))
        .replace("{offset}", &numbers(offset))
        .replace("{is_projected}", if is_proxy_the_influence(probe) { "true" } else { "false" })
        .replace("{blend}", &blend.to_string())
}
