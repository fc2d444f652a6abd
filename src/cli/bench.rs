//! `splatprobe bench`: run time against error.

use std::io::ErrorKind;
use std::path::PathBuf;

use clap::Args;
use splatprobe::bench::{BenchSettings, Source, bench};
use splatprobe::job::parse_numbers;
use splatprobe::{Error, Result};

/// Measure what each setting costs and what it is worth on a scene: run time against error, as a table on stdout and as
/// bench.json, bench.md and bench.svg in the output folder.
///
/// One setting at a time is changed about those of the job (without a job file: the defaults): tracer, face size, samples,
/// footprint, t-cutoff, and with meshes the surfaces; the presets and the samples of prefiltering besides. Errors are against
/// `reference` along single rays, against 16 x 16 rays per texel as areas, and against many paths; what no other setting
/// beats in both time and error is marked.
#[derive(Debug, Args)]
pub struct Bench {
    /// A splat or mesh file, a job file (for a scene of several inputs), or interior:N for a generated building of N
    /// Gaussians. Each is a scene of its own.
    #[arg(required = true, value_name = "SCENE")]
    scenes: Vec<String>,
    /// Folder for bench.json, bench.md and bench.svg.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Probe position in metres; repeat it for more [default: the job file's; else one free place near the middle].
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_numbers::<3>, allow_hyphen_values = true)]
    probe: Vec<[f64; 3]>,
    /// Runs of which the median time is taken.
    #[arg(long, value_name = "N", default_value_t = 3)]
    repeats: u32,
    /// Smaller faces and fewer values: under a minute for a scene of 300 000 Gaussians on two cores.
    #[arg(long)]
    quick: bool,
    /// Spherical harmonics degree of interior:N.
    #[arg(long, value_name = "DEGREE", default_value_t = 3)]
    sh: u8,
}

impl Bench {
    pub fn run(self) -> Result<String> {
        let sources = self.scenes.iter().map(|scene| Source::parse(scene, self.sh)).collect::<Result<Vec<_>>>()?;
        // Measuring takes minutes; what stands in the way of the folder is told before.
        if self.output.is_file() {
            return Err(Error::write(&self.output, ErrorKind::NotADirectory.into()));
        }
        let settings = BenchSettings { probes: self.probe, repeats: self.repeats, quick: self.quick };
        let words: Vec<String> = std::env::args().skip(1).collect();
        let command = format!("splatprobe {}", words.join(" "));
        let report = bench(&sources, &settings, command, &|line| super::status(line))?;
        report.write(&self.output)?;
        Ok(report.markdown())
    }
}
