//! A level drawn cell by cell: its borders, their triangulation with probes anywhere in free cells, and blending by that.
#![no_main]

use glam::{DVec2, DVec3};
use splatprobe::place::Network;
use splatprobe::place::contours::Contours;
use splatprobe::place::levels::Height;
use splatprobe::place::plan::{Lattice, Plan};
use splatprobe::place::triangulation::Ground;
use splatprobe::place::walls::Openings;

/// Bits of a cell: free, open toward +X and +Z, with a probe. The other four move the probe from the cell's centre.
const FREE: u8 = 1;
const OPEN_X: u8 = 2;
const OPEN_Z: u8 = 4;
const PROBE: u8 = 8;

/// Walls by the bits of the points that they stand between: any, and always the same.
struct Arbitrary;

impl Openings for Arbitrary {
    fn is_open(&self, from: DVec3, to: DVec3) -> bool {
        !(from + to).x.to_bits().wrapping_mul(0x9e37_79b9_7f4a_7c15).leading_zeros().is_multiple_of(3)
    }

    fn is_free(&self, point: DVec3) -> bool {
        point.z.to_bits() & 0x100 != 0
    }
}

fn plan(width: usize, cells: &[u8]) -> Plan {
    let lattice = Lattice { cell: 0.25, first: [-3, 5], size: [width, cells.len() / width] };
    let free: Vec<bool> = cells.iter().map(|cell| cell & FREE != 0).collect();
    let open = [OPEN_X, OPEN_Z].map(|bit| {
        let axis = usize::from(bit == OPEN_Z);
        let is_open =
            |i: usize| lattice.after(i, axis).is_some_and(|next| free[i] && free[next] && cells[i] & bit != 0);
        (0..cells.len()).map(is_open).collect()
    });
    Plan { lattice, height: 1.5, free, open }
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some((&width, cells)) = bytes.split_first() else { return };
    let width = usize::from(width % 32) + 1;
    let rows = (cells.len() / width).min(32);
    if rows == 0 {
        return;
    }
    let cells = &cells[..rows * width];
    let plan = plan(width, cells);
    let all: Vec<usize> = (0..cells.len()).filter(|&i| plan.free[i]).collect();
    let parts: Vec<DVec2> = plan.groups(&all).iter().map(|group| plan.lattice.centre(group[0])).collect();
    let with_probe = all.iter().filter(|&&i| cells[i] & PROBE != 0);
    // From the centre itself over next to nothing to nearly the border.
    let moved = |i: usize| {
        let by = [0.0, 1e-16, 1e-12, 0.12][usize::from(cells[i] >> 4 & 3)];
        plan.point(i) + DVec3::new(by, 0.0, if cells[i] >> 6 & 1 == 1 { by } else { -by })
    };
    let probes: Vec<(u32, DVec3)> = (0..).zip(with_probe.map(|&i| moved(i))).collect();
    let height = Height { y: 1.5, floor: 0.0, ceiling: 3.0 };
    let level = Ground::new(height, &Contours::of(&plan), parts).with_probes(&probes, &Arbitrary);
    let network = Network { levels: vec![level], ..Network::default() };
    for (_, probe) in &probes {
        let sum: f64 = network.weights(*probe).iter().map(|share| share.weight).sum();
        assert!((sum - 1.0).abs() < 1e-9, "{sum} at {probe}");
    }
});
