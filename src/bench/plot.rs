//! A bench as plots: error over time on one core, both logarithmic, a panel per scene and truth.

use std::fmt::Write;

use super::Axis;
use super::report::{BenchReport, Row, RowError, SceneBench, Truth, TruthRecord};

/// Edges of a panel, and what its axes leave free on the left, top, right and bottom, in pixels.
const PANEL: [f64; 2] = [560.0, 420.0];
const MARGIN: [f64; 4] = [70.0, 48.0, 24.0, 44.0];

/// Panels side by side.
const COLUMNS: usize = 2;

/// Above a scene's panels.
const HEADER: f64 = 56.0;

/// Above everything, for names and the legend.
const TOP: f64 = 64.0;

/// Mean width of a letter and height of a line of a point's label.
const LETTER: [f64; 2] = [5.6, 11.0];

/// Errors below are shown as this: an exact result has no logarithm.
const LEAST_ERROR: f64 = 1e-8;

const FRONT: &str = "#444444";

impl Axis {
    const ALL: [Self; 9] = [
        Self::Base,
        Self::Tracer,
        Self::TCutoff,
        Self::Footprint,
        Self::Samples,
        Self::FaceSize,
        Self::Preset,
        Self::Surface,
        Self::Prefilter,
    ];

    /// Name and colour in the legend: Okabe and Ito's colours, which the colour-blind tell apart, and two greys.
    fn legend(self) -> (&'static str, &'static str) {
        match self {
            Self::Base => ("default", "#000000"),
            Self::Tracer => ("tracer", "#cc79a7"),
            Self::TCutoff => ("t-cutoff", "#0072b2"),
            Self::Footprint => ("footprint", "#009e73"),
            Self::Samples => ("samples", "#d55e00"),
            Self::FaceSize => ("face size", "#56b4e9"),
            Self::Preset => ("preset", "#e69f00"),
            Self::Surface => ("surface", "#7a7a7a"),
            Self::Prefilter => ("prefilter", "#9a6a3a"),
        }
    }
}

/// The whole report.
pub(super) fn page(report: &BenchReport) -> String {
    let rows_of = |scene: &SceneBench| scene.truths.len().div_ceil(COLUMNS) as f64;
    let height: f64 = TOP + report.scenes.iter().map(|scene| HEADER + rows_of(scene) * PANEL[1]).sum::<f64>();
    let width = COLUMNS as f64 * PANEL[0];
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
         font-family=\"sans-serif\" font-size=\"11\">\n<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n"
    );
    let machine = &report.machine;
    let about = format!(
        "{} ({} build) on {}, {} threads, {}",
        report.generator, machine.build, machine.cpu, machine.threads, machine.level
    );
    text(&mut svg, [16.0, 24.0], "font-size=\"14\"", &about);
    legend(&mut svg, report);
    let mut top = TOP;
    for scene in &report.scenes {
        text(&mut svg, [16.0, top + 26.0], "font-size=\"16\" font-weight=\"bold\"", &scene.scene);
        let counts = format!(
            "{} Gaussians of degree {}, {} triangles; probes: {}",
            scene.gaussians,
            scene.sh_degree,
            scene.triangles,
            scene.probes.len()
        );
        text(&mut svg, [16.0, top + 46.0], "fill=\"#555555\"", &counts);
        top += HEADER;
        for (i, record) in scene.truths.iter().enumerate() {
            let corner = [(i % COLUMNS) as f64 * PANEL[0], top + (i / COLUMNS) as f64 * PANEL[1]];
            panel(&mut svg, corner, scene, record);
        }
        top += rows_of(scene) * PANEL[1];
    }
    svg.push_str("</svg>\n");
    svg
}

fn legend(svg: &mut String, report: &BenchReport) {
    let rows = || report.scenes.iter().flat_map(|scene| &scene.rows);
    let mut x = 20.0;
    for axis in Axis::ALL.into_iter().filter(|axis| rows().any(|row| row.axis == *axis)) {
        let (name, colour) = axis.legend();
        disc(svg, [x, 46.0], colour, true);
        text(svg, [x + 9.0, 50.0], "", name);
        x += 28.0 + name.len() as f64 * LETTER[0] * 1.1;
    }
    let _ = writeln!(svg, "<path d=\"M{x:.0},46h24\" stroke=\"{FRONT}\" stroke-width=\"1.5\"/>");
    text(svg, [x + 30.0, 50.0], "", "Pareto front (filled points)");
}

