//! Materials, tangents, lights and compressed geometry of glTF files of known content.

use std::f32::consts::{FRAC_PI_2, FRAC_PI_4};

use crate::common::gltf::{File, data_folder, load_file, png};
use glam::{Vec3, Vec4};
use serde_json::{Value, json};
use splatprobe::Error;
use splatprobe::scene::light::LightKind;
use splatprobe::scene::material::{Channel, ColourMap, ScalarMap};
use splatprobe::scene::texture::{Encoding, Filter, MipFilter};
use splatprobe::scene::{Light, LinearRgb, Material, Meshes};

/// The square with this material, and nine textures of one image each.
fn square_with(material: Value) -> File {
    let mut file = File::square();
    let view = file.view(&png(1, 1, &[[51, 102, 153, 204]]));
    file.json["images"] = (0..9).map(|_| json!({"bufferView": view})).collect();
    file.json["textures"] = (0..9).map(|image| json!({"source": image})).collect();
    file.push("materials", material);
    file.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    file
}

fn material_of(json: Value) -> (Material, Meshes) {
    let (mut meshes, _) = square_with(json).load().unwrap();
    (meshes.materials.remove(0), meshes)
}

/// Offset, factor, texture and channel of a map whose texture holds plain numbers, unless the channel is alpha.
fn parts(map: &ScalarMap, meshes: &Meshes) -> (f32, f32, Option<Channel>) {
    if let Some((texture, channel)) = map.texture {
        let encoding = meshes.textures[texture.texture as usize].image.encoding;
        assert!(encoding == Encoding::Linear || channel == Channel::A);
    }
    (map.offset, map.factor, map.texture.map(|(_, channel)| channel))
}

fn is_srgb(map: &ColourMap, meshes: &Meshes) -> bool {
    map.texture.is_some_and(|it| meshes.textures[it.texture as usize].image.encoding == Encoding::Srgb)
}

#[test]
fn an_empty_material_is_the_default_one() {
    assert_eq!(material_of(json!({})).0, Material::default());
    let empty: Vec<&str> =
        ["ior", "specular", "clearcoat", "sheen", "transmission", "volume", "anisotropy", "iridescence", "dispersion"]
            .into();
    let extensions: serde_json::Map<String, Value> =
        empty.iter().map(|name| (format!("KHR_materials_{name}"), json!({}))).collect();
    assert_eq!(material_of(json!({"extensions": extensions})).0, Material::default());
}

#[test]
fn core_textures_have_their_channels_and_encodings() {
    let (material, meshes) = material_of(json!({
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0.25, "roughnessFactor": 0.5,
            "metallicRoughnessTexture": {"index": 1}},
        "normalTexture": {"index": 2, "scale": 2.0},
        "occlusionTexture": {"index": 3, "strength": 0.75},
        "emissiveTexture": {"index": 4}, "emissiveFactor": [1, 1, 1]
    }));
    assert_eq!(parts(&material.metallic, &meshes), (0.0, 0.25, Some(Channel::B)));
    assert_eq!(parts(&material.roughness, &meshes), (0.0, 0.5, Some(Channel::G)));
    assert_eq!(parts(&material.occlusion, &meshes), (0.25, 0.75, Some(Channel::R)));
    let encoding = |texture: u32| meshes.textures[texture as usize].image.encoding;
    let normal = material.normal.unwrap();
    assert_eq!((normal.scale, encoding(normal.texture.texture)), (2.0, Encoding::Linear));
    for texture in [material.base_colour_texture, material.emissive_texture] {
        assert_eq!(encoding(texture.unwrap().texture), Encoding::Srgb);
    }
    assert!(meshes.textures.iter().all(|texture| !texture.image.is_decoded()), "no ray has asked for a pixel");
}

