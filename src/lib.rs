//! splatprobe bakes HDR reflection probes from captured 3D Gaussian splat scenes and the meshes placed in them.
//!
//! # Map of the crate
//!
//! The modules stand in the order in which the data flows. A module imports only from modules above it in this list
//! (`tests/tool/layering.rs` holds the rule); [`pipeline`] is the place that knows them all.
//!
//! ```text
//! error      one error type, sorted by who must act
//! scene      the immutable scene: Gaussians, triangles, textures, colour, spherical harmonics
//! generate   scenes made by rule, for tests and benches
//! job        what to bake: every setting, its unit and its default
//! ingest     files -> scene, in physical units; one file per format
//! bvh        one tree over the boxes of Gaussians and triangles
//! trace      radiance along rays: reference, ray, beam
//! filter     cubemaps for rough and diffuse reflection: GGX, Lambert, spherical harmonics
//! shade      what leaves a surface: textures, materials, BSDF, lights, path tracing
//! place      where probes stand and how far they reach
//! bake       probes -> cubemaps, on all cores
//! encode     cubemaps -> bytes: EXR, PNG
//! manifest   what was baked, for engines
//! compare    how much two images differ
//! export     bakes as engines take them
//! preview    a bake as one HTML file, for people
//! cache      what earlier bakes found out, by the hash of all that it depends on
//! pipeline   the whole bake as a handful of calls
//! bench      run time against error, setting by setting
//! ```
//!
//! # Conventions
//!
//! Canonical frame: glTF's. Right-handed, +Y up, metres; row 0 of a cube face is its top. Transforms are f64 and named
//! `<to>_from_<from>`; geometry is stored in f32 relative to [`scene::Scene::origin`].

pub mod error;

pub mod scene;

pub mod generate;

pub mod job;

pub mod ingest;

pub mod bvh;

pub mod trace;

pub mod filter;

pub mod shade;

pub mod place;

pub mod bake;

pub mod encode;

pub mod manifest;

pub mod compare;

pub mod export;

pub mod preview;

pub mod cache;

pub mod pipeline;

pub mod bench;

pub use error::{Error, Result};
