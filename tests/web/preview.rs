//! The preview page as a file; what it shows is looked at in a browser by tests/oracles/web.sh.

use std::path::Path;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use glam::{DVec3, Vec3};
use serde_json::Value;
use splatprobe::Error;
use splatprobe::bake::Calibration;
use splatprobe::encode::ktx2::from_rgb9e5;
use splatprobe::filter::{Prefilter, RgbCubemap};
use splatprobe::job::RoughnessCurve;
use splatprobe::preview;

use super::calibration;

fn page(bake: &Path) -> String {
    let out = bake.with_extension("html");
    preview::write(bake, &out).unwrap();
    std::fs::read_to_string(out).unwrap()
}

/// What the page's script parses.
fn data(page: &str) -> Value {
    let (_, rest) = page.split_once(r#"<script id="data" type="application/json">"#).unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

fn change_manifest(bake: &Path, change: impl FnOnce(&mut Value)) {
    let path = bake.join("manifest.json");
    let mut manifest = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    change(&mut manifest);
    std::fs::write(&path, manifest.to_string()).unwrap();
}

#[test]
fn the_page_needs_no_other_file() {
    let folder = tempfile::tempdir().unwrap();
    let page = page(&calibration(folder.path(), 16));
    for reference in ["http:", "https:", "src=", "href=", "url(", "@import", "import ", "import(", "fetch("] {
        assert!(!page.contains(reference), "{reference}");
    }
}

/// Colours of all mips of a probe, each six slots.
fn texels(data: &Value, probe: usize) -> Vec<Vec3> {
    let bytes = BASE64_STANDARD.decode(data["texels"][probe].as_str().unwrap()).unwrap();
    bytes.chunks_exact(4).map(|word| from_rgb9e5(u32::from_le_bytes(word.try_into().unwrap()))).collect()
}

/// The slots hold what is seen along (-x, y, z) of the vector that OpenGL 4.6, table 8.19, has for a texel.
fn direction(slot: usize, n: usize, x: usize, y: usize) -> DVec3 {
    let [s, t] = [x, y].map(|at| 2.0 * (at as f64 + 0.5) / n as f64 - 1.0);
    let vector = match slot {
        0 => [1.0, -t, -s],
        1 => [-1.0, -t, s],
        2 => [s, 1.0, t],
        3 => [s, -1.0, -t],
        4 => [s, -t, 1.0],
        _ => [-s, -t, -1.0],
    };
    (DVec3::from(vector) * DVec3::new(-1.0, 1.0, 1.0)).normalize()
}

#[test]
fn the_page_holds_every_texel_to_nine_bits() {
    let folder = tempfile::tempdir().unwrap();
    let data = data(&page(&calibration(folder.path(), 32)));
    assert_eq!((&data["faceSize"], &data["bakedFaceSize"]), (&32.into(), &32.into()));
    for probe in 0..2 {
        let texels = texels(&data, probe);
        assert_eq!(texels.len(), 6 * (32 * 32 + 16 * 16 + 8 * 8 + 4 * 4));
        for (i, found) in texels[..6 * 32 * 32].iter().enumerate() {
            let expected = Calibration::radiance(direction(i / 1024, 32, i % 32, i / 32 % 32));
            // Nine bits of the page after the eleven of the bake's half floats.
            let tolerance = expected.max_element() * (1.0 / 511.0 + 1.0 / 2048.0);
            assert!((found - expected).abs().max_element() <= tolerance, "{i}: {found} {expected}");
        }
        assert!((data["brightest"][probe].as_f64().unwrap() - 8.0).abs() < 0.1);
    }
}

#[test]
fn rough_balls_have_the_filters_mips() {
    let folder = tempfile::tempdir().unwrap();
    let data = data(&page(&calibration(folder.path(), 32)));
    let roughness: Vec<f64> =
        data["mips"].as_array().unwrap().iter().map(|mip| mip["roughness"].as_f64().unwrap()).collect();
    assert_eq!(roughness, [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0]);
    let source = RgbCubemap::from_fn(32, Calibration::radiance);
    let chain = Prefilter::new(source).chain(RoughnessCurve::Linear, 4);
    // The sum over a mip does not hang on the order of its slots.
    let mean = |texels: &[Vec3]| texels.iter().sum::<Vec3>() / texels.len() as f32;
    let texels = texels(&data, 0);
    let found = mean(&texels[texels.len() - 96..]);
    // Half floats of the bake and nine bits here.
    assert!((found / mean(chain[3].cubemap.texels()) - 1.0).abs().max_element() < 3e-3);
}

#[test]
fn larger_faces_than_a_page_shows_are_reduced_and_it_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let page = page(&calibration(folder.path(), 300));
    let data = data(&page);
    assert_eq!((&data["faceSize"], &data["bakedFaceSize"]), (&256.into(), &300.into()));
    assert!(page.contains("reduced from ${data.bakedFaceSize} to ${data.faceSize} px"));
}

#[test]
fn names_stay_text() {
    let folder = tempfile::tempdir().unwrap();
    let bake = calibration(folder.path(), 8);
    let plain = page(&bake);
    let name = "</script><script>alert(1)</script><!-- & \"'.ply";
    change_manifest(&bake, |manifest| {
        manifest["inputs"] = serde_json::json!([{ "path": name, "bytes": 1, "blake3": "0".repeat(64), "report": {} }]);
    });
    let page = page(&bake);
    for markup in ["<script", "</script", "<!--"] {
        assert_eq!(page.matches(markup).count(), plain.matches(markup).count(), "{markup}");
    }
    assert_eq!(data(&page)["manifest"]["inputs"][0]["path"], name);
    // Text is put into the page as text only.
    assert!(!page.contains("innerHTML") && !page.contains("document.write"));
}

#[test]
fn a_bake_that_is_not_what_its_manifest_says_is_an_error_and_no_page() {
    type Fault = (&'static str, fn(&Path));
    let faults: [Fault; 5] = [
        ("cannot be read", |bake| std::fs::remove_file(bake.join("manifest.json")).unwrap()),
        ("probe_001/radiance.exr: cannot be read", |bake| {
            std::fs::remove_file(bake.join("probe_001/radiance.exr")).unwrap();
        }),
        ("BLAKE3 is", |bake| {
            std::fs::copy(bake.join("probe_001/radiance.exr"), bake.join("probe_000/radiance.exr")).unwrap();
            change_manifest(bake, |manifest| {
                manifest["probes"][0]["files"][0]["blake3"] = "0".repeat(64).into();
            });
        }),
        ("manifest format 2", |bake| change_manifest(bake, |manifest| manifest["formatVersion"] = 2.into())),
        ("only a placement", |bake| {
            change_manifest(bake, |manifest| {
                manifest["probes"].as_array_mut().unwrap().iter_mut().for_each(|probe| probe["files"] = [(); 0].into());
            });
        }),
    ];
    for (expected, spoil) in faults {
        let folder = tempfile::tempdir().unwrap();
        let bake = calibration(folder.path(), 8);
        spoil(&bake);
        let out = folder.path().join("page.html");
        let error = preview::write(&bake, &out).unwrap_err();
        assert!(error.to_string().contains(expected), "{error} is not about '{expected}'");
        assert_eq!(error.exit_code(), 2);
        assert!(!out.exists());
    }
    let folder = tempfile::tempdir().unwrap();
    let bake = calibration(folder.path(), 8);
    let error = preview::write(&bake, &folder.path().join("absent/page.html")).unwrap_err();
    assert!(matches!(error, Error::Write { .. }), "{error}");
}
