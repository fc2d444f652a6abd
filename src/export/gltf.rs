//! glTF 2.0: a scene per probe that is lit by EXT_lights_image_based, with a node for every probe.
//!
//! Faces lie as Babylon.js takes them, whose authors wrote the extension: it looks cube maps up in its left-handed world,
//! where x of glTF's is negated, and takes images upside down, which is what the extension's "flipped" comes to. Irradiance
//! is mirrored likewise: the loader turns neither. `tests/oracles/export.sh` shows that it is so.

use std::f64::consts::PI;

use serde_json::{Value, json};

use super::bake::Bake;
use super::output::Output;
use crate::Result;
use crate::encode::preview::write_png;
use crate::encode::rgbd;
use crate::encode::slots::Slots;
use crate::filter::{Prefilter, mip_count};
use crate::job::RoughnessCurve;
use crate::manifest::ShRecord;

const EXTENSION: &str = "EXT_lights_image_based";

/// Largest faces: the six of the next size, 4096, are 400 MB once they are loaded as 8 bits.
const MAX_FACE_SIZE: u32 = 2048;

/// Faces of the roughest mip, as the extension advises.
const MIN_SIZE: u32 = 16;

const FACE_NAMES: [&str; 6] = ["px", "nx", "py", "ny", "pz", "nz"];

/// Writes the bake as glTF.
pub fn write(bake: &Bake, output: &mut Output) -> Result<()> {
    let manifest = &bake.manifest;
    let (mut images, mut lights, mut nodes) = (Vec::new(), Vec::new(), Vec::new());
    for (index, probe) in manifest.probes.iter().enumerate() {
        let cubemap = output.power_of_two(&probe.id, bake.cubemap(probe)?, MAX_FACE_SIZE);
        let size = cubemap.size();
        let chain = Prefilter::new(cubemap).chain(RoughnessCurve::Linear, mip_count(size, MIN_SIZE));
        let mut specular = Vec::with_capacity(chain.len());
        for (level, mip) in chain.iter().enumerate() {
            let texels = Slots::NEGATED_X.texels(&mip.cubemap);
            let faces = texels.chunks_exact(texels.len() / 6).zip(FACE_NAMES);
            let mut indices = Vec::with_capacity(6);
            for (face, name) in faces {
                let uri = format!("{}/specular_{level}_{name}.png", probe.id);
                let image = image::imageops::flip_vertical(&rgbd::encode(mip.cubemap.size(), face));
                write_png(&output.path(&uri)?, &image)?;
                indices.push(images.len());
                images.push(json!({ "uri": uri, "mimeType": "image/png" }));
            }
            specular.push(indices);
        }
        lights.push(json!({
            "name": probe.id,
            "intensity": 1.0,
            "irradianceCoefficients": irradiance(&probe.sh),
            "specularImageSize": size,
            "specularImages": specular,
        }));
        nodes.push(json!({
            "name": probe.id,
            "translation": probe.position,
            "extras": { "splatprobe": {
                "light": index,
                "influence": probe.influence,
                "proxy": probe.proxy,
                "priority": probe.priority,
            } },
        }));
    }
    let all_nodes: Vec<usize> = (0..nodes.len()).collect();
    let scene = |(light, name): (usize, &String)| json!({ "name": name, "nodes": all_nodes, "extensions": { EXTENSION: { "light": light } } });
    let scenes: Vec<Value> = manifest.probes.iter().map(|probe| &probe.id).enumerate().map(scene).collect();
    let document = json!({
        "asset": { "version": "2.0", "generator": manifest.generator, "extras": { "splatprobe": { "colour": manifest.colour } } },
        "extensionsUsed": [EXTENSION],
        "extensions": { EXTENSION: { "lights": lights } },
        "images": images,
        "nodes": nodes,
        "scenes": scenes,
        "scene": 0,
    });
    output.json("probes.gltf", &document)
}

/// Coefficients of irradiance: radiance by the bands of the clamped cosine, x negated, with the Condon-Shortley phase that
/// Babylon.js takes out again.
fn irradiance(sh: &ShRecord) -> Vec<[f64; 3]> {
    /// Of the nine: those that are odd in x, and those of odd m.
    const ODD_IN_X: [usize; 3] = [3, 4, 7];
    const ODD_ORDER: [usize; 4] = [1, 3, 5, 7];
    let bands = [PI, 2.0 * PI / 3.0, PI / 4.0];
    let factor = |i: usize| {
        let sign = |negative: bool| if negative { -1.0 } else { 1.0 };
        bands[i.isqrt()] * sign(ODD_IN_X.contains(&i)) * sign(ODD_ORDER.contains(&i))
    };
    let nine = sh.coefficients.iter().take(9).enumerate();
    nine.map(|(i, coefficient)| coefficient.map(|value| value * factor(i))).collect()
}
