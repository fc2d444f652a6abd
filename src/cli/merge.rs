//! `splatprobe merge`: the parts of a bake to one.

use std::path::PathBuf;

use clap::Args;
use splatprobe::{Result, pipeline};

/// Join the parts that `bake --shard I/N` made to one bake, whose manifest's path is printed: the same bytes as of a bake
/// at once.
///
/// All parts must be there once, be of the same version, inputs and settings, and be whole.
#[derive(Debug, Args)]
pub struct Merge {
    /// The parts, by their folders or manifests, in any order.
    #[arg(required = true, value_name = "PART")]
    parts: Vec<PathBuf>,
    /// Folder for the manifest and the probes.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

impl Merge {
    pub fn run(self) -> Result<String> {
        let manifest = pipeline::merge(&self.output, &self.parts)?;
        Ok(format!("{}\n", manifest.display()))
    }
}
