//! Blender: a panorama per probe, and a script that lights the world with one of them and makes light probe objects.
//!
//! Blender is right-handed, +Z up, metres; (x, y, z) becomes (x, -z, y), as its glTF importer does. An environment texture
//! is looked up by u = 1/2 - atan2(y, x) / 2 pi of Blender's axes (Cycles' direction_to_equirectangular), with the
//! manifest's +X in the middle: a quarter of a turn from OpenEXR's.

use glam::DVec3;
use serde_json::{Value, json};

use super::axes::Axes;
use super::bake::{Bake, influence};
use super::output::Output;
use crate::Result;
use crate::encode::latlong::Latlong;
use crate::filter::Sampler;
use crate::manifest::ProbeRecord;

const AXES: Axes = Axes { from: [(0, 1.0), (2, -1.0), (1, 1.0)], units_per_metre: 1.0 };

const SCRIPT: &str = include_str!("import_probes.py");

/// Writes the bake for Blender.
pub fn write(bake: &Bake, output: &mut Output) -> Result<()> {
    let mut probes = Vec::with_capacity(bake.manifest.probes.len());
    for probe in &bake.manifest.probes {
        let cubemap = bake.cubemap(probe)?;
        let name = format!("{}.exr", probe.id);
        let panorama = Latlong::new(&Sampler::new(&cubemap), 2 * cubemap.size()).turned(1);
        output.exr(&name, 2 * panorama.height, &panorama.pixels, bake.manifest.settings.pixel)?;
        probes.push(record(probe, &name));
    }
    let document = json!({
        "generator": bake.manifest.generator,
        "colour": bake.manifest.colour,
        // The strength of the world's background that leaves radiance as it is stored.
        "strength": 1.0,
        "probes": probes,
    });
    output.json("probes.json", &document)?;
    output.file("import_probes.py", SCRIPT)
}

/// A light probe is a box around the point of capture: half sizes reach the influence box's farther faces.
fn record(probe: &ProbeRecord, panorama: &str) -> Value {
    let position = AXES.point(probe.position.into());
    let half_size = |bounds| {
        let bounds = AXES.bounds(&bounds);
        (bounds.max - position).max(position - bounds.min).max(DVec3::splat(1e-3))
    };
    let half = half_size(influence(probe));
    let blend = AXES.by_face(probe.influence.blend);
    // Blender's falloff is one share of the box, from its faces inward: the greatest share of a face.
    let shares = blend.iter().enumerate().map(|(face, blend)| blend / half[face / 2]);
    json!({
        "id": probe.id,
        "panorama": panorama,
        "position": position,
        "halfSize": half,
        "falloff": shares.fold(0.0, f64::max).min(1.0),
        "parallaxHalfSize": half_size(probe.proxy),
    })
}
