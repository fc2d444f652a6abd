//! A running bake on stderr: a bar, lines, or events.

use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle as BarStyle};
use serde_json::json;
use splatprobe::bake::{Progress, Silent};
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
    fn begin(&self, probes: usize, rays: u64) {
        let template = "{msg} {wide_bar} {percent}% {human_pos} rays, {per_sec}, {eta} left";
        self.0.set_style(BarStyle::with_template(template).unwrap_or_else(|_| BarStyle::default_bar()));
        self.0.set_message(format!("{probes} probes"));
        self.0.set_length(rays);
    }

    fn advance(&self, rays: u64) {
        self.0.inc(rays);
    }

    fn probe_done(&self, _index: usize) {}

    fn finish(&self) {
        self.0.finish_and_clear();
    }
}

/// A line when the bake begins, every [`INTERVAL`] and when it ends, made by `format`.
struct Lines {
    format: fn(Event, &Meter) -> String,
    meter: Mutex<Meter>,
}

#[derive(Clone, Copy, PartialEq)]
enum Event {
    Begin,
    Progress,
    Finish,
}

/// How far a bake is.
#[derive(Clone, Copy)]
struct Meter {
    probes: usize,
    rays: u64,
    probes_done: usize,
    rays_done: u64,
    begun: Instant,
    reported: Instant,
}

impl Lines {
    fn new(format: fn(Event, &Meter) -> String) -> Self {
        let now = Instant::now();
        let meter = Meter { probes: 0, rays: 0, probes_done: 0, rays_done: 0, begun: now, reported: now };
        Self { format, meter: Mutex::new(meter) }
    }

    fn update(&self, event: Event, change: impl FnOnce(&mut Meter)) {
        // A thread that panicked while it held the meter left whole numbers behind.
        let mut meter = self.meter.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut meter);
        if event != Event::Progress || meter.reported.elapsed() >= INTERVAL {
            meter.reported = Instant::now();
            super::status((self.format)(event, &meter));
        }
    }
}

impl Progress for Lines {
    fn begin(&self, probes: usize, rays: u64) {
        self.update(Event::Begin, |meter| (meter.probes, meter.rays, meter.begun) = (probes, rays, Instant::now()));
    }

    fn advance(&self, rays: u64) {
        self.update(Event::Progress, |meter| meter.rays_done += rays);
    }

    fn probe_done(&self, _index: usize) {
        self.update(Event::Progress, |meter| meter.probes_done += 1);
    }

    fn finish(&self) {
        self.update(Event::Finish, |_| ());
    }
}

fn plain(event: Event, meter: &Meter) -> String {
    let Meter { probes, rays, probes_done, rays_done, begun, .. } = *meter;
    let seconds = begun.elapsed().as_secs_f64();
    match event {
        Event::Begin => format!("{probes} probes, {rays} rays"),
        Event::Progress | Event::Finish => format!(
            "{probes_done} of {probes} probes, {:.1} % of rays, {:.2} Mrays/s, {seconds:.1} s",
            100.0 * rays_done as f64 / rays.max(1) as f64,
            rays_done as f64 / 1e6 / seconds.max(1e-9)
        ),
    }
}

fn json(event: Event, meter: &Meter) -> String {
    let event = match event {
        Event::Begin => "begin",
        Event::Progress => "progress",
        Event::Finish => "finish",
    };
    json!({
        "event": event,
        "probes": meter.probes,
        "probesDone": meter.probes_done,
        "rays": meter.rays,
        "raysDone": meter.rays_done,
        "seconds": meter.begun.elapsed().as_secs_f64(),
    })
    .to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn half_done() -> Meter {
        let now = Instant::now();
        Meter { probes: 4, rays: 200, probes_done: 1, rays_done: 100, begun: now, reported: now }
    }

    #[test]
    fn a_plain_line_says_how_much_is_done() {
        let line = plain(Event::Progress, &half_done());
        assert!(line.starts_with("1 of 4 probes, 50.0 % of rays, "), "{line}");
    }

    #[test]
    fn an_event_is_one_line_of_json() {
        let line = json(Event::Finish, &half_done());
        assert!(!line.contains('\n'));
        let event: serde_json::Value = serde_json::from_str(&line).unwrap();
        assert_eq!((&event["event"], &event["raysDone"], &event["probes"]), (&json!("finish"), &json!(100), &json!(4)));
    }
}
