//! All rays of a tile at once: the ray tracer's own values at a rasteriser's cost.
//!
//! A tile's frustum descends the tree best-first ([`frustum`]), so that Gaussians and triangles arrive in the order of a
//! lower bound on their sort keys. They are projected once per tile ([`project`]), gathered in chunks, dealt to the
//! 4 x 4 texel blocks they touch, and evaluated and blended there in SIMD lanes, in exact order per ray ([`block`]).
//! Cells of the tile whose rays have all ended take no part in the descent any more: what stands behind a wall is never
//! projected.

mod block;
mod frustum;
mod project;
mod shade;

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::DVec3;

use self::block::{BLOCK_EDGE, Block};
use self::frustum::Frustum;
use self::project::{Candidate, Projection};
use self::shade::{ShadeChunk, Shader};
use super::level::Level;
use super::ray::RayScratch;
use super::{Radiance, Ray, RayTracer, Surfaces, Tile, TileTracer, TraceSettings};
use crate::bvh::{Bvh, Child, WIDTH};
use crate::job::ShDirection;
use crate::scene::{Scene, sh};

/// Texels along an edge of a cell; a tile's 8 x 8 cells are the bits of a `u64`.
const CELL_EDGE: u32 = Tile::EDGE / 8;

/// Candidates that are shaded together. More amortise the dealing to blocks, fewer stop sooner behind an opaque surface.
const CHUNK: usize = 512;

/// Traces whole tiles of a probe's cube through the tree.
pub struct BeamTracer<'a> {
    /// What is traced, in the order that [`Bvh::build`] left it in.
    pub scene: &'a Scene,
    /// The tree over `scene`.
    pub bvh: &'a Bvh,
    /// What surfaces look like.
    pub surfaces: &'a dyn Surfaces,
    /// Order, colour direction, near end and cut-off.
    pub settings: TraceSettings,
    /// Instruction level of the kernels.
    pub level: Level,
}

/// What one tile's walk through the tree needs.
struct Walk<'a> {
    tracer: &'a BeamTracer<'a>,
    frustum: Frustum,
    projection: Projection,
    /// Nodes and candidates by the bits of their lower bound, then by what they are.
    queue: BinaryHeap<Reverse<(u32, Queued)>>,
    /// Projected candidates that wait in the queue; freed slots are used again.
    waiting: Vec<Candidate>,
    free: Vec<u32>,
    /// Cells in which some ray has not ended.
    live: u64,
}

/// What waits in the queue. Candidates with equal keys leave it in the order of their indices.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Queued {
    Node(u32),
    Candidate { index: u32, slot: u32 },
}

impl TileTracer for BeamTracer<'_> {
    fn trace_tile(&self, origin: DVec3, tile: &Tile, texels: &mut [Radiance]) {
        let mut walk = Walk::new(self, origin, tile);
        let blocks_per_row = tile.width.div_ceil(BLOCK_EDGE);
        let mut blocks: Vec<Block> = (0..tile.height.div_ceil(BLOCK_EDGE))
            .flat_map(|row| (0..blocks_per_row).map(move |column| (column * BLOCK_EDGE, row * BLOCK_EDGE)))
            .map(|(x, y)| Block::new(tile, x, y, self.settings.t_near))
            .collect();
        let mut shader = Shader::new(self, origin, tile);
        let mut chunk = Vec::with_capacity(CHUNK);
        loop {
            let bound = walk.gather(&mut chunk);
            self.level.run(ShadeChunk {
                shader: &mut shader,
                blocks: &mut blocks,
                blocks_per_row,
                chunk: &chunk,
                bound,
                live: &mut walk.live,
            });
            if bound == f32::INFINITY || walk.live == 0 {
                break;
            }
            chunk.clear();
        }
        self.collect(origin, tile, &blocks, texels);
    }
}

