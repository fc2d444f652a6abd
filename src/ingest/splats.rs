//! All splat inputs of a scene, opened, placed and gathered.

use glam::DVec3;
use rayon::prelude::*;

use super::gather::Gathering;
use super::report::{SplatReport, Statistics};
use super::requests::SplatRequest;
use super::sanitize::{self, Selection, WorldFromFile};
use super::source::{SplatFile, SplatPart};
use super::{CHUNK, index_file, open, origin_for};
use crate::error::{Error, Result};
use crate::job::Frame;
use crate::scene::bounds::robust_bounds;
use crate::scene::{SplatEncoding, Splats};

/// All splat inputs, merged.
pub(super) struct LoadedSplats {
    /// World position, in metres, that the Gaussians' means are relative to.
    pub origin: DVec3,
    pub splats: Splats,
    /// What is blended before conversion; see [`Scene::encoding`](crate::scene::Scene::encoding).
    pub encoding: SplatEncoding,
    /// One per request, in their order.
    pub reports: Vec<SplatReport>,
}

/// A request's opened file, and where each of its parts goes.
struct Opened<'a> {
    request: &'a SplatRequest<'a>,
    file: SplatFile,
    frame: Frame,
    encoding: SplatEncoding,
    selection: Selection,
    world_from_parts: Vec<WorldFromFile>,
}

impl<'a> Opened<'a> {
    fn new(request: &'a SplatRequest<'a>) -> Result<Self> {
        let input = &*request.input;
        let file = open(request)?;
        let frame = input.frame.unwrap_or(file.frame);
        let encoding = input.encoding.unwrap_or(file.encoding);
        let selection = Selection { crop: input.crop, min_opacity: input.min_opacity };
        let field = format!("{}.transform", request.field);
        let world_from_part = |part: &SplatPart| {
            let degree = part.source.sh_degree();
            WorldFromFile::new(&field, frame, &input.transform, part.file_from_part, degree)
        };
        let world_from_parts = file.parts.iter().map(world_from_part).collect::<Result<_>>()?;
        Ok(Self { request, file, frame, encoding, selection, world_from_parts })
    }

    fn parts(&self) -> impl Iterator<Item = (&SplatPart, &WorldFromFile)> {
        self.file.parts.iter().zip(&self.world_from_parts)
    }

    /// Why nothing is left of the file.
    fn nothing_left(&self, dropped: sanitize::Dropped) -> Error {
        if dropped.cropped + dropped.below_min_opacity > 0 {
            let why = format!("of {} nothing is left: {dropped:?}", self.request.input.path.display());
            return Error::request(format!("{}.crop, {0}.minOpacity", self.request.field), why);
        }
        Error::invalid(&self.request.input.path, "all Gaussians", format!("none can be used: {dropped:?}"))
    }
}

/// Reads all of `requests` into one set of arrays.
pub(super) fn load(requests: &[SplatRequest]) -> Result<LoadedSplats> {
    let opened: Vec<Opened> = requests.iter().map(Opened::new).collect::<Result<_>>()?;
    let encoding = blended_encoding(&opened);
    let origin = opened.first().map_or(Ok(DVec3::ZERO), scene_origin)?;
    let count = opened.iter().map(|opened| opened.file.count()).sum();
    let stored_degree = opened.iter().map(|opened| opened.file.sh_degree()).max().unwrap_or(0);
    let mut gathering = Gathering::new(count, stored_degree);
    let mut gathered = Vec::with_capacity(opened.len());
    for opened in &opened {
        let mut whole = gathering.nothing();
        for (part, world_from_part) in opened.parts() {
            whole += gathering.append(&*part.source, world_from_part, &opened.selection, origin)?;
        }
        gathered.push(whole);
    }
    let mut splats = gathering.finish(gathered.iter().map(|part| part.sh_degree_used).max().unwrap_or(0));
    if opened.iter().any(|opened| is_linear(opened.encoding) != is_linear(encoding)) {
        let flags = opened.iter().zip(&gathered);
        splats.linear =
            flags.flat_map(|(opened, part)| part.range.clone().map(|_| is_linear(opened.encoding))).collect();
    }

    let mut reports = Vec::with_capacity(opened.len());
    for (opened, part) in opened.iter().zip(gathered) {
        let kept = part.range.len() as u64;
        let Some(statistics) = Statistics::of(&splats, part.range, origin) else {
            return Err(opened.nothing_left(part.dropped));
        };
        reports.push(SplatReport {
            path: opened.request.input.path.clone(),
            files: [vec![index_file(&opened.request.input.path)], opened.file.files.clone()].concat(),
            format: opened.file.format.clone(),
            count: opened.file.count() as u64,
            kept,
            dropped: part.dropped,
            sh_degree: opened.file.sh_degree(),
            sh_degree_used: part.sh_degree_used,
            sh_energy: statistics.sh_energy,
            encoding: opened.encoding,
            frame: opened.frame,
            order: opened.file.order,
            bounds: statistics.bounds,
            robust_bounds: statistics.robust_bounds,
            opacity: statistics.opacity,
            scale: statistics.scale,
        });
    }
    Ok(LoadedSplats { origin, splats, encoding, reports })
}

/// Whether colours need no conversion to become linear light.
fn is_linear(encoding: SplatEncoding) -> bool {
    encoding != SplatEncoding::SrgbDisplay
}

/// The encoding that is converted after blending: display colours' where there are any, because linear ones add to linear
/// light by themselves.
fn blended_encoding(opened: &[Opened]) -> SplatEncoding {
    let mut encodings = opened.iter().map(|opened| opened.encoding);
    let display = encodings.clone().find(|&encoding| !is_linear(encoding));
    display.or_else(|| encodings.next()).unwrap_or_default()
}

/// Zero, unless the first splat input lies so far from it that f32 world coordinates would lose detail: more than 64
/// times its extent. Then its centre, rounded to a power of two, so that f32 offsets from it stay exact.
fn scene_origin(opened: &Opened<'_>) -> Result<DVec3> {
    /// As many chunks of each part, evenly spaced, tell where a file lies.
    const CHUNKS: usize = 16;
    let mut means = Vec::new();
    for (part, world_from_part) in opened.parts() {
        let chunks = part.source.count().div_ceil(CHUNK);
        let sampled = (0..chunks).into_par_iter().step_by(chunks.div_ceil(CHUNKS).max(1));
        let decode = |chunk| {
            let mut found = Vec::with_capacity(CHUNK);
            part.source.for_each_in_chunk(chunk, &mut |gaussian| {
                let mean = world_from_part.position(gaussian.mean);
                let asked_for = opened.selection.check(mean, gaussian.opacity).is_ok();
                if asked_for && mean.abs().max_element() <= sanitize::LIMIT {
                    found.push(mean);
                }
            })?;
            Ok(found)
        };
        // In file order, so that the first error in the file is the one that is told.
        for found in sampled.map(decode).collect::<Vec<Result<_>>>() {
            means.extend(found?);
        }
    }
    // Relative to one of them: f32 would merge far points.
    let Some(&anchor) = means.first() else { return Ok(DVec3::ZERO) };
    let offsets: Vec<_> = means.iter().map(|&mean| (mean - anchor).as_vec3()).collect();
    Ok(robust_bounds(&offsets).map_or(DVec3::ZERO, |bounds| origin_for(bounds.translated(anchor))))
}
