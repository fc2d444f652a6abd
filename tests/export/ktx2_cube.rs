//! The views of Bevy, three.js, Babylon.js and PlayCanvas: KTX2 as the ktx2 crate reads it.

use std::io::Read;
use std::path::Path;

use glam::{DVec3, Vec3};
use splatprobe::bake::Calibration;
use splatprobe::filter::{RgbCubemap, Sampler};

use super::lookup::cube_texel;
use super::{Baked, SIZE, Shown, factor, json, sphere};

/// Edge and colours of a mip's six slots.
struct Mip {
    n: usize,
    texels: Vec<Vec3>,
}

impl Mip {
    fn at(&self, v: DVec3) -> Vec3 {
        let (slot, x, y) = cube_texel(v, self.n);
        self.texels[(slot * self.n + y) * self.n + x]
    }
}

fn mips(path: &Path) -> Vec<Mip> {
    let bytes = std::fs::read(path).unwrap();
    let reader = ktx2::Reader::new(&bytes[..]).unwrap();
    let header = reader.header();
    assert_eq!((header.format, header.face_count), (Some(ktx2::Format::R16G16B16A16_SFLOAT), 6));
    let level = |(i, level): (usize, ktx2::Level)| {
        let mut data = Vec::new();
        match header.supercompression_scheme {
            None => data.extend(level.data),
            Some(ktx2::SupercompressionScheme::Zstandard) => {
                ruzstd::decoding::StreamingDecoder::new(level.data).unwrap().read_to_end(&mut data).map(drop).unwrap();
            }
            other => panic!("{other:?}"),
        }
        let n = (header.pixel_width >> i) as usize;
        assert_eq!(data.len(), 48 * n * n);
        let half = |two: &[u8]| half::f16::from_le_bytes([two[0], two[1]]).to_f32();
        let texels = data.chunks(8).map(|texel| Vec3::new(half(texel), half(&texel[2..]), half(&texel[4..])));
        Mip { n, texels: texels.collect() }
    };
    reader.levels().enumerate().map(level).collect()
}

/// The web modules' `probeLookUp`: (-x, y, z), as three.js and PlayCanvas do and Babylon.js does in its mirrored world.
pub fn web(out: &Path, probe: &str) -> Shown {
    let mip = mips(&out.join(format!("{probe}/specular.ktx2"))).remove(0);
    Box::new(move |d| mip.at(DVec3::new(-d.x, d.y, d.z)))
}

/// A probe of the plugin's source.
struct LightProbe {
    translation: DVec3,
    scale: DVec3,
    falloff: DVec3,
    half_extents: DVec3,
}

fn light_probe(out: &Path, probe: &str) -> LightProbe {
    let source = std::fs::read_to_string(out.join("src/splatprobe.rs")).unwrap();
    let (_, record) = source.split_once(&format!("id: \"{probe}\"")).unwrap();
    let vector = |field: &str| {
        let (_, rest) = record.split_once(&format!("{field}: [")).unwrap();
        let numbers: Vec<f64> = rest.split(']').next().unwrap().split(", ").map(|n| n.parse().unwrap()).collect();
        DVec3::from_slice(&numbers)
    };
    LightProbe {
        translation: vector("translation"),
        scale: vector("scale"),
        falloff: vector("falloff"),
        half_extents: vector("parallax_half_extents"),
    }
}

impl LightProbe {
    /// `compute_cubemap_sample_dir` of bevy_pbr 0.19's environment_map.wgsl, for a ray from inside the box; before z is
    /// negated.
    fn sample_direction(&self, origin: DVec3, direction: DVec3) -> DVec3 {
        let (origin, direction) = ((origin - self.translation) / self.scale, direction / self.scale);
        let ahead = |bounds: DVec3| ((bounds - origin) / direction).map(|t| if t >= 0.0 { t } else { f64::MAX });
        let t = ahead(-self.half_extents).min(ahead(self.half_extents)).min_element();
        origin + direction * t
    }
}

/// Look-ups in the first mip as Bevy's sampler makes them, linear: z of the direction is negated for the cube map.
fn bevy_sampler(out: &Path, probe: &str) -> Sampler {
    let mip = mips(&out.join(format!("assets/splatprobe/{probe}/specular.ktx2"))).remove(0);
    Sampler::new(&RgbCubemap::from_fn(mip.n as u32, |d| mip.at(d * DVec3::new(1.0, 1.0, -1.0))))
}

