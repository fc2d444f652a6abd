//! Writes the demo's inputs: `cargo run --example make_demo [-- FOLDER]`, by default into `pipelines/demo`.

mod lamp;
mod ply;

use std::path::{Path, PathBuf};

use glam::DQuat;
use splatprobe::generate::{InteriorSettings, interior};

/// Few Gaussians, so that the file is small; larger ones than a capture's, so that the walls have no holes.
const ROOMS: InteriorSettings =
    InteriorSettings { gaussians: 52_000, rooms: [2, 1], joined: &[], sh_degree: 0, seed: 1, gaussian_size: 1.6 };

/// Half a turn about X: from +Y up, +Z back to the trainers' +Y down, +Z forward.
const RIGHT_DOWN_FORWARD: DQuat = DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0);

fn main() -> std::io::Result<()> {
    let default = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/pipelines/demo"));
    write(&std::env::args_os().nth(1).map_or(default, PathBuf::from))
}

/// Writes `demo.ply` and `lamp.glb` into `folder`.
pub fn write(folder: &Path) -> std::io::Result<()> {
    let mut bytes = Vec::new();
    ply::write(&interior(&ROOMS), RIGHT_DOWN_FORWARD, &mut bytes)?;
    std::fs::write(folder.join("demo.ply"), bytes)?;
    std::fs::write(folder.join("lamp.glb"), lamp::glb())
}
