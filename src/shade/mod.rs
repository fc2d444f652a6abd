//! What leaves a surface: textures and materials.

pub mod bsdf;
pub mod sampling;
pub mod texture;
mod unlit;

pub use unlit::UnlitSurfaces;
