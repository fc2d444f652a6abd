//! A regular grid of probes in a box (as GBake places them, SIGGRAPH Posters '25, doi 10.1145/3721250.3742978).

use glam::{DVec3, UVec3};

use super::{Probe, check_bounds, check_overlap, probe_id};
use crate::error::{Error, Result};
use crate::job::MAX_PROBES;
use crate::scene::Bounds;

/// Probes at the centres of `counts` cells of `bounds`, ordered with x fastest, then y, then z.
///
/// A probe's influence is its cell, grown by `overlap * spacing / 2` toward each neighbour, so that two neighbours share
/// a slab `overlap * spacing` thick; that thickness is the blend distance there. Both ramps cross the same slab in
/// opposite directions, so the weights of all probes sum to 1 everywhere in the bounds (`overlap` 0: twice 1 on the
/// shared faces themselves). Sides without a neighbour end at the bounds with blend 0.
///
/// Fails with [`Error::Request`] when the bounds are not a finite box with a volume, a count is 0, the grid has more than
/// [`MAX_PROBES`] probes, or `overlap` is outside [0, 1].
pub fn grid(bounds: Bounds, counts: [u32; 3], overlap: f64) -> Result<Vec<Probe>> {
    check_bounds(&bounds)?;
    check_overlap(overlap)?;
    let total = counts.iter().try_fold(1_usize, |total, &n| total.checked_mul(n as usize));
    let total = match total {
        Some(total @ 1..=MAX_PROBES) => total,
        _ => {
            let [x, y, z] = counts;
            return Err(Error::request("grid", format!("{x},{y},{z} does not give 1 to {MAX_PROBES} probes")));
        }
    };
    let counts = UVec3::from(counts);
    let spacing = (bounds.max - bounds.min) / counts.as_dvec3();
    // Cell borders are formed from the nearer end of the bounds, so that the outer ones are the bounds exactly.
    let border = |i: UVec3| {
        let from_min = bounds.min + spacing * i.as_dvec3();
        let from_max = bounds.max - spacing * (counts - i).as_dvec3();
        DVec3::select((i * 2).cmple(counts), from_min, from_max)
    };
    let mut probes = Vec::with_capacity(total);
    for z in 0..counts.z {
        for y in 0..counts.y {
            for x in 0..counts.x {
                let cell = UVec3::new(x, y, z);
                let (low, high) = (border(cell), border(cell + 1));
                // 1 on the axes where a neighbour shares the side.
                let below = DVec3::select(cell.cmpgt(UVec3::ZERO), DVec3::ONE, DVec3::ZERO);
                let above = DVec3::select((cell + 1).cmplt(counts), DVec3::ONE, DVec3::ZERO);
                let shared = spacing * overlap;
                let (blend_low, blend_high) = (shared * below, shared * above);
                let influence = Bounds { min: low - blend_low / 2.0, max: high + blend_high / 2.0 };
                probes.push(Probe {
                    id: probe_id(probes.len(), total),
                    position: (low + high) / 2.0,
                    influence,
                    proxy: influence,
                    blend: [blend_high.x, blend_low.x, blend_high.y, blend_low.y, blend_high.z, blend_low.z],
                });
            }
        }
    }
    Ok(probes)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROOM: Bounds = Bounds { min: DVec3::new(-3.0, 0.0, 10.0), max: DVec3::new(5.0, 2.5, 13.0) };

    #[test]
    fn probes_stand_at_cell_centres_with_x_fastest() {
        let probes = grid(ROOM, [4, 1, 2], 0.5).unwrap();
        assert_eq!(probes.len(), 8);
        assert_eq!(probes[0].position, DVec3::new(-2.0, 1.25, 10.75));
        assert_eq!(probes[1].position, DVec3::new(0.0, 1.25, 10.75));
        assert_eq!(probes[4].position, DVec3::new(-2.0, 1.25, 12.25));
        assert_eq!(probes[7].id, "probe_007");
    }

    #[test]
    fn neighbours_share_the_overlap_and_outer_sides_end_at_the_bounds() {
        let probes = grid(ROOM, [4, 1, 2], 0.5).unwrap();
        let [first, second] = [&probes[0], &probes[1]];
        assert_eq!(first.influence.max.x - second.influence.min.x, 0.5 * 2.0);
        assert_eq!(first.influence.min, ROOM.min);
        assert_eq!(probes[7].influence.max, ROOM.max);
        assert_eq!(first.blend, [1.0, 0.0, 0.0, 0.0, 0.75, 0.0]);
        assert_eq!(second.blend, [1.0, 1.0, 0.0, 0.0, 0.75, 0.0]);
    }

    #[test]
    fn weights_sum_to_one_everywhere_in_the_bounds() {
        for overlap in [0.1, 0.5, 1.0] {
            let probes = grid(ROOM, [4, 3, 2], overlap).unwrap();
            let steps = 23;
            for i in 0..=steps * steps * steps {
                let step =
                    DVec3::new((i % steps) as f64, (i / steps % steps) as f64, (i / steps / steps % steps) as f64);
                let point = ROOM.min + (ROOM.max - ROOM.min) * step / (steps - 1) as f64;
                let sum: f64 = probes.iter().map(|probe| probe.weight(point)).sum();
                assert!((sum - 1.0).abs() < 1e-9, "overlap {overlap}: {sum} at {point}");
            }
        }
    }

    #[test]
    fn a_probe_has_full_weight_at_its_own_position() {
        for probe in grid(ROOM, [3, 3, 3], 1.0).unwrap() {
            assert!((probe.weight(probe.position) - 1.0).abs() < 1e-12, "{}", probe.id);
        }
    }

    #[test]
    fn wrong_requests_name_the_field_that_is_wrong() {
        let field = |result: Result<Vec<Probe>>| match result {
            Err(Error::Request { field, .. }) => field,
            other => panic!("{other:?}"),
        };
        let inverted = Bounds { min: ROOM.max, max: ROOM.min };
        let flat = Bounds { min: ROOM.min, max: DVec3::new(5.0, 0.0, 13.0) };
        let endless = Bounds { min: ROOM.min, max: DVec3::INFINITY };
        for bounds in [inverted, flat, endless, Bounds { min: DVec3::NAN, max: ROOM.max }] {
            assert_eq!(field(grid(bounds, [1, 1, 1], 0.5)), "bounds");
        }
        assert_eq!(field(grid(ROOM, [2, 0, 2], 0.5)), "grid");
        assert_eq!(field(grid(ROOM, [u32::MAX; 3], 0.5)), "grid");
        for overlap in [-0.1, 1.1, f64::NAN] {
            assert_eq!(field(grid(ROOM, [2, 2, 2], overlap)), "overlap");
        }
    }
}
