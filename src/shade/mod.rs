//! What leaves a surface: textures and materials.

pub mod bsdf;
pub mod lights;
pub mod material;
pub mod path;
pub mod sampling;
pub mod texture;
mod unlit;

pub use lights::Lights;
pub use material::{MaterialPoint, SurfacePoint};
pub use path::{PathSettings, PathSurfaces};
pub use unlit::UnlitSurfaces;
