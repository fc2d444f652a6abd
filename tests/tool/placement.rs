//! Adaptive placement in rooms of coloured walls: where probes stand, what they predict, and what is asked wrongly.

use std::sync::atomic::AtomicBool;

use glam::{DVec2, DVec3, Vec3, Vec4};
use splatprobe::Error;
use splatprobe::bvh::Bvh;
use splatprobe::place::free_space::Space;
use splatprobe::place::{Adaptive, AdaptiveSettings, Network, Sight, adaptive, interpolate};
use splatprobe::scene::Material;
use splatprobe::scene::mesh::VertexAttributes;
use splatprobe::scene::{Bounds, LinearRgb, Scene, SplatEncoding};
use splatprobe::shade::UnlitSurfaces;
use splatprobe::trace::ray::RayScratch;
use splatprobe::trace::{Ray, RayTracer, TraceSettings};

use crate::common::Random;

const RED: Vec3 = Vec3::new(0.8, 0.1, 0.1);
const GREEN: Vec3 = Vec3::new(0.1, 0.7, 0.2);
const WHITE: Vec3 = Vec3::new(0.9, 0.9, 0.9);
const GREY: Vec3 = Vec3::new(0.4, 0.4, 0.4);

/// A scene in the making.
#[derive(Default)]
struct Rooms {
    scene: Scene,
}

impl Rooms {
    /// A rectangle from `corner` along two edges, seen from both sides.
    fn quad(&mut self, corner: [f64; 3], edges: [[f64; 3]; 2], colour: Vec3) -> &mut Self {
        let [corner, right, up] = [corner, edges[0], edges[1]].map(|at| DVec3::from(at).as_vec3());
        let meshes = &mut self.scene.meshes;
        let first = meshes.positions.len() as u32;
        meshes.positions.extend([corner, corner + right, corner + right + up, corner + up]);
        meshes.attributes.extend([VertexAttributes::default(); 4]);
        meshes.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        let material = meshes.materials.len() as u32;
        meshes.triangle_materials.extend([material; 2]);
        let base_colour = Vec4::from((colour, 1.0));
        meshes.materials.push(Material { base_colour, double_sided: true, ..Material::default() });
        self
    }

    /// The six sides of a box, from inside or outside.
    fn cuboid(&mut self, low: [f64; 3], high: [f64; 3], colour: Vec3) -> &mut Self {
        let [x, y, z] = std::array::from_fn(|axis| {
            let mut edge = [0.0; 3];
            edge[axis] = high[axis] - low[axis];
            edge
        });
        for (corner, edges) in [
            (low, [x, y]),
            (low, [y, z]),
            (low, [z, x]),
            (high, [neg(x), neg(y)]),
            (high, [neg(y), neg(z)]),
            (high, [neg(z), neg(x)]),
        ] {
            self.quad(corner, edges, colour);
        }
        self
    }
}

fn neg(edge: [f64; 3]) -> [f64; 3] {
    edge.map(|value| -value)
}

fn bounds(low: [f64; 3], high: [f64; 3]) -> Bounds {
    Bounds { min: low.into(), max: high.into() }
}

fn settings(bounds: Bounds) -> AdaptiveSettings {
    AdaptiveSettings { bounds, levels: Vec::new(), error: 0.1, max_probes: 64, time: None, held_out: 0 }
}

/// Runs `test` with a way to look at the scene.
fn with_sight<T>(rooms: &mut Rooms, test: impl FnOnce(&Sight) -> T) -> T {
    let scene = &mut rooms.scene;
    scene.encoding = SplatEncoding::LinScene;
    let bvh = Bvh::build(scene);
    let surfaces = UnlitSurfaces::new(&scene.meshes);
    let settings = TraceSettings::default();
    let tracer = RayTracer { scene, bvh: &bvh, surfaces: &surfaces, settings };
    test(&Sight { space: Space { tracer }, tiles: &tracer })
}

fn place(rooms: &mut Rooms, settings: &AdaptiveSettings) -> splatprobe::Result<Adaptive> {
    with_sight(rooms, |sight| adaptive(sight, settings, &AtomicBool::new(false)))
}

fn network(placed: &Adaptive) -> Network {
    let probes = placed.probes.iter().map(|probe| (probe.position, probe.proxy)).collect();
    Network { probes, levels: placed.record.levels.clone() }
}

/// Two closed rooms of 3 x 2.5 x 3 m on both sides of x = 0, each of one colour, and a wall without thickness.
fn two_rooms() -> Rooms {
    let mut rooms = Rooms::default();
    rooms.cuboid([-3.0, 0.0, 0.0], [-0.001, 2.5, 3.0], RED).cuboid([0.001, 0.0, 0.0], [3.0, 2.5, 3.0], GREEN);
    rooms
}

const TWO_ROOMS: [[f64; 3]; 2] = [[-3.1, -0.1, -0.1], [3.1, 2.6, 3.1]];

