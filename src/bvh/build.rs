//! From a scene to a wide tree: sort along a Morton curve, cluster, obvhs, widen.
//!
//! obvhs's working memory is some 260 bytes per primitive, more than a Gaussian with its colour. Clusters of up to
//! eight neighbours cut that, and the build time, to a fraction; they become the lowest nodes.

use std::ops::Range;

use glam::Vec3;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};
use rayon::prelude::*;

use super::boxes::{Box3, gaussian_box, triangle_box};
use super::{Bvh, Child, MESH_LANES, WIDTH, WideNode};
use crate::scene::{Meshes, Scene, Splats};

/// A cluster may cover this many times its members' summed surface area. Larger values give fewer, looser nodes.
const CLUSTER_LOOSENESS: f32 = 1.0;

/// More clusters than this are divided into eight parts before obvhs takes them, part after part: its working memory is
/// some 400 bytes per cluster, a third of a Gaussian with SH 3.
const MAX_CLUSTERS: usize = 1 << 16;

/// Cells per axis of the Morton curve. Above its 3 x 19 bits stands the primitive's size.
const MORTON_CELLS: f64 = (1u32 << 19) as f64;

/// Primitives of one kind that lie together, as one box for obvhs.
#[derive(Clone, Copy)]
struct Cluster {
    child_box: Box3,
    first: u32,
    count: u32,
    triangles: bool,
}

impl Bvh {
    /// Bytes per Gaussian that [`Bvh::build`] takes at most beside the scene, the tree itself among them. Measured on
    /// interiors of 1 and 1.5 million Gaussians: 92 and 83.
    pub const BUILD_BYTES_PER_GAUSSIAN: u64 = 100;

    /// Sorts the scene's Gaussians and triangles into leaf order and builds the tree over them.
    ///
    /// Below the root, the Gaussians and each of the first mesh inputs have a lane of their own; further inputs share the
    /// last one. What is below a lane depends on nothing else, so that a ray which meets no box of a changed input takes
    /// the very same way through the tree: that is what lets a bake keep tiles.
    pub fn build(scene: &mut Scene) -> Self {
        let splats = &scene.splats;
        let MortonOrder { order, codes } =
            sort_by_morton_code(0..splats.len(), |i| splats.means[i], |i| gaussian_box(splats, i));
        scene.splats.reorder(&order);
        drop(order);
        let mut clusters = gaussian_clusters(&scene.splats, &codes);
        drop(codes);
        // About as many nodes as clusters; growing by doubling would hold the largest array of a build twice.
        let mut nodes = Vec::with_capacity(clusters.len() + 2);
        nodes.push(WideNode::EMPTY);
        add_below(&mut nodes, (0, 0), scene, &mut clusters);
        drop(clusters);

        let meshes = &scene.meshes;
        let centre = |i| meshes.corners(i).iter().sum::<Vec3>() / 3.0;
        let parts = meshes.triangles_by_input(MESH_LANES);
        let sorted = parts.into_iter().map(|part| sort_by_morton_code(part, centre, |i| triangle_box(meshes, i)));
        let sorted: Vec<MortonOrder> = sorted.collect();
        scene.meshes.reorder_triangles(&sorted.iter().flat_map(|part| &part.order).copied().collect::<Vec<u32>>());
        let mut first = 0;
        for (part, MortonOrder { codes, .. }) in sorted.into_iter().enumerate() {
            let mut clusters = triangle_clusters(&scene.meshes, &codes, first);
            first += codes.len();
            add_below(&mut nodes, (0, 1 + part), scene, &mut clusters);
        }
        let is_empty = (0..WIDTH).all(|lane| nodes[0].lane_box(lane).is_none());
        Self { nodes: if is_empty { Vec::new() } else { nodes } }
    }

