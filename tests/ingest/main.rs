//! Files become scenes: every format, made in the test and real, and what is wrong with broken ones.

#[path = "../common/mod.rs"]
mod common;

mod files;
mod gltf_files;
mod gltf_hostile;
mod gltf_load;
mod gltf_materials;
mod gltf_splats;
mod packed;
mod packed_files;
mod ply;
mod sog;
mod usd_meshes;
mod usd_splats;
