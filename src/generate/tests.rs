use super::*;
use crate::scene::splats::{ALPHA_MAX, ALPHA_MIN};

/// One room with a default building's density.
fn one_room() -> InteriorSettings {
    InteriorSettings { gaussians: 100_000, rooms: [1, 1], sh_degree: 1, ..Default::default() }
}

fn quantiles<const N: usize>(mut values: Vec<f64>, shares: [f64; N]) -> [f64; N] {
    values.sort_by(f64::total_cmp);
    shares.map(|share| values[(share * (values.len() - 1) as f64) as usize])
}

fn bytes(splats: &Splats) -> Vec<u8> {
    let mut bytes = bytemuck::cast_slice::<_, u8>(&splats.means).to_vec();
    bytes.extend_from_slice(bytemuck::cast_slice(&splats.unit_from_world));
    bytes.extend_from_slice(bytemuck::cast_slice(&splats.opacities));
    bytes.extend_from_slice(bytemuck::cast_slice(&splats.sh));
    bytes
}

/// How many Gaussians a ray blends until its transmittance is below 0.001, and what it then is; every Gaussian asked.
fn blend(splats: &Splats, origin: DVec3, direction: DVec3) -> (usize, f64) {
    let mut hits: Vec<(f64, f64)> = (0..splats.len())
        .filter_map(|i| {
            let unit = splats.unit_from_world[i].as_dmat3();
            let [g, v] = [unit * (origin - splats.means[i].as_dvec3()), unit * direction];
            let distance = -g.dot(v) / v.length_squared();
            let squared = g.cross(v).length_squared() / v.length_squared();
            let alpha = (f64::from(splats.opacities[i]) * (-0.5 * squared).exp()).min(ALPHA_MAX);
            (distance > 0.0 && alpha >= ALPHA_MIN).then_some((distance, alpha))
        })
        .collect();
    hits.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut transmittance = 1.0;
    for (count, (_, alpha)) in hits.iter().enumerate() {
        transmittance *= 1.0 - alpha;
        if transmittance < 1e-3 {
            return (count + 1, transmittance);
        }
    }
    (hits.len(), transmittance)
}

/// Rays in random directions from eye height in the middle of each room in turn.
fn blended_from_rooms(settings: &InteriorSettings, rays: u64) -> (Vec<f64>, Vec<f64>) {
    let splats = interior(settings);
    let results: Vec<(usize, f64)> = (0..rays)
        .into_par_iter()
        .map(|ray| {
            let room = ray as usize % (settings.rooms[0] * settings.rooms[1]);
            let cell = DVec2::new((room % settings.rooms[0]) as f64, (room / settings.rooms[0]) as f64) + 0.5;
            let direction = Random::new(9, ray).direction();
            blend(&splats, DVec3::new(cell.x * ROOM.x, 1.5, cell.y * ROOM.z), direction)
        })
        .collect();
    (results.iter().map(|r| r.0 as f64).collect(), results.iter().map(|r| r.1).collect())
}

#[test]
fn one_thread_and_two_make_the_same_bytes() {
    let settings = InteriorSettings { gaussians: 20_000, rooms: [2, 1], ..Default::default() };
    let make = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| [bytes(&interior(&settings)), bytes(&extreme(1000, 3))].concat())
    };
    assert!(make(1) == make(2));
}

#[test]
fn another_seed_makes_another_building() {
    let settings = InteriorSettings { gaussians: 1000, ..one_room() };
    assert!(bytes(&interior(&settings)) != bytes(&interior(&InteriorSettings { seed: 2, ..settings })));
}

#[test]
fn the_degree_changes_higher_bands_only() {
    let settings = InteriorSettings { gaussians: 2000, ..one_room() };
    let [low, high] = [1, 3].map(|sh_degree| interior(&InteriorSettings { sh_degree, ..settings }));
    assert_eq!(low.means, high.means);
    assert_eq!(low.unit_from_world, high.unit_from_world);
    for i in 0..low.len() {
        for channel in 0..3 {
            assert_eq!(low.sh_of(i)[channel * 4..][..4], high.sh_of(i)[channel * 16..][..4]);
        }
    }
}

