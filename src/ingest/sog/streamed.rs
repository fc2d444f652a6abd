//! Streamed SOG: `lod-meta.json`, a tree of boxes whose leaves name, for each level of detail, a range of Gaussians in
//! one of several SOGs; and an environment, which belongs to every level.
//!
//! A bake wants one level everywhere, because a probe sees to infinity: only SOGs with Gaussians of that level are opened,
//! and decoded unless a crop leaves them out. The range of means in each SOG's `meta.json` tells that; the tree's boxes do
//! not, because some writers turned them against the Gaussians in them.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use glam::DAffine3;
use rayon::prelude::*;
use serde::Deserialize;

use super::super::file_log::FileLog;
use super::super::requests::SplatRequest;
use super::super::source::{SplatFile, SplatPart};
use super::files::{Files, inside};
use super::meta::Meta;
use super::source::{Sog, SogRange};
use crate::error::{Error, Result};

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct LodMeta {
    version: Option<serde_json::Value>,
    lod_levels: u32,
    environment: Option<String>,
    filenames: Vec<String>,
    tree: Node,
}

#[derive(Deserialize)]
struct Node {
    #[serde(default)]
    children: Vec<Node>,
    #[serde(default)]
    lods: BTreeMap<u32, Lod>,
}

/// Gaussians `offset .. offset + count` of the file with number `file`.
#[derive(Deserialize)]
struct Lod {
    file: usize,
    offset: usize,
    count: usize,
}

/// Ranges of each file, by its number.
type Ranges = BTreeMap<usize, Vec<Range<usize>>>;

/// Opens the level of detail that `request` asks for of the streamed SOG whose `lod-meta.json`, at `path`, has these
/// `bytes`. SOGs that its crop leaves out are not decoded, and not counted either.
///
/// # Errors
/// [`Error::Request`] when there are not so many levels, or nothing lies in the crop; [`Error::Invalid`] when the tree and the SOGs do not
/// fit together; those of [`super::open`] for each SOG.
pub(in super::super) fn open(path: &Path, bytes: &[u8], request: &SplatRequest) -> Result<SplatFile> {
    let lod = request.input.lod.unwrap_or(0);
    let meta: LodMeta =
        serde_json::from_slice(bytes).map_err(|error| Error::invalid(path, "lod-meta.json", error.to_string()))?;
    if let Some(version) = meta.version.filter(|version| version.as_u64() != Some(1)) {
        return Err(Error::unsupported(path, format!("streamed SOG version {version}; this program reads 1")));
    }
    if lod >= meta.lod_levels {
        let why = format!("{} has levels 0 to {}, not {lod}", path.display(), i64::from(meta.lod_levels) - 1);
        return Err(Error::request(format!("{}.lod", request.field), why));
    }
    let ranges = ranges_of_level(path, &meta.tree, lod, meta.filenames.len())?;
    let named = ranges.iter().map(|(&file, ranges)| (meta.filenames[file].as_str(), Some(&ranges[..])));
    let environment = meta.environment.as_deref().map(|name| (name, None));
    let mut wanted = BTreeMap::new();
    for (name, ranges) in named.chain(environment) {
        let file = inside(path, path.parent().unwrap_or(Path::new("")), name)?;
        // Twice the same Gaussians would also be any amount of memory from one small file.
        if wanted.insert(file, ranges).is_some() {
            return Err(Error::invalid(path, format!("file name '{name}'"), "the file is named twice"));
        }
    }
    // Collected before the first error is looked for, so that the same one is told whichever thread was first.
    let log = FileLog::default();
    let opened: Vec<Result<Vec<SplatPart>>> =
        wanted.par_iter().map(|(file, ranges)| parts_of(path, file, *ranges, request, &log)).collect();
    let parts: Vec<_> = opened.into_iter().collect::<Result<Vec<_>>>()?.into_iter().flatten().collect();
    if parts.is_empty() {
        let why = format!("nothing of {} lies in it", path.display());
        return Err(Error::request(format!("{}.crop", request.field), why));
    }
    Ok(super::splat_file(format!("streamed SOG, level {lod} of 0 to {}", meta.lod_levels - 1), parts, &log))
}

/// The ranges of `lod` in every leaf of `tree`, in order, joined where they touch.
fn ranges_of_level(path: &Path, tree: &Node, lod: u32, file_count: usize) -> Result<Ranges> {
    let fault = |what: String| Error::invalid(path, format!("tree, level {lod}"), what);
    let mut ranges = Ranges::new();
    // The JSON reader has limited the depth.
    let mut waiting = vec![tree];
    while let Some(node) = waiting.pop() {
        waiting.extend(&node.children);
        let Some(&Lod { file, offset, count }) = node.lods.get(&lod).filter(|lod| lod.count > 0) else { continue };
        let end = offset.checked_add(count).ok_or_else(|| fault(format!("{count} Gaussians from {offset} on")))?;
        if file >= file_count {
            return Err(fault(format!("file {file}; filenames has {file_count}")));
        }
        ranges.entry(file).or_default().push(offset..end);
    }
    for (file, ranges) in &mut ranges {
        ranges.sort_unstable_by_key(|range| range.start);
        let mut joined: Vec<Range<usize>> = Vec::new();
        for range in ranges.drain(..) {
            match joined.last_mut() {
                Some(last) if range.start < last.end => {
                    return Err(fault(format!("two nodes share Gaussian {} of file {file}", range.start)));
                }
                Some(last) if range.start == last.end => last.end = range.end,
                _ => joined.push(range),
            }
        }
        *ranges = joined;
    }
    match ranges.is_empty() {
        true => Err(fault("no node has Gaussians".into())),
        false => Ok(ranges),
    }
}

/// `ranges` of the SOG in `file`, or all of it; nothing where `request` leaves it out.
fn parts_of(
    path: &Path,
    file: &Path,
    ranges: Option<&[Range<usize>]>,
    request: &SplatRequest,
    log: &FileLog,
) -> Result<Vec<SplatPart>> {
    log.add(file);
    let bytes = super::super::map(file)?;
    if !super::is_sog(&bytes) {
        return Err(Error::invalid(file, "byte 0", format!("not a SOG, although {} says so", path.display())));
    }
    let files = Files::new(file, bytes, log.clone())?;
    let meta = Meta::parse(file, &files.index()?)?;
    if !request.may_need(meta.bounds(), super::FRAME) {
        return Ok(Vec::new());
    }
    let sog = Arc::new(Sog::read(&files, meta)?);
    let all = 0..sog.count();
    let ranges = ranges.unwrap_or(std::slice::from_ref(&all));
    let part = |range: &Range<usize>| {
        if range.end > all.end {
            let what =
                format!("Gaussians {} to {} of {}, which has {}", range.start, range.end, file.display(), all.end);
            return Err(Error::invalid(path, "tree", what));
        }
        let source = Box::new(SogRange::new(sog.clone(), range.clone()));
        Ok(SplatPart { file_from_part: DAffine3::IDENTITY, source })
    };
    ranges.iter().map(part).collect()
}
