//! Meshes of USD stages: what OpenUSD's own library finds in them, the schemas' rules one by one, broken files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::files::with_flipped_bytes;
use glam::{DVec3, Mat3, Vec2, Vec3, Vec4};
use splatprobe::ingest::{self, SceneReport, load_scene};
use splatprobe::job::{MeshInput, MissingTexture, SplatInput};
use splatprobe::scene::light::LightKind;
use splatprobe::scene::material::{AlphaMode, Channel};
use splatprobe::scene::texture::{Encoding, Wrap};
use splatprobe::scene::{Material, Meshes, Scene};
use splatprobe::{Error, Result};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/usd_meshes").join(name)
}

fn load_path(path: &Path) -> Result<(Scene, SceneReport)> {
    load_scene(&[], &[MeshInput::new(path)])
}

/// Loads the last of `files`, all of them in one folder.
fn load_files(files: &[(&str, &[u8])]) -> Result<(Scene, SceneReport)> {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in files {
        std::fs::write(folder.path().join(name), bytes).unwrap();
    }
    load_path(&folder.path().join(files.last().unwrap().0))
}

/// A stage in metres whose prims are `body`.
fn stage(body: &str) -> String {
    format!("#usda 1.0\n(\n    metersPerUnit = 1\n    upAxis = \"Y\"\n)\n{body}\n")
}

fn load(body: &str) -> (Scene, SceneReport) {
    load_files(&[("scene.usda", stage(body).as_bytes())]).unwrap_or_else(|error| panic!("{error}: {body}"))
}

fn message(body: &str) -> String {
    let error = load_files(&[("scene.usda", stage(body).as_bytes())]).expect_err(body);
    assert_eq!(error.exit_code(), 2, "{error}");
    error.to_string()
}

/// A unit square in the plane z = 0, seen from +Z, with more attributes, and children.
fn square(name: &str, more: &str) -> String {
    format!(
        "def Mesh \"{name}\" {{ int[] faceVertexCounts = [4]\nint[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]\nuniform token subdivisionScheme = \"none\"
        {more}\n}}\n"
    )
}

/// A material with a UsdPreviewSurface of these inputs, and more shaders.
fn material(name: &str, inputs: &str, shaders: &str) -> String {
    format!(
        "def Material \"{name}\" {{ token outputs:surface.connect = </{name}/S.outputs:surface>
        def Shader \"S\" {{ uniform token info:id = \"UsdPreviewSurface\"\n{inputs}\ntoken outputs:surface }}
        {shaders} }}\n"
    )
}

const BOUND: &str = "rel material:binding = </M>";

/// The material `M` with these inputs and shaders, as a square has it.
fn material_of(inputs: &str, shaders: &str) -> Material {
    let (scene, _) = load_with_image(&(material("M", inputs, shaders) + &square("Q", BOUND)));
    scene.meshes.materials[0].clone()
}

/// Loads a stage beside the 2 x 2 image colours.png: red, green, and below them blue, yellow.
fn load_with_image(body: &str) -> (Scene, SceneReport) {
    let image = std::fs::read(fixture("colours.png")).unwrap();
    load_files(&[("colours.png", &image), ("scene.usda", stage(body).as_bytes())])
        .unwrap_or_else(|error| panic!("{error}: {body}"))
}

/// A UsdUVTexture T of material M that shows colours.png by primvar st, with more inputs.
fn texture(more: &str) -> String {
    format!(
        "def Shader \"T\" {{ uniform token info:id = \"UsdUVTexture\"\nasset inputs:file = @colours.png@
        float2 inputs:st.connect = </M/R.outputs:result>\n{more} }}
        {READER}"
    )
}

const READER: &str = "def Shader \"R\" { uniform token info:id = \"UsdPrimvarReader_float2\"
        string inputs:varname = \"st\"\nfloat2 outputs:result }";

const ST: &str = "texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = \"vertex\")";

/// The area of a triangle, along its front's normal.
fn area_vector(meshes: &Meshes, triangle: usize) -> DVec3 {
    let [a, b, c] = meshes.corners(triangle).map(Vec3::as_dvec3);
    (b - a).cross(c - a) / 2.0
}

#[derive(serde::Deserialize)]
#[serde(rename_all = "camelCase")]
struct Expected {
    triangles: usize,
    area: BTreeMap<String, f64>,
    area_vector: [f64; 3],
    min: [f64; 3],
    max: [f64; 3],
}

fn expected(name: &str) -> BTreeMap<String, Expected> {
    serde_json::from_slice(&std::fs::read(fixture(name)).unwrap()).unwrap()
}

