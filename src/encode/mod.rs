//! Cubemaps to bytes.

pub mod exr;
pub mod file;
pub mod preview;
