//! Bakes as engines take them: files in an engine's layout and axes, and what loads them there.
//!
//! An exporter works from a bake's folder alone, its manifest and images; the scene is never loaded. What it ships to users
//! besides data (editor scripts, shaders, import settings) stands as template files beside its code.

mod axes;
mod bake;
mod bevy;
mod blender;
mod filament;
mod gltf;
mod godot;
mod output;
mod unity;
mod unreal;
mod usd;
mod web;

use std::path::{Path, PathBuf};

use crate::{Error, Result};

use output::Output;

pub use bake::Bake;
pub use web::{PROBES_GLSL, PROBES_JS};

/// A consumer of bakes.
pub struct Engine {
    /// What `--engine` takes.
    pub name: &'static str,
    /// What is written for it, in a line.
    pub about: &'static str,
    write: fn(&Bake, &mut Output) -> Result<()>,
}

/// Every engine that is known.
pub const ENGINES: &[Engine] = &[
    Engine {
        name: "unity",
        about: "EXR strips with import settings, an editor script that makes reflection probes (URP, built-in, HDRP)",
        write: unity::write,
    },
    Engine {
        name: "unreal",
        about: "Radiance panoramas, an editor script in Python that makes reflection captures",
        write: unreal::write,
    },
    Engine {
        name: "godot",
        about: "EXR strips that import as cubemaps, a scene of reflection probes that capture them (Godot 4)",
        write: godot::write,
    },
    Engine {
        name: "filament",
        about: "KTX1 cube maps and spherical harmonics as cmgen writes them, a list of the probes",
        write: filament::write,
    },
    Engine {
        name: "blender",
        about: "EXR panoramas, a script in Python that sets up the world and light probes",
        write: blender::write,
    },
    Engine { name: "gltf", about: "a glTF file with EXT_lights_image_based and a node per probe", write: gltf::write },
    Engine {
        name: "usd",
        about: "EXR panoramas, a layer with a dome light per probe in variants and the probes as transforms",
        write: usd::write,
    },
    Engine {
        name: "three",
        about: "KTX2 cube maps, an ES module that blends and corrects them in three.js's standard materials",
        write: web::three,
    },
    Engine {
        name: "babylon",
        about: "KTX2 cube maps, an ES module that blends and corrects them in Babylon.js's PBR materials",
        write: web::babylon,
    },
    Engine {
        name: "playcanvas",
        about: "KTX2 cube maps, an ES module that blends and corrects them in PlayCanvas's standard materials",
        write: web::playcanvas,
    },
    Engine {
        name: "bevy",
        about: "KTX2 cube maps, the source of a plugin that spawns light probes",
        write: bevy::write,
    },
];

/// What an export wrote.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Export {
    /// The files, in the order of writing.
    pub files: Vec<PathBuf>,
    /// What the user should know: images that had to be made smaller, what the engine cannot express.
    pub notes: Vec<String>,
}

/// Writes the bake at `bake`, its folder or its manifest, into the folder `out` for the engine of that name.
///
/// Fails with [`Error::Request`] for an unknown engine, with the errors of [`crate::manifest::verify`] where the bake is
/// not what its manifest says, with [`Error::Unsupported`] where it has not the images that the engine needs, and with
/// [`Error::Write`]. Nothing is written before the whole bake is checked.
pub fn export(bake: &Path, engine: &str, out: &Path) -> Result<Export> {
    let Some(engine) = ENGINES.iter().find(|known| known.name == engine) else {
        let known: Vec<&str> = ENGINES.iter().map(|engine| engine.name).collect();
        return Err(Error::request("engine", format!("'{engine}' is not known; known are {}", known.join(", "))));
    };
    let bake = Bake::open(bake)?;
    let mut output = Output::create(out)?;
    (engine.write)(&bake, &mut output)?;
    Ok(output.finish())
}
