//! `splatprobe schema`: the JSON Schemas of what is read and written.

use clap::{Args, ValueEnum};
use splatprobe::Result;
use splatprobe::job::Job;
use splatprobe::manifest::Manifest;

/// Print the JSON Schema of the job file or of the manifest.
#[derive(Debug, Args)]
pub struct Schema {
    /// Which one.
    of: Document,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Document {
    /// The file that `bake` reads.
    Job,
    /// The `manifest.json` that `bake` writes.
    Manifest,
}

impl Schema {
    pub fn run(self) -> Result<String> {
        let schema = match self.of {
            Document::Job => schemars::schema_for!(Job),
            Document::Manifest => schemars::schema_for!(Manifest),
        };
        Ok(super::json(schema.as_value()))
    }
}
