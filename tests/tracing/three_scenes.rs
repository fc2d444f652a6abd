//! Scenes in which tracers are compared: a furnished room, needles, and triangles among Gaussians.

use std::path::Path;

use glam::DVec3;
use splatprobe::ingest::load_scene;
use splatprobe::job::Job;
use splatprobe::scene::Scene;

use crate::common::{add_random_triangles, cloud};

pub struct Sample {
    pub name: &'static str,
    pub scene: Scene,
    /// Where to look from.
    pub origin: DVec3,
    /// Most that production tracers may differ from the reference, root mean square.
    pub rms: f64,
    /// Whether its triangles are masked and blended in a pattern.
    pub patterned: bool,
}

pub fn three_scenes() -> [Sample; 3] {
    let demo = Job::from_file(&Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/demo/demo.json"), None).unwrap();
    let (demo, _) = load_scene(&demo.splats, &demo.meshes).unwrap();
    let extreme = Scene { splats: cloud(20_000, [4e-5, 0.5], 1, 51), ..Scene::default() };
    let mut mixed = Scene { splats: cloud(4000, [0.01, 0.4], 3, 52), ..Scene::default() };
    add_random_triangles(&mut mixed, 200, 53);
    let sample = |name, scene, origin, rms, patterned| Sample { name, scene, origin, rms, patterned };
    [
        sample("demo", demo, DVec3::new(2.5, 1.4, 2.1), 2e-5, false),
        sample("extreme anisotropy", extreme, DVec3::ZERO, 1e-4, false),
        sample("masked and blended triangles", mixed, DVec3::new(0.1, 0.2, -0.3), 2e-5, true),
    ]
}
