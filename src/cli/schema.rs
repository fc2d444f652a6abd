//! `splatprobe schema`: the JSON Schemas of what is read and written.

use clap::{Args, ValueEnum};
use splatprobe::Result;
use splatprobe::bake::ProgressEvent;
use splatprobe::bench::BenchReport;
use splatprobe::job::Job;
use splatprobe::manifest::Manifest;

/// Print the JSON Schema of the job file, of the manifest, of the events of a bake, or of a bench.
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
    /// A line of `bake --progress json`.
    Progress,
    /// The `bench.json` that `bench` writes.
    Bench,
}

impl Schema {
    pub fn run(self) -> Result<String> {
        let schema = match self.of {
            Document::Job => schemars::schema_for!(Job),
            Document::Manifest => schemars::schema_for!(Manifest),
            Document::Progress => schemars::schema_for!(ProgressEvent),
            Document::Bench => schemars::schema_for!(BenchReport),
        };
        Ok(super::json(schema.as_value()))
    }
}
