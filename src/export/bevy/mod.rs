//! Bevy: KTX2 cube maps and a plugin's source that spawns a light probe for each.
//!
//! Bevy's frame is the manifest's. A light probe is a unit cube under its entity's transform, seen from the cube's middle
//! (bevy_light 0.19, probe.rs), and its cube maps are looked up by where a ray leaves a box around that middle, in the
//! scaled space of that cube (bevy_pbr, environment_map.wgsl: `compute_cubemap_sample_dir`). So every texel here holds what is
//! seen through the proxy box from the point of capture where that look-up means it: for a proxy that is the influence box,
//! boxes that are no cubes and captures outside of the middle come out exact. A cube map is looked up by (x, y, -z).

use std::fmt::Write;

use glam::DVec3;

use super::bake::{Bake, influence};
use super::output::Output;
use crate::Result;
use crate::encode::ktx2::{Supercompression, file};
use crate::encode::slots::Slots;
use crate::filter::{Prefilter, ROUGHEST_SIZE, RgbCubemap, Sampler, mip_count};
use crate::job::{HdrEncoding, RoughnessCurve};
use crate::manifest::ProbeRecord;
use crate::place::interpolate::parallax_corrected;
use crate::scene::Bounds;

const PLUGIN: &str = include_str!("splatprobe.rs.txt");

/// Larger faces are more than a reflection probe needs, and all probes are in memory at once.
const MAX_FACE_SIZE: u32 = 1024;

/// Edge of the diffuse maps' faces.
const DIFFUSE_SIZE: u32 = 32;

/// How far, as a share of the box, the proxy's faces may lie from the influence box's to be told as the same.
const SAME_BOX: f64 = 1e-3;

/// Writes the bake for Bevy.
pub fn write(bake: &Bake, output: &mut Output) -> Result<()> {
    let mut probes = String::new();
    for probe in &bake.manifest.probes {
        let view = View::new(probe);
        if !view.is_exact {
            output.note(format!(
                "{}: its proxy is not its influence box; Bevy corrects reflections exactly in the box's middle only",
                probe.id
            ));
        }
        let cubemap = output.power_of_two(&probe.id, bake.cubemap(probe)?, MAX_FACE_SIZE);
        let size = cubemap.size();
        let prefilter = Prefilter::new(cubemap);
        let count = mip_count(size, ROUGHEST_SIZE);
        let specular: Vec<RgbCubemap> =
            prefilter.chain(RoughnessCurve::Linear, count).iter().map(|mip| view.seen(&mip.cubemap)).collect();
        let diffuse = view.seen(&prefilter.irradiance(size.min(DIFFUSE_SIZE)));
        let mut ktx2 = |name: &str, mips: &[&RgbCubemap]| {
            let bytes = file(mips, &Slots::NEGATED_Z, HdrEncoding::Rgba16f, Supercompression::Zstandard);
            output.file(&format!("assets/splatprobe/{}/{name}.ktx2", probe.id), bytes)
        };
        ktx2("specular", &specular.iter().collect::<Vec<_>>())?;
        ktx2("diffuse", &[&diffuse])?;
        let [translation, scale, falloff, bounds] =
            [view.centre, view.size, view.falloff, view.bounds].map(|v| format!("[{:?}, {:?}, {:?}]", v.x, v.y, v.z));
        // Writing to a string does not fail.
        let _ = writeln!(
            probes,
            "    Probe {{\n        id: \"{}\",\n        translation: {translation},\n        scale: {scale},\n        \
             falloff: {falloff},\n        parallax_half_extents: {bounds},\n    }},",
            probe.id
        );
    }
    output.file("src/splatprobe.rs", PLUGIN.replace("{{probes}}", probes.trim_end()))
}

/// A light probe, and how it sees a cubemap.
struct View {
    taken_at: DVec3,
    proxy: Bounds,
    /// Of the influence box.
    centre: DVec3,
    size: DVec3,
    /// Share of the box's edge over which the weight rises, per axis: the mean of both sides.
    falloff: DVec3,
    /// Half extents, in shares of the box, of the smallest box around its middle that holds the proxy.
    bounds: DVec3,
    is_exact: bool,
}

impl View {
    fn new(probe: &ProbeRecord) -> Self {
        let influence = influence(probe);
        let (centre, size) = (influence.centre(), influence.extent());
        let blend = &probe.influence.blend;
        let falloff = DVec3::new(blend[0] + blend[1], blend[2] + blend[3], blend[4] + blend[5]) / 2.0 / size;
        let [low, high] = [probe.proxy.min, probe.proxy.max].map(|corner| (corner - centre) / size);
        let is_exact = (low + high).abs().max_element() < SAME_BOX;
        let (taken_at, bounds) = (probe.position.into(), low.abs().max(high.abs()));
        Self { taken_at, proxy: probe.proxy, centre, size, falloff, bounds, is_exact }
    }

    /// The cubemap by direction of the box's scaled space.
    fn seen(&self, cubemap: &RgbCubemap) -> RgbCubemap {
        let sampler = Sampler::new(cubemap);
        RgbCubemap::from_fn(cubemap.size(), |direction| {
            let toward = (direction * self.size).normalize();
            sampler.radiance(parallax_corrected(self.taken_at, &self.proxy, self.centre, toward).as_vec3())
        })
    }
}
