//! Files -> scene, in physical units and the canonical frame. One file per format; the format is known by content.

pub mod gltf;

mod gather;
mod ksplat;
mod ply;
mod report;
mod sanitize;
mod source;
mod splat;
mod spz;

use std::fs::File;
use std::path::Path;

use glam::DVec3;
use memmap2::Mmap;

use self::gather::Gathering;
use self::gltf::MeshReport;
use self::report::Statistics;
use self::sanitize::WorldFromFile;
use self::source::{SplatFile, SplatPart};
use crate::error::{Error, Result};
use crate::job::{Frame, MeshInput, SplatInput};
use crate::scene::bounds::{Bounds, robust_bounds};
use crate::scene::{Meshes, Scene, SplatEncoding, Splats};

pub use report::{Quantiles, SceneReport, SplatReport};
pub use sanitize::Dropped;

/// Gaussians decoded at a time by one thread.
const CHUNK: usize = 4096;

/// Reads all inputs into one scene; the report lists them in order.
///
/// # Errors
/// [`Error::Read`] when a file cannot be read, [`Error::Invalid`] or [`Error::Unsupported`] when its content cannot be
/// used, [`Error::Request`] when inputs do not fit together or a transform is singular.
pub fn load_scene(splats: &[SplatInput], meshes: &[MeshInput]) -> Result<(Scene, SceneReport)> {
    let loaded = load_splats(splats)?;
    let (origin, meshes, mesh_reports) = match splats.is_empty() {
        true => load_meshes_alone(meshes)?,
        false => {
            let (loaded_meshes, reports) = load_meshes(meshes, loaded.origin)?;
            (loaded.origin, loaded_meshes, reports)
        }
    };
    let scene = Scene { origin, splats: loaded.splats, meshes, encoding: loaded.encoding, ..Scene::default() };
    Ok((scene, SceneReport { splats: loaded.reports, meshes: mesh_reports }))
}

/// All mesh inputs, merged, with positions relative to `origin`.
fn load_meshes(inputs: &[MeshInput], origin: DVec3) -> Result<(Meshes, Vec<MeshReport>)> {
    let mut meshes = Meshes::default();
    let reports = inputs.iter().map(|input| gltf::load(input, origin, &mut meshes)).collect::<Result<_>>()?;
    Ok((meshes, reports))
}

/// All mesh inputs, merged, and an origin for a scene that has nothing else in it.
///
/// Where a mesh lies is known when it has been read, so that a scene which lies elsewhere than the first input's
/// transform says is read a second time.
fn load_meshes_alone(inputs: &[MeshInput]) -> Result<(DVec3, Meshes, Vec<MeshReport>)> {
    let guess = inputs.first().map_or(DVec3::ZERO, |input| {
        let placed = DVec3::from(input.transform.translation);
        origin_for(Bounds { min: placed, max: placed })
    });
    let (meshes, reports) = load_meshes(inputs, guess)?;
    let report = SceneReport { splats: Vec::new(), meshes: reports };
    let origin = report.mesh_bounds().map_or(guess, origin_for);
    if origin == guess {
        return Ok((origin, meshes, report.meshes));
    }
    let (meshes, reports) = load_meshes(inputs, origin)?;
    Ok((origin, meshes, reports))
}

/// What is in the splat file at `path`, understood with the format's defaults. Errors as in [`load_scene`].
pub fn inspect_splats(path: &Path) -> Result<SplatReport> {
    load_splats(&[SplatInput::new(path)])?
        .reports
        .pop()
        .ok_or_else(|| Error::invalid(path, "file", "nothing was loaded"))
}

/// All splat inputs, merged.
struct LoadedSplats {
    /// World position, in metres, that the Gaussians' means are relative to.
    origin: DVec3,
    splats: Splats,
    encoding: SplatEncoding,
    reports: Vec<SplatReport>,
}

/// An input's opened file, and where each of its parts goes.
struct Opened<'a> {
    input: &'a SplatInput,
    file: SplatFile,
    frame: Frame,
    encoding: SplatEncoding,
    world_from_parts: Vec<WorldFromFile>,
}

impl<'a> Opened<'a> {
    /// Opens input number `i`.
    fn new(i: usize, input: &'a SplatInput) -> Result<Self> {
        let file = open(&input.path)?;
        let frame = input.frame.unwrap_or(file.frame);
        let encoding = input.encoding.unwrap_or(file.encoding);
        let field = format!("splats[{i}].transform");
        let world_from_part = |part: &SplatPart| {
            let degree = part.source.sh_degree();
            WorldFromFile::new(&field, frame, &input.transform, part.file_from_part, degree)
        };
        let world_from_parts = file.parts.iter().map(world_from_part).collect::<Result<_>>()?;
        Ok(Self { input, file, frame, encoding, world_from_parts })
    }

    fn parts(&self) -> impl Iterator<Item = (&SplatPart, &WorldFromFile)> {
        self.file.parts.iter().zip(&self.world_from_parts)
    }
}