fn compare(name: &str, path: &Path, expected: &Expected) {
    let (scene, report) = load_path(path).unwrap();
    let (meshes, report) = (&scene.meshes, &report.meshes[0]);
    let dropped = report.dropped_triangles.zero_area + report.dropped_triangles.non_finite;
    assert_eq!(report.triangles + dropped, expected.triangles, "{name}");
    let bounds = report.bounds.unwrap();
    let size = DVec3::from(expected.max) - DVec3::from(expected.min);
    // Positions are f32 and matrices of half-precision turns; nothing else separates the two.
    let close = |found: DVec3, expected: [f64; 3]| (found - DVec3::from(expected)).length() < 1e-5 * size.length();
    assert!(close(bounds.min, expected.min) && close(bounds.max, expected.max), "{name}: {bounds:?}");
    let mut areas = BTreeMap::new();
    let mut sum = DVec3::ZERO;
    for i in 0..meshes.triangles.len() {
        let vector = area_vector(meshes, i);
        *areas.entry(meshes.material_of(i).name.clone()).or_insert(0.0) += vector.length();
        sum += vector;
    }
    let total: f64 = areas.values().sum();
    assert!((sum - DVec3::from(expected.area_vector)).length() < 1e-5 * total, "{name}: {sum}");
    for (material, area) in &expected.area {
        let found = areas.get(material).copied().unwrap_or(0.0);
        // A face that is not flat has a little more area when it is cut up than its corners enclose.
        assert!((found - area).abs() < 1e-4 * total, "{name}: {material} covers {found} of {area}");
    }
    assert!((total - expected.area.values().sum::<f64>()).abs() < 1e-4 * total, "{name}: {areas:?}");
}

#[test]
fn triangles_bounds_fronts_and_materials_are_those_that_openusd_finds() {
    for (name, expected) in expected("expected.json") {
        compare(&name, &fixture(&name), &expected);
    }
}

#[test]
fn shared_stages_are_those_that_openusd_finds() {
    let folder = std::env::var_os("SPLATPROBE_DATA").map(PathBuf::from);
    let folder = folder.unwrap_or(Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data")).join("usd");
    if !folder.is_dir() {
        println!("skipped: no {}", folder.display());
        return;
    }
    for (name, expected) in expected("shared.json") {
        compare(&name, &folder.join(&name), &expected);
    }
}

#[test]
fn textures_come_from_inside_a_package_and_the_right_way_up() {
    for name in ["scene.usda", "scene.usdc", "scene.usdz"] {
        let (scene, report) = load_path(&fixture(name)).unwrap();
        let meshes = &scene.meshes;
        let of_image = meshes.materials.iter().find(|it| it.name.ends_with("/Image")).unwrap();
        let used = of_image.base_colour_texture.unwrap();
        let image = &meshes.textures[used.texture as usize].image;
        assert_eq!((image.encoding, report.meshes[0].textures), (Encoding::Srgb, 1), "{name}");
        assert_eq!(image.levels().unwrap()[0].texels[..2], [[255, 0, 0, 255], [0, 255, 0, 255]], "{name}");
    }
    // st (0, 0) is the lower left corner of an image, uv (0, 0) the upper left one.
    let (scene, _) = load_with_image(
        &(material("M", "color3f inputs:diffuseColor.connect = </M/T.outputs:rgb>", &texture(""))
            + &square("Q", &format!("{BOUND}\n{ST}"))),
    );
    let corner = scene.meshes.positions.iter().position(|p| *p == Vec3::ZERO).unwrap();
    assert_eq!(scene.meshes.attributes[corner].uv[0], Vec2::new(0.0, 1.0));
    assert_eq!(scene.meshes.materials[0].base_colour_texture.unwrap().uv_from_uv, Mat3::IDENTITY);
}

#[test]
fn normals_have_every_interpolation_and_primvars_come_before_the_attribute() {
    let two = |more: &str| {
        format!(
            "def Mesh \"Q\" {{ int[] faceVertexCounts = [3, 3]\nint[] faceVertexIndices = [0, 1, 2, 0, 2, 3]
            point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]\nuniform token subdivisionScheme = \"none\"
            {more} }}"
        )
    };
    let normals_of = |more: &str| {
        let meshes = load(&two(more)).0.meshes;
        let at = |t: usize| meshes.triangles[t].map(|v| meshes.attributes[v as usize].normal);
        [at(0), at(1)]
    };
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    assert_eq!(normals_of(""), [[Vec3::ZERO; 3]; 2]);
    let given = |values: &str, interpolation: &str| {
        normals_of(&format!("normal3f[] normals = [{values}] (interpolation = \"{interpolation}\")"))
    };
    assert_eq!(given("(0, 2, 0)", "constant"), [[y; 3]; 2]);
    assert_eq!(given("(1, 0, 0), (0, 0, 1)", "uniform"), [[x; 3], [z; 3]]);
    for interpolation in ["vertex", "varying"] {
        assert_eq!(given("(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 1, 0)", interpolation), [[x, y, z], [x, z, y]]);
    }
    let corners = "(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 1), (0, 0, 1), (1, 0, 0)";
    assert_eq!(given(corners, "faceVarying"), [[x, y, z], [z, z, x]]);
    // Without a word a normal belongs to a point; a primvar to the mesh.
    let attribute = "normal3f[] normals = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 1, 0)]\n";
    assert_eq!(normals_of(attribute), [[x, y, z], [x, z, y]]);
    let primvar = "normal3f[] primvars:normals = [(0, 0, 1), (0, 1, 0)] (interpolation = \"faceVarying\")
        int[] primvars:normals:indices = [0, 1, 0, 1, 1, 1]";
    assert_eq!(normals_of(&format!("{attribute}{primvar}")), [[z, y, z], [y, y, y]]);
    // Corners that are alike share a vertex: four points, of which two have two normals.
    assert_eq!(load(&two(primvar)).0.meshes.positions.len(), 6);
    assert_eq!(load(&two("")).0.meshes.positions.len(), 4);
}

