//! Bakes as a step of builds: what is the same is not done again, what is interrupted goes on, what is shared out is joined;
//! and the bytes are always those of one bake at once.

#[path = "../common/cli.rs"]
mod cli;
#[path = "../common/mod.rs"]
mod common;

mod incremental;
mod resume;
mod scenes;
mod shards;
mod steps;