#[test]
fn two_rooms_behind_a_thin_wall_do_not_leak_into_each_other() {
    let mut rooms = two_rooms();
    // Not all of one room is alike, so that it needs more than one probe.
    rooms.cuboid([-2.0, 0.0, 1.0], [-1.5, 1.8, 1.5], RED * 0.3);
    let [low, high] = TWO_ROOMS;
    with_sight(&mut rooms, |sight| {
        let placed = adaptive(sight, &settings(bounds(low, high)), &AtomicBool::new(false)).unwrap();
        assert!(placed.probes.len() >= 2, "{}", placed.probes.len());
        let network = network(&placed);
        let tracer = &sight.space.tracer;
        let radiance = |probe: usize, direction: DVec3, _: f64| {
            let ray = Ray { origin: network.probes[probe].0, direction };
            tracer.trace(&ray, &mut RayScratch::default()).to_linear(SplatEncoding::LinScene, LinearRgb::default())
        };
        let mut random = Random(7);
        for i in 0..400 {
            let x = if i % 2 == 0 { random.uniform(-2.99, -0.01) } else { random.uniform(0.01, 2.99) };
            let position = DVec3::new(x, random.uniform(0.01, 2.49), random.uniform(0.01, 2.99));
            let seen = interpolate(&network, radiance, position, random.direction(), 0.3).0;
            // The other room's colour has the other channels.
            let hue = seen / seen.max_element();
            let own = if x < 0.0 { RED } else { GREEN };
            assert!((hue - own / own.max_element()).abs().max_element() < 0.02, "{position}: {seen}");
        }
    });
}

/// A hall in the shape of an L around a closed room, a pillar, and a table.
fn l_shaped_hall() -> (Rooms, Bounds) {
    let mut rooms = Rooms::default();
    rooms
        .cuboid([0.0, 0.0, 0.0], [7.0, 2.6, 6.0], GREY)
        .cuboid([3.5, 0.0, 0.0], [7.0, 2.6, 3.0], RED)
        .quad([0.0, 0.5, 1.0], [[0.0, 1.2, 0.0], [0.0, 0.0, 2.0]], WHITE * 3.0)
        .cuboid([1.5, 0.0, 4.0], [1.9, 2.6, 4.4], GREEN)
        .cuboid([4.5, 0.0, 4.2], [5.5, 0.8, 5.0], WHITE);
    (rooms, bounds([-0.2, -0.1, -0.2], [7.2, 2.7, 6.2]))
}

#[test]
fn no_probe_stands_in_matter_no_triangle_crosses_a_wall_and_every_place_is_in_a_box() {
    let (mut rooms, bounds) = l_shaped_hall();
    with_sight(&mut rooms, |sight| {
        let settings = AdaptiveSettings { error: 0.05, held_out: 60, ..settings(bounds) };
        let placed = adaptive(sight, &settings, &AtomicBool::new(false)).unwrap();
        let checks = placed.record.checks;
        assert_eq!(
            [checks.probes_in_matter, checks.triangles_across_walls, checks.positions_without_influence],
            [0; 3]
        );
        let mut scratch = RayScratch::default();
        let mut random = Random(3);
        for i in 0..2000 {
            let position =
                DVec3::new(random.uniform(0.05, 6.95), random.uniform(0.05, 2.55), random.uniform(0.05, 5.95));
            let is_free = sight.space.is_free(position, &mut scratch);
            let is_covered = placed.probes.iter().any(|probe| probe.weight(position) > 0.0);
            assert!(!is_free || is_covered, "{i}: {position}");
        }
        for level in &placed.record.levels {
            for triangle in &level.triangles {
                let corners = triangle.map(|vertex| level.vertices[vertex as usize].position);
                let centre = (corners[0] + corners[1] + corners[2]) / 3.0;
                let at = |plan: DVec2| DVec3::new(plan.x, level.height.y, plan.y);
                for corner in corners {
                    // Corners of borders lie in walls or half a cell before them.
                    assert!(sight.space.is_open(at(centre), at(centre.lerp(corner, 0.7)), &mut scratch), "{centre}");
                }
            }
        }
        let held_out = placed.record.held_out.unwrap();
        assert!(held_out.positions == 60 && held_out.adaptive.mean < held_out.grid.mean, "{held_out:?}");
    });
}

#[test]
fn equal_runs_give_equal_placements_on_any_number_of_threads() {
    let (mut rooms, bounds) = l_shaped_hall();
    with_sight(&mut rooms, |sight| {
        let settings = AdaptiveSettings { max_probes: 6, error: 0.0, held_out: 10, ..settings(bounds) };
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| adaptive(sight, &settings, &AtomicBool::new(false)).unwrap())
        };
        let [one, three] = [on(1), on(3)];
        assert_eq!(one.probes, three.probes);
        assert_eq!(one.record, three.record);
        assert_eq!(one.probes.len(), 6);
    });
}

