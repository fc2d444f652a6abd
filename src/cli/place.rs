//! `splatprobe place`: a job's probes without their images.

use clap::Args;
use splatprobe::{Result, pipeline};

use super::bake::{Bake, cancelled_by_signal};

/// Place probes without baking them: a manifest without images, whose path is printed, and for adaptive placement a plan
/// (plan.png and plan.svg: walls, triangles, probes, expected error as colour).
///
/// Takes a job and flags as `bake` does; without a grid or positions, probes are placed adaptively.
#[derive(Debug, Args)]
pub struct Place {
    #[command(flatten)]
    bake: Bake,
}

impl Place {
    pub fn run(self) -> Result<String> {
        let mut job = self.bake.into_job()?;
        let placement = &mut job.placement;
        placement.adaptive |= placement.grid.is_none() && placement.probes.is_empty();
        let report = pipeline::place(&job, cancelled_by_signal())?;
        let seconds = report.seconds;
        super::status(format_args!(
            "{} probes in {:.1} s",
            report.probes,
            seconds.load + seconds.build + seconds.place
        ));
        Ok(format!("{}\n", report.manifest.display()))
    }
}
