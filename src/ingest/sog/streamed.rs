//! Streamed SOG: `lod-meta.json`, a tree of boxes whose leaves name, for each level of detail, a range of Gaussians in
//! one of several SOGs; and an environment, which belongs to every level.
//!
//! A bake wants one level everywhere. Only SOGs with Gaussians of that level are opened. The tree's boxes are not used:
//! a probe sees to infinity, and some writers turned the boxes against the Gaussians in them.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use glam::DAffine3;
use rayon::prelude::*;
use serde::Deserialize;

use super::super::source::{SplatFile, SplatPart};
use super::files::{Files, inside};
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

/// Opens level `lod` (0 is the finest) of the streamed SOG whose `lod-meta.json`, at `path`, has these `bytes`.
///
/// # Errors
/// [`Error::Request`] in `field` when there are not so many levels; [`Error::Invalid`] when the tree and the SOGs do not
/// fit together; those of [`super::open`] for each SOG.
pub(in super::super) fn open(path: &Path, bytes: &[u8], lod: u32, field: &str) -> Result<SplatFile> {
    let meta: LodMeta =
        serde_json::from_slice(bytes).map_err(|error| Error::invalid(path, "lod-meta.json", error.to_string()))?;
    if let Some(version) = meta.version.filter(|version| version.as_u64() != Some(1)) {
        return Err(Error::unsupported(path, format!("streamed SOG version {version}; this program reads 1")));
    }
    if lod >= meta.lod_levels {
        let why = format!("{} has levels 0 to {}, not {lod}", path.display(), i64::from(meta.lod_levels) - 1);
        return Err(Error::request(field, why));
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
    let opened: Vec<Result<Vec<SplatPart>>> =
        wanted.par_iter().map(|(file, ranges)| parts_of(path, file, *ranges)).collect();
    let parts = opened.into_iter().collect::<Result<Vec<_>>>()?.into_iter().flatten().collect();
    Ok(super::splat_file(format!("streamed SOG, level {lod} of 0 to {}", meta.lod_levels - 1), parts))
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

/// `ranges` of the SOG in `file`, or all of it.
fn parts_of(path: &Path, file: &Path, ranges: Option<&[Range<usize>]>) -> Result<Vec<SplatPart>> {
    let bytes = super::super::map(file)?;
    if !super::is_sog(&bytes) {
        return Err(Error::invalid(file, "byte 0", format!("not a SOG, although {} says so", path.display())));
    }
    let sog = Arc::new(Sog::read(&Files::new(file, bytes)?)?);
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
