//! What holds for every engine: T1 each direction within a texel, T3 marks un-mirrored, T4 the same light in all formats.

use glam::{DVec3, Vec3};
use splatprobe::export::ENGINES;

use super::{Baked, assert_is_calibration, shown, sphere};

#[test]
fn every_direction_is_where_each_engine_looks_for_it() {
    let baked = Baked::new();
    for engine in ENGINES {
        let out = baked.export(engine.name);
        for probe in ["probe_000", "probe_001"] {
            assert_is_calibration(engine.name, &*shown(engine.name, &out, probe));
        }
    }
}

/// Means over the sphere of radiance times 1, x, y, z, xy, yz, zx, x^2, y^2.
fn moments(shown: &dyn Fn(DVec3) -> Vec3) -> [DVec3; 9] {
    let mut sums = [DVec3::ZERO; 9];
    let mut count = 0.0;
    for d in sphere() {
        let radiance = shown(d).as_dvec3();
        let basis = [1.0, d.x, d.y, d.z, d.x * d.y, d.y * d.z, d.z * d.x, d.x * d.x, d.y * d.y];
        sums.iter_mut().zip(basis).for_each(|(sum, value)| *sum += radiance * value);
        count += 1.0;
    }
    sums.map(|sum| sum / count)
}

#[test]
fn all_formats_of_a_probe_hold_the_same_light() {
    let baked = Baked::with(|job| job.face_size = 64);
    let found: Vec<(&str, [DVec3; 9])> = ENGINES
        .iter()
        .map(|engine| (engine.name, moments(&*shown(engine.name, &baked.export(engine.name), "probe_000"))))
        .collect();
    let (_, first) = found[0];
    for (engine, moments) in &found {
        let difference = moments.iter().zip(&first).map(|(a, b)| ((a - b) / first[0]).abs().max_element());
        let largest = difference.fold(0.0, f64::max);
        println!("{engine}: {:.3} % of the mean", 100.0 * largest);
        assert!(largest < 0.005, "{engine}: {largest}");
    }
}

#[test]
fn exports_of_the_same_bake_are_the_same_bytes() {
    let baked = Baked::new();
    let read = |engine: &str| {
        let (_, export) = baked.exported(engine);
        export.files.iter().map(|file| std::fs::read(file).unwrap()).collect::<Vec<_>>()
    };
    for engine in ENGINES {
        assert!(read(engine.name) == read(engine.name), "{}", engine.name);
    }
}
