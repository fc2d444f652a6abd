//! Bakes as a step of builds: what is the same is not done again, what is interrupted goes on, what is shared out is joined;
//! and the bytes are always those of one bake at once.

#[path = "../cli_support/mod.rs"]
mod cli_support;
#[path = "../gltf_support/mod.rs"]
mod gltf_support;

mod incremental;
mod resume;
mod scenes;
mod shards;
mod steps;