#[test]
fn cages_are_smooth_keep_their_corners_and_are_told() {
    let cube = |scheme: &str, more: &str| {
        format!(
            "def Mesh \"C\" {{ int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
            int[] faceVertexIndices = [0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5]
            point3f[] points = [(-1, -1, -1), (1, -1, -1), (-1, 1, -1), (1, 1, -1), (-1, -1, 1), (1, -1, 1), (-1, 1, 1), (1, 1, 1)]
            {scheme}\n{more} }}"
        )
    };
    for (scheme, smooth) in [
        ("", true),
        ("uniform token subdivisionScheme = \"loop\"", true),
        ("uniform token subdivisionScheme = \"bilinear\"", false),
        ("uniform token subdivisionScheme = \"none\"", false),
    ] {
        for hand in ["", "uniform token orientation = \"leftHanded\""] {
            let (scene, report) = load(&cube(scheme, hand));
            let facing = if hand.is_empty() { 1.0 } else { -1.0 };
            for (vertex, position) in scene.meshes.attributes.iter().zip(&scene.meshes.positions) {
                let expected = if smooth { position.normalize() * facing } else { Vec3::ZERO };
                assert!(vertex.normal.abs_diff_eq(expected, 1e-6), "{scheme} {hand}: {} {expected}", vertex.normal);
            }
            let is_cage = !scheme.contains("none");
            assert_eq!(report.meshes[0].notes.iter().any(|note| note.contains("cages: /C")), is_cage, "{scheme}");
            assert_eq!((scene.meshes.positions.len(), scene.meshes.triangles.len()), (8, 12));
        }
    }
}

#[test]
fn unbound_meshes_show_display_colour_and_opacity_or_grey() {
    let look = |body: &str| {
        let (scene, _) = load(body);
        let colours: Vec<Vec4> = scene.meshes.attributes.iter().map(|vertex| vertex.colour).collect();
        (colours, scene.meshes.materials[0].alpha, scene.meshes.materials[0].double_sided)
    };
    let grey = Vec3::splat(0.18).extend(1.0);
    assert_eq!(look(&square("Q", "")), (vec![grey; 4], AlphaMode::Opaque, false));
    let colour = "color3f[] primvars:displayColor = [(1, 0.5, 0)]";
    let orange = Vec4::new(1.0, 0.5, 0.0, 1.0);
    assert_eq!(look(&square("Q", &format!("{colour}\nuniform bool doubleSided = 1"))).0, vec![orange; 4]);
    assert!(look(&square("Q", "uniform bool doubleSided = 1")).2);
    let clear = format!("{colour}\nfloat[] primvars:displayOpacity = [0.25]");
    assert_eq!(look(&square("Q", &clear)), (vec![orange.truncate().extend(0.25); 4], AlphaMode::Blend, false));
    // A constant one is inherited, others are not.
    let inherited = |interpolation: &str| {
        let above = format!("color3f[] primvars:displayColor = [(1, 0.5, 0)] (interpolation = \"{interpolation}\")");
        look(&format!("def Xform \"X\" {{ {above}\n{} }}", square("Q", ""))).0
    };
    assert_eq!(inherited("constant"), vec![orange; 4]);
    assert_eq!(inherited("uniform"), vec![grey; 4]);
}

#[test]
fn preview_surfaces_become_metallic_roughness_with_their_own_fallbacks() {
    let plain = material_of("", "");
    assert_eq!(plain.base_colour, Vec3::splat(0.18).extend(1.0));
    assert_eq!((plain.metallic.factor, plain.roughness.factor, plain.ior), (0.0, 0.5, 1.5));
    assert_eq!((plain.clearcoat.factor.factor, plain.clearcoat.roughness.factor), (0.0, 0.01));
    assert_eq!((plain.alpha, plain.occlusion.factor, plain.normal), (AlphaMode::Opaque, 1.0, None));
    let all = material_of(
        "color3f inputs:diffuseColor = (0.1, 0.2, 0.3)\ncolor3f inputs:emissiveColor = (4, 5, 6)\nfloat inputs:metallic = 0.7
        float inputs:roughness = 0.8\nfloat inputs:clearcoat = 0.9\nfloat inputs:clearcoatRoughness = 0.4
        float inputs:ior = 0.5\nfloat inputs:opacity = 0.6\nfloat inputs:occlusion = 0.3",
        "",
    );
    assert_eq!((all.base_colour, all.emissive.0), (Vec4::new(0.1, 0.2, 0.3, 0.6), Vec3::new(4.0, 5.0, 6.0)));
    assert_eq!((all.metallic.factor, all.roughness.factor, all.occlusion.factor), (0.7, 0.8, 0.3));
    assert_eq!((all.clearcoat.factor.factor, all.clearcoat.roughness.factor), (0.9, 0.4));
    // An index and its inverse reflect alike.
    assert_eq!((all.ior, all.alpha), (2.0, AlphaMode::Blend));
    let cut = material_of("float inputs:opacity = 0.6\nfloat inputs:opacityThreshold = 0.5", "");
    assert_eq!(cut.alpha, AlphaMode::Mask { cutoff: 0.5 });
    let specular = material_of(
        "int inputs:useSpecularWorkflow = 1\ncolor3f inputs:specularColor = (0.1, 0.2, 0.3)\nfloat inputs:metallic = 1",
        "",
    );
    assert_eq!((specular.metallic.factor, specular.ior), (0.0, 0.0));
    assert_eq!(specular.specular_colour.factor, Vec3::new(0.1, 0.2, 0.3));
}