#[test]
fn every_extension_is_read_with_its_textures() {
    let transform = json!({"KHR_texture_transform": {"offset": [0.5, 0.0], "texCoord": 1}});
    let (material, meshes) = material_of(json!({"extensions": {
        "KHR_materials_ior": {"ior": 1.33},
        "KHR_materials_specular": {"specularFactor": 0.5, "specularTexture": {"index": 0},
            "specularColorFactor": [0.1, 0.2, 0.3], "specularColorTexture": {"index": 0}},
        "KHR_materials_clearcoat": {"clearcoatFactor": 0.25, "clearcoatTexture": {"index": 1},
            "clearcoatRoughnessFactor": 0.75, "clearcoatRoughnessTexture": {"index": 2},
            "clearcoatNormalTexture": {"index": 3, "scale": 0.5, "extensions": transform}},
        "KHR_materials_sheen": {"sheenColorFactor": [0.4, 0.5, 0.6], "sheenColorTexture": {"index": 4},
            "sheenRoughnessFactor": 0.125, "sheenRoughnessTexture": {"index": 4}},
        "KHR_materials_transmission": {"transmissionFactor": 0.875, "transmissionTexture": {"index": 5}},
        "KHR_materials_volume": {"thicknessFactor": 2.0, "thicknessTexture": {"index": 6},
            "attenuationDistance": 3.0, "attenuationColor": [0.7, 0.8, 0.9]},
        "KHR_materials_anisotropy": {"anisotropyStrength": 0.6, "anisotropyRotation": 1.5,
            "anisotropyTexture": {"index": 7}},
        "KHR_materials_iridescence": {"iridescenceFactor": 0.3, "iridescenceIor": 1.5,
            "iridescenceThicknessMinimum": 200.0, "iridescenceThicknessMaximum": 600.0,
            "iridescenceTexture": {"index": 8}, "iridescenceThicknessTexture": {"index": 8}},
        "KHR_materials_dispersion": {"dispersion": 0.4}
    }}));
    assert_eq!((material.ior, material.dispersion), (1.33, 0.4));
    assert_eq!(parts(&material.specular, &meshes), (0.0, 0.5, Some(Channel::A)));
    assert_eq!(material.specular_colour.factor, Vec3::new(0.1, 0.2, 0.3));
    assert_eq!(parts(&material.clearcoat.factor, &meshes), (0.0, 0.25, Some(Channel::R)));
    assert_eq!(parts(&material.clearcoat.roughness, &meshes), (0.0, 0.75, Some(Channel::G)));
    let coat = material.clearcoat.normal.unwrap();
    assert_eq!((coat.scale, coat.texture.uv_set), (0.5, 1));
    assert_eq!(coat.texture.uv_from_uv.transform_point2(glam::Vec2::ZERO), glam::Vec2::new(0.5, 0.0));
    assert_eq!(material.sheen.colour.factor, Vec3::new(0.4, 0.5, 0.6));
    assert_eq!(parts(&material.sheen.roughness, &meshes), (0.0, 0.125, Some(Channel::A)));
    assert_eq!(parts(&material.transmission, &meshes), (0.0, 0.875, Some(Channel::R)));
    assert_eq!(parts(&material.volume.thickness, &meshes), (0.0, 2.0, Some(Channel::G)));
    assert_eq!(material.volume.attenuation_distance, 3.0);
    assert_eq!(material.volume.attenuation_colour, LinearRgb(Vec3::new(0.7, 0.8, 0.9)));
    assert_eq!((material.anisotropy.strength, material.anisotropy.rotation), (0.6, 1.5));
    assert_eq!(parts(&material.iridescence.factor, &meshes), (0.0, 0.3, Some(Channel::R)));
    assert_eq!(parts(&material.iridescence.thickness_nm, &meshes), (200.0, 400.0, Some(Channel::G)));
    assert_eq!(material.iridescence.ior, 1.5);
    assert!(is_srgb(&material.specular_colour, &meshes) && is_srgb(&material.sheen.colour, &meshes));
    // An alpha channel beside a colour shares its pixels: specular and sheen have one texture each.
    assert_eq!(meshes.textures.len(), 9);
}

#[test]
fn specular_glossiness_becomes_a_dielectric_of_that_reflectance() {
    let (material, meshes) = material_of(json!({"extensions": {"KHR_materials_pbrSpecularGlossiness": {
        "diffuseFactor": [0.1, 0.2, 0.3, 0.4], "specularFactor": [0.5, 0.6, 0.7], "glossinessFactor": 0.75,
        "diffuseTexture": {"index": 0}, "specularGlossinessTexture": {"index": 1}}}}));
    assert_eq!(material.base_colour, Vec4::new(0.1, 0.2, 0.3, 0.4));
    assert!(material.base_colour_texture.is_some());
    assert_eq!((material.ior, material.metallic), (0.0, 0.0.into()));
    assert_eq!(material.specular_colour.factor, Vec3::new(0.5, 0.6, 0.7));
    assert!(is_srgb(&material.specular_colour, &meshes));
    // Roughness is 1 - glossiness.
    assert_eq!(parts(&material.roughness, &meshes), (1.0, -0.75, Some(Channel::A)));
    let (plain, _) = material_of(json!({"extensions": {"KHR_materials_pbrSpecularGlossiness": {}}}));
    assert_eq!(parts(&plain.roughness, &meshes), (1.0, -1.0, None));
}

