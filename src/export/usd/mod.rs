//! OpenUSD: a layer with a transform per probe and a dome light that a variant chooses the probe for.
//!
//! The stage is the manifest's frame: +Y up, metres. A dome light's image lies as OpenEXR lays it. There is no schema for
//! local probes, so that what they are stands in attributes of this program's own.

use std::fmt::Write;

use super::bake::Bake;
use super::output::Output;
use crate::Result;
use crate::encode::latlong::Latlong;
use crate::filter::Sampler;
use crate::manifest::{Manifest, ProbeRecord};

const LAYER: &str = include_str!("probes.usda");

/// Writes the bake as USD.
pub fn write(bake: &Bake, output: &mut Output) -> Result<()> {
    for probe in &bake.manifest.probes {
        let cubemap = bake.cubemap(probe)?;
        let panorama = Latlong::new(&Sampler::new(&cubemap), 2 * cubemap.size());
        let name = format!("{}.exr", probe.id);
        output.exr(&name, 2 * panorama.height, &panorama.pixels, bake.manifest.settings.pixel)?;
    }
    output.file("probes.usda", layer(&bake.manifest))
}

/// The template with the bake's numbers. Ids are names that need no quoting, here as everywhere in exports.
fn layer(manifest: &Manifest) -> String {
    let colour = &manifest.colour;
    let probes: String = manifest.probes.iter().map(transform).collect();
    let variants: String = manifest.probes.iter().map(variant).collect();
    let first = manifest.probes.first().map_or("", |probe| &probe.id);
    LAYER
        .replace("{generator}", concat!("splatprobe ", env!("CARGO_PKG_VERSION")))
        .replace("{exposure}", &colour.exposure.to_string())
        .replace("{paper_white}", &colour.paper_white.to_string())
        .replace("{match_tonemapper}", &json_name(&colour.match_tonemapper))
        .replace("{first}", first)
        .replace("{probes}", &probes)
        .replace("{variants}", &variants)
}

fn json_name(value: &impl serde::Serialize) -> String {
    serde_json::to_value(value).ok().and_then(|value| value.as_str().map(String::from)).unwrap_or_default()
}

fn transform(probe: &ProbeRecord) -> String {
    let tuple = |v: &[f64]| format!("({})", v.iter().map(f64::to_string).collect::<Vec<_>>().join(", "));
    let ProbeRecord { id, position, influence, proxy, priority, sh, .. } = probe;
    let coefficients: Vec<String> = sh.coefficients.iter().map(|c| tuple(c)).collect();
    let blend: Vec<String> = influence.blend.iter().map(f64::to_string).collect();
    let mut text = String::new();
    let mut line = |content: String| {
        // Writing to a string does not fail.
        let _ = writeln!(text, "            {content}");
    };
    line(format!("custom asset splatprobe:panorama = @./{id}.exr@"));
    line(format!("custom double3 splatprobe:influence:min = {}", tuple(&influence.min)));
    line(format!("custom double3 splatprobe:influence:max = {}", tuple(&influence.max)));
    line(format!("custom double[] splatprobe:influence:blend = [{}]", blend.join(", ")));
    line(format!("custom double3 splatprobe:proxy:min = {}", tuple(&proxy.min.to_array())));
    line(format!("custom double3 splatprobe:proxy:max = {}", tuple(&proxy.max.to_array())));
    line(format!("custom int splatprobe:priority = {priority}"));
    line(format!("custom double3[] splatprobe:sh = [{}]", coefficients.join(", ")));
    line(format!("double3 xformOp:translate = {}", tuple(position)));
    line("uniform token[] xformOpOrder = [\"xformOp:translate\"]".into());
    format!("        def Xform \"{id}\"\n        {{\n{text}        }}\n\n")
}

fn variant(ProbeRecord { id, .. }: &ProbeRecord) -> String {
    format!(
        "        \"{id}\" {{\n            over \"Environment\"\n            {{\n                \
         asset inputs:texture:file = @./{id}.exr@\n            }}\n        }}\n"
    )
}
