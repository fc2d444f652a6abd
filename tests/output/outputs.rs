//! Every format of a probe holds the same light in the directions that it says, read by another reader where there is one.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::cli::splatprobe;
use glam::{DVec3, Vec3};
use serde_json::Value;
use splatprobe::bake::Calibration;
use splatprobe::encode::exr::{Image, read_exr};
use splatprobe::encode::{ktx2, latlong, rgbd};
use splatprobe::filter::{RgbCubemap, ShRadiance};
use splatprobe::manifest;
use splatprobe::trace::Face;

const SIZE: usize = 32;

const ALL: &str = "strip,faces,mips,irradiance,latlong,latlong-hdr,envmap,ktx2,rgbd,moments";

/// A bake of one probe; its folder and its manifest.
fn bake(folder: &Path, arguments: &str) -> (PathBuf, Value) {
    let output = splatprobe(folder, &format!("bake -o out --face-size {SIZE} --progress none {arguments}"));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let path = folder.join("out/manifest.json");
    let problems = manifest::verify(&path).unwrap();
    assert!(problems.is_empty(), "{problems:?}");
    let manifest: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    (folder.join("out/probe_000"), manifest)
}

const CALIBRATION: &str = "--calibration --bounds -1,-1,-1,1,1,1 --grid 1,1,1";

fn pixels(image: &Image) -> Vec<Vec3> {
    let channel = |name: &str| &image.channels[name];
    (0..image.width * image.height).map(|i| Vec3::new(channel("R")[i], channel("G")[i], channel("B")[i])).collect()
}

fn strip_texel(face: Face, size: usize, x: usize, y: usize) -> usize {
    (face as usize * size + y) * size + x
}

/// Texels of a face with the directions of their centres, or of an edge-inclusive one.
fn directions(size: usize, on_edges: bool) -> impl Iterator<Item = (Face, usize, usize, DVec3)> {
    let point = move |i: usize| if on_edges { i as f64 / (size - 1) as f64 } else { (i as f64 + 0.5) / size as f64 };
    let texels = move |face| (0..size * size).map(move |i| (face, i % size, i / size));
    let faces = Face::ALL.into_iter().flat_map(texels);
    faces.map(move |(face, x, y)| (face, x, y, face.direction(1, point(x), point(y)).normalize()))
}

/// Angle between `expected` and the direction that a coded radiance stands for, whatever its brightness: with an unknown
/// factor k, radiance is k (d + 1) / 2 of a unit vector for two values of k, of which the better is taken. So a mean of
/// marked and unmarked texels can be read too.
fn angle(radiance: Vec3, expected: DVec3) -> f64 {
    let c = radiance.as_dvec3();
    let (sum, square) = (c.element_sum(), c.length_squared());
    let root = (sum * sum - 2.0 * square).max(0.0).sqrt();
    let decoded = [-1.0, 1.0].map(|sign| (c * ((sum + sign * root) / square) - 1.0).normalize());
    decoded.map(|d| d.angle_between(expected)).into_iter().fold(f64::INFINITY, f64::min)
}

/// The largest angle that neighbouring texels of a face of `size` are apart.
fn texel_angle(size: usize) -> f64 {
    2.0 / size as f64
}

