//! Wall time, on all cores and on one.

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
        let (result, all) = median(&self.all, self.repeats, &work)?;
        let (_, one) = median(&self.one, self.repeats, &work)?;
        Ok((result, Seconds { all, one }))
    }
}

fn median<T: Send>(pool: &ThreadPool, repeats: u32, work: &(impl Fn() -> Result<T> + Sync)) -> Result<(T, f64)> {
    let timed = || {
        let begun = Instant::now();
        pool.install(work).map(|result| (result, begun.elapsed().as_secs_f64()))
    };
    let (result, first) = timed()?;
    let mut times = vec![first];
    while times.len() < repeats as usize && first < LONG {
        times.push(timed()?.1);
    }
    times.sort_by(f64::total_cmp);
    Ok((result, times[times.len() / 2]))
}