#[test]
fn inputs_are_followed_through_interfaces_and_node_graphs() {
    let body = "def Material \"M\" { color3f inputs:tint = (0.5, 0.25, 0)\nstring inputs:uvName = \"map1\"
        token outputs:surface.connect = </M/G.outputs:surface>
        def NodeGraph \"G\" { color3f inputs:tint.connect = </M.inputs:tint>
            token outputs:surface.connect = </M/G/S.outputs:surface>
            def Shader \"S\" { uniform token info:id = \"UsdPreviewSurface\"
                color3f inputs:diffuseColor.connect = </M/G.inputs:tint>
                color3f inputs:emissiveColor.connect = </M/G/T.outputs:rgb> }
            def Shader \"T\" { uniform token info:id = \"UsdUVTexture\"\nasset inputs:file = @colours.png@
                float2 inputs:st.connect = </M/G/R.outputs:result> }
            def Shader \"R\" { uniform token info:id = \"UsdPrimvarReader_float2\"
                string inputs:varname.connect = </M.inputs:uvName> } } }";
    let uv = "texCoord2f[] primvars:map1 = [(0.25, 0.5)]";
    let (scene, _) = load_with_image(&format!("{body}\n{}", square("Q", &format!("{BOUND}\n{uv}"))));
    let material = &scene.meshes.materials[0];
    assert_eq!(material.base_colour, Vec4::new(0.5, 0.25, 0.0, 1.0));
    assert!(material.emissive_texture.is_some());
    assert_eq!(scene.meshes.attributes[0].uv[0], Vec2::new(0.25, 0.5));
    assert!(message(&format!(
        "def Material \"M\" {{ color3f inputs:a.connect = </M.inputs:b>\ncolor3f inputs:b.connect = </M.inputs:a>
        token outputs:surface.connect = </M/S.outputs:surface>\ndef Shader \"S\" {{ uniform token info:id = \"UsdPreviewSurface\"
        color3f inputs:diffuseColor.connect = </M.inputs:a> }} }}\n{}", square("Q", BOUND)))
        .contains("connected over more than"));
}

#[test]
fn channels_scale_bias_and_colour_spaces_reach_the_material() {
    let with = |inputs: &str, more: &str| {
        let body = material("M", inputs, &texture(more)) + &square("Q", &format!("{BOUND}\n{ST}"));
        load_with_image(&body).0.meshes
    };
    let rough = with(
        "float inputs:roughness.connect = </M/T.outputs:g>",
        "float4 inputs:scale = (1, 0.5, 1, 1)\nfloat4 inputs:bias = (0, 0.25, 0, 0)\ntoken inputs:sourceColorSpace = \"raw\"
        token inputs:wrapS = \"clamp\"\ntoken inputs:wrapT = \"mirror\"",
    );
    let map = rough.materials[0].roughness;
    let (used, channel) = map.texture.unwrap();
    let of_map = &rough.textures[used.texture as usize];
    assert_eq!((map.factor, map.offset, channel, of_map.image.encoding), (0.5, 0.25, Channel::G, Encoding::Linear));
    assert_eq!(of_map.wrap, [Wrap::Clamp, Wrap::Mirror]);
    // Scale without bias is a factor above 1, too, and leaves the image alone.
    let glow =
        with("color3f inputs:emissiveColor.connect = </M/T.outputs:rgb>", "float4 inputs:scale = (20, 10, 5, 1)");
    assert_eq!(glow.materials[0].emissive.0, Vec3::new(20.0, 10.0, 5.0));
    assert_eq!(glow.textures[0].image.levels().unwrap()[0].texels[2], [0, 0, 255, 255]);
    // With a bias the image is rewritten, in linear light: 0.5 * 1 + 0.25 and 0.25.
    let biased = with(
        "color3f inputs:diffuseColor.connect = </M/T.outputs:rgb>",
        "float4 inputs:scale = (0.5, 0.5, 0.5, 1)\nfloat4 inputs:bias = (0.25, 0.25, 0.25, 0)",
    );
    assert_eq!(biased.textures[0].image.levels().unwrap()[0].texels[0], [225, 137, 137, 255]);
    // One channel for a colour fills all three; another's alpha is its own.
    let grey = with(
        "color3f inputs:diffuseColor.connect = </M/T.outputs:g>\nfloat inputs:opacity.connect = </M/T.outputs:r>",
        "token inputs:sourceColorSpace = \"raw\"",
    );
    let texels = &grey.textures[0].image.levels().unwrap()[0].texels;
    assert_eq!(texels[..], [[0, 0, 0, 255], [255, 255, 255, 0], [0, 0, 0, 0], [255; 4]]);
    assert_eq!(grey.materials[0].alpha, AlphaMode::Blend);
}