#[test]
fn factors_that_mean_nothing_are_named() {
    for (material, message) in [
        (json!({"pbrMetallicRoughness": {"roughnessFactor": -1}}), "roughnessFactor"),
        (json!({"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 1e39]}}), "baseColorFactor"),
        (json!({"extensions": {"KHR_materials_ior": {"ior": 0.5}}}), "its ior is 0.5"),
        (json!({"extensions": {"KHR_materials_volume": {"attenuationDistance": 0}}}), "attenuationDistance"),
        (json!({"extensions": {"KHR_materials_sheen": {"sheenColorFactor": [0, -1, 0]}}}), "sheenColorFactor"),
        (json!({"normalTexture": {"index": 40}}), "index 40 is out of range"),
        (json!({"normalTexture": {"index": 0, "texCoord": 2}}), "TEXCOORD_2"),
        (json!({"alphaMode": "SOLID"}), "alphaMode"),
        (json!({"extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": "much"}}}), "/materials/0"),
    ] {
        let error = square_with(material).error();
        assert!(error.contains("/materials/0") && error.contains(message), "'{error}' does not say '{message}'");
    }
}

#[test]
fn samplers_keep_their_filters() {
    let filter = |sampler: Value| {
        let mut file = square_with(json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}));
        file.json["samplers"] = json!([sampler]);
        file.json["textures"][0]["sampler"] = json!(0);
        file.load().unwrap().0.textures[0].filter
    };
    let expected = |minify_nearest, mips| Filter { magnify_nearest: false, minify_nearest, mips };
    for (code, filter_of_code) in [
        (9728, expected(true, MipFilter::None)),
        (9729, expected(false, MipFilter::None)),
        (9984, expected(true, MipFilter::Nearest)),
        (9985, expected(false, MipFilter::Nearest)),
        (9986, expected(true, MipFilter::Linear)),
        (9987, expected(false, MipFilter::Linear)),
    ] {
        assert_eq!(filter(json!({"minFilter": code})), filter_of_code, "{code}");
    }
    assert_eq!(filter(json!({})), Filter::default());
    assert!(filter(json!({"magFilter": 9728})).magnify_nearest);
}

#[test]
fn variants_replace_the_materials_that_they_map() {
    let mut file = File::square();
    for name in ["plain", "red", "blue"] {
        file.push("materials", json!({"name": name}));
    }
    file.json["extensions"] =
        json!({"KHR_materials_variants": {"variants": [{"name": "a"}, {"name": "b"}, {"name": "c"}]}});
    let mappings = json!([{"material": 1, "variants": [0]}, {"material": 2, "variants": [0, 2]}]);
    let primitive = &mut file.json["meshes"][0]["primitives"][0];
    primitive["material"] = json!(0);
    primitive["extensions"] = json!({"KHR_materials_variants": {"mappings": mappings}});
    let name = |variant: Option<&str>| {
        let loaded = file.load_with(|input| input.variant = variant.map(str::to_owned));
        loaded.map(|(meshes, report)| (meshes.materials[0].name.clone(), report.variants.join(" ")))
    };
    for (variant, material) in [(None, "plain"), (Some("a"), "red"), (Some("b"), "plain"), (Some("c"), "blue")] {
        assert_eq!(name(variant).unwrap(), (material.to_owned(), "a b c".to_owned()));
    }
    let error = name(Some("d")).unwrap_err();
    assert!(matches!(error, Error::Request { .. }) && error.to_string().contains("it has a, b, c"), "{error}");
}

fn lights_of(light: Value, node: Value) -> Result<(Vec<Light>, usize), Error> {
    let mut file = File::square();
    file.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [light]}});
    file.json["scenes"][0]["nodes"] = json!([0, 1]);
    let mut node = node;
    node["extensions"] = json!({"KHR_lights_punctual": {"light": 0}});
    file.push("nodes", node);
    let mut lights = Vec::new();
    let (_, report) = file.load_all(|_| (), &mut lights)?;
    assert_eq!(report.lights, lights.len());
    Ok((lights, report.dark_lights))
}

