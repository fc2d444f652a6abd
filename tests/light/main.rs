//! Light on surfaces and in prefiltered cubemaps, against closed forms, furnaces and brute force.

#[path = "../common/mod.rs"]
mod common;

mod enclosure;
mod filter;
mod lobes;
mod path;
mod probe;
mod scenes;
mod shadows;