#[test]
fn normal_maps_are_plain_turned_over_or_weakened_by_scale_and_bias() {
    let with = |more: &str| {
        let inputs = "normal3f inputs:normal.connect = </M/T.outputs:rgb>";
        let body = material("M", inputs, &texture(more)) + &square("Q", &format!("{BOUND}\n{ST}"));
        let meshes = load_with_image(&body).0.meshes;
        let normal = meshes.materials[0].normal.unwrap();
        let image = &meshes.textures[normal.texture.texture as usize].image;
        assert_eq!(image.encoding, Encoding::Linear);
        let tangent = meshes.tangent_of(0);
        assert!(tangent.truncate().abs_diff_eq(Vec3::X, 1e-6), "{tangent}");
        (normal.scale, image.levels().unwrap()[0].texels[0])
    };
    let schema = "float4 inputs:scale = (2, 2, 2, 1)\nfloat4 inputs:bias = (-1, -1, -1, 0)";
    for more in ["", schema] {
        assert_eq!(with(more), (1.0, [255, 0, 0, 255]), "{more}");
    }
    let turned = "float4 inputs:scale = (2, -2, 2, 1)\nfloat4 inputs:bias = (-1, 1, -1, 0)";
    assert_eq!(with(turned), (1.0, [255, 255, 0, 255]));
    let weak = "float4 inputs:scale = (1, 1, 2, 1)\nfloat4 inputs:bias = (-0.5, -0.5, -1, 0)";
    assert_eq!(with(weak), (0.5, [255, 0, 0, 255]));
}

#[test]
fn texture_transforms_scale_then_turn_counter_clockwise_then_move_with_t_up() {
    let shaders = "def Shader \"T\" { uniform token info:id = \"UsdUVTexture\"\nasset inputs:file = @colours.png@
        float2 inputs:st.connect = </M/X.outputs:result> }
        def Shader \"X\" { uniform token info:id = \"UsdTransform2d\"\nfloat2 inputs:in.connect = </M/R.outputs:result>
        float2 inputs:scale = (2, 3)\nfloat inputs:rotation = 90\nfloat2 inputs:translation = (10, 20) }\n"
        .to_owned()
        + READER;
    let material = material_of("color3f inputs:diffuseColor.connect = </M/T.outputs:rgb>", &shaders);
    let uv_from_uv = material.base_colour_texture.unwrap().uv_from_uv;
    for (s, t) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.3, 0.8)] {
        let expected = Vec2::new(-3.0 * t + 10.0, 2.0 * s + 20.0);
        let found = uv_from_uv.transform_point2(Vec2::new(s, 1.0 - t));
        assert!(found.abs_diff_eq(Vec2::new(expected.x, 1.0 - expected.y), 1e-5), "{s} {t}: {found}");
    }
}

#[test]
fn materials_by_collection_come_before_the_direct_one() {
    let body = format!(
        "def Xform \"X\" (prepend apiSchemas = [\"CollectionAPI:some\"]) {{
        uniform token collection:some:expansionRule = \"expandPrims\"\nrel collection:some:includes = </X/A>
        rel material:binding:collection:some = [</X.collection:some>, </Red>]\nrel material:binding = </Green>\n{}{} }}\n{}{}",
        square("A", ""),
        square("B", ""),
        material("Red", "", ""),
        material("Green", "", "")
    );
    let (scene, _) = load(&body);
    let names: Vec<&str> = (0..4).map(|i| scene.meshes.material_of(i).name.as_str()).collect();
    assert_eq!(names, ["/Red", "/Red", "/Green", "/Green"]);
}

#[test]
fn a_material_without_a_preview_surface_is_told_and_previews_are_the_last_resort() {
    let other = "def Material \"O\" { token outputs:surface.connect = </O/S.outputs:surface>
        def Shader \"S\" { uniform token info:id = \"ND_standard_surface\" } }\n";
    let (scene, report) = load(&(other.to_owned() + &square("Q", "rel material:binding = </O>")));
    assert_eq!(scene.meshes.materials[0].name, "");
    assert!(report.meshes[0].notes[0].contains("without a UsdPreviewSurface are left out: /O"));
    let bindings = "rel material:binding = </O>\nrel material:binding:preview = </M>";
    let (scene, _) = load(&(other.to_owned() + &material("M", "", "") + &square("Q", bindings)));
    assert_eq!(scene.meshes.materials[0].name, "/M");
}

