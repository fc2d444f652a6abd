//! One scene, written in every format by other people's encoders, gives one cubemap.
//!
//! The files are in `tests/fixtures/one_scene`; `regenerate.sh` there makes them from `examples/make_one_scene`.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use glam::DVec3;
use splatprobe::bake::{BakeSettings, Cubemap, Silent, bake_probes};
use splatprobe::bvh::Bvh;
use splatprobe::ingest::load_scene;
use splatprobe::job::{Frame, SplatInput};
use splatprobe::place;
use splatprobe::scene::colour::linear_to_srgb;
use splatprobe::scene::{Scene, sh};
use splatprobe::shade::UnlitSurfaces;
use splatprobe::trace::{BeamTracer, TraceSettings};

// Its `main` is the example's.
#[expect(dead_code)]
#[path = "../../examples/make_one_scene/main.rs"]
mod make_one_scene;

/// A file, and how near its bake must come to the PLY's.
struct Case {
    file: &'static str,
    /// Bands that the format holds; the PLY is baked with as many.
    degree: u8,
    /// What the PLY's axes point at for the file's writer.
    ply_frame: &'static str,
    /// Peak signal to noise in display space, in decibels.
    least_psnr: f64,
}

/// splat-transform takes PLY's axes for left, down, back when it writes glTF.
const CASES: [Case; 10] = [
    Case { file: "scene.compressed.ply", degree: 3, ply_frame: "rdf", least_psnr: 35.0 },
    Case { file: "scene.sog", degree: 3, ply_frame: "rdf", least_psnr: 35.0 },
    Case { file: "scene-v3.spz", degree: 3, ply_frame: "rdf", least_psnr: 35.0 },
    Case { file: "scene-v4.spz", degree: 3, ply_frame: "rdf", least_psnr: 35.0 },
    Case { file: "scene-0.ksplat", degree: 2, ply_frame: "rdf", least_psnr: 60.0 },
    Case { file: "scene-1.ksplat", degree: 2, ply_frame: "rdf", least_psnr: 60.0 },
    Case { file: "scene-2.ksplat", degree: 2, ply_frame: "rdf", least_psnr: 50.0 },
    Case { file: "scene.glb", degree: 3, ply_frame: "ldb", least_psnr: 80.0 },
    Case { file: "scene.usda", degree: 3, ply_frame: "rdf", least_psnr: 80.0 },
    Case { file: "scene.usdc", degree: 3, ply_frame: "rdf", least_psnr: 80.0 },
];

/// No mistake of a reader may come as near as this.
const LEAST_OF_ALL: f64 = 35.0;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/one_scene").join(name)
}

fn load(name: &str, frame: Option<&str>) -> Scene {
    let frame = frame.map(|frame| frame.parse::<Frame>().expect("a frame"));
    load_scene(&[SplatInput { frame, ..SplatInput::new(fixture(name)) }], &[]).expect(name).0
}

/// Two cubemaps from different places, in display space.
fn bake(mut scene: Scene) -> Vec<f64> {
    let bvh = Bvh::build(&mut scene);
    let surfaces = UnlitSurfaces::new(&scene.meshes);
    let tracer = BeamTracer::new(&scene, &bvh, &surfaces, TraceSettings::default());
    let positions = [DVec3::new(0.3, -0.2, 0.1), DVec3::new(-0.7, 0.5, 0.6)];
    let probes = place::list(&positions, None, 0.0).expect("probes");
    let settings = BakeSettings { face_size: 32, samples: 1, distance: false, edge_texels: false };
    let cubemaps = Mutex::new([const { None::<Cubemap> }; 2]);
    bake_probes(&tracer, &scene, &probes, &settings, &Silent, &AtomicBool::new(false), |i, cubemap, _| {
        cubemaps.lock().expect("no panic")[i] = Some(cubemap);
        Ok(())
    })
    .expect("bakes");
    let cubemaps = cubemaps.into_inner().expect("no panic").map(|cubemap| cubemap.expect("baked"));
    let texels = cubemaps.iter().flat_map(|cubemap| &cubemap.texels);
    texels.flat_map(|texel| [texel[0], texel[1], texel[2]]).map(|linear| f64::from(linear_to_srgb(linear))).collect()
}

/// Peak signal to noise of two images, in decibels.
fn psnr(reference: &[f64], test: &[f64]) -> f64 {
    assert_eq!(reference.len(), test.len());
    let squares: f64 = reference.iter().zip(test).map(|(a, b)| (a - b).powi(2)).sum();
    -10.0 * (squares / reference.len() as f64).log10()
}

