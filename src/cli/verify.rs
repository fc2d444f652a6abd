//! `splatprobe verify`: whether a bake on disk is what its manifest says.

use std::path::PathBuf;

use clap::Args;
use splatprobe::{Error, Result, manifest};

/// Check a bake: manifest, presence, sizes and hashes of its files, and that their values are finite.
///
/// Prints every problem on stderr; the exit code is 2 when there is any.
#[derive(Debug, Args)]
pub struct Verify {
    /// The manifest.json, or the folder that it is in.
    manifest: PathBuf,
}

impl Verify {
    pub fn run(self) -> Result<String> {
        let path = manifest::path_of(&self.manifest);
        let problems = manifest::verify(&path)?;
        for problem in &problems {
            super::status(format_args!("splatprobe: {problem}"));
        }
        match problems.len() {
            0 => Ok(String::new()),
            count => Err(Error::invalid(path, "bake", format!("{count} problems; bake again"))),
        }
    }
}