fn load_splats(inputs: &[SplatInput]) -> Result<LoadedSplats> {
    let opened: Vec<Opened> =
        inputs.iter().enumerate().map(|(i, input)| Opened::new(i, input)).collect::<Result<_>>()?;
    let encoding = common_encoding(&opened)?;
    let origin = opened.first().map_or(Ok(DVec3::ZERO), scene_origin)?;
    let count = opened.iter().map(|opened| opened.file.count()).sum();
    let stored_degree = opened.iter().map(|opened| opened.file.sh_degree()).max().unwrap_or(0);
    let mut gathering = Gathering::new(count, stored_degree);
    let mut gathered = Vec::with_capacity(opened.len());
    for opened in &opened {
        let mut whole = gathering.nothing();
        for (part, world_from_part) in opened.parts() {
            whole += gathering.append(&*part.source, world_from_part, origin)?;
        }
        gathered.push(whole);
    }
    let splats = gathering.finish(gathered.iter().map(|part| part.sh_degree_used).max().unwrap_or(0));

    let mut reports = Vec::with_capacity(opened.len());
    for (Opened { input, file, frame, encoding, .. }, part) in opened.iter().zip(gathered) {
        let kept = part.range.len() as u64;
        let statistics = Statistics::of(&splats, part.range, origin).ok_or_else(|| {
            Error::invalid(&input.path, "all Gaussians", format!("none can be used: {:?}", part.dropped))
        })?;
        reports.push(SplatReport {
            path: input.path.clone(),
            format: file.format.clone(),
            count: file.count() as u64,
            kept,
            dropped: part.dropped,
            sh_degree: file.sh_degree(),
            sh_degree_used: part.sh_degree_used,
            encoding: *encoding,
            frame: *frame,
            bounds: statistics.bounds,
            robust_bounds: statistics.robust_bounds,
            opacity: statistics.opacity,
            scale: statistics.scale,
        });
    }
    Ok(LoadedSplats { origin, splats, encoding, reports })
}

/// The one encoding of all inputs: they are blended together, before any conversion.
fn common_encoding(opened: &[Opened]) -> Result<SplatEncoding> {
    let first = opened.first().map(|opened| opened.encoding).unwrap_or_default();
    match opened.iter().position(|opened| opened.encoding != first) {
        None => Ok(first),
        Some(i) => {
            let why = format!(
                "{} differs from {} of {}; Gaussians are blended in their encoding, so that all splat inputs must share one",
                serde_json::json!(opened[i].encoding),
                serde_json::json!(first),
                opened[0].input.path.display()
            );
            Err(Error::request(format!("splats[{i}].encoding"), why))
        }
    }
}

/// Zero, unless the first splat input lies so far from it that f32 world coordinates would lose detail: more than 64
/// times its extent. Then its centre, rounded to a power of two, so that f32 offsets from it stay exact.
fn scene_origin(opened: &Opened) -> Result<DVec3> {
    /// As many chunks of each part, evenly spaced, tell where a file lies.
    const CHUNKS: usize = 16;
    let mut means = Vec::new();
    for (part, world_from_part) in opened.parts() {
        let chunks = part.source.count().div_ceil(CHUNK);
        for chunk in (0..chunks).step_by(chunks.div_ceil(CHUNKS).max(1)) {
            part.source.for_each_in_chunk(chunk, &mut |gaussian| {
                let mean = world_from_part.position(gaussian.mean);
                if mean.abs().max_element() <= sanitize::LIMIT {
                    means.push(mean);
                }
            })?;
        }
    }
    // Relative to one of them: f32 would merge far points.
    let Some(&anchor) = means.first() else { return Ok(DVec3::ZERO) };
    let offsets: Vec<_> = means.iter().map(|&mean| (mean - anchor).as_vec3()).collect();
    Ok(robust_bounds(&offsets).map_or(DVec3::ZERO, |bounds| origin_for(bounds.translated(anchor))))
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

/// Opens a splat file of whichever supported format its first bytes show.
fn open(path: &Path) -> Result<SplatFile> {
    type Open = fn(&Path, Mmap) -> Result<SplatFile>;
    const FORMATS: [(&[u8], Open); 4] =
        [(ply::MAGIC, ply::open), (spz::GZIP_MAGIC, spz::open), (spz::MAGIC, spz::open), (ksplat::MAGIC, ksplat::open)];
    const ADVICE: &str = "supported splat formats: PLY (plain and compressed), SPZ, .splat, .ksplat";
    const OTHERS: [(&[u8], &str); 5] = [
        (b"PK\x03\x04", "a zip archive (.sog or .usdz)"),
        (b"glTF", "binary glTF"),
        (b"PXR-USDC", "binary USD"),
        (b"#usda", "text USD"),
        (b"{", "JSON (glTF or streamed SOG)"),
    ];
    let bytes = map(path)?;
    if let Some((_, open)) = FORMATS.iter().find(|(magic, _)| bytes.starts_with(magic)) {
        return open(path, bytes);
    }
    if let Some((_, name)) = OTHERS.iter().find(|(magic, _)| bytes.starts_with(magic)) {
        return Err(Error::unsupported(path, format!("{name} as a splat input; {ADVICE}")));
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
