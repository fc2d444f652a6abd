//! A tile's way through the tree: what it may see, nearest first.
//!
//! In windows of the sort key, as rays go: everything that begins inside the window is opened in any order, what
//! lies beyond waits. When a window is done, its end is a lower bound on the keys of all that is still to come.

use glam::DVec3;
use pulp::Simd;

use super::BeamTracer;
use super::candidate::Candidate;
use super::frustum::Frustum;
use super::project::Projection;
use crate::bvh::{Child, WIDTH};
use crate::job::ShDirection;
use crate::scene::sh;
use crate::trace::counters::Tally;
use crate::trace::{Tile, TraceSettings};

/// Candidates that are worth a round of shading. More amortise the dealing to blocks, fewer stop sooner behind an opaque
/// surface.
const CHUNK: usize = 512;

/// A window that brings this many candidates is shaded before it is complete, so that memory stays bounded.
const CHUNK_MAX: usize = 16 * CHUNK;

/// A window ends this much farther than the one before it.
const WINDOW_GROWTH: f32 = 1.08;

/// One tile's walk.
pub(super) struct Walk<'a> {
    tracer: &'a BeamTracer<'a>,
    frustum: Frustum,
    projection: Projection,
    /// Where the present window ends, and the one before it ended.
    window: f32,
    complete: f32,
    pub buffers: &'a mut WalkBuffers,
    pub tally: Tally,
}

/// What a walk needs room for.
#[derive(Default)]
pub(super) struct WalkBuffers {
    /// Nodes to open in this window.
    open: Vec<u32>,
    later: Vec<Later>,
    /// What was `later` in the window before.
    waited: Vec<Later>,
    /// Projected candidates that wait for their window; freed slots are used again.
    projected: Vec<Candidate>,
    free: Vec<u32>,
    /// Candidates to shade.
    pub chunk: Vec<Candidate>,
}

/// What begins behind the window.
#[derive(Clone, Copy)]
struct Later {
    /// A lower bound on its keys.
    key: f32,
    what: Waiting,
    /// Blocks that it may touch.
    blocks: u64,
}

#[derive(Clone, Copy)]
enum Waiting {
    Child(Child),
    /// By its slot.
    Projected(u32),
}

impl<'a> Walk<'a> {
    pub fn new(tracer: &'a BeamTracer<'a>, origin: DVec3, tile: &Tile, buffers: &'a mut WalkBuffers) -> Self {
        let TraceSettings { order, footprint, .. } = tracer.settings;
        buffers.later.clear();
        buffers.waited.clear();
        buffers.open.clear();
        buffers.open.extend((!tracer.bvh.nodes.is_empty()).then_some(0));
        buffers.projected.clear();
        buffers.free.clear();
        buffers.chunk.clear();
        Self {
            tracer,
            frustum: Frustum::new(origin, tile, order, footprint),
            projection: Projection::new(origin, tile, order, footprint),
            window: 0.0,
            complete: 0.0,
            buffers,
            tally: Tally::default(),
        }
    }

    /// Fills the chunk with candidates that touch `live` blocks, and returns a lower bound on the keys of all that is
    /// still to come.
    #[inline(always)]
    pub fn gather<S: Simd>(&mut self, simd: S, live: u64) -> f32 {
        loop {
            while let Some(node) = self.buffers.open.pop() {
                self.open_node(simd, node, live);
                if self.buffers.chunk.len() >= CHUNK_MAX {
                    return self.complete;
                }
            }
            self.project(simd, live);
            self.complete = self.window;
            if self.buffers.later.is_empty() {
                return f32::INFINITY;
            }
            if self.buffers.chunk.len() >= CHUNK {
                return self.complete;
            }
            self.begin_window(simd, live);
        }
    }

