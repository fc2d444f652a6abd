//! Filament's view: KTX 1 as its specification says, look-ups by the world's direction, the shader's polynomial of
//! spherical harmonics (light_indirect.fs, Irradiance_SphericalHarmonics).

use std::path::Path;

use glam::{DVec3, Vec3};

use super::lookup::cube_texel;
use super::{Baked, SIZE, Shown, cosine_of_three_bands, json, sphere};

struct Ktx {
    metadata: Vec<(String, String)>,
    /// Edge and texels of six faces, per level.
    levels: Vec<(usize, Vec<u32>)>,
}

fn ktx(path: &Path) -> Ktx {
    let bytes = std::fs::read(path).unwrap();
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!(bytes[..12], [0xab, 0x4b, 0x54, 0x58, 0x20, 0x31, 0x31, 0xbb, 0x0d, 0x0a, 0x1a, 0x0a]);
    assert_eq!(word(12), 0x0403_0201);
    // cmgen: the same constant for the type and all formats.
    assert_eq!([word(16), word(20), word(24), word(28), word(32)], [0x8c3a, 1, 0x8c3a, 0x8c3a, 0x8c3a]);
    let (width, height, levels) = (word(36), word(40), word(56));
    assert_eq!([height, word(44), word(48), word(52)], [width, 0, 0, 6]);
    let mut at = 64;
    let end = at + word(60);
    let mut metadata = Vec::new();
    while at < end {
        let length = word(at);
        let mut parts = bytes[at + 4..at + 4 + length].split(|byte| *byte == 0);
        let mut text = || String::from_utf8(parts.next().unwrap().to_vec()).unwrap();
        metadata.push((text(), text()));
        at += 4 + length.next_multiple_of(4);
    }
    let read_level = |level: usize, at: &mut usize| {
        let n = width >> level;
        assert_eq!(word(*at), 4 * n * n, "imageSize is that of a face");
        let texels = (0..6 * n * n).map(|i| word(*at + 4 + 4 * i) as u32).collect();
        *at += 4 + 24 * n * n;
        (n, texels)
    };
    let levels = (0..levels).map(|level| read_level(level, &mut at)).collect();
    assert_eq!(at, bytes.len());
    Ktx { metadata, levels }
}

/// Unsigned 11 and 10 bit floats (OpenGL 4.6, sections 2.3.4.3 and 2.3.4.4).
fn colour(texel: u32) -> Vec3 {
    let short = |bits: u32, mantissa: i32| {
        let (exponent, share) =
            ((bits >> mantissa) as i32, (bits & ((1 << mantissa) - 1)) as f32 / (1 << mantissa) as f32);
        if exponent == 0 { share * 2f32.powi(-14) } else { (1.0 + share) * 2f32.powi(exponent - 15) }
    };
    Vec3::new(short(texel & 0x7ff, 6), short(texel >> 11 & 0x7ff, 6), short(texel >> 22, 5))
}

pub fn shown(out: &Path, probe: &str) -> Shown {
    let ibl = ktx(&out.join(format!("{probe}/{probe}_ibl.ktx")));
    let skybox = ktx(&out.join(format!("{probe}/{probe}_skybox.ktx")));
    assert!(skybox.levels.len() == 1 && skybox.levels[0] == ibl.levels[0]);
    let (n, texels) = ibl.levels[0].clone();
    Box::new(move |direction| {
        let (slot, x, y) = cube_texel(direction, n);
        colour(texels[(slot * n + y) * n + x])
    })
}

#[test]
fn the_shaders_polynomial_is_the_irradiance() {
    let baked = Baked::new();
    let out = baked.export("filament");
    let radiance = shown(&out, "probe_001");
    let metadata = ktx(&out.join("probe_001/probe_001_ibl.ktx")).metadata;
    let [(key, text)] = &metadata[..] else { panic!("{metadata:?}") };
    assert_eq!(key, "sh");
    let numbers: Vec<f64> = text.split_whitespace().map(|number| number.parse().unwrap()).collect();
    let sh: Vec<DVec3> = numbers.chunks(3).map(DVec3::from_slice).collect();
    assert_eq!(sh.len(), 9);
    for normal in sphere().step_by(997) {
        let n = normal;
        let found = sh[0]
            + sh[1] * n.y
            + sh[2] * n.z
            + sh[3] * n.x
            + sh[4] * (n.y * n.x)
            + sh[5] * (n.y * n.z)
            + sh[6] * (3.0 * n.z * n.z - 1.0)
            + sh[7] * (n.z * n.x)
            + sh[8] * (n.x * n.x - n.y * n.y);
        let (mut sum, mut count) = (DVec3::ZERO, 0.0);
        for d in sphere() {
            sum += radiance(d).as_dvec3() * cosine_of_three_bands(d.dot(normal));
            count += 1.0;
        }
        // Irradiance over pi.
        let expected = sum * (4.0 / count);
        assert!(((found - expected) / expected).abs().max_element() < 0.01, "{normal}: {found}, not {expected}");
    }
    let lines = std::fs::read_to_string(out.join("probe_001/sh.txt")).unwrap();
    let first = lines.lines().next().unwrap();
    assert!(first.starts_with('(') && first.ends_with("); // L00, irradiance, pre-scaled base"), "{first}");
    for (line, coefficient) in lines.lines().zip(&sh) {
        let numbers: Vec<f64> =
            line[1..].split(')').next().unwrap().split(',').map(|number| number.trim().parse().unwrap()).collect();
        assert!((DVec3::from_slice(&numbers) - *coefficient).length() < 1e-12, "{line}");
    }
}

#[test]
fn chains_are_as_long_as_cmgens_and_have_its_roughness() {
    let baked = Baked::with(|job| (job.face_size, job.exposure) = (2 * SIZE, 1.0));
    let out = baked.export("filament");
    let levels = ktx(&out.join("probe_000/probe_000_ibl.ktx")).levels;
    assert!(levels.iter().map(|(n, _)| *n).eq([64, 32, 16]));
    let document = json(&out.join("probes.json"));
    assert_eq!(
        (&document["colour"]["paperWhite"], &document["intensityAtDefaultExposure"]),
        (&2.0.into(), &38400.0.into())
    );
    for (level, roughness) in document["probes"][0]["roughness"].as_array().unwrap().iter().enumerate() {
        // lodToPerceptualRoughness(level / 2), the inverse of lod = r (2 - r).
        let r = roughness.as_f64().unwrap();
        assert!((r * (2.0 - r) - level as f64 / 2.0).abs() < 1e-12);
    }
}
