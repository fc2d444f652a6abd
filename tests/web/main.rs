//! What runs in browsers: the preview page, and the module that chooses and corrects probes.

mod preview;
mod runtime;

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use splatprobe::bake::Silent;
use splatprobe::job::{Job, Placement};
use splatprobe::pipeline;

/// Bakes the calibration's light at two probes; the bake's folder.
fn calibration(folder: &Path, face_size: u32) -> PathBuf {
    let placement = Placement {
        bounds: Some([-1.0, 0.0, -2.0, 5.0, 2.5, 3.0]),
        probes: vec![[0.5, 1.2, 0.0], [3.5, 1.2, 1.0]],
        ..Placement::default()
    };
    let out = folder.join("bake");
    let job = Job { calibration: true, face_size, placement, output: Some(out.clone()), ..Job::default() };
    pipeline::bake(&job, &Silent, &AtomicBool::new(false)).unwrap();
    out
}
