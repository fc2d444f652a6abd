//! Scenes, surfaces and plans that break renderers, in one table: each case with the worst that was measured and the most
//! that it may be.
//!
//! `STRESS_TABLE=docs/stress.md cargo test --test tracing stress` writes the table.

mod lobes;
mod plans;
mod tracers;

use std::fmt::Write;

/// A case, and what came of it.
pub struct Row {
    /// What is tried.
    pub case: String,
    /// By what: the largest error of each, in the unit of the section.
    pub worst: Vec<(String, f64)>,
    /// The most that each may be.
    pub tolerance: f64,
}

impl Row {
    /// A case of one measurement.
    pub fn new(case: impl Into<String>, worst: f64, tolerance: f64) -> Self {
        Self { case: case.into(), worst: vec![("worst".into(), worst)], tolerance }
    }

    /// Whether it is within its tolerance; false for NaN.
    fn holds(&self) -> bool {
        self.worst.iter().all(|(_, worst)| *worst <= self.tolerance)
    }
}

/// The larger error; NaN, which is worse than any, if one is that.
fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) }
}

/// Cases that are measured alike.
struct Section {
    title: &'static str,
    what: &'static str,
    rows: Vec<Row>,
}

#[test]
fn every_case_of_the_stress_table_is_within_its_tolerance_and_listed() {
    let sections = [
        Section { title: "Tracers", what: tracers::WHAT, rows: tracers::rows() },
        Section { title: "Materials", what: lobes::WHAT, rows: lobes::rows() },
        Section { title: "Plans", what: plans::WHAT, rows: plans::rows() },
    ];
    let rows = || sections.iter().flat_map(|section| &section.rows);
    let failing: Vec<String> =
        rows().filter(|row| !row.holds()).map(|row| format!("{}: {:?}", row.case, row.worst)).collect();
    if let Some(path) = std::env::var_os("STRESS_TABLE") {
        std::fs::write(path, table(&sections)).expect("the table is written");
    }
    assert!(failing.is_empty(), "{failing:#?}");
    let listed = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/stress.md")).expect("the table");
    for row in rows() {
        let ends = |line: &str| line.starts_with(&format!("| {} |", row.case)) && line.ends_with(&tolerance(row));
        assert!(listed.lines().any(ends), "docs/stress.md is older than '{}'; write it anew", row.case);
    }
}

/// How a row's line ends.
fn tolerance(row: &Row) -> String {
    format!("| {:.0e} |", row.tolerance)
}

/// The table as Markdown.
fn table(sections: &[Section]) -> String {
    let mut text = String::from(
        "# Numerical stress\n\nThe worst that was measured of each case, and the most that a test lets pass. Written by\n\
         `STRESS_TABLE=docs/stress.md cargo test --test tracing stress`.\n",
    );
    for Section { title, what, rows } in sections {
        let names: Vec<&str> =
            rows.first().map_or(Vec::new(), |row| row.worst.iter().map(|(name, _)| &**name).collect());
        write!(text, "\n## {title}\n\n{what}\n\n| case | {} | tolerance |\n", names.join(" | ")).expect("a string");
        writeln!(text, "|---|{}", "---|".repeat(names.len() + 1)).expect("a string");
        for row in rows {
            let worst: Vec<String> = row.worst.iter().map(|(_, worst)| format!("{worst:.1e}")).collect();
            writeln!(text, "| {} | {} {}", row.case, worst.join(" | "), tolerance(row)).expect("a string");
        }
    }
    text
}
