//! What leaves a surface: textures and materials.

pub mod bsdf;
pub mod material;
pub mod texture;
mod unlit;

pub use material::{MaterialPoint, SurfacePoint};
pub use unlit::UnlitSurfaces;
