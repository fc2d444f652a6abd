//! What the fuzz targets share: an input becomes a file, the file a scene, and the scene a few traced rays.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use glam::DVec3;
use splatprobe::bvh::Bvh;
use splatprobe::ingest::load_scene;
use splatprobe::job::{MeshInput, SplatInput};
use splatprobe::scene::Scene;
use splatprobe::shade::UnlitSurfaces;
use splatprobe::trace::{BeamTracer, Face, Radiance, Tile, TileTracer, TraceSettings};
use tempfile::TempDir;

/// Gaussians and triangles of a scene that is still traced: more only take time.
const MAX_TRACED: usize = 256;

/// One folder for each process; its files are written over and over.
static FOLDER: LazyLock<TempDir> = LazyLock::new(|| tempfile::tempdir().expect("a temporary folder"));

/// The folder that [`file`] writes to.
pub fn folder() -> &'static Path {
    FOLDER.path()
}

/// Writes `bytes` to the file `name`; gives its path.
pub fn file(name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder().join(name);
    std::fs::write(&path, bytes).expect("written");
    path
}

/// Loads the file at `path` as splats.
pub fn load_splats(path: &Path) {
    use_scene(load_scene(&[SplatInput::new(path)], &[]));
}

/// Loads the file at `path` as meshes, with the splats in it.
pub fn load_meshes(path: &Path) {
    use_scene(load_scene(&[], &[MeshInput::new(path)]));
}

/// Builds the tree of what was loaded and traces a small tile, so that what a reader lets pass is also tried behind it.
fn use_scene<T>(loaded: splatprobe::Result<(Scene, T)>) {
    let Ok((mut scene, _)) = loaded else { return };
    if scene.splats.len() + scene.meshes.triangles.len() > MAX_TRACED {
        return;
    }
    let bvh = Bvh::build(&mut scene);
    let surfaces = UnlitSurfaces::new(&scene.meshes);
    let tracer = BeamTracer::new(&scene, &bvh, &surfaces, TraceSettings::default());
    for face in [Face::NegZ, Face::PosY] {
        let tile = Tile { face, face_size: 4, x: 0, y: 0, width: 4, height: 4 };
        let mut texels = [Radiance::default(); 16];
        tracer.trace_tile(DVec3::new(0.0, 0.0, 0.5), &tile, &mut texels);
        assert!(texels.iter().all(|texel| (0.0..=1.0).contains(&texel.transmittance)), "{texels:?}");
    }
}