    /// Moves the window's end, and takes up what waited for it.
    #[inline(always)]
    fn begin_window<S: Simd>(&mut self, simd: S, live: u64) {
        let mut nearest = f32::INFINITY;
        for later in &self.buffers.later {
            nearest = if later.key < nearest { later.key } else { nearest };
        }
        // At least one more, even if its key is 0.
        self.window = (self.window.max(nearest) * WINDOW_GROWTH).max(f32::MIN_POSITIVE);
        std::mem::swap(&mut self.buffers.later, &mut self.buffers.waited);
        for i in 0..self.buffers.waited.len() {
            let later = self.buffers.waited[i];
            if later.key >= self.window {
                self.buffers.later.push(later);
                continue;
            }
            let seen = later.blocks & live != 0;
            match later.what {
                Waiting::Child(child) if seen => self.meet(simd, child, live),
                Waiting::Child(_) => {}
                Waiting::Projected(slot) => {
                    self.buffers.free.push(slot);
                    if seen {
                        let candidate = self.buffers.projected[slot as usize];
                        self.choose(candidate);
                    }
                }
            }
        }
        self.buffers.waited.clear();
    }

    #[inline(always)]
    fn open_node<S: Simd>(&mut self, simd: S, node: u32, live: u64) {
        self.tally.nodes += 1;
        let wide = &self.tracer.bvh.nodes[node as usize];
        let seen = self.frustum.meet(wide);
        for lane in 0..WIDTH {
            let blocks = seen.blocks[lane] & live;
            if blocks == 0 {
                continue;
            }
            let child = wide.child(lane);
            if seen.keys[lane] < self.window {
                self.meet(simd, child, live);
            } else {
                self.buffers.later.push(Later { key: seen.keys[lane], what: Waiting::Child(child), blocks });
            }
        }
    }

    #[inline(always)]
    fn meet<S: Simd>(&mut self, simd: S, child: Child, live: u64) {
        let scene = self.tracer.scene;
        match child {
            Child::Node(node) => self.buffers.open.push(node),
            Child::Gaussian(index) => {
                if self.projection.add(&scene.splats, index) {
                    self.project(simd, live);
                }
            }
            Child::Triangle(index) => {
                if let Some(candidate) = self.projection.triangle(&scene.meshes, index) {
                    self.sort_in(candidate, live);
                }
            }
        }
    }

    /// Projects the Gaussians that were collected.
    #[inline(always)]
    fn project<S: Simd>(&mut self, simd: S, live: u64) {
        for lane in 0..self.projection.project(simd) {
            if let Some(candidate) = self.projection.candidate(lane) {
                self.sort_in(candidate, live);
            }
        }
    }

    /// Into the chunk, or to wait.
    #[inline(always)]
    fn sort_in(&mut self, candidate: Candidate, live: u64) {
        let blocks = candidate.blocks & live;
        if blocks == 0 {
            return;
        }
        if candidate.key_low < self.window {
            self.choose(candidate);
            return;
        }
        let slot = match self.buffers.free.pop() {
            Some(slot) => {
                self.buffers.projected[slot as usize] = candidate;
                slot
            }
            None => {
                self.buffers.projected.push(candidate);
                self.buffers.projected.len() as u32 - 1
            }
        };
        self.buffers.later.push(Later { key: candidate.key_low, what: Waiting::Projected(slot), blocks });
    }

    /// Adds a candidate to the chunk, with its colour, now that it is known to be seen.
    #[inline(always)]
    fn choose(&mut self, candidate: Candidate) {
        self.tally.candidates += 1;
        self.buffers.chunk.push(candidate);
        let Some(added) = self.buffers.chunk.last_mut().filter(|added| added.is_gaussian()) else { return };
        if let Some(counters) = self.tracer.counters {
            counters.touch(added.index);
        }
        if self.tracer.settings.sh_direction == ShDirection::Mean {
            let (splats, index) = (&self.tracer.scene.splats, added.index as usize);
            let direction = (splats.means[index].as_dvec3() - self.projection.origin).normalize().as_vec3();
            added.colour = sh::evaluate(splats.sh_degree, splats.sh_of(index), direction).to_array();
        }
        added.linear = self.tracer.scene.splats.is_linear(added.index as usize);
    }
}