#[test]
fn scattering_is_a_permutation() {
    for count in [1, 2, 1000, 65_537] {
        let mut seen: Vec<usize> = (0..count).map(|i| scattered(i, count)).collect();
        seen.sort_unstable();
        assert!(seen.into_iter().eq(0..count));
    }
}

#[test]
fn every_gaussian_is_finite_and_within_its_limits() {
    for splats in [interior(&InteriorSettings { sh_degree: 4, ..one_room() }), extreme(20_000, 5)] {
        assert_eq!(splats.sh.len(), splats.len() * splats.sh_stride());
        assert!(splats.sh.iter().all(|c| c.is_finite()));
        for i in 0..splats.len() {
            assert!(splats.means[i].is_finite() && splats.unit_from_world[i].is_finite());
            assert!((0.0..=1.0).contains(&splats.opacities[i]));
            let sds = splats.standard_deviations(i);
            assert!(sds.min_element() > 4.99e-5 && sds.max_element() < 10.01, "{sds}");
        }
    }
}

#[test]
fn opacities_and_sizes_have_a_captures_quantiles() {
    let splats = interior(&one_room());
    let opacities = splats.opacities.iter().map(|&o| f64::from(o)).collect();
    let [o1, o10, o50, o90] = quantiles(opacities, [0.01, 0.1, 0.5, 0.9]);
    let largest = (0..splats.len()).map(|i| splats.standard_deviations(i).max_element()).collect();
    let [s1, s50, s99, outlier] = quantiles(largest, [0.01, 0.5, 0.99, 1.0]);
    let smallest = (0..splats.len()).map(|i| splats.standard_deviations(i).min_element()).collect();
    let [thinnest] = quantiles(smallest, [0.0]);
    println!(
        "opacities {o1:.3} {o10:.3} {o50:.3} {o90:.4}; sizes {s1:.4} {s50:.4} {s99:.4} {outlier:.1}; {thinnest:.2e}"
    );
    assert!((o1 - 0.04).abs() < 0.01 && (o10 - 0.12).abs() < 0.02);
    assert!((o50 - 0.69).abs() < 0.03 && (o90 - 0.996).abs() < 0.001);
    let near = |value: f64, target: f64| (value / target).ln().abs() < 0.2;
    assert!(near(s1, 0.009) && near(s50, 0.04) && near(s99, 0.23));
    assert!(outlier > 3.0 && thinnest < 6e-5);
}

#[test]
fn a_ray_blends_about_forty_gaussians() {
    let (counts, _) = blended_from_rooms(&one_room(), 300);
    let [p10, p50, p90] = quantiles(counts, [0.1, 0.5, 0.9]);
    println!("{p10} {p50} {p90}");
    assert!((34.0..=46.0).contains(&p50), "{p50}");
}

#[test]
fn rooms_are_closed() {
    let small = InteriorSettings { gaussians: 40_000, rooms: [2, 1], gaussian_size: 2.0, ..one_room() };
    let (_, transmittances) = blended_from_rooms(&small, 300);
    let [p99] = quantiles(transmittances, [0.99]);
    assert!(p99 < 0.05, "{p99}");
}

#[test]
fn extremes_reach_anisotropies_of_ten_thousand() {
    let splats = extreme(10_000, 1);
    let ratios = (0..splats.len()).map(|i| splats.standard_deviations(i)).map(|s| s.max_element() / s.min_element());
    let [p50, p99] = quantiles(ratios.collect(), [0.5, 0.99]);
    assert!(p50 > 100.0 && p99 > 1e4, "{p50} {p99}");
}

#[test]
fn energy_falls_from_band_to_band_but_a_sign_slip_in_the_first_shows() {
    let splats = interior(&InteriorSettings { sh_degree: 3, gaussians: 20_000, ..one_room() });
    let mut energies = [0.0; 4];
    for i in 0..splats.len() {
        for (k, &c) in splats.sh_of(i)[..16].iter().enumerate() {
            let band = k.isqrt();
            energies[band] += f64::from(c).powi(2) / (2 * band + 1) as f64 / splats.len() as f64;
        }
    }
    assert!(energies.is_sorted_by(|a, b| a > b), "{energies:?}");
    // A coefficient of the wrong sign is off by twice its colour: more than 5 % of white here.
    assert!(2.0 * LINEAR * energies[1].sqrt() > 0.05, "{energies:?}");
}
