//! Files -> scene, in physical units and the canonical frame. One file per format; the format is known by content.

pub mod gltf;

mod file_log;
mod gather;
mod geometry;
mod image;
mod ksplat;
mod pages;
mod ply;
mod report;
mod requests;
mod sanitize;
mod sog;
mod source;
mod splat;
mod splats;
mod spz;
mod tangents;
mod usd;

use std::fs::File;
use std::ops::Range;
use std::path::Path;

use glam::DVec3;
use memmap2::Mmap;

use self::gltf::MeshReport;
use self::requests::{Requests, SplatRequest};
use self::source::SplatFile;
use crate::error::{Error, Result};
use crate::job::{MeshInput, SplatInput};
use crate::scene::bounds::Bounds;
use crate::scene::{Light, Meshes, Scene};

pub use report::{Quantiles, SceneReport, SplatReport};
pub use sanitize::Dropped;
pub use sog::{INDEX_NAMES as SOG_INDEX_NAMES, index_file};

/// Gaussians decoded at a time by one thread.
const CHUNK: usize = 4096;

/// Reads all inputs into one scene; the report lists them in order.
///
/// A file that holds both splats and meshes brings both, whichever list names it; what a list does not name comes after
/// what it does.
///
/// # Errors
/// [`Error::Read`] when a file cannot be read, [`Error::Invalid`] or [`Error::Unsupported`] when its content cannot be
/// used, [`Error::Request`] when a transform is singular or nothing of a file is asked for.
pub fn load_scene(splats: &[SplatInput], meshes: &[MeshInput]) -> Result<(Scene, SceneReport)> {
    let requests = Requests::new(splats, meshes)?;
    let loaded = splats::load(&requests.splats)?;
    let (origin, loaded_meshes) = match requests.splats.is_empty() {
        true => load_meshes_alone(&requests.meshes)?,
        false => (loaded.origin, load_meshes(&requests.meshes, loaded.origin)?),
    };
    let LoadedMeshes { meshes, lights, reports } = loaded_meshes;
    let scene = Scene { origin, splats: loaded.splats, meshes, lights, encoding: loaded.encoding, ..Scene::default() };
    Ok((scene, SceneReport { splats: loaded.reports, meshes: reports }))
}

/// How many Gaussians the inputs hold, and the highest degree of their spherical harmonics: of what [`load_scene`] would
/// read, without reading it.
///
/// Errors as in [`load_scene`], as far as the files' structure shows them.
pub fn count_gaussians(splats: &[SplatInput], meshes: &[MeshInput]) -> Result<(usize, u8)> {
    let requests = Requests::new(splats, meshes)?;
    let files: Vec<SplatFile> = requests.splats.iter().map(open).collect::<Result<_>>()?;
    let degree = files.iter().map(SplatFile::sh_degree).max().unwrap_or(0);
    Ok((files.iter().map(SplatFile::count).sum(), degree))
}

/// What is in the splat file at `path`, understood with the format's defaults. Errors as in [`load_scene`].
pub fn inspect_splats(path: &Path) -> Result<SplatReport> {
    let (_, report) = load_scene(&[SplatInput::new(path)], &[])?;
    report.splats.into_iter().next().ok_or_else(|| Error::invalid(path, "file", "nothing was loaded"))
}

/// What is in the file at `path`, splats and meshes, understood with the format's defaults. Errors as in [`load_scene`].
pub fn inspect(path: &Path) -> Result<SceneReport> {
    let (splats, meshes) = inputs_of(path)?;
    load_scene(&splats, &meshes).map(|(_, report)| report)
}

/// The file at `path` as the input that it is by its content: of splats or, where it may hold meshes, of meshes.
///
/// # Errors
/// [`Error::Read`] when it cannot be read, [`Error::Invalid`] when it is broken.
pub fn inputs_of(path: &Path) -> Result<(Vec<SplatInput>, Vec<MeshInput>)> {
    Ok(match requests::holds_meshes(path)? {
        true => (Vec::new(), vec![MeshInput::new(path)]),
        false => (vec![SplatInput::new(path)], Vec::new()),
    })
}

/// All mesh inputs, merged.
#[derive(Default)]
struct LoadedMeshes {
    meshes: Meshes,
    lights: Vec<Light>,
    reports: Vec<MeshReport>,
}

/// All mesh inputs, with positions relative to `origin`.
fn load_meshes(inputs: &[MeshInput], origin: DVec3) -> Result<LoadedMeshes> {
    let mut loaded = LoadedMeshes::default();
    for input in inputs {
        // Of whichever format its first bytes show.
        let load = if usd::is_usd(&map(&input.path)?) { usd::load } else { gltf::load };
        loaded.reports.push(load(input, origin, &mut loaded.meshes, &mut loaded.lights)?);
        loaded.meshes.input_ends.push(loaded.meshes.triangles.len());
    }
    Ok(loaded)
}

/// All mesh inputs, and an origin for a scene that has nothing else in it.
///
/// Where a mesh lies is known when it has been read, so that a scene which lies elsewhere than the first input's
/// transform says is read a second time.
fn load_meshes_alone(inputs: &[MeshInput]) -> Result<(DVec3, LoadedMeshes)> {
    let guess = inputs.first().map_or(DVec3::ZERO, |input| {
        let placed = DVec3::from(input.transform.translation);
        origin_for(Bounds { min: placed, max: placed })
    });
    let loaded = load_meshes(inputs, guess)?;
    let report = SceneReport { splats: Vec::new(), meshes: loaded.reports.clone() };
    let origin = report.mesh_bounds().map_or(guess, origin_for);
    if origin == guess {
        return Ok((origin, loaded));
    }
    Ok((origin, load_meshes(inputs, origin)?))
}

