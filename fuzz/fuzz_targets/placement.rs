//! The triangulation of a level between any borders, with any probes.
#![no_main]

use glam::{DVec2, DVec3};
use splatprobe::place::Network;
use splatprobe::place::contours::Contours;
use splatprobe::place::levels::Height;
use splatprobe::place::triangulation::Ground;

/// Points on a lattice of this many metres, so that many are collinear, cocircular or the same.
const STEP: f64 = 0.125;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some((&[borders, tiny], rest)) = bytes.split_first_chunk() else { return };
    let points: Vec<DVec2> = rest
        .chunks_exact(2)
        .take(200)
        .map(|at| DVec2::new(f64::from(at[0] as i8), f64::from(at[1] as i8)) * STEP)
        .collect();
    let (borders, probes) = points.split_at(points.len().min(usize::from(borders)));
    // Near-duplicates: every other probe is moved by next to nothing.
    let nudge = f64::from(tiny) * 1e-15;
    let probes: Vec<(u32, DVec3)> =
        (0..).zip(probes).map(|(i, p)| (i, DVec3::new(p.x + nudge * f64::from(i % 2), 1.5, p.y))).collect();
    let edges = (0..borders.len() / 2).map(|i| [2 * i, 2 * i + 1]).collect();
    let contours = Contours { points: borders.to_vec(), edges };
    let height = Height { y: 1.5, floor: 0.0, ceiling: 3.0 };
    let parts = probes.iter().map(|(_, p)| DVec2::new(p.x, p.z)).collect();
    let level = Ground::new(height, &contours, parts).with_probes(&probes, |a, b| (a + b) % 3 != 0);
    let network = Network { levels: vec![level], ..Network::default() };
    for (_, probe) in &probes {
        let sum: f64 = network.weights(*probe).iter().map(|share| share.weight).sum();
        assert!(network.levels[0].triangles.is_empty() || (sum - 1.0).abs() < 1e-9, "{sum} at {probe}");
    }
});
