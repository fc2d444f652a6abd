//! What holds for every engine: T1 each direction within a texel, T3 marks un-mirrored, T4 the same light in all formats,
//! T5 no seams between faces.

use glam::{DVec3, Vec3};
use splatprobe::export::ENGINES;

use super::{Baked, SIZE, assert_is_calibration, coded_direction, shown, sphere};

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

/// Points compared along an edge of the cube.
const STEPS: usize = 64;

/// For each of the cube's twelve edges points all along it: just within one of its faces, and just within the other.
fn edges() -> impl Iterator<Item = [[DVec3; 2]; STEPS]> {
    const INSIDE: f64 = 1.0 - 1e-9;
    let signs = [[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]];
    (0..3).flat_map(move |axis| signs.map(|signs| (axis, signs))).map(|(axis, [a, b])| {
        std::array::from_fn(|i| {
            let along = (2 * i + 1) as f64 / STEPS as f64 - 1.0;
            [[a * INSIDE, b], [a, b * INSIDE]].map(|[a, b]| {
                let mut point = [along; 3];
                (point[(axis + 1) % 3], point[(axis + 2) % 3]) = (a, b);
                DVec3::from(point).normalize()
            })
        })
    })
}

#[test]
fn what_an_engine_finds_on_both_sides_of_an_edge_lies_within_a_texel_of_a_faces_middle() {
    let baked = Baked::new();
    for engine in ENGINES {
        let shown = shown(engine.name, &baked.export(engine.name), "probe_000");
        let (mut largest, mut least_compared) = (0.0_f64, STEPS);
        for edge in edges() {
            let mut compared = 0;
            for sides in edge {
                if let [Some(a), Some(b)] = sides.map(|direction| coded_direction(shown(direction), direction)) {
                    largest = largest.max(a.angle_between(b));
                    compared += 1;
                }
            }
            least_compared = least_compared.min(compared);
        }
        let texel = 2.0 / f64::from(SIZE);
        println!(
            "{}: {:.2} texels, {least_compared} of {STEPS} pairs or more on every edge",
            engine.name,
            largest / texel
        );
        assert!(least_compared > STEPS / 2 && largest < texel, "{}: {least_compared}, {largest} rad", engine.name);
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