/// Both axes of a panel: logarithms of what is at its edges.
struct Scales {
    corner: [f64; 2],
    time: [f64; 2],
    error: [f64; 2],
}

impl Scales {
    /// With a margin around `points`, times and errors.
    fn around(corner: [f64; 2], points: &[[f64; 2]]) -> Self {
        let range = |k: usize| {
            let logs = points.iter().map(|point| point[k].log10());
            let (low, high) = logs.fold((f64::MAX, f64::MIN), |(low, high), log| (low.min(log), high.max(log)));
            // A little space for labels, and never nothing.
            let space = 0.08 * (high - low).max(0.5);
            [low - space, high + 1.5 * space]
        };
        Self { corner, time: range(0), error: range(1) }
    }

    fn place(&self, [time, error]: [f64; 2]) -> [f64; 2] {
        let share = |value: f64, [low, high]: [f64; 2]| (value.log10() - low) / (high - low);
        let [left, up, right, down] = MARGIN;
        let (width, height) = (PANEL[0] - left - right, PANEL[1] - up - down);
        let x = self.corner[0] + left + share(time, self.time) * width;
        [x, self.corner[1] + PANEL[1] - down - share(error, self.error) * height]
    }
}

fn panel(svg: &mut String, corner: [f64; 2], scene: &SceneBench, record: &TruthRecord) {
    let rows: Vec<(&Row, &RowError)> = scene.rows_by(record.truth).collect();
    let at = |row: &Row, error: &RowError| [row.seconds.one.max(1e-9), error.norms.rmse.max(LEAST_ERROR)];
    let points: Vec<[f64; 2]> = rows.iter().map(|(row, error)| at(row, error)).collect();
    if points.is_empty() {
        return;
    }
    let scales = Scales::around(corner, &points);
    let title = [corner[0] + MARGIN[0], corner[1] + 18.0];
    text(svg, title, "font-weight=\"bold\"", &format!("RMSE by {}", record.truth.name()));
    text(svg, [title[0], title[1] + 16.0], "fill=\"#555555\" font-size=\"10\"", &record.description);
    axes(svg, &scales, record.truth);

    let mut on_front: Vec<[f64; 2]> =
        rows.iter().zip(&points).filter(|((_, error), _)| error.on_front).map(|(_, point)| *point).collect();
    on_front.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let line: Vec<[f64; 2]> = on_front.iter().map(|&point| scales.place(point)).collect();
    let corners: Vec<String> = line.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
    let _ = writeln!(
        svg,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"{FRONT}\" stroke-width=\"1.5\"/>",
        corners.join(" ")
    );

    let places: Vec<[f64; 2]> = points.iter().map(|&point| scales.place(point)).collect();
    for ((row, error), place) in rows.iter().zip(&places) {
        disc(svg, *place, row.axis.legend().1, error.on_front);
    }
    let mut taken: Vec<[f64; 4]> = places.iter().map(|[x, y]| [x - 4.0, y - 4.0, x + 4.0, y + 4.0]).collect();
    taken.extend(line.windows(2).flat_map(|ends| along(ends[0], ends[1])));
    let [left, up, right, down] = MARGIN;
    let inside = [corner[0] + left, corner[1] + up, corner[0] + PANEL[0] - right, corner[1] + PANEL[1] - down];
    for ((row, _), place) in rows.iter().zip(&places) {
        let label = label_box(*place, &row.label, inside, &taken);
        leader(svg, *place, label);
        text(svg, [label[0], label[3] - 2.5], "fill=\"#222222\" font-size=\"10\"", &row.label);
        taken.push(label);
    }
}

/// A line from a point to its label, where that is not beside it.
fn leader(svg: &mut String, [x, y]: [f64; 2], [left, top, right, bottom]: [f64; 4]) {
    if y < top || y > bottom {
        let (to_x, to_y) = (if left > x { left - 1.0 } else { right + 1.0 }, (top + bottom) / 2.0);
        let _ =
            writeln!(svg, "<path d=\"M{x:.1},{y:.1}L{to_x:.1},{to_y:.1}\" stroke=\"#b0b0b0\" stroke-width=\"0.7\"/>");
    }
}

