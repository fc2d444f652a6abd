//! Unity's view: Cubemap and ReflectionProbe as documented, URP's GlobalIllumination.hlsl, HDRP's EnvLight.

use std::path::Path;

use glam::{DVec3, Vec3};
use serde_json::Value;
use splatprobe::place::interpolate::parallax_corrected;

use super::lookup::cube_texel;
use super::{Baked, Shown, exr, json, sphere};

/// Left-handed, +Y up: glTF importers negate x.
fn unity_from_manifest(v: DVec3) -> DVec3 {
    DVec3::new(-v.x, v.y, v.z)
}

fn vector(value: &Value) -> DVec3 {
    DVec3::new(value["x"].as_f64().unwrap(), value["y"].as_f64().unwrap(), value["z"].as_f64().unwrap())
}

/// Importer, "6 Frames Layout": +x -x +y -y +z -z side by side, rows from the top; texCUBE by the world direction.
pub fn shown(out: &Path, probe: &str) -> Shown {
    let (width, pixels) = exr(&out.join(format!("{probe}.exr")));
    let n = width / 6;
    assert_eq!(pixels.len(), 6 * n * n);
    Box::new(move |direction| {
        let (slot, x, y) = cube_texel(unity_from_manifest(direction), n);
        pixels[y * width + slot * n + x]
    })
}

/// URP, GlobalIllumination.hlsl, CalculateProbeWeight: the least distance to a face of the box over the blend distance.
fn urp_weight(at: DVec3, min: DVec3, max: DVec3, blend: f64) -> f64 {
    ((at - min).min(max - at) / blend).min_element().clamp(0.0, 1.0)
}

/// HDRP, EnvLightIntersection: the same per face.
fn hdrp_weight(at: DVec3, min: DVec3, max: DVec3, positive: DVec3, negative: DVec3) -> f64 {
    // A blend distance of 0 ends at once; the shader divides by at least an epsilon.
    let share = |distance: DVec3, blend: DVec3| (distance / blend.max(DVec3::splat(1e-6))).min_element();
    share(max - at, positive).min(share(at - min, negative)).clamp(0.0, 1.0)
}

#[test]
fn influence_boxes_weigh_in_unity_as_the_manifest_says() {
    let baked = Baked::new();
    let document = json(&baked.export("unity").join("probes.json"));
    for (probe, record) in document["probes"].as_array().unwrap().iter().zip(&baked.manifest.probes) {
        let position = vector(&probe["position"]);
        assert_eq!(position, unity_from_manifest(record.position.into()));
        let (uniform, influence) = (&probe["box"], &probe["influence"]);
        let half = vector(&uniform["size"]) / 2.0;
        let centre = vector(&uniform["centre"]);
        let (half_hd, centre_hd) = (vector(&influence["size"]) / 2.0, vector(&influence["centre"]));
        let (min, max) = (DVec3::from(record.influence.min), DVec3::from(record.influence.max));
        for i in 0..4000 {
            // Never on a face.
            let share = DVec3::new(0.7548, 0.5698, 0.4302) * (f64::from(i) + 0.5);
            let at = min + (max - min) * share.fract();
            // The manifest: a ramp over each face's blend distance, inward; the least of them where engines take no product.
            let ramp = |distance: f64, blend: f64| if distance < blend { distance / blend } else { 1.0 };
            let expected = (0..3)
                .flat_map(|axis| {
                    let blend = &record.influence.blend;
                    [ramp(max[axis] - at[axis], blend[2 * axis]), ramp(at[axis] - min[axis], blend[2 * axis + 1])]
                })
                .fold(1.0, f64::min);
            let seen = unity_from_manifest(at);
            let (positive, negative) = (vector(&influence["blendPositive"]), vector(&influence["blendNegative"]));
            let weight = hdrp_weight(seen, centre_hd - half_hd, centre_hd + half_hd, positive, negative);
            assert!((weight - expected).abs() < 1e-5, "HDRP at {at}: {weight}, not {expected}");
            let blend = uniform["blendDistance"].as_f64().unwrap();
            let weight = urp_weight(seen, centre - half, centre + half, blend);
            // One distance for all faces: exact where the weight is 1, and never less than it should be.
            assert!(weight >= expected - 1e-9, "URP at {at}: {weight}, not {expected}");
            assert_eq!(weight > 1.0 - 1e-9, expected > 1.0 - 1e-9, "URP at {at}");
        }
    }
}

