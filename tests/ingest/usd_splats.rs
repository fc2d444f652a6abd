//! ParticleField3DGaussianSplat in USD stages: the schema's rules, transforms, composition inside a folder, broken files.

use std::path::{Path, PathBuf};

use crate::files::with_flipped_bytes;
use glam::{DVec3, Vec3};
use splatprobe::Error;
use splatprobe::ingest::{SceneReport, load_scene};
use splatprobe::job::{Frame, Order, SplatInput};
use splatprobe::scene::{Scene, SplatEncoding, sh};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/usd").join(name)
}

fn load_path(path: &Path) -> splatprobe::Result<(Scene, SceneReport)> {
    load_scene(&[SplatInput::new(path)], &[])
}

/// Loads the last of `files`, all of them in one folder.
fn load_files(files: &[(&str, &[u8])]) -> splatprobe::Result<(Scene, SceneReport)> {
    let folder = tempfile::tempdir().unwrap();
    let inside = folder.path().join("stage");
    std::fs::create_dir(&inside).unwrap();
    for (name, bytes) in files {
        let path = inside.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    load_path(&inside.join(files.last().unwrap().0))
}

fn load_text(text: &str) -> splatprobe::Result<(Scene, SceneReport)> {
    load_files(&[("scene.usda", text.as_bytes())])
}

/// A stage in metres whose prims are `body`.
fn stage(body: &str) -> String {
    format!("#usda 1.0\n(\n    metersPerUnit = 1\n    upAxis = \"Y\"\n)\n{body}\n")
}

/// A splat prim of one particle at x, with more attributes or prims.
fn splat(name: &str, x: f64, more: &str) -> String {
    format!("def ParticleField3DGaussianSplat \"{name}\" {{ point3f[] positions = [({x}, 0, 0)]\n{more}\n}}\n")
}

fn means(body: &str) -> Vec<Vec3> {
    load_text(&stage(body)).unwrap().0.splats.means
}

fn message(body: &str) -> String {
    load_text(&stage(body)).expect_err("broken").to_string()
}

#[test]
fn files_of_openusds_own_library_give_the_scene_that_was_written() {
    for (name, tolerance) in [("float.usdc", 1e-6), ("half.usdc", 1e-3), ("float.usda", 1e-6), ("float.usdz", 1e-6)] {
        let (scene, report) = load_path(&fixture(name)).unwrap();
        let splats = &scene.splats;
        for (i, mean) in splats.means.iter().enumerate() {
            // A quarter turn about Z, 100 units along X, centimetres, and Z up to Y up.
            let i = i as f32;
            let expected = Vec3::new(0.8 + 0.01 * i, 0.05 + 0.02 * i, -0.1 * i);
            assert!((*mean - expected).length() < tolerance, "{name}: {mean} is not {expected}");
        }
        assert_eq!(splats.opacities, [0.25, 0.5, 0.75, 1.0], "{name}");
        let covariance = splats.covariance(0);
        for (axis, expected) in [4e-4, 16e-4, 1e-4].into_iter().enumerate() {
            assert!((covariance.col(axis)[axis] - expected).abs() < 1e-8, "{name}: {covariance}");
        }
        // The second particle's axes are x -> y -> z -> x.
        let covariance = splats.covariance(1);
        for (axis, expected) in [4e-4, 9e-4, 25e-4].into_iter().enumerate() {
            assert!((covariance.col(axis)[axis] - expected).abs() < 1e-8, "{name}: {covariance}");
        }
        for i in 0..4 {
            let p = i as f32;
            let written = |k: f32| [p + 0.125 * k, p - 0.25 * k, 0.5 * k];
            let coefficients: Vec<f32> =
                (0..3).flat_map(|channel| [0.0, 1.0, 2.0, 3.0].map(|k| written(k)[channel])).collect();
            for d in [Vec3::X, Vec3::Y, Vec3::new(0.6, -0.48, 0.64)] {
                let expected = sh::evaluate(1, &coefficients, d);
                let found = sh::evaluate(1, splats.sh_of(i), Vec3::new(-d.y, d.z, -d.x));
                assert!((found - expected).abs().max_element() < 1e-5, "{name}, {i}, {d}: {found} {expected}");
            }
        }
        let report = &report.splats[0];
        assert_eq!((report.kept, report.sh_degree, report.frame), (4, 1, Frame::RFU));
        assert_eq!((report.order, report.encoding), (Some(Order::RayHitDistance), SplatEncoding::SrgbDisplay));
    }
}

#[test]
fn a_prim_with_positions_alone_has_the_schemas_fallbacks() {
    let (scene, report) = load_text(&stage(&splat("A", 3.0, ""))).unwrap();
    let splats = &scene.splats;
    assert_eq!((splats.opacities[0], splats.standard_deviations(0)), (1.0, DVec3::ONE));
    assert_eq!(sh::evaluate(splats.sh_degree, splats.sh_of(0), Vec3::X), Vec3::splat(0.5));
    // The fallback zDepth needs a camera.
    assert_eq!((report.splats[0].sh_degree, report.splats[0].order), (0, None));
    // Without metersPerUnit a stage is in centimetres.
    let (scene, _) = load_text(&format!("#usda 1.0\n{}", splat("A", 3.0, ""))).unwrap();
    assert!((scene.splats.means[0].x - 0.03).abs() < 1e-7);
}

#[test]
fn longer_arrays_are_cut_shorter_ones_ignored_and_float_wins_over_half() {
    let more =
        "float[] opacities = [0.5, 0.25]\nfloat3[] scales = []\nquatf[] orientations = [(0, 0, 0, 2), (1, 0, 0, 0)]
        half[] opacitiesh = [0.125]\nhalf3[] scalesh = [(2, 3, 4)]";
    let (scene, _) = load_text(&stage(&splat("A", 0.0, more))).unwrap();
    assert_eq!((scene.splats.opacities[0], scene.splats.standard_deviations(0)), (0.5, DVec3::ONE));
    let (scene, _) = load_text(&stage(&splat("A", 0.0, "half3[] scalesh = [(2, 3, 4)]"))).unwrap();
    assert!((scene.splats.standard_deviations(0) - DVec3::new(2.0, 3.0, 4.0)).length() < 1e-6);
    // Degree 3, the fallback, needs 16 coefficients: 15 are ignored.
    for (count, degree) in [(15, 0), (16, 3), (17, 3)] {
        let coefficients = vec!["(1, 1, 1)"; count].join(", ");
        let more = format!("float3[] radiance:sphericalHarmonicsCoefficients = [{coefficients}]");
        assert_eq!(load_text(&stage(&splat("A", 0.0, &more))).unwrap().1.splats[0].sh_degree, degree, "{count}");
    }
}

#[test]
fn transform_operations_apply_from_the_last_to_the_first_through_the_hierarchy() {
    let splat = splat("S", 1.0, "");
    let close = |body: &str, expected: [f64; 3]| {
        let found = means(body)[0];
        assert!((found.as_dvec3() - DVec3::from(expected)).length() < 1e-6, "{found} is not {expected:?}: {body}");
    };
    let under = |ops: &str, order: &str| {
        format!("def Xform \"P\" {{ {ops}\nuniform token[] xformOpOrder = [{order}]\n{splat} }}")
    };
    let translate = "double3 xformOp:translate = (0, 5, 0)";
    close(&under(translate, "\"xformOp:translate\""), [1.0, 5.0, 0.0]);
    let scaled = format!("{translate}\nfloat3 xformOp:scale = (2, 2, 2)");
    close(&under(&scaled, "\"xformOp:translate\", \"xformOp:scale\""), [2.0, 5.0, 0.0]);
    close(&under(&scaled, "\"xformOp:scale\", \"xformOp:translate\""), [2.0, 10.0, 0.0]);
    // About X leaves x; then about Y takes x to -z; then about Z leaves -z.
    let euler = "float3 xformOp:rotateXYZ = (90, 90, 90)";
    close(&under(euler, "\"xformOp:rotateXYZ\""), [0.0, 0.0, -1.0]);
    // About Z takes x to y, about Y leaves y, about X takes y to z.
    close(&under("float3 xformOp:rotateZYX = (90, 90, 90)", "\"xformOp:rotateZYX\""), [0.0, 0.0, 1.0]);
    close(&under("quatf xformOp:orient = (0, 0, 1, 0)", "\"xformOp:orient\""), [-1.0, 0.0, 0.0]);
    let matrix = "matrix4d xformOp:transform = ((0, 1, 0, 0), (-1, 0, 0, 0), (0, 0, 1, 0), (7, 8, 9, 1))";
    close(&under(matrix, "\"xformOp:transform\""), [7.0, 9.0, 9.0]);
    let pivot = "double3 xformOp:translate:pivot = (1, 0, 0)\nfloat xformOp:rotateZ = 90";
    let order = "\"xformOp:translate:pivot\", \"xformOp:rotateZ\", \"!invert!xformOp:translate:pivot\"";
    close(&under(pivot, order), [1.0, 0.0, 0.0]);
    // A prim that resets the stack stands in the stage's coordinates.
    let reset = "def Xform \"Q\" { uniform token[] xformOpOrder = [\"!resetXformStack!\"]";
    close(
        &format!(
            "def Xform \"P\" {{ {translate}\nuniform token[] xformOpOrder = [\"xformOp:translate\"]\n{reset}\n{splat} }} }}"
        ),
        [1.0, 0.0, 0.0],
    );
    assert!(message(&under("float3 xformOp:shear = (1, 2, 3)", "\"xformOp:shear\"")).contains("xformOp:shear"));
    assert!(message(&under("float3 xformOp:scale = (1, 0, 3)", "\"xformOp:scale\"")).contains("/P/S"));
}

#[test]
fn only_what_is_defined_active_visible_and_rendered_is_read() {
    let prims = [
        splat("Seen", 1.0, ""),
        splat("Hidden", 2.0, "token visibility = \"invisible\""),
        splat("Guide", 3.0, "uniform token purpose = \"guide\""),
        splat("Render", 4.0, "uniform token purpose = \"render\""),
        splat("Inactive", 5.0, "").replacen("\"Inactive\"", "\"Inactive\" (active = false)", 1),
        splat("Class", 6.0, "").replacen("def", "class", 1),
        format!("def Xform \"Off\" {{ token visibility = \"invisible\"\n{} }}", splat("Below", 7.0, "")),
        format!("def Xform \"Proxy\" {{ uniform token purpose = \"proxy\"\n{} }}", splat("Below", 8.0, "")),
        "def Mesh \"M\" { point3f[] points = [(0, 0, 0)] }".into(),
    ];
    let mut xs: Vec<f32> = means(&prims.concat()).iter().map(|mean| mean.x).collect();
    xs.sort_by(f32::total_cmp);
    assert_eq!(xs, [1.0, 4.0]);
    assert!(message(&prims[1]).contains("no particles"));
}

#[test]
fn references_inside_the_folder_compose_and_others_are_errors() {
    let library = stage(&splat("Lib", 1.0, ""));
    let placed = |path: &str| {
        let refer = |name: &str, x: i32| {
            format!(
                "def Xform \"{name}\" (references = @{path}@</Lib>) {{ double3 xformOp:translate = ({x}, 0, 0)\n\
                 uniform token[] xformOpOrder = [\"xformOp:translate\"] }}\n"
            )
        };
        // The referring prim's own type wins, so that the library's prim is taken below it.
        stage(&(refer("A", 10) + &refer("B", 20)).replace("def Xform", "def"))
    };
    let files = |reference: &str| {
        load_files(&[("sub/lib.usda", library.as_bytes()), ("scene.usda", placed(reference).as_bytes())])
    };
    let (scene, report) = files("./sub/lib.usda").unwrap();
    let mut xs: Vec<f32> = scene.splats.means.iter().map(|mean| mean.x).collect();
    xs.sort_by(f32::total_cmp);
    assert_eq!((xs, report.splats[0].count), (vec![11.0, 21.0], 2));
    for outside in ["../outside.usda", "/etc/passwd", "./absent.usda", "../stage/../../x.usda"] {
        let error = files(outside).expect_err(outside);
        assert!(matches!(error, Error::Invalid { .. }), "{outside}: {error}");
    }
}

#[test]
fn time_sampled_attributes_are_read_at_their_first_sample() {
    let body = "def ParticleField3DGaussianSplat \"A\" { point3f[] positions.timeSamples = \
        { 1: [(4, 0, 0)], 2: [(5, 0, 0)] } }";
    assert_eq!(means(body), [Vec3::new(4.0, 0.0, 0.0)]);
}

#[test]
fn faults_are_errors_that_name_prim_and_attribute() {
    for (more, words) in [
        ("float[] scales = [1]", "/A: scales"),
        ("double[] opacities = [1]", "/A: opacities"),
        ("uniform int radiance:sphericalHarmonicsDegree = 9", "degree 9"),
        ("uniform int radiance:sphericalHarmonicsDegree = -1", "degree -1"),
        ("string visibility = \"inherited\"", "visibility"),
        (
            "uniform token[] xformOpOrder = [\"xformOp:translate\"]\nstring xformOp:translate = \"x\"",
            "xformOp:translate",
        ),
    ] {
        let message = message(&splat("A", 0.0, more));
        assert!(message.contains(words), "'{words}' is not in: {message}");
    }
    for (metadata, words) in [("metersPerUnit = 0", "metersPerUnit"), ("upAxis = \"X\"", "upAxis")] {
        let text = format!("#usda 1.0\n(\n    {metadata}\n)\n{}", splat("A", 0.0, ""));
        let message = load_text(&text).expect_err("broken").to_string();
        assert!(message.contains(words), "'{words}' is not in: {message}");
    }
    assert!(load_files(&[("scene.bin", stage("").as_bytes())]).expect_err("name").to_string().contains("rename"));
    let (_, report) =
        load_text(&stage(&format!("{}{}", splat("A", 0.0, ""), splat("B", f64::NAN, ""))).replace("NaN", "nan"))
            .unwrap();
    assert_eq!(report.splats[0].dropped.non_finite, 1);
}

#[test]
fn stages_that_multiply_or_nest_without_end_are_errors() {
    // Each class refers to the one before it twice: 2^40 prims.
    let mut doubling = splat("L0", 0.0, "");
    for level in 1..40 {
        let below = level - 1;
        doubling += &format!(
            "def \"L{level}\" {{ def \"A\" (references = </L{below}>) {{}} def \"B\" (references = </L{below}>) {{}} }}\n"
        );
    }
    let error = load_text(&stage(&doubling)).expect_err("doubling");
    assert!(matches!(error, Error::Unsupported { .. } | Error::Invalid { .. }), "{error}");
    let nested = "def \"A\" {".repeat(100_000);
    assert!(message(&nested).contains("nested"));
    assert!(message("def \"A}b\" { def \"B\" {} }").contains("no name"));
    let _ = load_text(&stage("def \"A\" (references = </A}b>) {}"));
    let _ = load_text(&stage("def \"A\" (variants = { string \"x\" = \"}a{\" }) {}"));
    let itself = "def \"A\" (references = </A>) {}";
    assert!(load_text(&stage(itself)).is_err());
}

#[test]
fn every_truncation_of_a_crate_and_of_a_package_is_an_error_and_text_never_panics() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["float.usdc", "float.usdz", "float.usda"] {
        let bytes = std::fs::read(fixture(name)).unwrap();
        let path = folder.path().join(name);
        for length in 0..bytes.len() {
            std::fs::write(&path, &bytes[..length]).unwrap();
            let loaded = load_path(&path).is_ok();
            assert!(!loaded || name == "float.usda" && length + 3 > bytes.len(), "{length} bytes of {name} load");
        }
    }
}