    /// The boxes of what has a lane of its own: the Gaussians, and then the mesh inputs, of which those from number
    /// [`MESH_LANES`] on share one. `None` for what is empty.
    pub fn part_boxes(&self) -> [Option<Box3>; WIDTH] {
        std::array::from_fn(|lane| self.nodes.first().and_then(|root| root.lane_box(lane)))
    }
}

/// The order of primitives by size class and then along the Morton curve, and their codes in that order.
///
/// Size comes first because a cluster is as loose as its largest member: a captured wall holds discs of metres among
/// ones of millimetres. (Measured on the generated interior: half the time of a ray, a third off a small cube's.)
struct MortonOrder {
    order: Vec<u32>,
    codes: Vec<u64>,
}

fn sort_by_morton_code(
    range: Range<usize>,
    centre: impl Fn(usize) -> Vec3 + Sync,
    box_of: impl Fn(usize) -> Box3 + Sync,
) -> MortonOrder {
    // The curve's cells span the middle 98 % of the centres and as much again around them, so that a stray
    // primitive a million metres away does not put the whole scene into one cell.
    let step = range.len().div_ceil(1 << 16).max(1);
    let sample = |axis: usize| {
        let mut values: Vec<f32> =
            range.clone().step_by(step).map(|i| centre(i)[axis]).filter(|x| x.is_finite()).collect();
        values.sort_unstable_by(f32::total_cmp);
        let at = |share: f64| values.get(((values.len().max(1) - 1) as f64 * share) as usize).copied().unwrap_or(0.0);
        let (low, high) = (f64::from(at(0.01)), f64::from(at(0.99)));
        let margin = (high - low) / 2.0;
        (low - margin, MORTON_CELLS / (high - low + 2.0 * margin).max(f64::MIN_POSITIVE))
    };
    let axes = [sample(0), sample(1), sample(2)];
    let mut keyed: Vec<(u64, u32)> = range
        .into_par_iter()
        .map(|i| {
            let point = centre(i);
            let cell = |axis: usize| {
                let (low, scale) = axes[axis];
                // `as` saturates, and takes NaN to 0.
                spread_bits(((f64::from(point[axis]) - low) * scale).min(MORTON_CELLS - 1.0) as u64)
            };
            (size_class(box_of(i)) << 57 | cell(0) | cell(1) << 1 | cell(2) << 2, i as u32)
        })
        .collect();
    keyed.par_sort_unstable();
    MortonOrder { order: keyed.iter().map(|k| k.1).collect(), codes: keyed.iter().map(|k| k.0).collect() }
}

/// The power of two above a box's diagonal, as 7 bits.
fn size_class(own_box: Box3) -> u64 {
    ((own_box.max - own_box.min).length().log2().ceil() + 64.0).clamp(0.0, 127.0) as u64
}

