//! A bake's files: made in a folder of their own, moved to their final place when all of them are done.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crate::bake::{Cubemap, ProbeStatistics};
use crate::encode::exr::{DISTANCE_CHANNEL, RADIANCE_FILE, write_cubemap};
use crate::encode::preview::{self, ContactSheet, write_png};
use crate::job::{Job, Pixel};
use crate::manifest::{
    self, FileFormat, FileRecord, FileRole, Influence, Layout, Manifest, ProbeRecord, TexelSampling,
};
use crate::place::Probe;
use crate::scene::Bounds;
use crate::{Error, Result};

/// Name of a probe's picture in its folder, and of the contact sheet of all probes in the output folder.
pub const PREVIEW_FILE: &str = "preview.png";

/// A bake's files on their way to the output folder.
pub(super) struct Output {
    folder: PathBuf,
    /// Inside `folder`, so that moving out of it is a rename; removes itself.
    staging: tempfile::TempDir,
    pixel: Pixel,
    written: Mutex<Written>,
}

struct Written {
    records: Vec<Option<ProbeRecord>>,
    preview: ContactSheet,
    clamped_values: usize,
}

/// What was moved to its final place.
pub(super) struct Published {
    /// The manifest's path.
    pub manifest: PathBuf,
    /// Channel values that half floats could not hold.
    pub clamped_values: usize,
}

impl Output {
    /// Makes the job's output folder and room in it for `probes` probes.
    pub fn begin(job: &Job, probes: usize) -> Result<Self> {
        let folder =
            job.output.clone().ok_or_else(|| Error::request("-o", "give the folder to write the probes to"))?;
        let make = || {
            std::fs::create_dir_all(&folder)?;
            tempfile::Builder::new().prefix(".splatprobe-").tempdir_in(&folder)
        };
        let staging = make().map_err(|source| Error::write(&folder, source))?;
        let written = Written {
            records: vec![None; probes],
            // Validation keeps the number of probes far below 2^32.
            preview: ContactSheet::new(probes as u32, job.face_size),
            clamped_values: 0,
        };
        Ok(Self { folder, staging, pixel: job.pixel, written: Mutex::new(written) })
    }

    /// Writes a probe's files and remembers what the manifest will say. Called on many threads at once.
    pub fn write_probe(
        &self,
        index: usize,
        probe: &Probe,
        cubemap: &Cubemap,
        statistics: ProbeStatistics,
    ) -> Result<()> {
        let folder = self.staging.path().join(&probe.id);
        std::fs::create_dir(&folder).map_err(|source| Error::write(&folder, source))?;
        let path = folder.join(RADIANCE_FILE);
        let clamped = write_cubemap(&path, cubemap, self.pixel)?;
        write_png(&folder.join(PREVIEW_FILE), &preview::cross(cubemap))?;
        let record = probe_record(probe, vec![radiance_record(&path, probe, cubemap, self.pixel)?], statistics);
        // A panic on another thread ends the bake by itself.
        if let Ok(mut written) = self.written.lock() {
            written.records[index] = Some(record);
            written.preview.draw(index as u32, cubemap);
            written.clamped_values += clamped;
        }
        Ok(())
    }

    /// Moves everything to its final place, the manifest last.
    pub fn publish(self, manifest: impl FnOnce(Vec<ProbeRecord>) -> Manifest) -> Result<Published> {
        let written = self.written.into_inner().unwrap_or_else(PoisonError::into_inner);
        let staging = self.staging.path();
        write_png(&staging.join(PREVIEW_FILE), written.preview.image())?;
        let manifest = manifest(written.records.into_iter().flatten().collect());
        // Before anything is moved: a full disk shows here.
        manifest.write(&staging.join(manifest::FILE_NAME))?;
        let path = self.folder.join(manifest::FILE_NAME);
        let earlier = Manifest::read(&path).ok();
        for file in probe_files(&manifest).chain([PREVIEW_FILE.into(), manifest::FILE_NAME.into()]) {
            rename(&staging.join(&file), &self.folder.join(&file))?;
        }
        if let Some(earlier) = earlier {
            remove_outdated(&self.folder, &earlier, &manifest);
        }
        Ok(Published { manifest: path, clamped_values: written.clamped_values })
    }
}

/// Removes files of an earlier bake that the new one does not have, and the folders that this leaves empty.
///
/// The new bake is complete without it, so that a file which cannot be removed is no error.
fn remove_outdated(folder: &Path, earlier: &Manifest, manifest: &Manifest) {
    let paths = |manifest: &Manifest| -> BTreeSet<PathBuf> {
        probe_files(manifest).filter_map(|file| manifest::path_in(folder, &file)).collect()
    };
    for path in paths(earlier).difference(&paths(manifest)) {
        let _ = std::fs::remove_file(path);
        let _ = path.parent().filter(|parent| *parent != folder).map(std::fs::remove_dir);
    }
}

/// Every file in the folders of a bake's probes, relative to the manifest.
fn probe_files(manifest: &Manifest) -> impl Iterator<Item = String> + '_ {
    manifest.probes.iter().flat_map(|probe| {
        let listed = probe.files.iter().map(|file| file.path.clone());
        listed.chain([format!("{}/{PREVIEW_FILE}", probe.id)])
    })
}

fn rename(from: &Path, to: &Path) -> Result<()> {
    let rename = || {
        to.parent().map_or(Ok(()), std::fs::create_dir_all)?;
        std::fs::rename(from, to)
    };
    rename().map_err(|source| Error::write(to, source))
}

fn radiance_record(path: &Path, probe: &Probe, cubemap: &Cubemap, pixel: Pixel) -> Result<FileRecord> {
    let (bytes, blake3) = manifest::digest(path)?;
    let distance = cubemap.distance.as_ref().map(|_| DISTANCE_CHANNEL);
    Ok(FileRecord {
        path: format!("{}/{RADIANCE_FILE}", probe.id),
        role: FileRole::Radiance,
        format: FileFormat::Exr,
        layout: Layout::Strip,
        width: cubemap.face_size,
        height: 6 * cubemap.face_size,
        pixel,
        texel_sampling: TexelSampling::Center,
        channels: ["A", "B", "G", "R"].into_iter().chain(distance).map(String::from).collect(),
        bytes,
        blake3,
    })
}

fn probe_record(probe: &Probe, files: Vec<FileRecord>, statistics: ProbeStatistics) -> ProbeRecord {
    let Bounds { min, max } = probe.influence;
    ProbeRecord {
        id: probe.id.clone(),
        position: probe.position.into(),
        influence: Influence { min: min.into(), max: max.into(), blend: probe.blend },
        proxy: probe.proxy,
        priority: 0,
        files,
        statistics,
    }
}
