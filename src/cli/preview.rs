//! `splatprobe preview`: a bake as one HTML file.

use std::path::PathBuf;

use clap::Args;
use splatprobe::{Result, preview};

/// Write one HTML file that shows a bake: plan, cubemaps, balls that reflect, statistics.
///
/// Works from the bake's folder alone. The page opens in any browser with WebGL 2, without a network.
#[derive(Debug, Args)]
pub struct Preview {
    /// The manifest.json, or the folder that it is in.
    manifest: PathBuf,
    /// The file to write.
    #[arg(long, short, value_name = "FILE.html")]
    out: PathBuf,
}

impl Preview {
    pub fn run(self) -> Result<String> {
        preview::write(&self.manifest, &self.out)?;
        Ok(String::new())
    }
}