/// BoxProjectedCubemapDirection (URP) and IntersectBoxProxy with its caller (HDRP): where the ray from `at` leaves the box,
/// seen from where the probe was taken.
fn box_projected(at: DVec3, direction: DVec3, [min, max]: [DVec3; 2], taken_at: DVec3) -> DVec3 {
    let ahead = DVec3::select(direction.cmpgt(DVec3::ZERO), max, min);
    at + direction * ((ahead - at) / direction).min_element() - taken_at
}

#[test]
fn projections_on_boxes_are_those_of_the_manifest() {
    let baked = Baked::new();
    let document = json(&baked.export("unity").join("probes.json"));
    let (mut urp, mut unprojected, mut count) = (0.0_f64, 0.0_f64, 0);
    for (probe, record) in document["probes"].as_array().unwrap().iter().zip(&baked.manifest.probes) {
        let corners = |value: &Value| {
            let (centre, half) = (vector(&value["centre"]), vector(&value["size"]) / 2.0);
            [centre - half, centre + half]
        };
        let taken_at = vector(&probe["position"]);
        for (i, direction) in sphere().step_by(37).enumerate() {
            let share = (DVec3::new(0.7548, 0.5698, 0.4302) * (i as f64 + 0.5)).fract();
            let at = record.proxy.min + record.proxy.extent() * share;
            let expected = parallax_corrected(record.position.into(), &record.proxy, at, direction);
            let (at, seen) = (unity_from_manifest(at), unity_from_manifest(direction));
            let expected = unity_from_manifest(expected);
            let hdrp = box_projected(at, seen, corners(&probe["proxy"]), taken_at);
            assert!(hdrp.angle_between(expected) < 1e-6, "{at} {direction}");
            urp += box_projected(at, seen, corners(&probe["box"]), taken_at).angle_between(expected);
            unprojected += seen.angle_between(expected);
            count += 1;
        }
    }
    // URP's one box is larger than the proxy where the probe does not fade, here by 0.6 m at five of six faces of a room of
    // 2.5 m. That must still be much nearer to the truth than no projection.
    let mean = |sum: f64| (sum / f64::from(count)).to_degrees();
    println!("URP: {:.1} degrees in the mean, {:.1} without projection", mean(urp), mean(unprojected));
    assert!(urp < 0.6 * unprojected, "{} of {}", mean(urp), mean(unprojected));
}

#[test]
fn reflections_are_projected_only_where_the_proxy_is_the_influence_box() {
    let is_projected =
        |baked: &Baked| json(&baked.export("unity").join("probes.json"))["probes"][0]["box"]["isProjected"] == true;
    let baked = Baked::new();
    assert!(is_projected(&baked));
    // A room that reaches further than the box in which the probe is used.
    baked.change_manifest(|manifest| manifest["probes"][0]["proxy"]["max"][0] = 5.0.into());
    assert!(!is_projected(&baked));
}

#[test]
fn import_settings_stay_the_same_assets_when_the_bake_is_made_anew() {
    let meta = |baked: &Baked, probe: &str| {
        let text = std::fs::read_to_string(baked.export("unity").join(format!("{probe}.exr.meta"))).unwrap();
        // The importer's recipe: one texture of the shape "cube", found out by its size, convolved for gloss, with mips.
        for setting in ["textureShape: 2", "generateCubemap: 6", "cubemapConvolution: 1", "enableMipMap: 1"] {
            assert!(text.contains(setting), "{setting}");
        }
        let guid = text.lines().find_map(|line| line.strip_prefix("guid: ")).unwrap().to_owned();
        assert!(guid.len() == 32 && guid.bytes().all(|c| c.is_ascii_hexdigit()), "{guid}");
        guid
    };
    let first = meta(&Baked::new(), "probe_000");
    assert_eq!(first, meta(&Baked::with(|job| job.face_size = 16), "probe_000"));
    assert_ne!(first, meta(&Baked::new(), "probe_001"));
    assert_ne!(first, meta(&Baked::with(|job| job.placement.grid = Some([1, 1, 1])), "probe_000"));
}

#[test]
fn exposure_and_paper_white_pass_through() {
    let baked = Baked::with(|job| job.exposure = 1.5);
    let out = baked.export("unity");
    let document = json(&out.join("probes.json"));
    assert_eq!(document["exposure"], 1.5);
    assert!((document["paperWhite"].as_f64().unwrap() - 1.5f64.exp2()).abs() < 1e-12);
    let mean = |pixels: &[Vec3]| pixels.iter().sum::<Vec3>().element_sum();
    let unexposed = mean(&exr(&Baked::new().export("unity").join("probe_000.exr")).1);
    let ratio = mean(&exr(&out.join("probe_000.exr")).1) / unexposed;
    assert!((f64::from(ratio) / 1.5f64.exp2() - 1.0).abs() < 1e-3, "{ratio}");
}