fn instancer(name: &str, prototypes: &str, attributes: &str, below: &str) -> String {
    format!("def PointInstancer \"{name}\" {{ rel prototypes = [{prototypes}]\n{attributes}\n{below} }}\n")
}

#[test]
fn instancers_inside_of_prototypes_multiply_and_those_without_end_are_errors() {
    let two = "int[] protoIndices = [0, 0]\npoint3f[] positions = [(0, 0, 0), (10, 0, 0)]";
    let three = "int[] protoIndices = [0, 0, 0]\npoint3f[] positions = [(0, 0, 0), (0, 10, 0), (0, 20, 0)]";
    // A class is drawn only where it is a prototype.
    let class = format!("class \"Kit\" {{ {} }}", instancer("Inner", "</Kit/Inner/Q>", three, &square("Q", "")));
    let (scene, report) = load(&(class + &instancer("Outer", "</Kit/Inner>", two, "")));
    assert_eq!(scene.meshes.triangles.len(), 12);
    assert_eq!(report.meshes[0].bounds.unwrap().max, DVec3::new(11.0, 21.0, 0.0));
    assert!(message(&instancer("I", "</I>", two, "")).contains("part of itself"));
    let cycle = instancer("A", "</B>", two, "") + &instancer("B", "</A>", two, "");
    assert!(message(&cycle).contains("part of itself"));
    // Each draws the one before it a thousand times: 10^12 squares.
    let many = (0..1000).map(|i| format!("({i}, 0, 0)")).collect::<Vec<_>>().join(", ");
    let many = format!("int[] protoIndices = [{}]\npoint3f[] positions = [{many}]", vec!["0"; 1000].join(", "));
    let chain = square("Q", "")
        + &instancer("I1", "</Q>", &many, "")
        + &instancer("I2", "</I1>", &many, "")
        + &instancer("I3", "</I2>", &many, "")
        + &instancer("I4", "</I3>", &many, "");
    assert!(message(&chain).contains("place fewer"));
}

#[test]
fn lights_have_the_amounts_of_usd_lux() {
    let (scene, report) = load(
        "def Xform \"X\" { float3 xformOp:rotateXYZ = (-90, 0, 0)\nfloat3 xformOp:scale = (2, 2, 2)
        uniform token[] xformOpOrder = [\"xformOp:rotateXYZ\", \"xformOp:scale\"]
        def DistantLight \"Sun\" { float inputs:intensity = 10\nfloat inputs:angle = 60\ncolor3f inputs:color = (1, 0.5, 0) }
        def DistantLight \"Lux\" { float inputs:intensity = 3\nfloat inputs:exposure = 1\nbool inputs:normalize = 1 }
        def SphereLight \"Bulb\" { float inputs:intensity = 7\nfloat inputs:radius = 0.5 }
        def SphereLight \"Power\" { float inputs:intensity = 8\nbool inputs:normalize = 1 }
        def SphereLight \"Spot\" (prepend apiSchemas = [\"ShapingAPI\"]) { float inputs:shaping:cone:angle = 60
            float inputs:shaping:cone:softness = 0.5 }
        def SphereLight \"Off\" { float inputs:intensity = 0 }
        def RectLight \"Panel\" {}\ndef DomeLight \"Sky\" {} }",
    );
    let pi = std::f32::consts::PI;
    let intensities: Vec<f32> = scene.lights.iter().map(|light| light.intensity.0.x).collect();
    // Half angle 30 degrees: pi / 4 of the radiance. Radius 1 m. Power over 4 pi r^2, seen as pi r^2.
    let expected = [10.0 * pi / 4.0, 6.0, 7.0 * pi, 2.0, pi];
    assert_eq!(intensities.len(), expected.len());
    for (found, expected) in intensities.iter().zip(expected) {
        assert!((found / expected - 1.0).abs() < 1e-5, "{intensities:?}");
    }
    let LightKind::Directional { direction } = scene.lights[0].kind else { panic!("{:?}", scene.lights[0]) };
    assert!(direction.abs_diff_eq(Vec3::NEG_Y, 1e-6), "{direction}");
    let LightKind::Spot { direction, inner_cone, outer_cone, .. } = scene.lights[4].kind else { panic!() };
    assert!(direction.abs_diff_eq(Vec3::NEG_Y, 1e-6));
    assert!((inner_cone - pi / 6.0).abs() < 1e-6 && (outer_cone - pi / 3.0).abs() < 1e-6);
    let report = &report.meshes[0];
    assert_eq!((report.lights, report.dark_lights), (5, 1));
    let notes = report.notes.join("\n");
    assert!(notes.contains("RectLight is left out") && notes.contains("DomeLight is left out"), "{notes}");
}

