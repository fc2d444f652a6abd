//! Files that others made.

use std::path::PathBuf;

use splatprobe::ingest::load_scene;
use splatprobe::job::SplatInput;

use crate::files::data;

#[test]
fn a_captured_desk_is_the_ply_it_was_made_of_in_another_order() {
    let (Some(sog), Some(ply)) = (data("splats/leica-sofort-8k.sog"), data("splats/leica-sofort-8k.ply")) else {
        return;
    };
    let load = |path: PathBuf| load_scene(&[SplatInput::new(path)], &[]).expect("loads");
    let ((sog, sog_report), (ply, ply_report)) = (load(sog), load(ply));
    let (sog_report, ply_report) = (&sog_report.splats[0], &ply_report.splats[0]);
    assert_eq!((sog_report.count, sog_report.kept, sog_report.sh_degree_used), (8192, 8192, 3));
    let near = |a: f64, b: f64, tolerance: f64| assert!((a - b).abs() <= tolerance, "{a} {b}");
    for axis in 0..3 {
        near(sog_report.bounds.min[axis], ply_report.bounds.min[axis], 3e-3);
        near(sog_report.bounds.max[axis], ply_report.bounds.max[axis], 3e-3);
    }
    near(sog_report.opacity.p50, ply_report.opacity.p50, 0.005);
    near(sog_report.scale.p50, ply_report.scale.p50, 0.03 * ply_report.scale.p50);
    // Matched by place: the format sorts Gaussians, and keeps positions to a few parts in 10,000.
    let mut squared_errors = [0.0; 4];
    for i in (0..sog.splats.len()).step_by(16) {
        let distance = |j: &usize| (ply.splats.means[*j] - sog.splats.means[i]).length_squared();
        let j = (0..ply.splats.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).expect("Gaussians");
        assert!(distance(&j).sqrt() < 2e-3 * (1.0 + sog.splats.means[i].length()), "Gaussian {i}");
        squared_errors[0] += f64::from(sog.splats.opacities[i] - ply.splats.opacities[j]).powi(2) / 512.0;
        let covariances = [sog.splats.covariance(i), ply.splats.covariance(j)];
        let norm = |m: glam::DMat3| m.to_cols_array().iter().map(|entry| entry * entry).sum::<f64>().sqrt();
        squared_errors[1] += (norm(covariances[0] - covariances[1]) / norm(covariances[1])).powi(2) / 512.0;
        for (k, (a, b)) in sog.splats.sh_of(i).iter().zip(ply.splats.sh_of(j)).enumerate() {
            squared_errors[if k % 16 == 0 { 2 } else { 3 }] += f64::from(a - b).powi(2) / 512.0 / 48.0;
        }
    }
    let [opacity, covariance, colour, directions] = squared_errors.map(f64::sqrt);
    println!("rms error: opacity {opacity:.4}, covariance {covariance:.4}, band 0 {colour:.4}, others {directions:.4}");
    assert!(opacity < 0.01 && covariance < 0.1 && colour < 0.01 && directions < 0.05);
}

#[test]
fn every_level_of_a_streamed_robot_loads() {
    let Some(folder) = data("splats/playbot") else { return };
    for (lod, count) in [500_000, 250_000, 125_000, 31_000, 8_406, 3_000, 1_873].into_iter().enumerate() {
        let input = SplatInput { lod: Some(lod as u32), ..SplatInput::new(&folder) };
        let (scene, report) = load_scene(&[input], &[]).expect("loads");
        assert_eq!((report.splats[0].count, scene.splats.sh_degree), (count, 2), "level {lod}");
        assert!(report.splats[0].kept > count * 9 / 10, "{:?}", report.splats[0].dropped);
        // It stands on the ground and reaches 1.1 m up: its file's -Y points there.
        let bounds = report.splats[0].bounds;
        assert!((-0.06..0.0).contains(&bounds.min.y) && (1.0..1.1).contains(&bounds.max.y), "{bounds:?}");
    }
}
