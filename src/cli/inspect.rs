//! `splatprobe inspect`: what is in a file.

use std::path::{Path, PathBuf};

use clap::Args;
use glam::DVec3;
use serde_json::{Value, json};
use splatprobe::Result;
use splatprobe::ingest::{gltf, inspect_splats};
use splatprobe::job::MeshInput;
use splatprobe::scene::Meshes;

/// Print what splat and mesh files hold and what a bake would skip, as a JSON list.
#[derive(Debug, Args)]
pub struct Inspect {
    /// Splat or glTF files.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
}

impl Inspect {
    pub fn run(self) -> Result<String> {
        let reports = self.files.iter().map(|path| inspect(path)).collect::<Result<Vec<_>>>()?;
        Ok(super::json(&Value::Array(reports)))
    }
}

fn inspect(path: &Path) -> Result<Value> {
    let is_mesh = path.extension().is_some_and(|it| it.eq_ignore_ascii_case("glb") || it.eq_ignore_ascii_case("gltf"));
    if is_mesh {
        let report = gltf::load(&MeshInput::new(path), DVec3::ZERO, &mut Meshes::default())?;
        Ok(json!(report))
    } else {
        Ok(json!(inspect_splats(path)?))
    }
}
