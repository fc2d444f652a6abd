//! The tree and the three tracers, against closed forms, each other and the f64 reference.

#[path = "../common/mod.rs"]
mod common;

mod analytic;
mod bvh;
mod footprint;
mod stress;
mod three_scenes;
mod tracers;
