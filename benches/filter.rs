//! How fast cubemaps are prefiltered, and how far they are from brute force.
//!
//! ```text
//! cargo bench --bench filter                       # 256 px, 7 mips, all cores
//! cargo bench --bench filter -- --size 512 --runs 3 --truth 100
//! ```
//!
//! Times are medians over `--runs`. Errors are RMS over `--truth` texels of each mip, over the mean of the truth; the light is a
//! room with a window 20 times and a lamp 100 times as bright as its walls.

#[path = "../tests/common/mod.rs"]
mod common;
#[path = "../tests/light/lobes/mod.rs"]
mod lobes;

use std::time::Instant;

use lobes::{brute_force, ggx, relative_rmse, room, some_texels};
use splatprobe::filter::{Prefilter, RgbCubemap, ShRadiance};
use splatprobe::job::RoughnessCurve;

/// Mips of the chain.
const MIPS: u32 = 7;

fn main() {
    let [size, runs, truth] = parse();
    let source = RgbCubemap::from_fn(size, room);
    println!("{size} px, {MIPS} mips, six faces, {} threads, median of {runs}", rayon::current_num_threads());
    let prefilter = Prefilter::new(source.clone());
    println!("mips of the source        {:8.4} s", median(runs, || drop(Prefilter::new(source.clone()))));
    for curve in [RoughnessCurve::Linear, RoughnessCurve::Filament, RoughnessCurve::Unity, RoughnessCurve::Unreal] {
        let name = format!("GGX chain, {curve:?}");
        println!("{name:25} {:8.4} s", median(runs, || drop(prefilter.chain(curve, MIPS))));
    }
    println!("irradiance, 32 px         {:8.4} s", median(runs, || drop(prefilter.irradiance(32))));
    println!("spherical harmonics, L3   {:8.4} s", median(runs, || drop(ShRadiance::project(&source, 3))));

    println!("| roughness | px | relative RMSE to brute force |\n|---|---|---|");
    for mip in prefilter.chain(RoughnessCurve::Linear, MIPS).into_iter().skip(1) {
        // Narrow lobes are finer than a texel of a small source.
        let steps = if mip.roughness < 0.3 { (192 / size).max(1) } else { 1 };
        let texels = some_texels(&mip.cubemap, truth as usize);
        let error = relative_rmse(&texels, |d| brute_force(&source, d, steps, ggx(mip.roughness)));
        println!("| {:.3} | {} | {:.3} % |", mip.roughness, mip.cubemap.size(), 100.0 * error);
    }
    let texels = some_texels(&prefilter.irradiance(32), truth as usize);
    let error = relative_rmse(&texels, |d| brute_force(&source, d, 1, |cosine| cosine.max(0.0)));
    println!("| irradiance | 32 | {:.3} % |", 100.0 * error);
}

/// Median seconds of a call.
fn median(runs: u32, call: impl Fn()) -> f64 {
    let mut seconds: Vec<f64> = (0..runs)
        .map(|_| {
            let begun = Instant::now();
            call();
            begun.elapsed().as_secs_f64()
        })
        .collect();
    seconds.sort_by(f64::total_cmp);
    seconds[seconds.len() / 2]
}

/// Size, runs and texels to check.
fn parse() -> [u32; 3] {
    let mut values = [256, 5, 24];
    let mut words = std::env::args().skip(1).filter(|word| word != "--bench");
    while let Some(flag) = words.next() {
        let value = words.next().and_then(|value| value.parse().ok());
        let slot = ["--size", "--runs", "--truth"].iter().position(|known| *known == flag);
        match (slot, value) {
            (Some(slot), Some(value)) if value > 0 => values[slot] = value,
            _ => panic!("{flag} needs a number above 0; flags are --size, --runs, --truth"),
        }
    }
    values
}