#[test]
fn the_calibration_reads_back_within_a_texel_from_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let (probe, _) = bake(folder.path(), &format!("{CALIBRATION} --outputs {ALL} --pixel float"));
    let check = |name: &str, angle: f64, most: f64| assert!(angle <= most, "{name}: {angle} rad, a texel is {most}");
    let strip = pixels(&read_exr(&probe.join("radiance.exr")).unwrap());
    for (face, x, y, d) in directions(SIZE, false) {
        // Of its own texels, marks included, the code is exact.
        let error = Calibration::direction(strip[strip_texel(face, SIZE, x, y)]).angle_between(d);
        check("strip", error, 1e-5);
    }
    for (i, short) in ["px", "nx", "py", "ny", "pz", "nz"].into_iter().enumerate() {
        let face = pixels(&read_exr(&probe.join(format!("radiance_{short}.exr"))).unwrap());
        assert!(face == strip[i * SIZE * SIZE..][..SIZE * SIZE], "{short}");
    }
    let envmap = pixels(&read_exr(&probe.join("envmap.exr")).unwrap());
    for (face, x, y, d) in directions(SIZE, true) {
        check("envmap", angle(envmap[strip_texel(face, SIZE, x, y)], d), texel_angle(SIZE));
    }
    let exr = pixels(&read_exr(&probe.join("latlong.exr")).unwrap());
    let hdr = image::open(probe.join("latlong.hdr")).unwrap().into_rgb32f();
    let width = 4 * SIZE;
    assert_eq!(hdr.dimensions(), (width as u32, width as u32 / 2));
    for (i, (exr, hdr)) in exr.iter().zip(hdr.pixels()).enumerate() {
        let place = [(i % width) as f64 + 0.5, (i / width) as f64 + 0.5].map(|at| at / width as f64);
        let d = latlong::direction([place[0], 2.0 * place[1]]);
        check("latlong.exr", angle(*exr, d), texel_angle(SIZE));
        let difference = (Vec3::from(hdr.0) - exr).abs().max_element();
        assert!(difference <= exr.max_element() / 255.0, "latlong.hdr: {hdr:?} is not {exr}");
    }
    let rgbd = image::open(probe.join("rgbd_0.png")).unwrap().into_rgba8();
    for (stored, expected) in rgbd.pixels().zip(&strip) {
        let error = (rgbd::decode(*stored) - expected).abs().max_element();
        // Half a step of eight bits, whose slope at the top is 2.2.
        assert!(error <= 1.2 / 255.0 * expected.max_element().max(1.0), "rgbd: {error} at {expected}");
    }
}

/// Levels of a KTX2 file, as another crate reads the container.
fn ktx2_levels(path: &Path) -> Vec<Vec<u8>> {
    let bytes = std::fs::read(path).unwrap();
    let reader = ::ktx2::Reader::new(&bytes[..]).unwrap();
    let inflate = |level: ::ktx2::Level<'_>| {
        let mut inflated = Vec::new();
        ruzstd::decoding::StreamingDecoder::new(level.data).unwrap().read_to_end(&mut inflated).unwrap();
        inflated
    };
    reader.levels().map(inflate).collect()
}

/// Index of the texel that a graphics API's cube map is looked up at: OpenGL 4.6, table 8.19.
fn api_texel(d: DVec3, size: usize) -> usize {
    let a = d.abs();
    let (slot, s, t, depth) = if a.x >= a.y && a.x >= a.z {
        if d.x > 0.0 { (0, -d.z, -d.y, a.x) } else { (1, d.z, -d.y, a.x) }
    } else if a.y >= a.z {
        if d.y > 0.0 { (2, d.x, d.z, a.y) } else { (3, d.x, -d.z, a.y) }
    } else if d.z > 0.0 {
        (4, d.x, -d.y, a.z)
    } else {
        (5, -d.x, -d.y, a.z)
    };
    let texel = |at: f64| (((at / depth + 1.0) / 2.0 * size as f64) as usize).min(size - 1);
    (slot * size + texel(t)) * size + texel(s)
}