impl BeamTracer<'_> {
    /// Reads the finished blocks out; blocks that overflowed go through the ray tracer.
    fn collect(&self, origin: DVec3, tile: &Tile, blocks: &[Block], texels: &mut [Radiance]) {
        let exact = RayTracer { scene: self.scene, bvh: self.bvh, surfaces: self.surfaces, settings: self.settings };
        let mut scratch = RayScratch::default();
        let blocks_per_row = tile.width.div_ceil(BLOCK_EDGE);
        for (i, texel) in texels.iter_mut().enumerate() {
            let (x, y) = (i as u32 % tile.width, i as u32 / tile.width);
            let block = &blocks[(y / BLOCK_EDGE * blocks_per_row + x / BLOCK_EDGE) as usize];
            *texel = match block.radiance((y % BLOCK_EDGE * BLOCK_EDGE + x % BLOCK_EDGE) as usize) {
                Some(radiance) => radiance,
                None => exact.trace(&Ray { origin, direction: tile.direction(x, y) }, &mut scratch),
            };
        }
    }

    fn colour(&self, index: usize, origin: DVec3) -> [f32; 3] {
        let splats = &self.scene.splats;
        let direction = (splats.means[index].as_dvec3() - origin).normalize().as_vec3();
        sh::evaluate(splats.sh_degree, splats.sh_of(index), direction).to_array()
    }
}

impl<'a> Walk<'a> {
    fn new(tracer: &'a BeamTracer<'a>, origin: DVec3, tile: &Tile) -> Self {
        let cells = |texels: u32| texels.div_ceil(CELL_EDGE);
        let row = (1u64 << cells(tile.width)) - 1;
        let live = (0..cells(tile.height)).fold(0, |live, y| live | row << (8 * y));
        let mut queue = BinaryHeap::new();
        if !tracer.bvh.nodes.is_empty() {
            queue.push(Reverse((0, Queued::Node(0))));
        }
        Self {
            tracer,
            frustum: Frustum::new(origin, tile, tracer.settings.order),
            projection: Projection::new(origin, tile, tracer.settings.order),
            queue,
            waiting: Vec::new(),
            free: Vec::new(),
            live,
        }
    }

    /// Fills `chunk` with the next candidates and returns a lower bound on the keys of all that is still to come.
    fn gather(&mut self, chunk: &mut Vec<Candidate>) -> f32 {
        while chunk.len() < CHUNK {
            let Some(Reverse((_, queued))) = self.queue.pop() else { return f32::INFINITY };
            match queued {
                Queued::Node(node) => self.open(node),
                Queued::Candidate { slot, .. } => {
                    self.free.push(slot);
                    let candidate = &self.waiting[slot as usize];
                    if candidate.cells & self.live != 0 {
                        chunk.push(*candidate);
                        if let Some(added) = chunk.last_mut()
                            && added.is_gaussian()
                            && self.tracer.settings.sh_direction == ShDirection::Mean
                        {
                            added.colour = self.tracer.colour(added.index as usize, self.projection.origin);
                        }
                    }
                }
            }
        }
        self.queue.peek().map_or(f32::INFINITY, |Reverse((key, _))| f32::from_bits(*key))
    }

    fn open(&mut self, node: u32) {
        let (scene, wide) = (self.tracer.scene, &self.tracer.bvh.nodes[node as usize]);
        let seen = self.frustum.meet(wide);
        for lane in 0..WIDTH {
            if seen.cells[lane] & self.live != 0 {
                match wide.child(lane) {
                    Child::Node(child) => {
                        self.queue.push(Reverse((seen.keys[lane].to_bits(), Queued::Node(child))));
                    }
                    Child::Gaussian(index) => {
                        let projected = self.projection.gaussian(&scene.splats, index);
                        self.wait(projected);
                    }
                    Child::Triangle(index) => {
                        let projected = self.projection.triangle(&scene.meshes, index);
                        self.wait(projected);
                    }
                }
            }
        }
    }

    fn wait(&mut self, candidate: Option<Candidate>) {
        let Some(candidate) = candidate.filter(|c| c.cells & self.live != 0) else { return };
        let slot = match self.free.pop() {
            Some(slot) => {
                self.waiting[slot as usize] = candidate;
                slot
            }
            None => {
                self.waiting.push(candidate);
                self.waiting.len() as u32 - 1
            }
        };
        let queued = Queued::Candidate { index: candidate.index, slot };
        self.queue.push(Reverse((candidate.key_low.to_bits(), queued)));
    }
}