#[test]
fn a_change_in_the_other_room_moves_no_probe_in_this_one() {
    let [low, high] = TWO_ROOMS;
    let this_room = |rooms: &mut Rooms| -> Vec<DVec3> {
        rooms.cuboid([-2.0, 0.0, 1.0], [-1.5, 2.0, 1.5], WHITE);
        let placed = place(rooms, &settings(bounds(low, high))).unwrap();
        placed.probes.iter().map(|probe| probe.position).filter(|position| position.x < 0.0).collect()
    };
    let before = this_room(&mut two_rooms());
    let mut changed = two_rooms();
    changed.cuboid([1.2, 0.0, 1.2], [1.7, 2.2, 1.9], WHITE * 2.0);
    assert_eq!(this_room(&mut changed), before);
    assert!(before.len() > 1, "{before:?}");
}

fn request(result: splatprobe::Result<Adaptive>) -> (String, String) {
    match result {
        Err(Error::Request { field, why }) => (field, why),
        Err(other) => panic!("{other}"),
        Ok(placed) => panic!("{} probes", placed.probes.len()),
    }
}

#[test]
fn places_without_free_space_are_named() {
    let outside = bounds([50.0, 0.0, 50.0], [53.0, 2.5, 53.0]);
    let (field, why) = request(place(&mut two_rooms(), &settings(outside)));
    assert!(field == "--bounds" && why.contains("no floor"), "{why}");
    let [low, high] = TWO_ROOMS.map(DVec3::from);
    let inverted = Bounds { min: high, max: low };
    assert_eq!(request(place(&mut two_rooms(), &settings(inverted))).0, "bounds");
    let level = |y: f64| AdaptiveSettings { levels: vec![1.2, y], ..settings(Bounds { min: low, max: high }) };
    assert!(request(place(&mut two_rooms(), &level(9.0))).1.contains("outside the bounds"));
    // In the ceiling.
    let (field, why) = request(place(&mut two_rooms(), &level(2.45)));
    assert!(field == "--levels" && why.starts_with("2.45 m: of "), "{field}: {why}");
}

#[test]
fn the_least_free_space_and_the_least_budget_give_the_least_placement() {
    // A shaft for one point, and one for a row of points.
    for width in [0.5, 2.2] {
        let mut shaft = Rooms::default();
        shaft.cuboid([0.0, 0.0, 0.0], [width, 2.5, 0.5], GREY);
        let placed = place(&mut shaft, &settings(bounds([-0.1, -0.1, -0.1], [width + 0.1, 2.6, 0.6]))).unwrap();
        assert!(!placed.probes.is_empty() && !placed.record.levels[0].triangles.is_empty(), "{width}");
        assert!(!network(&placed).weights(DVec3::new(0.2, 1.0, 0.2)).is_empty());
    }
    let (mut hall, bounds) = l_shaped_hall();
    let lone = AdaptiveSettings { max_probes: 1, error: 0.0, ..settings(bounds) };
    assert_eq!(place(&mut hall, &lone).unwrap().probes.len(), 1);
}

#[test]
fn an_error_of_0_ends_with_a_probe_on_every_site() {
    let mut room = Rooms::default();
    room.cuboid([0.0, 0.0, 0.0], [2.0, 2.5, 2.0], RED).cuboid([0.0, 0.0, 0.0], [0.4, 1.0, 0.4], GREEN);
    let exact =
        AdaptiveSettings { error: 0.0, max_probes: 1_000_000, ..settings(bounds([-0.1, -0.1, -0.1], [2.1, 2.6, 2.1])) };
    let placed = place(&mut room, &exact).unwrap();
    assert!(placed.probes.len() <= placed.record.sites && placed.probes.len() > placed.record.sites / 2);
}

#[test]
fn an_outdoor_scene_without_end_has_probes_above_its_ground() {
    let mut field = Rooms::default();
    field.quad([-500.0, 0.0, -500.0], [[0.0, 0.0, 1000.0], [1000.0, 0.0, 0.0]], GREEN);
    field.cuboid([-3.0, 0.0, -3.0], [3.0, 4.0, 3.0], RED);
    let outdoors =
        AdaptiveSettings { max_probes: 4, ..settings(bounds([-400.0, -10.0, -400.0], [400.0, 100.0, 400.0])) };
    let placed = place(&mut field, &outdoors).unwrap();
    assert!((1..=4).contains(&placed.probes.len()));
    assert!(placed.probes.iter().all(|probe| (0.5..4.0).contains(&probe.position.y)), "{:?}", placed.probes);
}

#[test]
fn without_time_there_is_still_one_probe() {
    let (mut hall, bounds) = l_shaped_hall();
    let hurried = AdaptiveSettings { time: Some(std::time::Duration::from_nanos(1)), ..settings(bounds) };
    assert_eq!(place(&mut hall, &hurried).unwrap().probes.len(), 1);
}
