//! The tree's invariants, on the inputs that are known to hurt its builder (coincident boxes, outliers, broken numbers).

use std::time::{Duration, Instant};

use crate::common::{Gaussian, add_random_triangles, add_triangle, cloud, splats};
use glam::{DQuat, DVec3, Vec3};
use splatprobe::bvh::{Box3, Bvh, Child, WIDTH, gaussian_box};
use splatprobe::scene::Scene;

/// Every primitive stands in exactly one leaf, inside all boxes above it. Walks with an explicit stack: a tree over
/// hostile input may be deep.
fn assert_valid(scene: &Scene, bvh: &Bvh) {
    let mut gaussians = vec![0u8; scene.splats.len()];
    let mut triangles = vec![0u8; scene.meshes.triangles.len()];
    let everything = Box3 { min: Vec3::splat(f32::MIN), max: Vec3::splat(f32::MAX) };
    let mut pending = if bvh.nodes.is_empty() { vec![] } else { vec![(0u32, everything)] };
    let contains = |outer: &Box3, inner: &Box3| outer.min.cmple(inner.min).all() && outer.max.cmpge(inner.max).all();
    while let Some((node, outer)) = pending.pop() {
        for lane in 0..WIDTH {
            let wide = &bvh.nodes[node as usize];
            let Some(lane_box) = wide.lane_box(lane) else { continue };
            assert!(contains(&outer, &lane_box), "child {lane} of node {node} leaves its parent");
            match wide.child(lane) {
                Child::Node(child) => pending.push((child, lane_box)),
                Child::Gaussian(i) => {
                    gaussians[i as usize] += 1;
                    let own_box = gaussian_box(&scene.splats, i as usize);
                    assert!(contains(&lane_box, &own_box), "Gaussian {i} leaves its leaf");
                }
                Child::Triangle(i) => {
                    triangles[i as usize] += 1;
                    for corner in scene.meshes.corners(i as usize).into_iter().filter(|corner| corner.is_finite()) {
                        assert!(corner.cmpge(lane_box.min).all() && corner.cmple(lane_box.max).all());
                    }
                }
            }
        }
    }
    assert!(gaussians.iter().chain(&triangles).all(|&times| times == 1));
}

fn ball(mean: DVec3, radius: f64) -> Gaussian {
    Gaussian {
        mean,
        rotation: DQuat::IDENTITY,
        standard_deviations: DVec3::splat(radius),
        opacity: 0.9,
        colour: Vec3::ONE,
    }
}

fn build(mut scene: Scene) -> (Scene, Bvh) {
    let bvh = Bvh::build(&mut scene);
    (scene, bvh)
}

#[test]
fn every_primitive_stands_in_one_leaf_inside_its_boxes() {
    let mut scene = Scene { splats: cloud(5000, [1e-4, 1.0], 1, 3), ..Scene::default() };
    add_random_triangles(&mut scene, 3000, 4);
    let (scene, bvh) = build(scene);
    assert_valid(&scene, &bvh);
}

#[test]
fn a_scene_that_is_built_in_parts_makes_a_valid_tree_whatever_the_thread_count() {
    // More clusters than obvhs is given at once: random sizes and places cluster badly.
    let tree = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        pool.install(|| build(Scene { splats: cloud(200_000, [1e-3, 0.05], 1, 5), ..Scene::default() }))
    };
    let (scene, bvh) = tree(1);
    assert_valid(&scene, &bvh);
    let (other, same) = tree(2);
    assert_eq!(scene.splats.means, other.splats.means);
    assert_eq!(format!("{:?}", bvh.nodes), format!("{:?}", same.nodes));
}

#[test]
fn none_one_and_two_primitives_make_valid_trees() {
    for count in 0..3 {
        let scene =
            Scene { splats: splats((0..count).map(|i| ball(DVec3::X * f64::from(i), 0.1))), ..Scene::default() };
        let (scene, bvh) = build(scene);
        assert_valid(&scene, &bvh);
        assert_eq!(bvh.nodes.is_empty(), count == 0);
    }
}

