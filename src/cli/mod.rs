//! The command line: declares flags, maps them to library calls, reports. One file per subcommand.

mod bake;
mod bench;
mod cache;
mod compare;
mod export;
mod inspect;
mod merge;
mod place;
mod preview;
mod progress;
mod schema;
mod verify;

use std::io::Write;

use clap::{Parser, Subcommand};
use splatprobe::Result;

/// Bakes HDR reflection probes from 3D Gaussian splat scenes and the glTF meshes placed in them.
///
/// Status goes to stderr, data to stdout. Exit codes: 0 done, 1 the bake failed, 2 the request or an input is wrong, 3 the
/// time budget was over before all probes were baked.
#[derive(Debug, Parser)]
#[command(version)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Bake(Box<bake::Bake>),
    Place(Box<place::Place>),
    Merge(merge::Merge),
    Cache(cache::Cache),
    Inspect(inspect::Inspect),
    Verify(verify::Verify),
    Compare(compare::Compare),
    Bench(bench::Bench),
    Export(export::Export),
    Preview(preview::Preview),
    Schema(schema::Schema),
}

impl Cli {
    /// Runs the subcommand; the answer is its data for stdout.
    pub fn run(self) -> Result<String> {
        match self.command {
            Command::Bake(command) => command.run(),
            Command::Place(command) => command.run(),
            Command::Merge(command) => command.run(),
            Command::Cache(command) => command.run(),
            Command::Inspect(command) => command.run(),
            Command::Verify(command) => command.run(),
            Command::Compare(command) => command.run(),
            Command::Bench(command) => command.run(),
            Command::Export(command) => command.run(),
            Command::Preview(command) => command.run(),
            Command::Schema(command) => command.run(),
        }
    }
}

/// JSON for people and programs: indented, with a final newline.
fn json(value: &serde_json::Value) -> String {
    format!("{value:#}\n")
}

/// A line of status on stderr. Where nobody reads it any more, the work goes on.
pub fn status(line: impl std::fmt::Display) {
    let _ = writeln!(std::io::stderr(), "{line}");
}
