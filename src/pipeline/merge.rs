//! The parts of a bake to one bake: the same bytes as if it had been baked at once.

use std::path::{Path, PathBuf};

use image::RgbaImage;

use super::output::{PREVIEW_FILE, files_of, publish};
use super::plan::Plan;
use super::workspace::Workspace;
use crate::encode::preview::{ContactSheet, write_png};
use crate::manifest::{self, Manifest, ProbeRecord, ShardRecord};
use crate::{Error, Result};

/// A part of a bake on disk.
struct Part {
    folder: PathBuf,
    path: PathBuf,
    manifest: Manifest,
    shard: ShardRecord,
}

/// Joins the bakes of all parts, each given by its folder or manifest in any order, to one in `output`; returns the path
/// of its manifest.
///
/// Fails with [`Error::Request`] when a part is missing or given twice, [`Error::Invalid`] when one is of another bake
/// (other inputs, settings, version or instruction level), incomplete or damaged, [`Error::Busy`] while another process has the folder, and
/// [`Error::Write`]. Earlier output is then untouched.
pub fn merge(output: &Path, parts: &[PathBuf]) -> Result<PathBuf> {
    let parts = parts.iter().map(|path| Part::read(path)).collect::<Result<Vec<_>>>()?;
    let Some(first) = parts.first() else { return Err(Error::request("PART", "give the folders of the parts")) };
    for part in &parts {
        part.check_same(first)?;
    }
    check_complete(first, &parts)?;
    for part in &parts {
        manifest::check(&part.path)?;
    }
    let workspace = Workspace::begin(output)?;
    let staging = workspace.staging();
    let mut probes: Vec<(usize, ProbeRecord)> = Vec::new();
    for part in &parts {
        let numbers = (0..part.shard.probes.len()).filter(|&number| part.shard.part.holds(number));
        for (number, record) in numbers.zip(&part.manifest.probes) {
            for file in files_of(record) {
                copy(&part.folder.join(&file), &staging.join(&file))?;
            }
            probes.push((number, record.clone()));
        }
    }
    probes.sort_by_key(|(number, _)| *number);
    let probes: Vec<ProbeRecord> = probes.into_iter().map(|(_, record)| record).collect();
    let mut beside = Vec::new();
    if probes.iter().any(|probe| !probe.files.is_empty()) {
        write_png(&staging.join(PREVIEW_FILE), &sheet(&parts)?)?;
        beside.push(PREVIEW_FILE.to_owned());
    }
    for name in Plan::PICTURES.into_iter().filter(|name| first.folder.join(name).is_file()) {
        copy(&first.folder.join(name), &staging.join(name))?;
        beside.push(name.to_owned());
    }
    let placement = first.shard.placement.clone();
    let manifest = Manifest { probes, placement, shard: None, ..first.manifest.clone() };
    publish(&staging, output, &beside, &manifest)
}

impl Part {
    fn read(path: &Path) -> Result<Self> {
        let path = manifest::path_of(path);
        let mut manifest = Manifest::read(&path)?;
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        let fault = |place: &str, what: &str| Err(Error::invalid(&path, place, what));
        let Some(shard) = manifest.shard.take() else {
            return fault("/shard", "not a part of a bake: bake it with --shard I/N");
        };
        if !manifest.unfinished.is_empty() {
            return fault("/unfinished", "the part is not finished: bake it again");
        }
        let ids = shard.probes.iter().enumerate().filter(|(number, _)| shard.part.holds(*number));
        if !ids.map(|(_, id)| id).eq(manifest.probes.iter().map(|probe| &probe.id)) {
            return fault("/probes", "these are not the probes of the part");
        }
        Ok(Self { folder, path, manifest, shard })
    }

    /// Fails unless the part is of the same bake as `first`.
    fn check_same(&self, first: &Self) -> Result<()> {
        let (own, other) = (&self.manifest, &first.manifest);
        let same = [
            ("/generator", own.generator == other.generator),
            ("/inputs", own.inputs == other.inputs),
            ("/settings", own.settings == other.settings),
            ("/colour", own.colour == other.colour),
            ("/frame", own.frame == other.frame),
            ("/shard/probes", self.shard.probes == first.shard.probes),
            ("/shard/placement", self.shard.placement == first.shard.placement),
            ("/shard/part", self.shard.part.count() == first.shard.part.count()),
        ];
        if own.instruction_level != other.instruction_level {
            let what = format!(
                "{}, but {} was baked with {}: their numbers differ in the last digits; bake all parts on machines of one \
                 instruction level",
                own.instruction_level,
                first.path.display(),
                other.instruction_level
            );
            return Err(Error::invalid(&self.path, "/instructionLevel", what));
        }
        match same.into_iter().find(|(_, is_same)| !is_same) {
            None => Ok(()),
            Some((place, _)) => {
                let what = format!("differs from {}: these are not parts of one bake", first.path.display());
                Err(Error::invalid(&self.path, place, what))
            }
        }
    }
}

/// Fails unless every part is there once.
fn check_complete(first: &Part, parts: &[Part]) -> Result<()> {
    let count = first.shard.part.count();
    let of = |index: u32| parts.iter().filter(move |part| part.shard.part.index() == index);
    let missing: Vec<String> =
        (1..=count).filter(|&index| of(index).next().is_none()).map(|index| format!("{index}/{count}")).collect();
    if !missing.is_empty() {
        return Err(Error::request("PART", format!("missing: {}", missing.join(", "))));
    }
    for index in 1..=count {
        let twice: Vec<String> = of(index).map(|part| part.folder.display().to_string()).collect();
        if twice.len() > 1 {
            return Err(Error::request("PART", format!("{index}/{count} is given twice: {}", twice.join(", "))));
        }
    }
    Ok(())
}

/// The contact sheet of all probes, from those of the parts: each has the crosses of its own probes where they belong.
fn sheet(parts: &[Part]) -> Result<RgbaImage> {
    let mut whole: Option<RgbaImage> = None;
    for part in parts {
        let path = part.folder.join(PREVIEW_FILE);
        let read = image::ImageReader::open(&path).map_err(|source| Error::read(&path, source))?;
        let image = read.decode().map_err(|error| Error::invalid(&path, "image", error.to_string()))?.into_rgba8();
        let sheet = whole.get_or_insert_with(|| RgbaImage::new(image.width(), image.height()));
        if !ContactSheet::overlay(sheet, &image) {
            return Err(Error::invalid(&path, "size", "not that of the other parts' sheets"));
        }
    }
    Ok(whole.unwrap_or_default())
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    let folder = to.parent().unwrap_or(to);
    std::fs::create_dir_all(folder).map_err(|source| Error::write(folder, source))?;
    let content = std::fs::read(from).map_err(|source| Error::read(from, source))?;
    std::fs::write(to, content).map_err(|source| Error::write(to, source))
}