#[test]
fn reordering_moves_every_array_of_a_gaussian_together() {
    let count = 500;
    let gaussian = |i: usize| Gaussian {
        opacity: 0.2 + i as f64 / 1000.0,
        colour: Vec3::splat(i as f32 / 500.0),
        ..ball(DVec3::new((i * 7919 % 500) as f64, 0.0, 0.0), 0.01 + i as f64 * 1e-3)
    };
    let (scene, _) = build(Scene { splats: splats((0..count).map(gaussian)), ..Scene::default() });
    for k in 0..count {
        let i = ((f64::from(scene.splats.opacities[k]) - 0.2) * 1000.0).round() as usize;
        let expected = splats([gaussian(i)]);
        assert_eq!(scene.splats.means[k], expected.means[0]);
        assert_eq!(scene.splats.unit_from_world[k], expected.unit_from_world[0]);
        assert_eq!(scene.splats.sh_of(k), expected.sh_of(0));
    }
}

/// PLOC chains coincident boxes in quadratic time: 50 000 of them took it 11 s and more.
#[test]
fn a_hundred_thousand_coincident_gaussians_build_in_seconds() {
    let start = Instant::now();
    let (scene, bvh) = build(Scene {
        splats: splats((0..100_000).map(|i| ball(DVec3::ONE, if i % 2 == 0 { 0.1 } else { 0.2 }))),
        ..Scene::default()
    });
    assert!(start.elapsed() < Duration::from_secs(20), "{:?}", start.elapsed());
    assert_valid(&scene, &bvh);
}

#[test]
fn coincident_clumps_and_concentric_shells_among_others_build_in_seconds() {
    let start = Instant::now();
    let clumps = (0..40_000).map(|i| ball(DVec3::new(f64::from(i % 20), 0.0, 0.0), 0.1));
    let shells = (0..20_000).map(|i| ball(DVec3::new(5.0, 5.0, 5.0), 1e-3 * 1.0005f64.powi(i)));
    let mut all = splats(clumps.chain(shells));
    let other = cloud(20_000, [0.01, 0.1], 0, 9);
    all.means.extend(other.means);
    all.unit_from_world.extend(other.unit_from_world);
    all.opacities.extend(other.opacities);
    all.sh.extend(other.sh);
    let (scene, bvh) = build(Scene { splats: all, ..Scene::default() });
    assert!(start.elapsed() < Duration::from_secs(20), "{:?}", start.elapsed());
    assert_valid(&scene, &bvh);
}

#[test]
fn non_finite_and_enormous_primitives_neither_panic_nor_hide_the_others() {
    let mut scene = Scene { splats: cloud(300, [0.01, 0.1], 0, 11), ..Scene::default() };
    scene.splats.means[3] = Vec3::NAN;
    scene.splats.means[5] = Vec3::splat(1e9);
    scene.splats.means[7].y = f32::INFINITY;
    scene.splats.unit_from_world[9] *= 1e-30;
    add_triangle(&mut scene, [Vec3::NAN, Vec3::X, Vec3::Y]);
    add_triangle(&mut scene, [Vec3::INFINITY, Vec3::X, Vec3::Y]);
    let (scene, bvh) = build(scene);
    assert_valid(&scene, &bvh);
}

#[test]
fn the_tree_does_not_depend_on_the_number_of_threads() {
    let tree = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| build(Scene { splats: cloud(60_000, [0.01, 0.1], 0, 2), ..Scene::default() }))
    };
    let ((one, one_tree), (three, three_tree)) = (tree(1), tree(3));
    assert_eq!(one.splats.means, three.splats.means);
    assert_eq!(format!("{:?}", one_tree.nodes), format!("{:?}", three_tree.nodes));
}
