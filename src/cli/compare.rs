//! `splatprobe compare`: how much two bakes or two images differ.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;
use splatprobe::Result;
use splatprobe::compare::{compare_bakes, compare_images};

/// Print the error of a bake or an EXR against a reference, as JSON: RMSE, largest difference, PSNR, FLIP.
#[derive(Debug, Args)]
pub struct Compare {
    /// The truth: an EXR file, or a bake by its folder or manifest.
    reference: PathBuf,
    /// What is judged, of the same kind.
    test: PathBuf,
}

impl Compare {
    pub fn run(self) -> Result<String> {
        let is_image = self.reference.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
        let error = match is_image {
            true => json!(compare_images(&self.reference, &self.test)?),
            false => json!(compare_bakes(&self.reference, &self.test)?),
        };
        Ok(super::json(&error))
    }
}
