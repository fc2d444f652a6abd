//! A running bake on stderr: a bar, lines, or events.

use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle as BarStyle};
use serde_json::json;
use splatprobe::bake::{Progress, ProgressEvent, ProgressState, Silent};
use splatprobe::job::ProgressStyle;

/// Lines and events come at most this often; a bake of many small probes would drown the log.
const INTERVAL: Duration = Duration::from_secs(1);

/// What reports a bake in `style`.
pub fn reporter(style: ProgressStyle) -> Box<dyn Progress> {
    match style {
        ProgressStyle::Auto if std::io::stderr().is_terminal() => Box::new(Bar(ProgressBar::no_length())),
        ProgressStyle::Auto | ProgressStyle::Plain => Box::new(Lines::new(plain)),
        ProgressStyle::Json => Box::new(Lines::new(json)),
        ProgressStyle::None => Box::new(Silent),
    }
}

/// A bar with the rate and the time left.
struct Bar(ProgressBar);

impl Progress for Bar {
    fn stage(&self, what: &str) {
        self.0.set_style(BarStyle::default_spinner());
        self.0.set_message(what.to_owned());
    }

    fn begin(&self, probes: usize, rays: u64) {
        let template = "{msg} {wide_bar} {percent}% {human_pos} rays, {per_sec}, {eta} left";
        self.0.set_style(BarStyle::with_template(template).unwrap_or_else(|_| BarStyle::default_bar()));
        self.0.set_message(format!("{probes} probes"));
        self.0.set_length(rays);
        // Rate and time left are of the rays, not of what went before.
        self.0.reset();
    }

    fn advance(&self, rays: u64) {
        self.0.inc(rays);
    }

    fn probe_done(&self, _index: usize) {}

    fn finish(&self) {
        self.0.finish_and_clear();
    }

    fn warn(&self, message: &str) {
        self.0.suspend(|| super::status(format_args!("warning: {message}")));
    }
}

/// A line when the bake begins, every [`INTERVAL`] and when it ends, made by `format`.
struct Lines {
    format: fn(&ProgressEvent) -> String,
    meter: Mutex<Meter>,
}

/// How far a bake is.
struct Meter {
    state: ProgressState,
    begun: Instant,
    reported: Instant,
}

impl Lines {
    fn new(format: fn(&ProgressEvent) -> String) -> Self {
        let now = Instant::now();
        let state = ProgressState { probes: 0, probes_done: 0, rays: 0, rays_done: 0, seconds: 0.0 };
        Self { format, meter: Mutex::new(Meter { state, begun: now, reported: now }) }
    }

    fn update(&self, event: fn(ProgressState) -> ProgressEvent, is_due: bool, change: impl FnOnce(&mut Meter)) {
        // A thread that panicked while it held the meter left whole numbers behind.
        let mut meter = self.meter.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut meter);
        if is_due || meter.reported.elapsed() >= INTERVAL {
            meter.reported = Instant::now();
            let seconds = meter.begun.elapsed().as_secs_f64();
            super::status((self.format)(&event(ProgressState { seconds, ..meter.state })));
        }
    }
}

impl Progress for Lines {
    fn stage(&self, what: &str) {
        super::status((self.format)(&ProgressEvent::Stage { message: what.into() }));
    }

    fn begin(&self, probes: usize, rays: u64) {
        self.update(ProgressEvent::Begin, true, |meter| {
            (meter.state.probes, meter.state.rays, meter.begun) = (probes, rays, Instant::now());
        });
    }

    fn advance(&self, rays: u64) {
        self.update(ProgressEvent::Progress, false, |meter| meter.state.rays_done += rays);
    }

    fn probe_done(&self, _index: usize) {
        self.update(ProgressEvent::Progress, false, |meter| meter.state.probes_done += 1);
    }

    fn finish(&self) {
        self.update(ProgressEvent::Finish, true, |_| ());
    }

    fn warn(&self, message: &str) {
        super::status((self.format)(&ProgressEvent::Warning { message: message.into() }));
    }
}

fn plain(event: &ProgressEvent) -> String {
    match event {
        ProgressEvent::Stage { message } => message.clone(),
        ProgressEvent::Begin(ProgressState { probes, rays, .. }) => format!("{probes} probes, {rays} rays"),
        ProgressEvent::Progress(state) | ProgressEvent::Finish(state) => {
            let ProgressState { probes, probes_done, rays, rays_done, seconds } = *state;
            format!(
                "{probes_done} of {probes} probes, {:.1} % of rays, {:.2} Mrays/s, {seconds:.1} s",
                100.0 * rays_done as f64 / rays.max(1) as f64,
                rays_done as f64 / 1e6 / seconds.max(1e-9)
            )
        }
        ProgressEvent::Warning { message } => format!("warning: {message}"),
    }
}

fn json(event: &ProgressEvent) -> String {
    json!(event).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    const HALF_DONE: ProgressState =
        ProgressState { probes: 4, probes_done: 1, rays: 200, rays_done: 100, seconds: 2.0 };

    #[test]
    fn a_plain_line_says_how_much_is_done() {
        let line = plain(&ProgressEvent::Progress(HALF_DONE));
        assert!(line.starts_with("1 of 4 probes, 50.0 % of rays, "), "{line}");
    }

    #[test]
    fn an_event_is_one_line_of_json() {
        let line = json(&ProgressEvent::Finish(HALF_DONE));
        assert!(!line.contains('\n'));
        let event: serde_json::Value = serde_json::from_str(&line).unwrap();
        assert_eq!((&event["event"], &event["raysDone"], &event["probes"]), (&json!("finish"), &json!(100), &json!(4)));
    }
}
