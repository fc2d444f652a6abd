//! All rays of a tile at once: the ray tracer's own values at a rasteriser's cost.
//!
//! A tile's frustum descends the tree in windows of the sort key, nearest first ([`frustum`], [`walk`]). What begins in a
//! window is projected once per tile ([`project`]), dealt to the quads of texels that its cone reaches ([`deal`]), and
//! evaluated ([`shade`], [`evaluate`]) and blended there in SIMD lanes, in exact order per ray ([`quad`]). Quads whose rays
//! have all ended take no part in the descent any more: what stands behind a wall is never projected.
//
// Tried: blocks of 8 x 8 texels with one order for all (half as many entries again, as rays end later than in quads);
// letting entries wait until their least key is certain to be next (a quarter of the corrections, but keeping the queue cost
// more); lists per quad instead of per four quads (a tenth slower, small faces included); batches of 4 and 12.

mod candidate;
mod deal;
mod desk;
mod evaluate;
mod frustum;
mod image;
mod lanes;
mod project;
mod quad;
mod shade;
mod walk;

use std::cell::Cell;

use glam::DVec3;
use pulp::{Simd, WithSimd};

use self::deal::QUADS_PER_ROW;
use self::lanes::{LANES, QUAD, texel_of_lane};
use self::quad::{Quad, State};
use self::shade::{Shader, ShaderBuffers};
use self::walk::{Walk, WalkBuffers};
use super::counters::{Counters, Tally};
use super::level::Level;
use super::ray::{PACKET_EDGE, RayScratch};
use super::{Radiance, RayTracer, Surfaces, Tile, TileTracer, TraceSettings};
use crate::bvh::Bvh;
use crate::scene::Scene;

/// Quads along an edge of a block. The blocks of a tile, 8 x 8, are bits of a `u64` where the tree is descended.
const QUADS_PER_BLOCK: usize = 2;

/// Texels along an edge of a block.
const BLOCK_EDGE: u32 = QUADS_PER_BLOCK as u32 * QUAD;

// A quad that overflows goes to the ray tracer as a packet.
const _: () = assert!(PACKET_EDGE == QUAD);

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
        self.level.run(TraceTile { tracer: self, origin, tile, texels });
    }
}

/// What tracing a tile needs room for, kept by each thread from one to the next.
#[derive(Default)]
struct Buffers {
    quads: Vec<Quad>,
    walk: WalkBuffers,
    shader: ShaderBuffers,
}

thread_local! {
    static BUFFERS: Cell<Option<Box<Buffers>>> = const { Cell::new(None) };
}

struct TraceTile<'a, 'b> {
    tracer: &'a BeamTracer<'b>,
    origin: DVec3,
    tile: &'a Tile,
    texels: &'a mut [Radiance],
}

impl WithSimd for TraceTile<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { tracer, origin, tile, texels } = self;
        let mut buffers = BUFFERS.take().unwrap_or_default();
        let mut tally = tracer.shade_quads(simd, origin, tile, &mut buffers);
        tally.fallback_rays = tracer.collect(origin, tile, &buffers.quads, texels);
        if let Some(counters) = tracer.counters {
            counters.add_tile(tile.len(), tally);
        }
        BUFFERS.set(Some(buffers));
    }
}

impl BeamTracer<'_> {
    /// Traces a tile into the buffers' quads; tells what was done.
    #[inline(always)]
    fn shade_quads<S: Simd>(&self, simd: S, origin: DVec3, tile: &Tile, buffers: &mut Buffers) -> Tally {
        let Buffers { quads, walk, shader } = buffers;
        quads.clear();
        let corners = (0..QUADS_PER_ROW * QUADS_PER_ROW).map(|i| [i % QUADS_PER_ROW, i / QUADS_PER_ROW]);
        let corners = corners.map(|corner| corner.map(|quad| quad as u32 * QUAD));
        quads.extend(corners.map(|[x, y]| Quad::new(tile, x, y, self.settings.t_near)));
        let mut walk = Walk::new(self, origin, tile, walk);
        let mut shader = Shader::new(self, origin, tile, quads, shader);
        let mut live = shader.live_blocks();
        loop {
            let bound = walk.gather(simd, live);
            shader.shade_chunk(simd, quads, &walk.buffers.chunk, bound);
            live = shader.live_blocks();
            if bound == f32::INFINITY || live == 0 {
                let mut tally = walk.tally;
                tally += shader.tally;
                return tally;
            }
            walk.buffers.chunk.clear();
        }
    }

    /// Reads the finished quads out to `texels`; quads that overflowed go through the ray tracer. Returns how many rays
    /// did.
    #[inline(always)]
    fn collect(&self, origin: DVec3, tile: &Tile, quads: &[Quad], texels: &mut [Radiance]) -> u64 {
        let mut fallback_rays = 0;
        let exact = RayTracer { scene: self.scene, bvh: self.bvh, surfaces: self.surfaces, settings: self.settings };
        let mut scratch: Option<RayScratch> = None;
        for (i, quad) in quads.iter().enumerate() {
            let [left, top] = [i % QUADS_PER_ROW, i / QUADS_PER_ROW].map(|quad| quad as u32 * QUAD);
            if left >= tile.width || top >= tile.height {
                continue;
            }
            if quad.state == State::Overflowed {
                fallback_rays += u64::from(QUAD.min(tile.width - left) * QUAD.min(tile.height - top));
                exact.trace_square(origin, tile, [left, top], scratch.get_or_insert_default(), texels);
                continue;
            }
            for lane in 0..LANES {
                let [x, y] = texel_of_lane(lane);
                let (x, y) = (left + x, top + y);
                if x < tile.width && y < tile.height {
                    texels[(y * tile.width + x) as usize] = quad.radiance(lane);
                }
            }
        }
        fallback_rays
    }
}
