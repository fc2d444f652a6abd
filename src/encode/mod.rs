//! Cubemaps to bytes.

pub mod exr;
pub mod file;
pub mod ktx1;
pub mod ktx2;
pub mod latlong;
pub mod plan;
pub mod preview;
pub mod rgbd;
pub mod slots;
pub mod tonemap;