/// Puts the low 21 bits of `x` at every third bit.
fn spread_bits(x: u64) -> u64 {
    let x = x & 0x1f_ffff;
    let x = (x | x << 32) & 0x001f_0000_0000_ffff;
    let x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    let x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    let x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

fn gaussian_clusters(splats: &Splats, codes: &[u64]) -> Vec<Cluster> {
    clusters(codes, 0, false, |i| gaussian_box(splats, i))
}

/// Of the triangles from `first` on, whose codes are given.
fn triangle_clusters(meshes: &Meshes, codes: &[u64], first: usize) -> Vec<Cluster> {
    clusters(codes, first, true, |i| triangle_box(meshes, i))
}

/// Groups neighbours on the curve into clusters of at most [`WIDTH`], and all that share a cell into one cluster of any
/// size: PLOC turns coincident boxes into a chain, in quadratic time.
fn clusters(codes: &[u64], first: usize, triangles: bool, box_of: impl Fn(usize) -> Box3 + Sync) -> Vec<Cluster> {
    // Fixed blocks, so that the clusters do not depend on the number of threads.
    const BLOCK: usize = 1 << 14;
    let starts: Vec<usize> = (0..codes.len()).step_by(BLOCK).collect();
    starts
        .into_par_iter()
        .map(|start| cluster_block(codes, start..(start + BLOCK).min(codes.len()), first, triangles, &box_of))
        .flatten_iter()
        .collect()
}

fn cluster_block(
    codes: &[u64],
    block: Range<usize>,
    first: usize,
    triangles: bool,
    box_of: &(impl Fn(usize) -> Box3 + Sync),
) -> Vec<Cluster> {
    let mut clusters = Vec::with_capacity(block.len() / 4 + 1);
    let mut open: Option<(Cluster, f32)> = None;
    for i in block {
        let own_box = box_of(first + i);
        let own_area = own_box.half_area();
        if let Some((cluster, area)) = &mut open {
            let union = cluster.child_box.union(own_box);
            let coincident = codes[i] == codes[cluster.first as usize - first];
            let tight = union.half_area() <= CLUSTER_LOOSENESS * (*area + own_area);
            if coincident || (tight && (cluster.count as usize) < WIDTH) {
                cluster.child_box = union;
                cluster.count += 1;
                *area += own_area;
                continue;
            }
            clusters.push(*cluster);
        }
        open = Some((Cluster { child_box: own_box, first: (first + i) as u32, count: 1, triangles }, own_area));
    }
    clusters.extend(open.map(|(cluster, _)| cluster));
    clusters
}

/// Builds the tree over `clusters` below a lane of a node that exists.
fn add_below(nodes: &mut Vec<WideNode>, (node, lane): (usize, usize), scene: &Scene, clusters: &mut [Cluster]) {
    if clusters.is_empty() {
        return;
    }
    let bounds = clusters.iter().map(|cluster| cluster.child_box).fold(Box3::EMPTY, Box3::union);
    let top = nodes.len();
    nodes[node].set(lane, bounds, Child::Node(top as u32));
    nodes.push(WideNode::EMPTY);
    if clusters.len() > MAX_CLUSTERS {
        for (lane, part) in eighths(clusters).into_iter().enumerate() {
            add_below(nodes, (top, lane), scene, part);
        }
    } else {
        widen(nodes, top, scene, clusters);
    }
}

/// Halves the clusters by their centres along the widest axis, and the halves, and theirs.
fn eighths(clusters: &mut [Cluster]) -> Vec<&mut [Cluster]> {
    let mut parts = vec![clusters];
    while parts.len() < WIDTH {
        parts = parts.into_iter().flat_map(halves).collect();
    }
    parts
}

fn halves(clusters: &mut [Cluster]) -> [&mut [Cluster]; 2] {
    let centre = |cluster: &Cluster| cluster.child_box.min + cluster.child_box.max;
    let centres = clusters.iter().map(centre).map(|point| Box3 { min: point, max: point });
    let extent = centres.fold(Box3::EMPTY, Box3::union);
    let axis = (extent.max - extent.min).max_position();
    // The first member decides between equal centres, so that the halves are the same however they were sorted before.
    let place = |cluster: &Cluster| (centre(cluster)[axis], cluster.first);
    let middle = clusters.len() / 2;
    clusters.select_nth_unstable_by(middle, |a, b| {
        let (a, b) = (place(a), place(b));
        a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))
    });
    clusters.split_at_mut(middle).into()
}

/// Builds obvhs's binary tree over the clusters and widens it from node `top` on: the inner child with the largest
/// surface is replaced by its two children until a node has eight.
fn widen(nodes: &mut Vec<WideNode>, top: usize, scene: &Scene, clusters: &[Cluster]) {
    let binary = binary_tree(clusters);
    // An explicit stack: the depth of a tree over hostile input is bounded only by its size.
    let mut pending = vec![(top, Slot::of(0, &binary, clusters))];
    while let Some((target, slot)) = pending.pop() {
        for (lane, (child_box, slot)) in children(slot, &binary, scene, clusters).into_iter().enumerate() {
            let child = match slot {
                Slot::Part { first, count: 1, triangles: false } => Child::Gaussian(first),
                Slot::Part { first, count: 1, triangles: true } => Child::Triangle(first),
                inner => {
                    pending.push((nodes.len(), inner));
                    nodes.push(WideNode::EMPTY);
                    Child::Node(nodes.len() as u32 - 1)
                }
            };
            nodes[target].set(lane, child_box, child);
        }
    }
}