/// Loads 10,000 versions of a fixture with one to three bytes changed; gives how many still load.
fn flip(name: &str, seed: u64) -> usize {
    let bytes = std::fs::read(fixture(name)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    with_flipped_bytes(&bytes, 10_000, seed, |broken| {
        std::fs::write(&path, broken).unwrap();
        let loaded = load_path(&path);
        if let Ok((scene, _)) = &loaded {
            assert!(scene.splats.means.iter().all(|mean| mean.is_finite()));
            assert!(scene.splats.unit_from_world.iter().all(|matrix| matrix.is_finite()));
        }
        loaded.is_ok()
    })
}

#[test]
fn flipped_bytes_of_a_crate_never_panic() {
    let loaded = flip("float.usdc", 1);
    assert!((500..9500).contains(&loaded), "{loaded} of 10000 loaded: the changes test only one side");
}

#[test]
fn flipped_bytes_of_text_never_panic() {
    let loaded = flip("float.usda", 2);
    assert!((100..9500).contains(&loaded), "{loaded} of 10000 loaded: the changes test only one side");
}

#[test]
fn counts_that_promise_more_than_a_crate_holds_are_errors_before_anything_is_allocated() {
    let bytes = std::fs::read(fixture("float.usdc")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("float.usdc");
    for at in 16..bytes.len() - 8 {
        let mut broken = bytes.clone();
        broken[at..at + 8].copy_from_slice(&(u64::MAX >> 12).to_le_bytes());
        std::fs::write(&path, &broken).unwrap();
        let _ = load_path(&path);
    }
}
