//! Radiance along rays: one model, three tracers.

mod batch;
pub mod beam;
pub mod composite;
pub mod counters;
pub mod cube;
pub mod footprint;
pub mod gaussian;
pub mod level;
pub mod ray;
pub mod reference;
mod sees;
pub mod triangle;

use glam::{DVec3, Vec2};

use crate::job::{Order, ShDirection};
use crate::scene::LinearRgb;

pub use beam::BeamTracer;
pub use composite::Radiance;
pub use counters::{CounterReport, Counters};
pub use cube::Face;
pub use footprint::Footprint;
pub use level::Level;
pub use ray::RayTracer;
pub use reference::ReferenceTracer;

/// What every tracer is told about a bake.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TraceSettings {
    /// Blending order along a ray.
    pub order: Order,
    /// Direction in which Gaussians' colours are evaluated.
    pub sh_direction: ShDirection,
    /// A ray ends when its transmittance falls below this; 0 follows every ray to its end.
    pub t_cutoff: f32,
    /// Contributions nearer than this, in metres, are ignored.
    pub t_near: f32,
    /// How Gaussians are widened.
    pub footprint: Footprint,
}

impl Default for TraceSettings {
    fn default() -> Self {
        Self {
            order: Order::default(),
            sh_direction: ShDirection::default(),
            t_cutoff: 1.0 / 2048.0,
            t_near: 0.0,
            footprint: Footprint::default(),
        }
    }
}

/// A ray. The direction has unit length; the origin is relative to the scene origin, in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Start, in metres relative to the scene origin.
    pub origin: DVec3,
    /// Unit direction.
    pub direction: DVec3,
}

/// Where a ray meets a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceHit {
    /// Index into [`crate::scene::Meshes::triangles`].
    pub triangle: u32,
    /// Barycentric weights of the triangle's second and third corner.
    pub barycentric: Vec2,
    /// Whether the ray came from the counter-clockwise side.
    pub front: bool,
    /// Distance from the ray's origin, in metres.
    pub distance: f64,
}

/// A rectangle of texels of one cube face.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tile {
    /// The face.
    pub face: Face,
    /// Texels along an edge of the whole face.
    pub face_size: u32,
    /// First column, counted from the left edge; below 0 beyond it, on the face's plane.
    pub x: i32,
    /// First row, counted from the top edge; below 0 beyond it, on the face's plane.
    pub y: i32,
    /// Columns, at most [`Tile::EDGE`].
    pub width: u32,
    /// Rows, at most [`Tile::EDGE`].
    pub height: u32,
}

impl Tile {
    /// Largest width and height of a tile, in texels: the unit of work of a bake.
    pub const EDGE: u32 = 64;

    /// How many texels the tile has.
    pub fn len(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Unit direction through the centre of a texel, counted from the tile's corner.
    pub fn direction(&self, x: u32, y: u32) -> DVec3 {
        let centre = [(self.x, x), (self.y, y)].map(|(first, i)| f64::from(first) + f64::from(i) + 0.5);
        self.face.direction(self.face_size, centre[0], centre[1]).normalize()
    }

    /// Unit directions through the texels' centres, row by row.
    pub fn directions(&self) -> impl Iterator<Item = DVec3> + '_ {
        (0..self.height).flat_map(move |y| (0..self.width).map(move |x| self.direction(x, y)))
    }

    /// Whether the tile has no texels.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Traces the rays through texel centres of a probe's cube.
pub trait TileTracer: Sync {
    /// Traces every texel of `tile` for a probe at `origin` (metres relative to the scene origin).
    /// `texels` holds [`Tile::len`] values row by row and is overwritten.
    fn trace_tile(&self, origin: DVec3, tile: &Tile, texels: &mut [Radiance]);
}

/// What a surface sends back along a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fragment {
    /// Share of the light behind the surface that it holds back: 0 for nothing there, 1 for opaque.
    pub alpha: f32,
    /// Linear radiance, not premultiplied by alpha.
    pub radiance: LinearRgb,
}

/// The stage below that knows materials. Tracers only ask it what a hit looks like.
pub trait Surfaces: Sync {
    /// Whether every hit on `triangle` from a seen side is fully opaque, so that nothing behind it can matter.
    fn is_opaque(&self, triangle: u32) -> bool;

    /// Whether the back of `triangle` is seen at all.
    fn is_double_sided(&self, triangle: u32) -> bool;

    /// The light that leaves the hit toward the ray's origin.
    fn fragment(&self, ray: &Ray, hit: &SurfaceHit) -> Fragment;
}

/// Surfaces that hold nothing back and are seen from both sides, so that a ray hears of each one on its way.
#[derive(Debug, Clone, Copy)]
pub struct EverySurface;

impl Surfaces for EverySurface {
    fn is_opaque(&self, _: u32) -> bool {
        false
    }

    fn is_double_sided(&self, _: u32) -> bool {
        true
    }

    fn fragment(&self, _: &Ray, _: &SurfaceHit) -> Fragment {
        Fragment { alpha: 0.0, radiance: LinearRgb(glam::Vec3::ZERO) }
    }
}