#[test]
fn a_stage_of_splats_and_meshes_brings_both_whichever_list_names_it() {
    let splat = "def ParticleField3DGaussianSplat \"S\" { point3f[] positions = [(1, 2, 3)] }\n";
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("both.usda");
    std::fs::write(&path, stage(&(splat.to_owned() + &square("Q", "")))).unwrap();
    for scene in [load_path(&path), load_scene(&[SplatInput::new(&path)], &[])] {
        let (scene, report) = scene.unwrap();
        assert_eq!((scene.splats.len(), scene.meshes.triangles.len()), (1, 2));
        assert_eq!((report.splats.len(), report.meshes.len()), (1, 1));
    }
    let report = ingest::inspect(&path).unwrap();
    assert_eq!((report.splats.len(), report.meshes.len(), report.meshes[0].triangles), (1, 1, 2));
    std::fs::write(&path, stage(splat)).unwrap();
    assert_eq!(ingest::inspect(&path).unwrap().meshes.len(), 0);
    std::fs::write(&path, stage("def Sphere \"Ball\" {}\ndef Points \"P\" {}")).unwrap();
    let report = &ingest::inspect(&path).unwrap().meshes[0];
    assert_eq!((report.triangles, report.skipped_primitives), (0, 1));
    assert_eq!(report.notes, ["Sphere prims are left out: make them Mesh prims: /Ball"]);
}

