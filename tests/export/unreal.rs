//! Unreal's view: TextureCompressorModule.cpp for panoramas, ReflectionEnvironmentShared.ush for boxes.

use std::f64::consts::PI;
use std::path::Path;

use glam::{DVec3, Vec3};
use serde_json::Value;

use super::{Baked, Shown, json};

/// Left-handed, +Z up, centimetres (Unreal's glTF importer).
fn unreal_from_manifest(v: DVec3) -> DVec3 {
    DVec3::new(v.x, v.z, v.y)
}

pub fn vector(value: &Value) -> DVec3 {
    serde_json::from_value(value.clone()).unwrap()
}

/// A cube's texel for the world direction d is the panorama at X = (1 + atan2(d.x, -d.y) / pi) / 2, Y = acos(d.z) / pi, in
/// shares of its size, interpolated between whole pixels without half a pixel's shift.
pub fn shown(out: &Path, probe: &str) -> Shown {
    let image = image::open(out.join(format!("{probe}.hdr"))).unwrap().into_rgb32f();
    let (width, height) = image.dimensions();
    assert_eq!(width, 2 * height);
    Box::new(move |direction| {
        let d = unreal_from_manifest(direction);
        let x = (1.0 + d.x.atan2(-d.y) / PI) / 2.0 * f64::from(width);
        let y = d.z.acos() / PI * f64::from(height);
        let (fx, fy) = ((x - x.floor()) as f32, (y - y.floor()) as f32);
        let at =
            |dx: u32, dy: u32| Vec3::from(image.get_pixel((x as u32 + dx) % width, (y as u32 + dy).min(height - 1)).0);
        let row = |dy| at(0, dy) * (1.0 - fx) + at(1, dy) * fx;
        row(0) * (1.0 - fy) + row(1) * fy
    })
}

/// GetLookupVectorForBoxCapture's DistanceAlpha for a box of half size `scales` around `centre`.
fn box_alpha(at: DVec3, centre: DVec3, scales: DVec3, transition: f64) -> f64 {
    let shrunken = scales - 0.5 * transition;
    let distance = ((at - centre).abs() - shrunken).max(DVec3::ZERO).length();
    let t = (distance / (0.7 * transition)).clamp(0.0, 1.0);
    1.0 - t * t * (3.0 - 2.0 * t)
}

#[test]
fn box_captures_are_full_where_the_manifest_is_and_end_at_its_faces() {
    let baked = Baked::new();
    let document = json(&baked.export("unreal").join("probes.json"));
    for (probe, record) in document["probes"].as_array().unwrap().iter().zip(&baked.manifest.probes) {
        assert_eq!(vector(&probe["position"]), unreal_from_manifest(record.position.into()) * 100.0);
        let (centre, scales) = (vector(&probe["box"]["centre"]), vector(&probe["box"]["halfSize"]));
        let transition = probe["box"]["transitionDistance"].as_f64().unwrap();
        let (min, max) = (DVec3::from(record.influence.min), DVec3::from(record.influence.max));
        let blend = record.influence.blend;
        // Along each axis, from the middle through both faces: 1 up to the blend distance, 0 where the greatest of the
        // distances ends.
        let widest = blend.iter().copied().fold(0.0, f64::max);
        for axis in 0..3 {
            for i in -140..=140 {
                let mut at = (min + max) / 2.0;
                let share = f64::from(i) / 100.0;
                at[axis] += share * (max[axis] - min[axis]) / 2.0;
                let low = share < 0.0;
                let depth = if low { at[axis] - min[axis] } else { max[axis] - at[axis] };
                let blend = blend[2 * axis + usize::from(low)];
                let alpha = box_alpha(unreal_from_manifest(at) * 100.0, centre, scales, transition);
                if depth >= blend + 1e-9 {
                    assert!(alpha > 1.0 - 1e-9, "{at}: {alpha}");
                } else if depth < blend - widest - 1e-9 {
                    assert!(alpha < 1e-9, "{at}: {alpha}");
                }
            }
        }
    }
}

#[test]
fn probes_in_larger_rooms_are_spheres_that_hold_their_influence() {
    let baked = Baked::new();
    baked.change_manifest(|manifest| manifest["probes"][0]["proxy"]["max"][0] = 5.0.into());
    let document = json(&baked.export("unreal").join("probes.json"));
    let probe = &document["probes"][0];
    assert!(probe.get("box").is_none());
    let radius = probe["sphere"]["radius"].as_f64().unwrap();
    let record = &baked.manifest.probes[0];
    let farthest = (DVec3::from(record.influence.max) - DVec3::from(record.position))
        .abs()
        .max((DVec3::from(record.influence.min) - DVec3::from(record.position)).abs());
    assert!((radius - 100.0 * farthest.length()).abs() < 1e-6, "{radius}");
    assert!(document["probes"][1].get("box").is_some());
}

#[test]
fn exposure_and_paper_white_pass_through() {
    let document = json(&Baked::with(|job| job.exposure = -2.0).export("unreal").join("probes.json"));
    assert_eq!((&document["colour"]["exposure"], &document["colour"]["paperWhite"]), (&(-2.0).into(), &0.25.into()));
}