/// The scene origin for a scene that fills `bounds`, in world metres.
fn origin_for(bounds: Bounds) -> DVec3 {
    // A scene's Gaussians have a size themselves: one metre is taken as the least extent.
    let extent = bounds.extent().max_element().max(1.0);
    let nearest = DVec3::ZERO.clamp(bounds.min, bounds.max);
    if nearest.length() <= 64.0 * extent {
        return DVec3::ZERO;
    }
    let unit = extent.log2().floor().exp2();
    (bounds.centre() / unit).round() * unit
}

/// Opens the splat file that `request` asks for, of whichever supported format its first bytes show.
fn open(request: &SplatRequest) -> Result<SplatFile> {
    type Open = fn(&Path, Mmap) -> Result<SplatFile>;
    const FORMATS: [(&[u8], Open); 4] =
        [(ply::MAGIC, ply::open), (spz::GZIP_MAGIC, spz::open), (spz::MAGIC, spz::open), (ksplat::MAGIC, ksplat::open)];
    const ADVICE: &str =
        "supported splat formats: PLY (plain and compressed), SPZ, SOG (also streamed), .splat, .ksplat, glTF, USD";
    let path = &*index_file(&request.input.path);
    let bytes = map(path)?;
    if sog::is_streamed(&bytes) {
        return sog::open_streamed(path, &bytes, request);
    }
    if request.input.lod.is_some() {
        let why = format!("{} has no levels of detail: leave it out", path.display());
        return Err(Error::request(format!("{}.lod", request.field), why));
    }
    if is_gltf(&bytes) {
        return gltf::open_splats(path, request.scene);
    }
    if usd::is_usd(&bytes) {
        return usd::open_splats(path);
    }
    if sog::is_sog(&bytes) {
        return sog::open(path, bytes);
    }
    if let Some((_, open)) = FORMATS.iter().find(|(magic, _)| bytes.starts_with(magic)) {
        return open(path, bytes);
    }
    // .splat has no first bytes of its own. A file that is nothing known is what its name says, so that the reader of
    // that format can tell what is wrong with it.
    match path.extension().and_then(|extension| extension.to_str()) {
        _ if splat::is_plausible(&bytes) => splat::open(path, bytes),
        Some("splat") => splat::open(path, bytes),
        Some("ksplat") => ksplat::open(path, bytes),
        _ => {
            let shown = bytes[..bytes.len().min(16)].escape_ascii();
            Err(Error::invalid(path, "byte 0", format!("unknown format, begins with '{shown}'; {ADVICE}")))
        }
    }
}

/// Whether `bytes` are a glTF file; a SOG's JSON has an "asset", too.
fn is_gltf(bytes: &[u8]) -> bool {
    gltf::is_gltf(bytes) && !sog::is_sog(bytes) && !sog::is_streamed(bytes)
}

/// Lets the system take back the memory of a part of a file that has been decoded; reading it again brings it back. Of a
/// scene as large as memory, file and Gaussians would otherwise both be resident: 5.6 GB of 12 million Gaussians of SH degree
/// 3 were, half of them the file.
fn release(bytes: &Mmap, range: Range<usize>) {
    // SAFETY: the map is of a file and never written to, so that the bytes are the same when they are read again.
    #[cfg(unix)]
    let _ = unsafe { bytes.unchecked_advise_range(memmap2::UncheckedAdvice::DontNeed, range.start, range.len()) };
}

/// Maps a regular file into memory.
fn map(path: &Path) -> Result<Mmap> {
    let read = |source| Error::read(path, source);
    // Asked first, because opening a pipe may wait for ever.
    let metadata = std::fs::metadata(path).map_err(read)?;
    if !metadata.is_file() {
        return Err(read(std::io::Error::other("not a regular file")));
    }
    if metadata.len() == 0 {
        return Err(Error::invalid(path, "byte 0", "the file is empty"));
    }
    let file = File::open(path).map_err(read)?;
    // SAFETY: the map is read-only and its bytes are only ever taken as numbers, for which any value is valid. Inputs must
    // not be shortened while they are read, as for every program that maps its inputs; the manual says so.
    unsafe { Mmap::map(&file) }.map_err(read)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bounds(min: [f64; 3], max: [f64; 3]) -> Bounds {
        Bounds { min: min.into(), max: max.into() }
    }

    #[test]
    fn origin_stays_zero_unless_the_scene_is_64_extents_away() {
        assert_eq!(origin_for(bounds([600.0, 0.0, 0.0], [610.0, 1.0, 1.0])), DVec3::ZERO);
        assert_eq!(origin_for(bounds([-1.0; 3], [1e9; 3])), DVec3::ZERO);
        assert_eq!(origin_for(bounds([63.0, 0.0, 0.0], [63.0, 0.0, 0.0])), DVec3::ZERO);
    }

    #[test]
    fn far_origin_is_the_centre_rounded_to_a_power_of_two_below_the_extent() {
        let origin = origin_for(bounds([4_000_000.3, 0.0, 700.0], [4_000_010.3, 2.0, 701.0]));
        assert_eq!(origin, DVec3::new(4_000_008.0, 0.0, 704.0));
    }
}