#[test]
fn values_over_time_are_read_at_their_first_sample() {
    let body = square("Q", "").replace(
        "point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]",
        "point3f[] points.timeSamples = { 3: [(0, 0, 0), (4, 0, 0), (4, 1, 0), (0, 1, 0)], 5: [(0, 0, 0), (9, 0, 0), (9, 1, 0), (0, 1, 0)] }
        token visibility.timeSamples = { 3: \"inherited\", 5: \"invisible\" }",
    );
    assert_eq!(load(&body).1.meshes[0].bounds.unwrap().max.x, 4.0);
}

#[test]
fn faces_without_area_or_with_points_that_are_no_numbers_are_dropped_and_counted() {
    let with = |points: &str| {
        let body = square("Q", "").replace("[(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]", points);
        load(&body).1.meshes[0].clone()
    };
    assert_eq!(with("[(0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0)]").dropped_triangles.zero_area, 2);
    let report = with("[(0, 0, 0), (1, 0, 0), (1, 1, 0), (nan, 1, 0)]");
    assert_eq!(report.triangles + report.dropped_triangles.non_finite, 2);
    assert!(report.dropped_triangles.non_finite >= 1);
    assert_eq!(with("[(1e38, 0, 0), (0, 1e38, 0), (0, 0, 1e38), (inf, 0, 0)]").dropped_triangles.non_finite, 1);
    let two_corners = square("Q", "").replace("[4]", "[2, 2]");
    assert_eq!(load(&two_corners).1.meshes[0].triangles, 0);
}

#[test]
fn tokens_that_cannot_name_an_attribute_name_none_and_end_the_search() {
    // Found by fuzzing: the openusd crate looks for the parent of a path with a stray brace without end.
    let moved = load(&square("Q", "uniform token[] xformOpOrder = [\"}\", \"xformOp:translate:}{\"]"));
    assert_eq!(moved.1.meshes[0].bounds.unwrap().max.x, 1.0);
    let shader = texture("").replace("\"st\"", "\"}\"");
    let body = material("M", "color3f inputs:diffuseColor.connect = </M/T.outputs:rgb>", &shader) + &square("Q", BOUND);
    let image = std::fs::read(fixture("colours.png")).unwrap();
    let shaded = load_files(&[("colours.png", &image), ("scene.usda", stage(&body).as_bytes())]);
    assert_eq!(shaded.expect("a square without texture coordinates").1.meshes[0].triangles, 2);
}

#[test]
fn faults_are_errors_that_name_prim_and_attribute() {
    let subset = |more: &str| {
        format!(
            "def GeomSubset \"G\" {{ uniform token familyName = \"materialBind\"\nuniform token elementType = \"face\"\n{more} }}"
        )
    };
    let one = "int[] protoIndices = [0]\npoint3f[] positions = [(0, 0, 0)]";
    let place = |attributes: &str| instancer("I", "</I/Q>", attributes, &square("Q", ""));
    let wave: Vec<String> = (0..6000).map(|i| format!("({i}, {}, 0)", i % 2)).collect();
    let wave_indices: Vec<String> = (0..6000).map(|i| i.to_string()).collect();
    for (body, words) in [
        (square("Q", "").replace("[4]", "[5]"), "/Q: faceVertexCounts asks for 5 corners and faceVertexIndices has 4"),
        (square("Q", "").replace("[4]", "[-4]"), "/Q: faceVertexCounts has a negative"),
        (square("Q", "").replace("[0, 1, 2, 3]", "[0, 1, 2, 4]"), "faceVertexIndices has 4; there are 4 points"),
        (square("Q", "").replace("[0, 1, 2, 3]", "[0, 1, -2, 3]"), "faceVertexIndices has -2"),
        (square("Q", "int[] holeIndices = [1]"), "holeIndices has 1"),
        (square("Q", "uniform token orientation = \"up\""), "orientation up"),
        (square("Q", "normal3f[] normals = [(0, 0, 1)]"), "normals has 1 values where 4 are needed"),
        (square("Q", "float[] normals = [1]"), "normals is not an array of 3"),
        (square("Q", "normal3f[] normals = [(0, 0, 1)] (interpolation = \"often\")"), "interpolation 'often'"),
        (
            square("Q", "color3f[] primvars:displayColor = [(0, 0, 1)]\nint[] primvars:displayColor:indices = [7]"),
            "displayColor:indices has 7",
        ),
        (square("Q", &subset("int[] indices = [3]")), "/Q/G: indices has 3; there are 1 faces"),
        (place("int[] protoIndices = [1]\npoint3f[] positions = [(0, 0, 0)]"), "protoIndices has 1; there are 1"),
        (place("int[] protoIndices = [0]"), "no positions"),
        (place(&format!("{one}\nfloat3[] scales = [(1, 1, 1), (2, 2, 2)]")), "scales has 2 elements for 1"),
        (place(&format!("{one}\nint64[] ids = [1, 2]")), "ids has 2"),
        (instancer("I", "</Nowhere>", one, ""), "prototype /Nowhere is not there"),
        (
            format!(
                "def Mesh \"W\" {{ int[] faceVertexCounts = [6000]\nint[] faceVertexIndices = [{}]\npoint3f[] points = [{}] }}",
                wave_indices.join(", "),
                wave.join(", ")
            ),
            "face 0 has 6000 corners and is not convex",
        ),
        (material("M", "float inputs:ior = 0", "") + &square("Q", BOUND), "/M/S: its ior is 0"),
        (material("M", "float inputs:roughness = nan", "") + &square("Q", BOUND), "inputs:roughness is not 1 finite"),
        (material("M", "string inputs:diffuseColor = \"red\"", "") + &square("Q", BOUND), "inputs:diffuseColor"),
        ("def SphereLight \"L\" { float inputs:intensity = -1 }".into(), "/L: its intensity"),
        ("def Xform \"A\" (references = </A>) {}".into(), "stage"),
        ("def Xform \"A\" (references = @absent.usda@) {}".into(), "absent.usda"),
        ("def Xform \"A\" { def Xform \"B\" (references = @../outside.usda@</X>) {} }".into(), "outside.usda"),
    ] {
        let message = message(&body);
        assert!(message.contains(words), "'{words}' is not in: {message}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.usda");
    std::fs::write(&path, stage(&square("Q", ""))).unwrap();
    let named = MeshInput { scene: Some("Main".into()), ..MeshInput::new(&path) };
    assert!(matches!(load_scene(&[], &[named]), Err(Error::Request { .. })));
}

#[test]
fn missing_textures_are_named_and_magenta_only_if_asked() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.usda");
    let shaders = texture("").replace("colours.png", "not there.png");
    let inputs = "color3f inputs:diffuseColor.connect = </M/T.outputs:rgb>";
    std::fs::write(&path, stage(&(material("M", inputs, &shaders) + &square("Q", BOUND)))).unwrap();
    let error = load_path(&path).expect_err("missing");
    assert_eq!(error.exit_code(), 2);
    assert!(error.to_string().contains("'not there.png' of /M/T"), "{error}");
    let allowed = MeshInput { missing_texture: MissingTexture::Magenta, ..MeshInput::new(&path) };
    let (scene, report) = load_scene(&[], &[allowed]).unwrap();
    assert_eq!(scene.meshes.textures[0].image.levels().unwrap()[0].texels, [[255, 0, 255, 255]]);
    assert_eq!(report.meshes[0].replaced_images.len(), 1);
    std::fs::write(folder.path().join("not there.png"), b"no image").unwrap();
    assert!(load_path(&path).expect_err("broken").to_string().contains("neither PNG"));
}

/// Loads versions of a fixture with one to three bytes changed; gives how many still load.
fn flip(name: &str, count: usize, seed: u64) -> usize {
    let bytes = std::fs::read(fixture(name)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    for beside in ["parts.usda", "parts.usdc", "colours.png"] {
        std::fs::copy(fixture(beside), folder.path().join(beside)).unwrap();
    }
    let path = folder.path().join(name);
    with_flipped_bytes(&bytes, count, seed, |broken| {
        std::fs::write(&path, broken).unwrap();
        let loaded = load_path(&path);
        if let Ok((scene, _)) = &loaded {
            assert!(scene.meshes.positions.iter().all(|position| position.is_finite()));
        }
        loaded.is_ok()
    })
}

#[test]
fn flipped_bytes_never_panic() {
    for (name, count) in [("scene.usda", 400), ("parts.usdc", 2000), ("scene.usdz", 400)] {
        let loaded = flip(name, count, 3);
        assert!((count / 50..count).contains(&loaded), "{loaded} of {count} of {name} loaded");
    }
}
