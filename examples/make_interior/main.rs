//! Writes the generated interior, as the benches trace it, for other programs to read:
//! `cargo run --release --example make_interior -- GAUSSIANS SH_DEGREE FILE.ply`. +Y is up (`--splat-frame raw`).

#[path = "../make_demo/ply.rs"]
mod ply;

use std::fs::File;
use std::io::{BufWriter, Error, Write};

use glam::DQuat;
use splatprobe::generate::{InteriorSettings, interior};

fn main() -> std::io::Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let usage = || Error::other("give GAUSSIANS SH_DEGREE FILE.ply");
    let [gaussians, sh_degree, path] = words.as_slice() else { return Err(usage()) };
    let gaussians = gaussians.parse().map_err(|_| usage())?;
    let sh_degree = sh_degree.parse().map_err(|_| usage())?;
    let splats = interior(&InteriorSettings { gaussians, sh_degree, ..InteriorSettings::default() });
    let mut out = BufWriter::new(File::create(path)?);
    ply::write(&splats, DQuat::IDENTITY, &mut out)?;
    out.flush()
}
