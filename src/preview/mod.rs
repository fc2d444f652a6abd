//! A bake as one HTML file for people: plan, cubemaps, balls that reflect, statistics. It opens without a network.
//!
//! The page's parts are files beside this one; what belongs to every runtime, blending and parallax correction, is shared
//! with the exporters for web engines.

use std::io::Write;
use std::path::Path;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use glam::Vec3;
use serde::Serialize;

use crate::encode::file::write_bytes_atomically;
use crate::encode::ktx2::rgb9e5;
use crate::encode::slots::Slots;
use crate::export::{Bake, PROBES_GLSL, PROBES_JS};
use crate::filter::{Prefilter, ROUGHEST_SIZE, RgbCubemap, mip_count};
use crate::job::RoughnessCurve;
use crate::manifest::{FileRole, Manifest};
use crate::{Error, Result};

const PAGE: &str = include_str!("page.html");

/// What stands for the page's placeholders; the data follows.
const PARTS: [(&str, &str); 6] = [
    ("style", include_str!("page.css")),
    ("probes.glsl", PROBES_GLSL),
    ("ball.glsl", include_str!("ball.glsl")),
    ("probes.js", PROBES_JS),
    ("render.js", include_str!("render.js")),
    ("page.js", include_str!("page.js")),
];

/// Faces of more texels do not look better in balls of a few hundred pixels.
const MAX_FACE_SIZE: u32 = 256;

/// Bytes of cubemaps in a page, before base64; faces are halved until all fit.
const MAX_BYTES: u64 = 24 << 20;

/// What the page's script reads.
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Data<'a> {
    manifest: &'a Manifest,
    baked_face_size: u32,
    face_size: u32,
    mips: Vec<Mip>,
    /// Per probe: mean radiance over the sphere, of the mean of red, green and blue.
    mean: Vec<f64>,
    /// Per probe: the largest channel of any texel of the bake.
    brightest: Vec<f32>,
    /// Per probe: all mips, the largest first, six slots each as web engines look them up, RGB9E5 in little endian, base64.
    texels: Vec<String>,
}

#[derive(Serialize)]
struct Mip {
    size: u32,
    roughness: f64,
}

/// Writes a page that shows the bake at `bake`, its folder or its manifest, to `out`.
///
/// Faces in the page are powers of two, at most 256 texels wide, and so small that all probes fit 24 MiB; the page says so.
/// Fails with the errors of [`crate::export::Bake::open`] where the bake is not what its manifest says, and with
/// [`Error::Write`].
pub fn write(bake: &Path, out: &Path) -> Result<()> {
    let bake = Bake::open(bake)?;
    let manifest = &bake.manifest;
    let baked_face_size = baked_face_size(manifest);
    let face_size = fitting_size(baked_face_size, manifest.probes.len() as u64);
    let count = mip_count(face_size, ROUGHEST_SIZE);
    let mips = (0..count).map(|index| {
        let size = face_size >> index;
        let roughness = RoughnessCurve::Linear.roughness(index, count, size);
        Mip { size, roughness }
    });
    let mut data = Data {
        manifest,
        baked_face_size,
        face_size,
        mips: mips.collect(),
        mean: Vec::new(),
        brightest: Vec::new(),
        texels: Vec::new(),
    };
    for probe in &manifest.probes {
        let cubemap = bake.cubemap(probe)?;
        data.brightest.push(cubemap.texels().iter().map(|texel| texel.max_element()).fold(0.0, f32::max));
        data.mean.push(mean(&cubemap));
        data.texels.push(BASE64_STANDARD.encode(chain(cubemap, face_size, count)));
    }
    let json = serde_json::to_string(&data).map_err(|error| Error::write(out, error.into()))?;
    // A script element ends at "</script", wherever it stands.
    let page = fill(&json.replace('<', "\\u003c"));
    write_bytes_atomically(out, |writer| writer.write_all(page.as_bytes()))
}

/// The smallest faces of any probe's radiance.
fn baked_face_size(manifest: &Manifest) -> u32 {
    let files = manifest.probes.iter().flat_map(|probe| &probe.files);
    files.filter(|file| file.role == FileRole::Radiance).map(|file| file.width).min().unwrap_or(1)
}

/// The largest power of two with which all probes fit.
fn fitting_size(baked: u32, probes: u64) -> u32 {
    let mut size = 1 << baked.clamp(1, MAX_FACE_SIZE).ilog2();
    // A third more for the mips.
    while size > 1 && probes * 6 * 4 * u64::from(size).pow(2) * 4 / 3 > MAX_BYTES {
        size /= 2;
    }
    size
}

fn chain(cubemap: RgbCubemap, face_size: u32, count: u32) -> Vec<u8> {
    let chain = Prefilter::new(cubemap.reduced(face_size)).chain(RoughnessCurve::Linear, count);
    let texels = chain.iter().flat_map(|mip| Slots::NEGATED_X.texels(&mip.cubemap));
    texels.flat_map(|texel| rgb9e5(texel).to_le_bytes()).collect()
}

fn mean(cubemap: &RgbCubemap) -> f64 {
    cubemap.reduced(1).texels().iter().map(|texel| f64::from(texel.dot(Vec3::splat(1.0 / 3.0)))).sum::<f64>() / 6.0
}

/// The page with its parts. What is put in is not looked through again.
fn fill(json: &str) -> String {
    let mut pieces = PAGE.split("{{");
    let mut page = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        let (name, rest) = piece.split_once("}}").unwrap_or(("", piece));
        let part = PARTS.iter().find(|(known, _)| *known == name);
        page += part.map_or(json, |(_, part)| part);
        page += rest;
    }
    page
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_number_of_probes_fits() {
        assert_eq!([fitting_size(100, 1), fitting_size(512, 1), fitting_size(1, 1)], [64, 256, 1]);
        for probes in [1, 47, 48, 1000, 100_000] {
            let size = u64::from(fitting_size(512, probes));
            assert!(size == 1 || probes * 32 * size * size <= MAX_BYTES, "{probes}: {size}");
        }
    }

    #[test]
    fn every_placeholder_of_the_page_is_filled() {
        let page = fill("{\"{{style}}\": 1}");
        assert_eq!(page.matches("{{").count(), 1);
        assert_eq!(PAGE.matches("{{").count(), PARTS.len() + 1);
        assert!(PARTS.iter().all(|(name, part)| PAGE.contains(&format!("{{{{{name}}}}}")) && page.contains(part)));
    }
}
