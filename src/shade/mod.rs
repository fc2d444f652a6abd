//! What leaves a surface: textures and materials.

pub mod bsdf;
mod footing;
pub mod lights;
pub mod local;
pub mod material;
pub mod path;
pub mod sampling;
pub mod shadows;
pub mod texture;
mod unlit;

use std::cell::RefCell;

use crate::trace::ray::RayScratch;

pub use lights::Lights;
pub use local::LocallyLitSurfaces;
pub use material::{MaterialPoint, SurfacePoint};
pub use path::{PathSettings, PathSurfaces};
pub use unlit::UnlitSurfaces;

/// Lends `work` what the rays of one thread use one after another; never one call within another.
fn with_scratch<T>(work: impl FnOnce(&mut RayScratch) -> T) -> T {
    thread_local! {
        static SCRATCH: RefCell<RayScratch> = RefCell::default();
    }
    SCRATCH.with_borrow_mut(work)
}