#[test]
fn an_api_finds_every_direction_of_the_calibration_in_ktx2_where_it_looks() {
    for encoding in ["rgba16f", "rgb9e5"] {
        let folder = tempfile::tempdir().unwrap();
        let (probe, manifest) = bake(folder.path(), &format!("{CALIBRATION} --outputs ktx2 --hdr-encoding {encoding}"));
        let levels = ktx2_levels(&probe.join("specular.ktx2"));
        let mips = &manifest["probes"][0]["files"][0]["mips"];
        let sizes = [32, 16, 8, 4, 2, 1];
        assert_eq!((levels.len(), mips.as_array().unwrap().len()), (6, 6));
        for ((level, mip), (i, size)) in levels.iter().zip(mips.as_array().unwrap()).zip(sizes.into_iter().enumerate())
        {
            let texel_bytes = if encoding == "rgb9e5" { 4 } else { 8 };
            assert_eq!(level.len(), 6 * size * size * texel_bytes);
            assert_eq!((mip["width"].as_u64(), mip["roughness"].as_f64()), (Some(size as u64), Some(i as f64 / 5.0)));
        }
        for (_, _, _, d) in directions(SIZE, false) {
            let at = api_texel(d, SIZE);
            let colour = if encoding == "rgb9e5" {
                let bytes = levels[0][4 * at..][..4].try_into().unwrap();
                ktx2::from_rgb9e5(u32::from_le_bytes(bytes))
            } else {
                let half = |k: usize| {
                    half::f16::from_le_bytes([levels[0][8 * at + 2 * k], levels[0][8 * at + 2 * k + 1]]).to_f32()
                };
                Vec3::new(half(0), half(1), half(2))
            };
            let expected = Calibration::radiance(d);
            assert!((colour - expected).abs().max_element() <= expected.max_element() / 511.0, "{encoding} {d}");
        }
    }
}

/// Spherical harmonics of an image whose pixels have directions and solid angles.
fn project(pixels: impl Iterator<Item = (Vec3, DVec3, f64)>) -> [DVec3; 4] {
    let mut sums = [DVec3::ZERO; 4];
    for (colour, d, angle) in pixels {
        let basis = [0.282_094_79, 0.488_602_51 * d.y, 0.488_602_51 * d.z, 0.488_602_51 * d.x];
        sums.iter_mut().zip(basis).for_each(|(sum, value)| *sum += colour.as_dvec3() * value * angle);
    }
    sums
}

#[test]
fn all_formats_of_a_probe_hold_the_same_light_within_half_a_percent() {
    let folder = tempfile::tempdir().unwrap();
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/demo/demo.json");
    let line = format!("{} --outputs {ALL} --samples 2 --exposure 1 --sh-degree 3 --sh-window", demo.display());
    let (probe, manifest) = bake(folder.path(), &line);
    let strip = pixels(&read_exr(&probe.join("radiance.exr")).unwrap());
    let cubemap = RgbCubemap::new(SIZE as u32, strip.clone()).unwrap();
    let sh = ShRadiance::project(&cubemap, 3);
    let mean = sh.coefficients()[0];
    let agree = |name: &str, found: &[DVec3]| {
        for (found, expected) in found.iter().zip(sh.coefficients()) {
            let error = ((found - expected) / mean).abs().max_element();
            assert!(error < 0.005, "{name}: {found} is not {expected}: {error}");
        }
    };
    let stored = &manifest["probes"][0]["sh"];
    let coefficients = |value: &Value| -> Vec<DVec3> {
        let colour = |c: &Value| DVec3::from_array([0, 1, 2].map(|k| c[k].as_f64().unwrap()));
        value["coefficients"].as_array().unwrap().iter().map(colour).collect()
    };
    assert_eq!(coefficients(stored).len(), 16);
    agree("manifest", &coefficients(stored));
    assert_eq!(coefficients(&stored["windowed"])[0], coefficients(stored)[0]);
    assert_eq!(
        (manifest["colour"]["exposure"].as_f64(), manifest["colour"]["paperWhite"].as_f64()),
        (Some(1.0), Some(2.0))
    );

    let width = 4 * SIZE;
    let place = |i: usize| [((i % width) as f64 + 0.5) / width as f64, 2.0 * ((i / width) as f64 + 0.5) / width as f64];
    let pixel_angle = (2.0 * std::f64::consts::PI / width as f64).powi(2);
    let of_latlong = |pixels: Vec<Vec3>| {
        project(pixels.into_iter().enumerate().map(|(i, colour)| {
            let d = latlong::direction(place(i));
            (colour, d, pixel_angle * (1.0 - d.y * d.y).sqrt())
        }))
    };
    agree("latlong.exr", &of_latlong(pixels(&read_exr(&probe.join("latlong.exr")).unwrap())));
    let hdr = image::open(probe.join("latlong.hdr")).unwrap().into_rgb32f();
    agree("latlong.hdr", &of_latlong(hdr.pixels().map(|pixel| Vec3::from(pixel.0)).collect()));
    // Texels on edges and corners are shared by faces: their solid angles are those within their face.
    let envmap = pixels(&read_exr(&probe.join("envmap.exr")).unwrap());
    let inside = |i: usize| if i == 0 || i == SIZE - 1 { 0.5 } else { 1.0 };
    agree(
        "envmap.exr",
        &project(directions(SIZE, true).map(|(face, x, y, d)| {
            let cosine = d.abs().max_element();
            let angle = (2.0 / (SIZE - 1) as f64).powi(2) * cosine.powi(3) * inside(x) * inside(y);
            (envmap[strip_texel(face, SIZE, x, y)], d, angle)
        })),
    );
    // A part that is prefiltered at roughness 0 is the strip; blur keeps the mean.
    let mips = read_exr(&probe.join("specular.exr")).unwrap();
    assert!(pixels(&mips) == strip);
    let irradiance = pixels(&read_exr(&probe.join("irradiance.exr")).unwrap());
    let irradiance = ShRadiance::project(&RgbCubemap::new(SIZE as u32, irradiance).unwrap(), 0);
    agree("irradiance.exr", irradiance.coefficients());
    // Distances: a room's walls are metres away, and a mean square is never below the square of the mean.
    let moments = read_exr(&probe.join("moments.exr")).unwrap();
    for (mean, mean_square) in moments.channels["R"].iter().zip(&moments.channels["G"]) {
        assert!(*mean > 0.1 && *mean_square >= mean * mean * 0.999, "{mean} {mean_square}");
    }
}

