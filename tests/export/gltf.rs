//! EXT_lights_image_based as Babylon.js loads it: a left-handed world with x of glTF's negated, images upside down, RGBD,
//! irradiance with the Condon-Shortley phase.

use std::path::Path;

use glam::{DVec3, Vec3};
use serde_json::Value;

use super::lookup::cube_texel;
use super::{Baked, SIZE, Shown, cosine_of_three_bands, json, sphere};

/// Babylon.js' __root__ node mirrors glTF's x.
fn babylon_from_manifest(v: DVec3) -> DVec3 {
    DVec3::new(-v.x, v.y, v.z)
}

fn light(document: &Value, probe: &str) -> Value {
    let lights = document["extensions"]["EXT_lights_image_based"]["lights"].as_array().unwrap();
    lights.iter().find(|light| light["name"] == probe).unwrap().clone()
}

pub fn shown(out: &Path, probe: &str) -> Shown {
    let document = json(&out.join("probes.gltf"));
    let light = light(&document, probe);
    let n = light["specularImageSize"].as_u64().unwrap() as usize;
    let face = |index: &Value| {
        let uri = document["images"][index.as_u64().unwrap() as usize]["uri"].as_str().unwrap();
        let image = image::open(out.join(uri)).unwrap().into_rgba8();
        assert_eq!(image.dimensions(), (n as u32, n as u32));
        image
    };
    let faces: Vec<_> = light["specularImages"][0].as_array().unwrap().iter().map(face).collect();
    assert_eq!(faces.len(), 6);
    Box::new(move |direction| {
        let (slot, x, y) = cube_texel(babylon_from_manifest(direction), n);
        // Images are uploaded from their last row.
        let [r, g, b, a] = faces[slot].get_pixel(x as u32, (n - 1 - y) as u32).0.map(f32::from);
        // fromRGBD: colours to linear, divided by alpha.
        (Vec3::new(r, g, b) / 255.0).powf(2.2) / (a / 255.0)
    })
}

#[test]
fn irradiance_is_the_integral_of_radiance() {
    let baked = Baked::new();
    let out = baked.export("gltf");
    let radiance = shown(&out, "probe_000");
    let coefficients: Vec<DVec3> =
        serde_json::from_value(light(&json(&out.join("probes.gltf")), "probe_000")["irradianceCoefficients"].clone())
            .unwrap();
    assert_eq!(coefficients.len(), 9);
    for normal in sphere().step_by(997) {
        // With the Condon-Shortley phase: Y1-1 = -0.488603 y and so on, in Babylon's world.
        let n = babylon_from_manifest(normal);
        let basis = [
            0.282095,
            -0.488603 * n.y,
            0.488603 * n.z,
            -0.488603 * n.x,
            1.092548 * n.x * n.y,
            -1.092548 * n.y * n.z,
            0.315392 * (3.0 * n.z * n.z - 1.0),
            -1.092548 * n.x * n.z,
            0.546274 * (n.x * n.x - n.y * n.y),
        ];
        let found: DVec3 = coefficients.iter().zip(basis).map(|(c, y)| *c * y).sum();
        let (mut sum, mut count) = (DVec3::ZERO, 0.0);
        for d in sphere() {
            sum += radiance(d).as_dvec3() * cosine_of_three_bands(d.dot(normal));
            count += 1.0;
        }
        let expected = sum * (4.0 * std::f64::consts::PI / count);
        assert!(((found - expected) / expected).abs().max_element() < 0.01, "{normal}: {found}, not {expected}");
    }
}

#[test]
fn mips_end_at_16_pixels_and_every_scene_is_lit_by_its_probe() {
    let baked = Baked::with(|job| (job.face_size, job.exposure) = (2 * SIZE, 1.0));
    let document = json(&baked.export("gltf").join("probes.gltf"));
    assert_eq!(document["asset"]["extras"]["splatprobe"]["colour"]["paperWhite"], 2.0);
    for (i, record) in baked.manifest.probes.iter().enumerate() {
        let light = light(&document, &record.id);
        assert_eq!(light["specularImageSize"], 2 * SIZE);
        assert_eq!(light["specularImages"].as_array().unwrap().len(), 3, "64, 32 and 16 pixels");
        assert_eq!(document["scenes"][i]["extensions"]["EXT_lights_image_based"]["light"], i);
        let node = &document["nodes"][i];
        assert_eq!(node["translation"], serde_json::json!(record.position));
        assert_eq!(node["extras"]["splatprobe"]["proxy"]["max"], serde_json::json!(record.proxy.max));
    }
}
