//! `splatprobe export`: a bake as an engine takes it.

use std::fmt::Write;
use std::path::PathBuf;

use clap::Args;
use splatprobe::{Result, export};

/// Write a bake as an engine takes it: files in its layout and axes, and a script, scene or module that loads them.
///
/// Works from the bake's folder alone. Prints the files that were written.
#[derive(Debug, Args)]
#[command(after_help = engines())]
pub struct Export {
    /// The manifest.json, or the folder that it is in.
    manifest: PathBuf,
    /// What the files are for; see the list below.
    #[arg(long, value_name = "NAME")]
    engine: String,
    /// Folder that the files are written to.
    #[arg(long, short, value_name = "DIR")]
    out: PathBuf,
}

impl Export {
    pub fn run(self) -> Result<String> {
        let export = export::export(&self.manifest, &self.engine, &self.out)?;
        for note in &export.notes {
            super::status(note);
        }
        Ok(export.files.iter().map(|file| format!("{}\n", file.display())).collect())
    }
}

fn engines() -> String {
    let mut list = String::from("Engines:\n");
    for engine in export::ENGINES {
        // Writing to a string does not fail.
        let _ = writeln!(list, "  {:<10}  {}", engine.name, engine.about);
    }
    list
}
