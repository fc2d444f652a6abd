//! The browsers' choice of probes (src/export/web/probes.js, run by node) against the crate's.

use std::io::Write;
use std::process::{Command, Stdio};

use glam::{DVec2, DVec3};
use serde_json::{Value, json};
use splatprobe::export::PROBES_JS;
use splatprobe::filter::{RgbCubemap, ShRadiance};
use splatprobe::place::interpolate::{Network, parallax_corrected};
use splatprobe::place::levels::Height;
use splatprobe::place::triangulation::{Level, Share, Vertex};
use splatprobe::place::{Probe, grid};
use splatprobe::scene::bounds::Bounds;

/// Runs a module after probes.js with `input` as a variable; what it assigns to `output`. None where there is no node.
fn run(module: &str, input: &Value) -> Option<Value> {
    let source =
        format!("{PROBES_JS}\nconst input = {input};\nlet output;\n{module}\nconsole.log(JSON.stringify(output));");
    let node = Command::new("node")
        .args(["--input-type=module"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let Ok(mut node) = node else {
        println!("skipped: node is absent");
        return None;
    };
    node.stdin.take().unwrap().write_all(source.as_bytes()).unwrap();
    let output = node.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

/// Positions all over a box, a little beyond it too.
fn positions() -> Vec<DVec3> {
    let at = |i: u32, step: f64| 1.3 * (f64::from(i) * step).fract() - 0.15;
    (0..2000).map(|i| DVec3::new(6.0 * at(i, 0.618_034), 6.0 * at(i, 0.414_214), 4.0 * at(i, 0.732_051))).collect()
}

fn shares(value: &Value) -> Vec<(u64, f64)> {
    let share = |share: &Value| (share["probe"].as_u64().unwrap(), share["weight"].as_f64().unwrap());
    value.as_array().unwrap().iter().map(share).collect()
}

fn assert_agree(found: &Value, expected: &[(u64, f64)], at: DVec3) {
    let found = shares(found);
    assert!(found.iter().map(|share| share.0).eq(expected.iter().map(|share| share.0)), "{at}: {found:?} {expected:?}");
    for (found, expected) in found.iter().zip(expected) {
        assert!((found.1 - expected.1).abs() < 1e-9, "{at}: {found:?} {expected:?}");
    }
}

/// Two rooms side by side with a border vertex between two probes, and a blocked edge.
fn level(y: f64, [floor, ceiling]: [f64; 2], first: u32) -> Level {
    let probe = |x: f64, z: f64, probe: u32| Vertex {
        position: DVec2::new(x, z),
        blend: vec![Share { probe: first + probe, weight: 1.0 }],
        is_probe: true,
    };
    let between = Vertex {
        position: DVec2::new(3.0, 4.0),
        blend: vec![Share { probe: first + 1, weight: 0.25 }, Share { probe: first + 2, weight: 0.75 }],
        is_probe: false,
    };
    Level {
        height: Height { y, floor, ceiling },
        vertices: vec![probe(0.5, 0.5, 0), probe(5.5, 1.0, 1), probe(0.3, 3.5, 2), between],
        triangles: vec![[0, 1, 2], [1, 3, 2]],
        neighbours: vec![[Some(1), None, None], [None, Some(0), None]],
        walls: Vec::new(),
        blocked: vec![[0, 2]],
    }
}

#[test]
fn triangles_and_levels_weigh_as_in_the_crate() {
    let mut levels = vec![level(1.0, [0.0, 2.5], 0), level(2.0, [0.0, 2.5], 3), level(4.0, [3.0, 5.0], 6)];
    // A corner that is kept from one which does not count itself, and corners that are all kept apart.
    levels[1].blocked = vec![[0, 1], [1, 2]];
    levels[2].blocked = vec![[0, 1], [0, 2], [1, 2], [1, 3], [2, 3]];
    let input = json!({ "probes": [], "placement": { "levels": levels }, "positions": positions() });
    let Some(found) = run("output = input.positions.map((position) => weights(input, position));", &input) else {
        return;
    };
    let network = Network { probes: Vec::new(), levels };
    for (at, found) in positions().into_iter().zip(found.as_array().unwrap()) {
        let expected: Vec<_> = network.weights(at).iter().map(|share| (u64::from(share.probe), share.weight)).collect();
        assert_agree(found, &expected, at);
    }
}

#[test]
fn boxes_weigh_and_correct_as_in_the_crate() {
    let bounds = Bounds { min: DVec3::ZERO, max: DVec3::new(6.0, 6.0, 4.0) };
    let probes: Vec<Probe> = grid(bounds, [3, 2, 2], 0.4).unwrap();
    let records: Vec<Value> = probes
        .iter()
        .map(|probe| {
            let influence = json!({ "min": probe.influence.min, "max": probe.influence.max, "blend": probe.blend });
            json!({ "position": probe.position, "influence": influence, "proxy": probe.proxy })
        })
        .collect();
    let directions: Vec<DVec3> = positions().iter().map(|at| (at - 2.5).normalize()).chain(DVec3::AXES).collect();
    let input = json!({ "probes": records, "positions": positions(), "directions": directions });
    let module = "output = { weights: input.positions.map((position) => weights(input, position)), \
        corrected: input.directions.map((d, i) => parallaxCorrected(input.probes[i % 12], input.positions[i % 2000], d)) };";
    let Some(found) = run(module, &input) else { return };
    for (at, found) in positions().into_iter().zip(found["weights"].as_array().unwrap()) {
        let reaching: Vec<(u64, f64)> =
            (0..).zip(&probes).map(|(i, probe)| (i, probe.weight(at))).filter(|share| share.1 > 0.0).collect();
        let sum: f64 = reaching.iter().map(|share| share.1).sum();
        let expected: Vec<_> = reaching.into_iter().map(|(i, weight)| (i, weight / sum)).collect();
        assert_agree(found, &expected, at);
    }
    for (i, (direction, found)) in directions.iter().zip(found["corrected"].as_array().unwrap()).enumerate() {
        let found = DVec3::from_array([0, 1, 2].map(|axis| found[axis].as_f64().unwrap())).normalize();
        let probe = &probes[i % 12];
        let expected = parallax_corrected(probe.position, &probe.proxy, positions()[i % 2000], *direction);
        assert!((found - expected).length() < 1e-9, "{direction}: {found} is not {expected}");
    }
}

#[test]
fn diffuse_light_is_the_irradiance_of_the_harmonics() {
    let cubemap = RgbCubemap::from_fn(16, |d| (d * DVec3::new(0.3, 0.5, 0.2) + 1.0 + d.x * d.y).as_vec3());
    let sh = ShRadiance::project(&cubemap, 2);
    let coefficients: Vec<[f64; 3]> = sh.coefficients().iter().map(|c| c.to_array()).collect();
    let Some(found) = run("output = irradianceFactors(input);", &json!({ "coefficients": coefficients })) else {
        return;
    };
    let s: Vec<DVec3> = (0..9).map(|i| DVec3::from_array([0, 1, 2].map(|k| found[i][k].as_f64().unwrap()))).collect();
    for n in positions().iter().map(|at| (at - 2.0).normalize()) {
        let found = s[0]
            + s[1] * n.y
            + s[2] * n.z
            + s[3] * n.x
            + s[4] * (n.x * n.y)
            + s[5] * (n.y * n.z)
            + s[6] * (3.0 * n.z * n.z - 1.0)
            + s[7] * (n.x * n.z)
            + s[8] * (n.x * n.x - n.y * n.y);
        let expected = sh.irradiance(n);
        assert!((found - expected).abs().max_element() < 1e-5, "{n}: {found} is not {expected}");
    }
}
