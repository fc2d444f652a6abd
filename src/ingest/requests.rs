//! What is read from which file: the inputs as named, and the other kind of content of the files that they name.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use glam::{BVec3, DAffine3, DVec3};

use super::gltf::{self, Contents};
use super::{index_file, is_gltf, map};
use crate::error::Result;
use crate::job::{Frame, MeshInput, SplatInput};
use crate::scene::bounds::Bounds;

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

impl SplatRequest<'_> {
    /// Whether a mean within `bounds`, in the coordinates of a file with the default frame `frame`, may be asked for.
    pub fn may_need(&self, bounds: Bounds, frame: Frame) -> bool {
        let Some(crop) = self.input.crop else { return true };
        let canonical_from_file = self.input.frame.unwrap_or(frame).canonical_from_file();
        let world_from_file = self.input.transform.world_from_file() * DAffine3::from_mat3(canonical_from_file);
        let Bounds { min, max } = bounds;
        let corners = (0..8).map(|corner| {
            let upper = BVec3::new(corner & 1 != 0, corner & 2 != 0, corner & 4 != 0);
            world_from_file.transform_point3(DVec3::select(upper, max, min))
        });
        // What is not finite cannot be judged.
        Bounds::of(corners).is_none_or(|world| !(world.min + world.max).is_finite() || crop.touches(&world))
    }
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
                requests.meshes.push(MeshInput { transform: input.transform, ..MeshInput::new(&input.path) });
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
    Ok(is_gltf(&map(&index_file(path))?) && contents(path, None)? != Contents { splats: true, meshes: false })
}

/// What the chosen scene of the file at `path` holds.
fn contents(path: &Path, scene: Option<&str>) -> Result<Contents> {
    match is_gltf(&map(&index_file(path))?) {
        true => gltf::contents(path, scene),
        false => Ok(Contents::default()),
    }
}

/// What tells whether two paths mean one file.
fn identity(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}