#[test]
fn lights_stand_and_point_as_their_nodes_do_whatever_the_scale() {
    let half = std::f32::consts::FRAC_1_SQRT_2;
    // A quarter turn about y takes -z to -x; scale and mirroring move nothing here and change no intensity.
    for scale in [[1.0, 1.0, 1.0], [3.0, 3.0, 3.0], [-1.0, 1.0, 1.0]] {
        let node = json!({"translation": [1, 2, 3], "rotation": [0, half, 0, half], "scale": scale});
        let only = |light: Value| lights_of(light, node.clone()).unwrap().0.remove(0);
        let sun = only(json!({"type": "directional", "color": [1.0, 0.5, 0.25], "intensity": 4.0, "name": "sun"}));
        assert_eq!((sun.name.as_str(), sun.intensity), ("sun", LinearRgb(Vec3::new(4.0, 2.0, 1.0))));
        let LightKind::Directional { direction } = sun.kind else { panic!("{:?}", sun.kind) };
        assert!(direction.abs_diff_eq(Vec3::NEG_X, 1e-6), "{direction}");
        let bulb = only(json!({"type": "point", "range": 5.0}));
        assert_eq!(bulb.kind, LightKind::Point { position: Vec3::new(1.0, 2.0, 3.0), range: 5.0 });
        assert_eq!(bulb.intensity, LinearRgb(Vec3::ONE));
        let LightKind::Spot { inner_cone, outer_cone, range, .. } = only(json!({"type": "spot"})).kind else {
            panic!()
        };
        assert_eq!((inner_cone, outer_cone, range), (0.0, FRAC_PI_4, f32::INFINITY));
    }
}

#[test]
fn dark_lights_are_counted_and_impossible_ones_are_errors() {
    let plain = json!({});
    for (light, node) in [
        (json!({"type": "point", "intensity": 0}), plain.clone()),
        (json!({"type": "point", "color": [0, 0, 0]}), plain.clone()),
        (json!({"type": "spot"}), json!({"scale": [0, 0, 0]})),
        (json!({"type": "point"}), json!({"translation": [1e300, 0, 0]})),
    ] {
        let (lights, dark) = lights_of(light.clone(), node).unwrap();
        assert!(lights.is_empty() && dark == 1, "{light}");
    }
    for light in [
        json!({"type": "point", "intensity": -1}),
        json!({"type": "point", "intensity": 1e39}),
        json!({"type": "point", "color": [1e30, 0, 0], "intensity": 1e30}),
        json!({"type": "point", "range": 0}),
        json!({"type": "spot", "spot": {"innerConeAngle": 1.0, "outerConeAngle": 0.5}}),
        json!({"type": "spot", "spot": {"outerConeAngle": 2.0 * FRAC_PI_2}}),
        json!({"type": "area"}),
        json!({}),
    ] {
        let error = lights_of(light.clone(), plain.clone()).unwrap_err().to_string();
        assert!(error.contains("/extensions/KHR_lights_punctual/lights/0"), "{light}: {error}");
    }
    let mut file = File::square();
    file.json["nodes"][0]["extensions"] = json!({"KHR_lights_punctual": {"light": 3}});
    assert!(file.error().contains("/nodes/0: KHR_lights_punctual: light 3 is out of range"), "{}", file.error());
}

fn normal_mapped() -> File {
    square_with(json!({"normalTexture": {"index": 0}}))
}

#[test]
fn tangents_follow_the_first_texture_coordinate_and_bitangents_oppose_the_second() {
    // u runs along +x and v along -y: the bitangent, up in the image, is +y.
    for (scale, tangent, bitangent) in [
        ([1.0, 1.0, 1.0], Vec3::X, Vec3::Y),
        ([-2.0, 3.0, 1.0], Vec3::NEG_X, Vec3::Y),
        ([1.0, -1.0, -5.0], Vec3::X, Vec3::NEG_Y),
        ([-1.0, -1.0, -1.0], Vec3::NEG_X, Vec3::NEG_Y),
    ] {
        let mut file = normal_mapped();
        file.json["nodes"][0]["scale"] = json!(scale);
        let mut with_tangents = normal_mapped();
        with_tangents.json["nodes"][0]["scale"] = json!(scale);
        let given = with_tangents.floats("VEC4", &[[1.0, 0.0, 0.0, 1.0]; 4]);
        with_tangents.json["meshes"][0]["primitives"][0]["attributes"]["TANGENT"] = json!(given);
        for file in [file, with_tangents] {
            let (meshes, _) = file.load().unwrap();
            assert_eq!(meshes.tangents.len(), 4);
            for v in 0..4 {
                let (found, normal) = (meshes.tangent_of(v), meshes.attributes[v].normal);
                assert!(found.truncate().abs_diff_eq(tangent, 1e-6), "{scale:?}: {found}");
                let found = normal.cross(found.truncate()) * found.w;
                assert!(found.abs_diff_eq(bitangent, 1e-6), "{scale:?}: {found}");
            }
        }
    }
}