/// OpenEXR's own tools (Debian: `apt-get install openexr`). What the converter makes of it is checked in
/// `tests/oracles/formats.sh`: it copies a header attribute that this crate's reader then takes for damage.
#[test]
fn openexr_knows_the_envmap_and_no_other_file_as_cube_faces() {
    let folder = tempfile::tempdir().unwrap();
    let (probe, _) = bake(folder.path(), &format!("{CALIBRATION} --outputs strip,mips,envmap"));
    for (name, is_envmap) in [("envmap.exr", true), ("radiance.exr", false), ("specular.exr", false)] {
        match Command::new("exrheader").arg(probe.join(name)).output() {
            Ok(output) => {
                assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
                assert_eq!(String::from_utf8_lossy(&output.stdout).contains("cube-face map"), is_envmap, "{name}");
            }
            Err(error) => return println!("skipped: exrheader: {error}"),
        }
    }
}

#[test]
fn a_manifest_lists_the_files_that_are_there_and_no_others() {
    let folder = tempfile::tempdir().unwrap();
    let (probe, manifest) = bake(folder.path(), &format!("{CALIBRATION} --outputs {ALL}"));
    let files = manifest["probes"][0]["files"].as_array().unwrap().clone();
    let listed: BTreeMap<String, Value> =
        files.into_iter().map(|file| (file["path"].as_str().unwrap().replace("probe_000/", ""), file)).collect();
    let mut found: Vec<String> =
        std::fs::read_dir(&probe).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    found.retain(|name| name != "preview.png");
    found.sort();
    assert!(found.iter().eq(listed.keys()), "{found:?} {:?}", listed.keys());
    assert_eq!(listed["envmap.exr"]["texelSampling"], "edge");
    assert_eq!(listed["latlong.hdr"]["pixel"], "rgbe");
    assert_eq!(listed["radiance_ny.exr"]["face"], "-Y");
    assert_eq!(listed["specular.exr"]["mips"][1]["height"], 96);
    // 1.5 diagonals of a box 2 m wide.
    assert!((listed["moments.exr"]["maxDistance"].as_f64().unwrap() - 3.0 * 3_f64.sqrt()).abs() < 1e-9);

    // A smaller bake removes what it does not have.
    bake(folder.path(), CALIBRATION);
    let left = std::fs::read_dir(&probe).unwrap().count();
    assert_eq!(left, 2);
}
