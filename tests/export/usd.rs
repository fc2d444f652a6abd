//! OpenUSD's view: UsdLuxDomeLight's latlong is OpenEXR's (ImfEnvmap.h), about +Y.

use std::f64::consts::PI;
use std::path::Path;

use super::lookup::bilinear;
use super::{Baked, Shown, exr};

/// Longitude is atan2(x, z), from pi at the left to -pi; latitude asin(y) from the top.
pub fn shown(out: &Path, probe: &str) -> Shown {
    let (width, pixels) = exr(&out.join(format!("{probe}.exr")));
    Box::new(move |d| bilinear(width, &pixels, 0.5 - d.x.atan2(d.z) / (2.0 * PI), 0.5 - d.y.asin() / PI))
}

#[test]
fn the_layer_names_every_probe_with_its_place_and_its_variant() {
    let baked = Baked::with(|job| job.exposure = 1.0);
    let out = baked.export("usd");
    let layer = std::fs::read_to_string(out.join("probes.usda")).unwrap();
    assert!(layer.starts_with("#usda 1.0\n") && !layer.contains("{first}"));
    assert!(layer.contains("splatprobe:exposure = 1\n") && layer.contains("splatprobe:paperWhite = 2\n"), "{layer}");
    for record in &baked.manifest.probes {
        let [x, y, z] = record.position;
        assert!(layer.contains(&format!("def Xform \"{}\"", record.id)));
        assert!(layer.contains(&format!("double3 xformOp:translate = ({x}, {y}, {z})")), "{layer}");
        assert_eq!(layer.matches(&format!("@./{}.exr@", record.id)).count(), 2);
    }
}
