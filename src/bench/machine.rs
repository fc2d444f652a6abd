//! What a bench ran on.

use super::Machine;
use crate::trace::Level;

/// This machine, with so many threads at work.
pub(super) fn this(threads: usize) -> Machine {
    Machine {
        cpu: cpu_model().unwrap_or_else(|| std::env::consts::ARCH.into()),
        system: std::env::consts::OS.into(),
        cores: std::thread::available_parallelism().map_or(1, usize::from),
        threads,
        level: Level::best().name().into(),
        build: if cfg!(debug_assertions) { "development" } else { "release" }.into(),
    }
}

/// As Linux tells it; other systems do not in a file.
fn cpu_model() -> Option<String> {
    let cpuinfo = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let (_, model) = cpuinfo.lines().find(|line| line.starts_with("model name"))?.split_once(':')?;
    Some(model.trim().to_owned())
}
