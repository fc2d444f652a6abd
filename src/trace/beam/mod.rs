//! All rays of a tile at once: the ray tracer's own values at a rasteriser's cost.
//!
//! A tile's frustum descends the tree in windows of the sort key, nearest first ([`frustum`], [`walk`]). What begins in a
//! window is projected once per tile ([`project`]), dealt to the blocks of texels it touches ([`shade`]), and evaluated
//! and blended there in SIMD lanes, in exact order per ray ([`block`]). Blocks whose rays have all ended take no part in
//! the descent any more: what stands behind a wall is never projected.

mod block;
mod desk;
mod frustum;
mod lanes;
mod project;
mod shade;
mod walk;

use glam::DVec3;
use pulp::{Simd, WithSimd};

use self::block::Block;
use self::lanes::{NARROW, WIDE, edge, lane_of_texel};
use self::shade::Shader;
use self::walk::Walk;
use super::counters::{Counters, Tally};
use super::level::Level;
use super::ray::RayScratch;
use super::{Radiance, Ray, RayTracer, Surfaces, Tile, TileTracer, TraceSettings};
use crate::bvh::Bvh;
use crate::scene::Scene;

/// Blocks along an edge of a tile: they are the bits of a `u64`.
const BLOCKS_PER_ROW: u32 = 8;

/// Faces from this size on are traced in wide blocks. Measured on an interior: at 256 texels wide blocks take up to three
/// times as long as narrow ones (order overlaps more within a block), at 800 three quarters.
const WIDE_FACE: u32 = 512;

/// Traces whole tiles of a probe's cube through the tree.
pub struct BeamTracer<'a> {
    /// What is traced, in the order that [`Bvh::build`] left it in.
    pub scene: &'a Scene,
    /// The tree over `scene`.
    pub bvh: &'a Bvh,
    /// What surfaces look like.
    pub surfaces: &'a dyn Surfaces,
    /// Order, colour direction, near end, cut-off and footprint.
    pub settings: TraceSettings,
    /// Instruction level of the kernels.
    pub level: Level,
    /// Where to count what is done, if that is asked for.
    pub counters: Option<&'a Counters>,
}

impl<'a> BeamTracer<'a> {
    /// A tracer at the machine's best level that counts nothing.
    pub fn new(scene: &'a Scene, bvh: &'a Bvh, surfaces: &'a dyn Surfaces, settings: TraceSettings) -> Self {
        Self { scene, bvh, surfaces, settings, level: Level::best(), counters: None }
    }
}

impl TileTracer for BeamTracer<'_> {
    fn trace_tile(&self, origin: DVec3, tile: &Tile, texels: &mut [Radiance]) {
        if tile.face_size >= WIDE_FACE {
            self.level.run(TraceTile::<WIDE> { tracer: self, origin, tile, texels });
        } else {
            self.level.run(TraceTile::<NARROW> { tracer: self, origin, tile, texels });
        }
    }
}

/// A tile in blocks of `N` texels: split, where so many blocks do not cover it.
struct TraceTile<'a, 'b, const N: usize> {
    tracer: &'a BeamTracer<'b>,
    origin: DVec3,
    tile: &'a Tile,
    texels: &'a mut [Radiance],
}

impl<const N: usize> WithSimd for TraceTile<'_, '_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { tracer, origin, tile, texels } = self;
        let part_edge = BLOCKS_PER_ROW * edge(N);
        for y in (0..tile.height).step_by(part_edge as usize) {
            for x in (0..tile.width).step_by(part_edge as usize) {
                let (width, height) = (part_edge.min(tile.width - x), part_edge.min(tile.height - y));
                let part = Tile { x: tile.x + x as i32, y: tile.y + y as i32, width, height, ..*tile };
                let (blocks, mut tally) = tracer.blocks::<S, N>(simd, origin, &part);
                let row_length = tile.width as usize;
                let first = y as usize * row_length + x as usize;
                tally.fallback_rays = tracer.collect(origin, &part, &blocks, &mut texels[first..], row_length);
                if let Some(counters) = tracer.counters {
                    counters.add_tile(part.len(), tally);
                }
            }
        }
    }
}

impl BeamTracer<'_> {
    /// Traces a tile that 8 x 8 blocks cover; gives those blocks, and what was done.
    #[inline(always)]
    fn blocks<S: Simd, const N: usize>(&self, simd: S, origin: DVec3, tile: &Tile) -> (Vec<Block<N>>, Tally) {
        let positions = (0..BLOCKS_PER_ROW * BLOCKS_PER_ROW).map(|i| (i % BLOCKS_PER_ROW, i / BLOCKS_PER_ROW));
        let mut blocks: Vec<Block<N>> =
            positions.map(|(x, y)| Block::new(tile, x * edge(N), y * edge(N), self.settings.t_near)).collect();
        // Blocks beyond the tile's edge have ended before they begin.
        let mut live = (0..blocks.len()).filter(|&i| blocks[i].is_inside(tile)).fold(0, |live, i| live | 1 << i);
        let mut walk = Walk::new(self, origin, tile, edge(N));
        let mut shader = Shader::new(self, origin, tile);
        loop {
            let bound = walk.gather(simd, live);
            shader.shade_chunk(simd, &mut blocks, &walk.chunk, bound, &mut live);
            if bound == f32::INFINITY || live == 0 {
                let mut tally = walk.tally;
                tally += shader.tally;
                return (blocks, tally);
            }
            walk.chunk.clear();
        }
    }

    /// Reads the finished blocks out to `texels`, whose rows are `row_length` long; blocks that overflowed go through the
    /// ray tracer. Returns how many rays did.
    fn collect<const N: usize>(
        &self,
        origin: DVec3,
        tile: &Tile,
        blocks: &[Block<N>],
        texels: &mut [Radiance],
        row_length: usize,
    ) -> u64 {
        let mut fallback_rays = 0;
        let exact = RayTracer { scene: self.scene, bvh: self.bvh, surfaces: self.surfaces, settings: self.settings };
        let mut scratch = None;
        for (y, row) in (0..tile.height).zip(texels.chunks_mut(row_length)) {
            for (x, texel) in (0..tile.width).zip(row) {
                let block = &blocks[(y / edge(N) * BLOCKS_PER_ROW + x / edge(N)) as usize];
                let lane = lane_of_texel(N, [x % edge(N), y % edge(N)]);
                *texel = block.radiance(lane).unwrap_or_else(|| {
                    fallback_rays += 1;
                    let ray = Ray { origin, direction: tile.direction(x, y) };
                    exact.trace(&ray, scratch.get_or_insert_with(RayScratch::default))
                });
            }
        }
        fallback_rays
    }
}
