//! Cubemaps for rough and diffuse reflection: GGX roughness chains, Lambert irradiance, spherical harmonics.

pub mod cubemap;
mod lobe;
pub mod moments;
pub mod prefilter;
mod roughness;
pub mod sampler;
pub mod sh;

pub use cubemap::RgbCubemap;
pub use prefilter::Prefilter;
pub use roughness::{ROUGHEST_SIZE, mip_count};
pub use sampler::Sampler;
pub use sh::ShRadiance;
