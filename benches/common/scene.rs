//! The scene that benches look at: a file of splats, or the generated interior.

use glam::DVec3;
use splatprobe::generate::{InteriorSettings, ROOM, interior};
use splatprobe::ingest;
use splatprobe::job::SplatInput;
use splatprobe::scene::Scene;

/// The splats of the file, or else the interior.
pub fn scene(splats: Option<&str>, settings: InteriorSettings) -> Scene {
    match splats {
        Some(path) => ingest::load_scene(&[SplatInput::new(path)], &[]).unwrap_or_else(|error| panic!("{error}")).0,
        None => Scene { splats: interior(&settings), ..Scene::default() },
    }
}

/// Where a person's eyes are in the middle of one of the interior's rooms, in metres.
pub fn eye() -> DVec3 {
    DVec3::new(1.5 * ROOM.x, 1.6, 1.5 * ROOM.z)
}
