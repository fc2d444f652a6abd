//! A bench as tables.

use std::fmt::Write;

use super::report::{BenchReport, SceneBench, Truth};

/// The whole report.
pub(super) fn page(report: &BenchReport) -> String {
    let BenchReport { generator, command, machine, repeats, scenes, .. } = report;
    let mut page = format!(
        "{generator}, {} build, on {} ({}, {} threads, {}); median of {repeats} runs.\n\n    {command}\n",
        machine.build, machine.cpu, machine.system, machine.threads, machine.level
    );
    for scene in scenes {
        add_scene(&mut page, scene);
    }
    page
}

fn add_scene(page: &mut String, scene: &SceneBench) {
    let SceneBench { scene: name, gaussians, sh_degree, triangles, probes, .. } = scene;
    let probes: Vec<String> = probes.iter().map(|[x, y, z]| format!("({x:.2}, {y:.2}, {z:.2})")).collect();
    // Writing to a string does not fail.
    let _ = write!(
        page,
        "\n## {name}\n\n{gaussians} Gaussians of degree {sh_degree}, {triangles} triangles; probes at {} m.\n",
        probes.join(", ")
    );
    for record in &scene.truths {
        let _ = write!(
            page,
            "\n### Error by {}\n\nTruth: {}; {:.1} s. Errors in display space; * marks the Pareto front by time on one core.\n\n\
             | | setting | s, all cores | s, one core | Mrays/s | RMSE | max | PSNR, dB | FLIP |\n\
             |---|---|---:|---:|---:|---:|---:|---:|---:|\n",
            record.truth.name(),
            record.description,
            record.seconds
        );
        add_rows(page, scene, record.truth);
    }
}

fn add_rows(page: &mut String, scene: &SceneBench, truth: Truth) {
    for (row, error) in scene.rows_by(truth) {
        let mark = if error.on_front { "*" } else { "" };
        let rate = if row.rays > 0 { format!("{:.2}", row.rays as f64 / 1e6 / row.seconds.all) } else { String::new() };
        let psnr = error.norms.psnr_db.map_or("exact".into(), |db| format!("{db:.1}"));
        let flip = error.flip.map_or(String::new(), |flip| format!("{flip:.4}"));
        let _ = writeln!(
            page,
            "| {mark} | {} | {:.4} | {:.4} | {rate} | {:.2e} | {:.2e} | {psnr} | {flip} |",
            row.label, row.seconds.all, row.seconds.one, error.norms.rmse, error.norms.max_abs
        );
    }
}
