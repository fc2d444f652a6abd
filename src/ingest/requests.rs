//! What is read from which file: the inputs as named, and the other kind of content of the files that they name.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use super::gltf::{self, Contents};
use super::map;
use crate::error::Result;
use crate::job::{MeshInput, SplatInput};

/// Everything that a scene is read from. What no input names stands after what one does.
pub(super) struct Requests<'a> {
    pub splats: Vec<SplatRequest<'a>>,
    pub meshes: Vec<MeshInput>,
}

/// Splats to be read.
pub(super) struct SplatRequest<'a> {
    pub input: Cow<'a, SplatInput>,
    /// Scene of a file that has several; the file's default without one.
    pub scene: Option<&'a str>,
    /// The job's field that asked for it, for messages.
    pub field: String,
}

impl<'a> Requests<'a> {
    /// Adds the meshes of files that only `splats` names, under the same transform, and the splats of files that only
    /// `meshes` names. A file that both name is read once for each kind, as the list of that kind says.
    pub fn new(splats: &'a [SplatInput], meshes: &'a [MeshInput]) -> Result<Self> {
        let splat_files: Vec<PathBuf> = splats.iter().map(|input| identity(&input.path)).collect();
        let mesh_files: Vec<PathBuf> = meshes.iter().map(|input| identity(&input.path)).collect();
        let mut requests = Self { splats: Vec::new(), meshes: meshes.to_vec() };
        for (i, (input, file)) in splats.iter().zip(&splat_files).enumerate() {
            let as_meshes = mesh_files.iter().position(|named| named == file);
            let scene = as_meshes.and_then(|mesh| meshes[mesh].scene.as_deref());
            requests.splats.push(SplatRequest { input: Cow::Borrowed(input), scene, field: format!("splats[{i}]") });
            if as_meshes.is_none() && contents(&input.path, None)?.meshes {
                let transform = input.transform;
                requests.meshes.push(MeshInput { path: input.path.clone(), transform, scene: None });
            }
        }
        for (i, (input, file)) in meshes.iter().zip(&mesh_files).enumerate() {
            let scene = input.scene.as_deref();
            if !splat_files.contains(file) && contents(&input.path, scene)?.splats {
                let input = SplatInput { transform: input.transform, ..SplatInput::new(&input.path) };
                requests.splats.push(SplatRequest { input: Cow::Owned(input), scene, field: format!("meshes[{i}]") });
            }
        }
        Ok(requests)
    }
}

/// Whether the file at `path` is one that meshes are read from, or could be.
pub(super) fn holds_meshes(path: &Path) -> Result<bool> {
    Ok(gltf::is_gltf(&map(path)?) && contents(path, None)? != Contents { splats: true, meshes: false })
}

/// What the chosen scene of the file at `path` holds.
fn contents(path: &Path, scene: Option<&str>) -> Result<Contents> {
    match gltf::is_gltf(&map(path)?) {
        true => gltf::contents(path, scene),
        false => Ok(Contents::default()),
    }
}

/// What tells whether two paths mean one file.
fn identity(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}