/// Small boxes along a line, which labels leave free.
fn along(from: [f64; 2], to: [f64; 2]) -> impl Iterator<Item = [f64; 4]> {
    let steps = ((to[0] - from[0]).hypot(to[1] - from[1]) / LETTER[0]).ceil().max(1.0);
    (0..=steps as usize).map(move |i| {
        let at = |k: usize| from[k] + (to[k] - from[k]) * i as f64 / steps;
        [at(0) - 1.0, at(1) - 1.0, at(0) + 1.0, at(1) + 1.0]
    })
}

/// Where a label goes: beside its point, or wherever near it and `inside` is still free.
fn label_box([x, y]: [f64; 2], label: &str, inside: [f64; 4], taken: &[[f64; 4]]) -> [f64; 4] {
    let (width, height) = (label.len() as f64 * LETTER[0], LETTER[1]);
    let corners = (0..12).flat_map(|ring| {
        let away = height * 0.75 * f64::from(ring);
        [
            [x + 7.0, y - height / 2.0 - away],
            [x + 7.0, y - height / 2.0 + away],
            [x - 7.0 - width, y - height / 2.0 - away],
            [x - 7.0 - width, y - height / 2.0 + away],
        ]
    });
    let is_inside = |b: &[f64; 4]| (0..2).all(|k| b[k] >= inside[k] && b[k + 2] <= inside[k + 2]);
    let boxes = corners.map(|[x, y]| [x, y, x + width, y + height]).filter(is_inside);
    let overlaps = |a: &[f64; 4], b: &[f64; 4]| a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
    let beside = [x + 7.0, y - height / 2.0, x + 7.0 + width, y + height / 2.0];
    let mut free = boxes.filter(|place| !taken.iter().any(|other| overlaps(place, other)));
    free.next().unwrap_or(beside)
}

fn axes(svg: &mut String, scales: &Scales, truth: Truth) {
    let [x0, y1] = scales.place([10_f64.powf(scales.time[0]), 10_f64.powf(scales.error[0])]);
    let [x1, y0] = scales.place([10_f64.powf(scales.time[1]), 10_f64.powf(scales.error[1])]);
    for value in ticks(scales.time) {
        let [x, _] = scales.place([value, 1.0]);
        let _ = writeln!(svg, "<path d=\"M{x:.1},{y0:.1}V{y1:.1}\" stroke=\"#e4e4e4\"/>");
        text(svg, [x, y1 + 15.0], "text-anchor=\"middle\" fill=\"#555555\"", &number(value));
    }
    for value in ticks(scales.error) {
        let [_, y] = scales.place([1.0, value]);
        let _ = writeln!(svg, "<path d=\"M{x0:.1},{y:.1}H{x1:.1}\" stroke=\"#e4e4e4\"/>");
        text(svg, [x0 - 6.0, y + 4.0], "text-anchor=\"end\" fill=\"#555555\"", &number(value));
    }
    let (width, height) = (x1 - x0, y1 - y0);
    let _ = writeln!(
        svg,
        "<rect x=\"{x0:.1}\" y=\"{y0:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"none\" stroke=\"#999999\"/>"
    );
    let what =
        if truth == Truth::Lobe { "seconds of a chain on one core" } else { "seconds of all probes on one core" };
    text(svg, [(x0 + x1) / 2.0, y1 + 32.0], "text-anchor=\"middle\"", what);
}

/// 1, 2 and 5 times the powers of 10 between the logarithms; of many, the powers alone.
fn ticks([low, high]: [f64; 2]) -> Vec<f64> {
    let factors: &[f64] = if high - low > 2.2 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    let powers = low.floor() as i32..=high.ceil() as i32;
    let all = powers.flat_map(|power| factors.iter().map(move |factor| factor * 10_f64.powi(power)));
    all.filter(|value| (low..=high).contains(&value.log10())).collect()
}

fn number(value: f64) -> String {
    if (0.001..1000.0).contains(&(value * 1.0001)) {
        format!("{}", (value * 1e4).round() / 1e4)
    } else {
        format!("{value:.0e}")
    }
}

fn disc(svg: &mut String, [x, y]: [f64; 2], colour: &str, is_filled: bool) {
    let fill = if is_filled { colour } else { "#ffffff" };
    let _ = writeln!(
        svg,
        "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\" fill=\"{fill}\" stroke=\"{colour}\" stroke-width=\"1.5\"/>"
    );
}

fn text(svg: &mut String, [x, y]: [f64; 2], attributes: &str, content: &str) {
    let content = content.replace('&', "&amp;").replace('<', "&lt;");
    // Writing to a string does not fail.
    let _ = writeln!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\" {attributes}>{content}</text>");
}
