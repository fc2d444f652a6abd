//! Blender's view: Cycles' direction_to_equirectangular; light probes as boxes around their objects.

use std::f64::consts::PI;
use std::path::Path;

use glam::DVec3;

use super::lookup::bilinear;
use super::unreal::vector;
use super::{Baked, Shown, exr, json};

/// Right-handed, +Z up.
fn blender_from_manifest(v: DVec3) -> DVec3 {
    DVec3::new(v.x, -v.z, v.y)
}

/// u = 1/2 - atan2(y, x) / 2 pi from the left, v = 1/2 - asin(z) / pi from the top.
pub fn shown(out: &Path, probe: &str) -> Shown {
    let (width, pixels) = exr(&out.join(format!("{probe}.exr")));
    Box::new(move |direction| {
        let d = blender_from_manifest(direction);
        bilinear(width, &pixels, 0.5 - d.y.atan2(d.x) / (2.0 * PI), 0.5 - d.z.asin() / PI)
    })
}

#[test]
fn light_probes_stand_where_the_bakes_do_and_reach_as_far() {
    let baked = Baked::with(|job| job.exposure = 1.0);
    let document = json(&baked.export("blender").join("probes.json"));
    assert_eq!(document["colour"]["paperWhite"], 2.0);
    for (probe, record) in document["probes"].as_array().unwrap().iter().zip(&baked.manifest.probes) {
        let position = vector(&probe["position"]);
        assert_eq!(position, blender_from_manifest(record.position.into()));
        let half = vector(&probe["halfSize"]);
        for corner in [record.influence.min, record.influence.max] {
            let distance = (blender_from_manifest(corner.into()) - position).abs();
            assert!((distance - half).max_element() < 1e-9, "{probe}");
        }
        let falloff = probe["falloff"].as_f64().unwrap();
        assert!((0.0..=1.0).contains(&falloff));
    }
}
