//! The command line tool as its users meet it, and rules that the sources keep.

#[path = "../common/cli.rs"]
mod cli;
#[path = "../common/mod.rs"]
mod common;

mod bad_input;
mod bench;
mod commands;
mod demo;
mod layering;
mod one_scene;
mod placement;
mod results;
mod schemas;