/// Something that becomes a lane of a wide node, and what is below that lane.
#[derive(Clone, Copy)]
enum Slot {
    /// An inner node of the binary tree.
    Inner(usize),
    /// Part of a cluster.
    Part { first: u32, count: u32, triangles: bool },
}

impl Slot {
    fn of(index: usize, binary: &Bvh2, clusters: &[Cluster]) -> Self {
        let node = &binary.nodes[index];
        if node.is_leaf() {
            let Cluster { first, count, triangles, .. } =
                clusters[binary.primitive_indices[node.first_index as usize] as usize];
            Self::Part { first, count, triangles }
        } else {
            Self::Inner(index)
        }
    }
}

/// The up to eight children of what is below a lane, with their boxes.
fn children(slot: Slot, binary: &Bvh2, scene: &Scene, clusters: &[Cluster]) -> Vec<(Box3, Slot)> {
    let mut slots = split(slot, binary, scene, clusters);
    loop {
        // Splitting the widest lane that still fits gains most.
        let room = WIDTH + 1 - slots.len();
        let fits = |slot: &Slot| match *slot {
            Slot::Inner(_) => room >= 2,
            Slot::Part { count, .. } => count > 1 && count as usize <= room,
        };
        let widest = (0..slots.len())
            .filter(|&k| fits(&slots[k].1))
            .max_by(|&a, &b| slots[a].0.half_area().total_cmp(&slots[b].0.half_area()));
        let Some(widest) = widest else { return slots };
        let (_, slot) = slots.swap_remove(widest);
        slots.extend(split(slot, binary, scene, clusters));
    }
}

/// What is right below a lane: two nodes of the binary tree, or up to eight parts of a cluster.
fn split(slot: Slot, binary: &Bvh2, scene: &Scene, clusters: &[Cluster]) -> Vec<(Box3, Slot)> {
    match slot {
        Slot::Inner(index) => {
            let first = binary.nodes[index].first_index as usize;
            let with_box = |child: usize| {
                let aabb = binary.nodes[child].aabb;
                (Box3 { min: aabb.min.into(), max: aabb.max.into() }, Slot::of(child, binary, clusters))
            };
            vec![with_box(first), with_box(first + 1)]
        }
        Slot::Part { first, count, triangles } => {
            let parts = count.min(WIDTH as u32);
            let start = |k: u32| first + (u64::from(count) * u64::from(k) / u64::from(parts)) as u32;
            let part = |k: u32| {
                let member_box = |i: u32| match triangles {
                    true => triangle_box(&scene.meshes, i as usize),
                    false => gaussian_box(&scene.splats, i as usize),
                };
                let bounds = (start(k)..start(k + 1)).map(member_box).fold(Box3::EMPTY, Box3::union);
                (bounds, Slot::Part { first: start(k), count: start(k + 1) - start(k), triangles })
            };
            (0..parts).map(part).collect()
        }
    }
}

fn binary_tree(clusters: &[Cluster]) -> Bvh2 {
    let boxes: Vec<Aabb> =
        clusters.iter().map(|c| Aabb { min: c.child_box.min.into(), max: c.child_box.max.into() }).collect();
    let indices = (0..boxes.len() as u32).collect();
    let mut binary =
        PlocBuilder::with_capacity(boxes.len()).build(PlocSearchDistance::Low, &boxes, indices, SortPrecision::U64, 2);
    ReinsertionOptimizer::default().run(&mut binary, 0.02, None);
    binary
}