fn bake_of_ply(frame: &str, degree: u8) -> Vec<f64> {
    let mut scene = load("scene.ply", Some(frame));
    scene.splats.lower_sh_degree(degree);
    bake(scene)
}

#[test]
fn every_format_bakes_to_what_the_ply_bakes_to() {
    let mut faults = Vec::new();
    for Case { file, degree, ply_frame, least_psnr } in CASES {
        let scene = load(file, None);
        assert_eq!((scene.splats.len(), scene.splats.sh_degree), (1000, degree), "{file}");
        let found = psnr(&bake_of_ply(ply_frame, degree), &bake(scene));
        println!("{file}: {found:.1} dB");
        if found < least_psnr {
            faults.push(format!("{file}: {found:.1} dB, not {least_psnr}"));
        }
    }
    assert!(faults.is_empty(), "{faults:?}");
}

#[test]
fn the_scene_fills_every_probe_and_depends_on_the_direction() {
    let image = bake_of_ply("rdf", 3);
    assert!(image.iter().all(|value| (0.0..1.5).contains(value)));
    let mean = image.iter().sum::<f64>() / image.len() as f64;
    assert!((0.3..0.7).contains(&mean), "{mean}");
    assert!(psnr(&image, &bake_of_ply("rdf", 0)) < 20.0);
    assert!(psnr(&image, &bake_of_ply("rdf", 2)) < 28.0);
}

#[test]
fn any_other_frame_would_fail() {
    let image = bake_of_ply("rdf", 3);
    let axes = ["rl", "ud", "fb"];
    let orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    let frames = orders.into_iter().flat_map(|order| {
        let letter = move |place: usize, signs: usize| char::from(axes[order[place]].as_bytes()[signs >> place & 1]);
        (0..8).map(move |signs| (0..3).map(|place| letter(place, signs)).collect::<String>())
    });
    let wrong: Vec<String> = frames.filter(|frame| frame != "rdf").collect();
    assert_eq!(wrong.len(), 47);
    for frame in wrong {
        let found = psnr(&image, &bake_of_ply(&frame, 3));
        assert!(found < LEAST_OF_ALL - 5.0, "{frame}: {found:.1} dB");
    }
}

#[test]
fn any_slip_in_spherical_harmonics_would_fail() {
    for degree in [2, 3] {
        let image = bake_of_ply("rdf", degree);
        let count = sh::coefficient_count(degree);
        let slipped = |slip: &dyn Fn(&mut [f32])| {
            let mut scene = load("scene.ply", Some("rdf"));
            scene.splats.lower_sh_degree(degree);
            scene.splats.sh.chunks_exact_mut(count).for_each(slip);
            psnr(&image, &bake(scene))
        };
        for k in 1..count {
            let sign = slipped(&|channel| channel[k] = -channel[k]);
            assert!(sign < LEAST_OF_ALL, "sign of coefficient {k}: {sign:.1} dB");
            let order = slipped(&|channel| channel.swap(k, k % (count - 1) + 1));
            assert!(order < LEAST_OF_ALL, "coefficients {k} and {} for each other: {order:.1} dB", k % (count - 1) + 1);
        }
    }
}

#[test]
fn colours_that_do_not_turn_with_their_gaussians_would_fail() {
    let image = bake_of_ply("rdf", 3);
    let mut scene = load("scene.ply", Some("rdf"));
    // What a reader gives that mirrors or turns positions alone: the coefficients of another frame.
    for frame in ["ruf", "ldf", "rub", "ldb"] {
        scene.splats.sh = load("scene.ply", Some(frame)).splats.sh;
        let found = psnr(&image, &bake(scene.clone()));
        assert!(found < LEAST_OF_ALL - 5.0, "{frame}: {found:.1} dB");
    }
}

#[test]
fn the_example_writes_the_committed_scene() {
    let floats = |bytes: &[u8]| -> Vec<f32> {
        let end = bytes.windows(11).position(|window| window == b"end_header\n").expect("a header") + 11;
        bytes[end..].chunks_exact(4).map(|f| f32::from_le_bytes([f[0], f[1], f[2], f[3]])).collect()
    };
    let (committed, made) = (std::fs::read(fixture("scene.ply")).expect("a file"), make_one_scene::ply());
    let (committed, made) = (floats(&committed), floats(&made));
    assert_eq!(committed.len(), 1000 * 59);
    assert_eq!(committed.len(), made.len());
    // Platforms' logarithms and sines may differ in the last bits.
    assert!(committed.iter().zip(&made).all(|(a, b)| (a - b).abs() < 1e-5));
}
