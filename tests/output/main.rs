//! What is written: read back by our own readers and by other people's.

#[path = "../common/cli.rs"]
mod cli;
#[path = "../common/mod.rs"]
mod common;

mod encodings;
mod openexr;
mod outputs;
