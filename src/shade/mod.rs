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

pub use lights::Lights;
pub use local::LocallyLitSurfaces;
pub use material::{MaterialPoint, SurfacePoint};
pub use path::{PathSettings, PathSurfaces};
pub use unlit::UnlitSurfaces;