#[test]
fn tangents_are_made_only_where_a_material_needs_them() {
    assert!(square_with(json!({})).load().unwrap().0.tangents.is_empty());
    let mut plain_with_tangents = File::square();
    let given = plain_with_tangents.floats("VEC4", &[[1.0, 0.0, 0.0, 1.0]; 4]);
    plain_with_tangents.json["meshes"][0]["primitives"][0]["attributes"]["TANGENT"] = json!(given);
    assert!(plain_with_tangents.load().unwrap().0.tangents.is_empty());
    let mut without_uv = normal_mapped();
    without_uv.json["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap().remove("TEXCOORD_0");
    assert!(without_uv.load().unwrap().0.tangents.is_empty());
    let mut brushed = square_with(json!({"extensions": {"KHR_materials_anisotropy": {"anisotropyStrength": 1}}}));
    // A plain primitive before it: its vertices have none, and the others keep their places.
    let mut plain = brushed.json["meshes"][0]["primitives"][0].clone();
    plain.as_object_mut().unwrap().remove("material");
    brushed.json["meshes"][0]["primitives"].as_array_mut().unwrap().insert(0, plain);
    let (meshes, _) = brushed.load().unwrap();
    assert_eq!((meshes.positions.len(), meshes.tangents.len()), (8, 8));
    assert!((0..4).all(|v| meshes.tangent_of(v) == Vec4::ZERO) && (4..8).all(|v| meshes.tangent_of(v) != Vec4::ZERO));
}

#[test]
fn a_vertex_between_mirrored_halves_of_a_texture_is_split() {
    let mut file = normal_mapped();
    // Two squares side by side; u runs from 0 to 1 and back to 0.
    let position =
        file.floats("VEC3", &[[0., 0., 0.], [1., 0., 0.], [2., 0., 0.], [0., 1., 0.], [1., 1., 0.], [2., 1., 0.]]);
    let normal = file.floats("VEC3", &[[0., 0., 1.]; 6]);
    let uv = file.floats("VEC2", &[[0., 1.], [1., 1.], [0., 1.], [0., 0.], [1., 0.], [0., 0.]]);
    let indices = file.indices(&[0, 1, 4, 0, 4, 3, 1, 2, 5, 1, 5, 4]);
    file.json["meshes"][0]["primitives"][0]["attributes"] =
        json!({"POSITION": position, "NORMAL": normal, "TEXCOORD_0": uv});
    file.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
    let (meshes, _) = file.load().unwrap();
    assert_eq!(meshes.positions.len(), 8, "the two vertices in the middle stand for two each");
    for (triangle, tangent, sign) in
        [(0, Vec3::X, 1.0), (1, Vec3::X, 1.0), (2, Vec3::NEG_X, -1.0), (3, Vec3::NEG_X, -1.0)]
    {
        for v in meshes.triangles[triangle] {
            let found: Vec4 = meshes.tangent_of(v as usize);
            assert!(found.truncate().abs_diff_eq(tangent, 1e-5) && found.w == sign, "{triangle}: {found}");
        }
    }
}

#[test]
fn tangents_of_a_real_file_agree_with_those_made_from_its_texture_coordinates() {
    let Some(data) = data_folder() else { return };
    let path = data.join("meshes/NormalTangentTest.glb");
    let (meshes, _) = load_file(&path).unwrap();
    assert!(!meshes.tangents.is_empty());
    for v in 0..meshes.positions.len() {
        let (tangent, normal) = (meshes.tangent_of(v), meshes.attributes[v].normal);
        assert!((tangent.truncate().length() - 1.0).abs() < 1e-4 && tangent.w.abs() == 1.0, "{v}: {tangent}");
        assert!(tangent.truncate().dot(normal).abs() < 0.05, "{v}: {tangent} is not across {normal}");
    }
}

#[test]
fn meshopt_views_read_as_plain_ones_and_their_fallback_buffer_need_not_be_there() {
    let mut file = File::square();
    // The square's indices, 0 1 2 0 2 3: table entry 0 is three new vertices, then edge (a, c) and a new one.
    let mut packed = vec![0xE1, 0xF0, 0x00];
    packed.extend([0; 16]);
    let view = file.view(&packed);
    let compression = json!({"buffer": 0, "byteOffset": file.json["bufferViews"][view]["byteOffset"],
        "byteLength": packed.len(), "byteStride": 2, "count": 6, "mode": "TRIANGLES"});
    file.json["bufferViews"][view] = json!({"buffer": 1, "byteLength": 12,
        "extensions": {"EXT_meshopt_compression": compression}});
    file.json["accessors"][3]["bufferView"] = json!(view);
    file.json["buffers"] = json!([{"byteLength": file.bin.len()}, {"byteLength": 12}]);
    file.json["extensionsRequired"] = json!(["EXT_meshopt_compression"]);
    let (meshes, _) = file.load().unwrap();
    assert_eq!(meshes.triangles, File::square().load().unwrap().0.triangles);
    file.json["bufferViews"][view]["extensions"]["EXT_meshopt_compression"]["byteLength"] = json!(15);
    assert!(file.error().contains("/bufferViews/4/extensions/EXT_meshopt_compression: "), "{}", file.error());
}

#[test]
fn broken_draco_data_are_an_error_and_plain_data_beside_them_are_read() {
    let mut file = File::square();
    let view = file.view(&[b'D', b'R', b'A', b'C', b'O', 2, 2, 1, 1, 0, 0]);
    let draco = json!({"bufferView": view, "attributes": {"POSITION": 0}});
    file.json["meshes"][0]["primitives"][0]["extensions"] = json!({"KHR_draco_mesh_compression": draco});
    assert_eq!(file.load().unwrap().1.triangles, 2, "the plain data are there");
    file.json["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    let error = file.error();
    assert!(error.contains("/meshes/0/primitives/0/extensions/KHR_draco_mesh_compression"), "{error}");
}

#[test]
fn an_image_of_an_extension_serves_where_there_is_no_plain_one() {
    let with_texture = |texture: Value| {
        let mut file = square_with(json!({"emissiveTexture": {"index": 0}, "emissiveFactor": [1, 1, 1]}));
        file.json["textures"][0] = texture;
        file
    };
    let webp = |source: Value| json!({"extensions": {"EXT_texture_webp": {"source": source}}});
    assert!(with_texture(webp(json!(3))).load().is_ok());
    assert!(with_texture(webp(json!("three"))).error().contains("/textures/0: EXT_texture_webp has no source"));
    let unknown = with_texture(json!({"extensions": {"VENDOR_image": {"source": 1}}})).error();
    assert!(unknown.contains("has no PNG, JPEG, WebP or KTX2 source, only VENDOR_image"), "{unknown}");
}

/// The files were made with Basis Universal's own encoder (npm ktx2-encoder 0.6.0) from 8 x 8 pixels: (200, 40, 0) left,
/// (0, 40, 180) right, alpha 255 above and 128 below.
#[test]
fn basis_textures_decode_to_the_pixels_that_were_packed() {
    for (bytes, tolerance) in
        [(&include_bytes!("../common/uastc.ktx2")[..], 2), (include_bytes!("../common/etc1s.ktx2"), 12)]
    {
        let mut file = square_with(json!({"emissiveTexture": {"index": 0}, "emissiveFactor": [1, 1, 1]}));
        let view = file.view(bytes);
        file.json["images"][5] = json!({"bufferView": view, "mimeType": "image/ktx2"});
        file.json["textures"][0] = json!({"extensions": {"KHR_texture_basisu": {"source": 5}}});
        file.json["extensionsRequired"] = json!(["KHR_texture_basisu"]);
        let (meshes, _) = file.load().unwrap();
        let level = &meshes.textures[0].image.levels().unwrap()[0];
        assert_eq!((level.width, level.height), (8, 8));
        for (i, texel) in level.texels.iter().enumerate() {
            let (x, y) = (i % 8, i / 8);
            let [r, b] = if x < 4 { [200, 0] } else { [0, 180] };
            let expected = [r, 40, b, if y < 4 { 255 } else { 128 }];
            let off = texel.iter().zip(expected).map(|(found, expected)| (i32::from(*found) - expected).abs()).max();
            assert!(off <= Some(tolerance), "({x}, {y}): {texel:?} is not {expected:?}");
        }
    }
}
