//! Wall time on all cores, and processor time on one.

use std::time::Instant;

use rayon::{ThreadPool, ThreadPoolBuilder};

use super::Seconds;
use crate::error::{Error, Result};

/// A run that takes so many seconds is not repeated: what disturbs a machine disturbs it for less.
const LONG: f64 = 10.0;

/// Threads to run on.
pub(super) struct Clock {
    all: ThreadPool,
    one: ThreadPool,
    repeats: u32,
}

impl Clock {
    pub fn new(repeats: u32) -> Result<Self> {
        let pool = |threads: usize| {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build();
            pool.map_err(|error| Error::request("threads", error.to_string()))
        };
        Ok(Self { all: pool(0)?, one: pool(1)?, repeats })
    }

    /// How many threads all cores have.
    pub fn threads(&self) -> usize {
        self.all.current_num_threads()
    }

    /// Runs `work` on all cores, once and without timing it.
    pub fn run<T: Send>(&self, work: impl Fn() -> Result<T> + Sync) -> Result<T> {
        self.all.install(&work)
    }

    /// What `work` gives, and how long it takes.
    pub fn time<T: Send>(&self, work: impl Fn() -> Result<T> + Sync) -> Result<(T, Seconds)> {
        let (result, all) = self.median(&self.all, wall_seconds, &work)?;
        let (_, one) = self.median(&self.one, thread_seconds, &work)?;
        Ok((result, Seconds { all, one }))
    }

    fn median<T: Send>(
        &self,
        pool: &ThreadPool,
        clock: fn(Instant) -> f64,
        work: &(impl Fn() -> Result<T> + Sync),
    ) -> Result<(T, f64)> {
        let timed = || {
            let start = Instant::now();
            // Within, so that a clock of the thread is that of the thread that works.
            pool.install(|| {
                let begun = clock(start);
                work().map(|result| (result, clock(start) - begun))
            })
        };
        let (result, first) = timed()?;
        let mut times = vec![first];
        while times.len() < self.repeats as usize && first < LONG {
            times.push(timed()?.1);
        }
        times.sort_by(f64::total_cmp);
        Ok((result, times[times.len() / 2]))
    }
}

fn wall_seconds(start: Instant) -> f64 {
    start.elapsed().as_secs_f64()
}

/// Processor time of this thread, which other work on the machine does not lengthen; wall time where the system does not tell.
fn thread_seconds(start: Instant) -> f64 {
    // Linux: the first number is nanoseconds on a processor (Documentation/scheduler/sched-stats.rst).
    let statistics = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = statistics.split_whitespace().next().and_then(|first| first.parse::<f64>().ok());
    nanoseconds.map_or_else(|| wall_seconds(start), |nanoseconds| nanoseconds * 1e-9)
}