/// What Bevy shows from the point of capture.
pub fn bevy(out: &Path, probe: &str) -> Shown {
    let (light_probe, specular) = (light_probe(out, probe), bevy_sampler(out, probe));
    let manifest = json(&out.with_file_name("bake").join("manifest.json"));
    let record = manifest["probes"].as_array().unwrap().iter().find(|record| record["id"] == *probe).unwrap();
    let taken_at = DVec3::from_array([0, 1, 2].map(|axis| record["position"][axis].as_f64().unwrap()));
    Box::new(move |d| specular.radiance(light_probe.sample_direction(taken_at, d).as_vec3()))
}

/// Captured away from the middle of a box that is no cube.
fn off_centre() -> Baked {
    Baked::with(|job| {
        job.placement.grid = None;
        job.placement.probes = vec![[1.3, 1.7, -0.4], [3.9, 0.8, 1.1]];
        job.face_size = 2 * SIZE;
    })
}

#[test]
fn bevy_corrects_exactly_from_everywhere_in_a_box_that_is_no_cube() {
    let baked = off_centre();
    let out = baked.export("bevy");
    for probe in &baked.manifest.probes {
        let (position, influence) = (DVec3::from(probe.position), &probe.influence);
        assert_eq!((probe.proxy.min, probe.proxy.max), (influence.min.into(), influence.max.into()));
        let (light_probe, specular) = (light_probe(&out, &probe.id), bevy_sampler(&out, &probe.id));
        let (mut largest, mut clear, mut count) = (0.0_f64, 0, 0);
        for (i, direction) in sphere().enumerate().step_by(7) {
            let share = DVec3::new(0.1, 0.2, 0.3) + 0.6 * DVec3::splat((i as f64 * 0.618).fract());
            let origin = probe.proxy.min + (probe.proxy.max - probe.proxy.min) * share;
            let expected =
                splatprobe::place::interpolate::parallax_corrected(position, &probe.proxy, origin, direction);
            let found = specular.radiance(light_probe.sample_direction(origin, direction).as_vec3());
            // Where a mark and what is beside it are mixed, the texel says less of its direction.
            let k = factor(found, expected);
            if [1.0, f64::from(Calibration::MARK)].into_iter().any(|pure| (k / pure - 1.0).abs() < 0.1) {
                largest = largest.max((found.as_dvec3() / k * 2.0 - 1.0).angle_between(expected));
                clear += 1;
            }
            count += 1;
        }
        let texel = 2.0 / f64::from(2 * SIZE);
        println!("{}: {:.2} texels at most, {clear} of {count}", probe.id, largest / texel);
        // A texel of the scaled cube covers up to the ratio of the box's edges more of what the capture saw.
        let size = light_probe.scale;
        assert!(largest < texel * size.max_element() / size.min_element(), "{}: {}", probe.id, largest / texel);
        assert!(4 * clear > 3 * count, "{}: {clear} of {count} are clear", probe.id);
    }
}

#[test]
fn bevys_weights_rise_over_the_blend_distance() {
    let baked = Baked::new();
    let out = baked.export("bevy");
    for probe in &baked.manifest.probes {
        let light_probe = light_probe(&out, &probe.id);
        // light_probe.wgsl: saturate((1 - 2 |p|) / (2 falloff)), the least of the axes.
        let weight = |position: DVec3| {
            let p = (position - light_probe.translation) / light_probe.scale;
            let falloff = light_probe.falloff.max(DVec3::splat(1e-4));
            ((1.0 - 2.0 * p.abs()) / (2.0 * falloff)).clamp(DVec3::ZERO, DVec3::ONE).min_element()
        };
        let influence = &probe.influence;
        let (min, max) = (DVec3::from(influence.min), DVec3::from(influence.max));
        let middle = (min + max) / 2.0;
        for axis in 0..3 {
            let blend = (influence.blend[2 * axis] + influence.blend[2 * axis + 1]) / 2.0;
            for share in [0.25, 0.5, 1.0] {
                let mut at = middle;
                at[axis] = min[axis] + blend * share;
                if blend > 0.0 {
                    assert!((weight(at) - share).abs() < 1e-9, "{}: axis {axis}, {share}", probe.id);
                }
            }
        }
        assert_eq!(weight(max + 0.01), 0.0);
    }
}

#[test]
fn the_last_mip_is_four_texels_wide_and_diffuse_light_has_one() {
    let baked = Baked::new();
    for (engine, specular) in [("three", "probe_000"), ("bevy", "assets/splatprobe/probe_000")] {
        let mips = mips(&baked.export(engine).join(specular).join("specular.ktx2"));
        assert!(mips.iter().map(|mip| mip.n).eq([32, 16, 8, 4]), "{engine}");
    }
    let diffuse = mips(&baked.folder.path().join("bevy/assets/splatprobe/probe_000/diffuse.ktx2"));
    assert_eq!((diffuse.len(), diffuse[0].n), (1, 32));
}
