//! Run time against error: what each setting costs and what it is worth, measured on a scene.
//!
//! One setting at a time is changed ([`sweep`] holds the values), about those of the job, which without a job file are the
//! defaults; the presets change several and are there as a cross-check. It is not the full product: that would take days,
//! and settings hardly act on each other (each error has a cause of its own: resolution, aliasing, cut-off, noise).
//!
//! A row's time is that of tracing all probes' cubemaps, the median of some runs: wall time on all cores, and processor
//! time on one, which also means something on a machine that does other things besides. Loading, the tree and writing are not
//! in it. Its errors are against up to five truths ([`Truth`]), in display space; only rows that share a truth compare, and
//! the best of them, by time on one core, are marked: the [Pareto front](front).

pub mod front;
mod light;
mod machine;
mod markdown;
mod plot;
mod prefilter;
mod report;
mod site;
mod sweep;
mod time;
mod tracing;

use crate::error::{Error, Result};

pub use report::{BenchReport, Machine, Row, RowError, RowSettings, SceneBench, Seconds, Truth, TruthRecord};
pub use site::Source;
pub use sweep::Axis;

use self::site::Site;
use self::sweep::Sweep;
use self::time::Clock;

/// How a bench is run.
#[derive(Debug, Clone, PartialEq)]
pub struct BenchSettings {
    /// Probes, in metres, world space; without any those of a job file's list, else one in the middle of the scene, moved
    /// to where little opacity is around it.
    pub probes: Vec<[f64; 3]>,
    /// Runs of which the median is taken, at least 1.
    pub repeats: u32,
    /// Whether faces have a quarter of the edge and fewer values are tried: under a minute for a scene of 300 000 Gaussians
    /// on two cores.
    pub quick: bool,
}

/// Most runs of a setting.
const MAX_REPEATS: u32 = 1000;

/// Measures `sources` one after the other. `command` is what the report says it was made by; `status` hears how it goes.
///
/// Fails with [`Error::Request`] for a wrong request, and with the errors of reading the scenes.
pub fn bench(
    sources: &[Source],
    settings: &BenchSettings,
    command: String,
    status: &dyn Fn(&str),
) -> Result<BenchReport> {
    if !(1..=MAX_REPEATS).contains(&settings.repeats) {
        let why = format!("{} is not between 1 and {MAX_REPEATS} runs", settings.repeats);
        return Err(Error::request("--repeats", why));
    }
    let clock = Clock::new(settings.repeats)?;
    let scenes = sources.iter().map(|source| bench_scene(source, settings, &clock, status)).collect::<Result<_>>()?;
    Ok(BenchReport {
        generator: concat!("splatprobe ", env!("CARGO_PKG_VERSION")).into(),
        command,
        machine: machine::this(clock.threads()),
        quick: settings.quick,
        repeats: settings.repeats,
        scenes,
    })
}

fn bench_scene(source: &Source, settings: &BenchSettings, clock: &Clock, status: &dyn Fn(&str)) -> Result<SceneBench> {
    status(&format!("{}: loading", source.name()));
    let site = Site::read(source, settings)?;
    let sweep = Sweep::about(&site.job, settings.quick);
    let mut scene = site.describe();
    let mut bench = Bench { site: &site, sweep: &sweep, clock, status, scene: &mut scene };
    tracing::measure(&mut bench)?;
    light::measure(&mut bench)?;
    prefilter::measure(&mut bench)?;
    scene.mark_fronts();
    Ok(scene)
}

/// A scene on its way to be measured.
struct Bench<'a> {
    site: &'a Site,
    sweep: &'a Sweep,
    clock: &'a Clock,
    status: &'a dyn Fn(&str),
    scene: &'a mut SceneBench,
}

impl Bench<'_> {
    fn say(&self, what: &str) {
        (self.status)(&format!("{}: {what}", self.scene.scene));
    }

    fn add_row(&mut self, row: Row) {
        let errors: Vec<String> =
            row.errors.iter().map(|error| format!("{} {:.1e}", error.truth.name(), error.norms.rmse)).collect();
        self.say(&format!("{}: {:.3} s, error by {}", row.label, row.seconds.all, errors.join(", ")));
        self.scene.rows.push(row);
    }
}
