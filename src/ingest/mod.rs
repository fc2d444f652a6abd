//! ingest

pub mod gltf;
