//! Triangulations of points that triangulations fear.

use glam::{DVec2, DVec3};
use splatprobe::place::Network;
use splatprobe::place::contours::Contours;
use splatprobe::place::levels::Height;
use splatprobe::place::triangulation::Ground;
use splatprobe::place::walls::Air;

use super::{Row, worse};
use crate::common::Random;

/// What the numbers are.
pub const WHAT: &str = "Probes in a rectangle of free space: the largest of how far the weights of any position, the probes' own among \
them, are from summing to 1, how far a probe's own weight at its place is from 1 (shared with those that stand \
within a millionth of the plan's size), and how far the triangles' area is from the rectangle's, relative to it.";

/// All cases, measured.
pub fn rows() -> Vec<Row> {
    let mut random = Random(21);
    let line = |step: DVec2| (0..40).map(|i| DVec2::splat(0.1) + step * f64::from(i)).collect();
    let ring = |count: i32, radius: f64| {
        (0..count).map(move |i| {
            DVec2::splat(5.0) + DVec2::from_angle(f64::from(i) / f64::from(count) * std::f64::consts::TAU) * radius
        })
    };
    let scattered: Vec<DVec2> =
        (0..60).map(|_| DVec2::new(random.uniform(0.1, 9.9), random.uniform(0.1, 9.9))).collect();
    let twins = |apart: f64| scattered.iter().flat_map(|&p| [p, p + DVec2::new(apart, -apart)]).collect();
    let lattice = || (1..10).flat_map(|x| (1..10).map(move |z| DVec2::new(f64::from(x), f64::from(z)))).collect();
    let cases: Vec<(String, Vec<DVec2>, f64, DVec2)> = vec![
        ("collinear along an axis".into(), line(DVec2::new(0.2, 0.0)), 1.0, DVec2::ZERO),
        ("collinear along a slant that f64 cannot hold".into(), line(DVec2::new(0.1, 0.2 / 3.0)), 1.0, DVec2::ZERO),
        ("cocircular".into(), ring(64, 4.0).collect(), 1.0, DVec2::ZERO),
        (
            "cocircular on three circles of one centre".into(),
            [1.0, 2.0, 4.0].into_iter().flat_map(|r| ring(32, r)).collect(),
            1.0,
            DVec2::ZERO,
        ),
        ("a lattice, cocircular everywhere".into(), lattice(), 1.0, DVec2::ZERO),
        (
            "a lattice on the borders".into(),
            (0..11).flat_map(|x| (0..11).map(move |z| DVec2::new(f64::from(x), f64::from(z)))).collect(),
            1.0,
            DVec2::ZERO,
        ),
        ("pairs 1e-3 apart".into(), twins(1e-3), 1.0, DVec2::ZERO),
        ("pairs 1e-9 apart".into(), twins(1e-9), 1.0, DVec2::ZERO),
        ("pairs 1e-15 apart".into(), twins(1e-15), 1.0, DVec2::ZERO),
        ("pairs in one place".into(), twins(0.0), 1.0, DVec2::ZERO),
        ("all in one place".into(), vec![DVec2::new(3.0, 4.0); 50], 1.0, DVec2::ZERO),
        ("a plan of 1e-3 m".into(), scattered.clone(), 1e-4, DVec2::ZERO),
        ("a plan of 1e6 m".into(), scattered.clone(), 1e5, DVec2::ZERO),
        ("a plan of 10 m, 1e7 m from zero".into(), scattered.clone(), 1.0, DVec2::new(1e7, -1e7)),
    ];
    cases.into_iter().map(|(case, points, scale, offset)| Row::new(case, worst(&points, scale, offset), 1e-9)).collect()
}

/// The largest error of any kind; infinite when the plan has no triangles.
fn worst(points: &[DVec2], scale: f64, offset: DVec2) -> f64 {
    let place = |p: DVec2| p * scale + offset;
    let edge = 10.0;
    let borders = [[0.0, 0.0], [edge, 0.0], [edge, edge], [0.0, edge]].map(|corner| place(DVec2::from(corner)));
    let contours = Contours { points: borders.to_vec(), edges: vec![[0, 1], [1, 2], [2, 3], [3, 0]] };
    let at = |p: DVec2| DVec3::new(p.x, 1.5, p.y);
    let probes: Vec<(u32, DVec3)> = (0..).zip(points.iter().map(|&p| at(place(p)))).collect();
    let height = Height { y: 1.5, floor: 0.0, ceiling: 3.0 };
    let parts = vec![place(DVec2::new(5.03, 4.91))];
    let network = Network {
        levels: vec![Ground::new(height, &contours, parts).with_probes(&probes, &Air)],
        ..Network::default()
    };
    let level = &network.levels[0];
    if level.triangles.is_empty() {
        return f64::INFINITY;
    }
    let sum = |position: DVec3| network.weights(position).iter().map(|share| share.weight).sum::<f64>();
    let mut random = Random(22);
    let anywhere = (0..500).map(|_| at(place(DVec2::new(random.uniform(-1.0, 11.0), random.uniform(-1.0, 11.0)))));
    let sums = probes.iter().map(|probe| probe.1).chain(anywhere).map(|position| (sum(position) - 1.0).abs());
    let own = probes.iter().map(|(_, position)| {
        let near = |probe: u32| probes[probe as usize].1.distance(*position) <= 1e-6 * edge * scale;
        1.0 - network.weights(*position).iter().filter(|share| near(share.probe)).map(|share| share.weight).sum::<f64>()
    });
    let area: f64 = level
        .triangles
        .iter()
        .map(|corners| {
            let [a, b, c] = corners.map(|corner| level.vertices[corner as usize].position);
            (b - a).perp_dot(c - a) / 2.0
        })
        .sum();
    let area = (area / (edge * scale).powi(2) - 1.0).abs();
    sums.chain(own).chain([area]).fold(0.0, worse)
}
