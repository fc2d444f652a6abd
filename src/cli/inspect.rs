//! `splatprobe inspect`: what is in a file.

use std::path::PathBuf;

use clap::Args;
use serde_json::{Value, json};
use splatprobe::{Result, ingest};

/// Print what splat and mesh files hold and what a bake would skip, as a JSON list: one entry for the
/// splats of a file, one for its meshes.
#[derive(Debug, Args)]
pub struct Inspect {
    /// Splat or mesh files; which they are is known by content.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
}

impl Inspect {
    pub fn run(self) -> Result<String> {
        let mut entries = Vec::new();
        for path in &self.files {
            let report = ingest::inspect(path)?;
            entries.extend(report.splats.iter().map(|splats| json!(splats)));
            entries.extend(report.meshes.iter().map(|meshes| json!(meshes)));
        }
        Ok(super::json(&Value::Array(entries)))
    }
}
