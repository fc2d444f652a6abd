//! A bake's files: made in a folder of their own, moved to their final place when all of them are done.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use glam::Vec3;

use super::files::ProbeFiles;
use crate::bake::{Cubemap, ProbeStatistics};
use crate::encode::file::write_bytes_atomically;
use crate::encode::plan::PlanPicture;
use crate::encode::preview::{self, ContactSheet, write_png};
use crate::encode::tonemap;
use crate::job::{Job, Tonemapper};
use crate::manifest::{self, FileRecord, Influence, Manifest, ProbeRecord, ShRecord};
use crate::place::Probe;
use crate::scene::Bounds;
use crate::{Error, Result};

/// Name of a probe's picture in its folder, and of the contact sheet of all probes in the output folder.
pub const PREVIEW_FILE: &str = "preview.png";

/// Names of the plan's pictures in the output folder.
const PLAN_FILES: [&str; 2] = ["plan.png", "plan.svg"];

/// A bake's files on their way to the output folder.
pub(super) struct Output<'a> {
    job: &'a Job,
    folder: PathBuf,
    /// Inside `folder`, so that moving out of it is a rename; removes itself.
    staging: tempfile::TempDir,
    written: Mutex<Written>,
}

struct Written {
    records: Vec<Option<ProbeRecord>>,
    preview: ContactSheet,
    clamped_values: usize,
    /// Files in the output folder itself, beside the manifest.
    beside: Vec<&'static str>,
}

/// What was moved to its final place.
pub(super) struct Published {
    /// The manifest's path.
    pub manifest: PathBuf,
    /// Channel values that half floats could not hold.
    pub clamped_values: usize,
}

impl<'a> Output<'a> {
    /// Makes the job's output folder and room in it for `probes` probes.
    pub fn begin(job: &'a Job, probes: usize) -> Result<Self> {
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
            beside: Vec::new(),
        };
        Ok(Self { job, folder, staging, written: Mutex::new(written) })
    }

    /// Writes a probe's files and remembers what the manifest will say. Called on many threads at once.
    pub fn write_probe(
        &self,
        index: usize,
        probe: &Probe,
        cubemap: Cubemap,
        statistics: ProbeStatistics,
    ) -> Result<()> {
        let mut cubemap = self.exposed(cubemap);
        let folder = self.staging.path().join(&probe.id);
        if self.has_images() {
            std::fs::create_dir(&folder).map_err(|source| Error::write(&folder, source))?;
        }
        let mut files = ProbeFiles::new(self.job, &folder, probe);
        let sh = files.write(&mut cubemap)?;
        if self.has_images() {
            write_png(&folder.join(PREVIEW_FILE), &preview::cross(&cubemap))?;
        }
        let ProbeFiles { records, clamped_values, .. } = files;
        // A panic on another thread ends the bake by itself.
        if let Ok(mut written) = self.written.lock() {
            written.records[index] = Some(probe_record(probe, records, sh, statistics));
            written.preview.draw(index as u32, &cubemap);
            written.clamped_values += clamped_values;
        }
        Ok(())
    }

    /// Writes the `envmap` of a probe whose other files are written. Called on many threads at once.
    pub fn write_envmap(&self, index: usize, probe: &Probe, cubemap: Cubemap) -> Result<()> {
        let folder = self.staging.path().join(&probe.id);
        let mut files = ProbeFiles::new(self.job, &folder, probe);
        files.write_envmap(&self.exposed(cubemap))?;
        let ProbeFiles { records, clamped_values, .. } = files;
        if let Ok(mut written) = self.written.lock() {
            written.records[index].iter_mut().for_each(|record| record.files.extend_from_slice(&records));
            written.clamped_values += clamped_values;
        }
        Ok(())
    }

    /// Writes the plan of a placement.
    pub fn write_plan(&mut self, picture: &PlanPicture) -> Result<()> {
        let staging = self.staging.path();
        write_png(&staging.join(PLAN_FILES[0]), &picture.image())?;
        write_bytes_atomically(&staging.join(PLAN_FILES[1]), |file| file.write_all(picture.svg().as_bytes()))?;
        self.written.get_mut().unwrap_or_else(PoisonError::into_inner).beside.extend(PLAN_FILES);
        Ok(())
    }

    fn has_images(&self) -> bool {
        !self.job.outputs.is_empty()
    }

    /// Light as it is written: through the inverse of the tone mapper to match, and exposed.
    fn exposed(&self, mut cubemap: Cubemap) -> Cubemap {
        let (tonemapper, factor) = (self.job.match_tonemapper, self.job.exposure.exp2());
        if tonemapper != Tonemapper::None || factor != 1.0 {
            for [rgb @ .., _] in &mut cubemap.texels {
                *rgb = (tonemap::inverse(tonemapper, Vec3::from(*rgb)) * factor).to_array();
            }
        }
        cubemap
    }

    /// Moves everything to its final place, the manifest last.
    pub fn publish(self, manifest: impl FnOnce(Vec<ProbeRecord>) -> Manifest) -> Result<Published> {
        let has_images = self.has_images();
        let mut written = self.written.into_inner().unwrap_or_else(PoisonError::into_inner);
        let staging = self.staging.path();
        if has_images {
            write_png(&staging.join(PREVIEW_FILE), written.preview.image())?;
            written.beside.push(PREVIEW_FILE);
        }
        let manifest = manifest(written.records.into_iter().flatten().collect());
        // Before anything is moved: a full disk shows here.
        manifest.write(&staging.join(manifest::FILE_NAME))?;
        let path = self.folder.join(manifest::FILE_NAME);
        let earlier = Manifest::read(&path).ok();
        let beside = written.beside.iter().copied().chain([manifest::FILE_NAME]).map(String::from);
        for file in probe_files(&manifest).chain(beside) {
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

/// Every file in the folders of a bake's probes, relative to the manifest. Probes without images have none.
fn probe_files(manifest: &Manifest) -> impl Iterator<Item = String> + '_ {
    manifest.probes.iter().filter(|probe| !probe.files.is_empty()).flat_map(|probe| {
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

fn probe_record(probe: &Probe, files: Vec<FileRecord>, sh: ShRecord, statistics: ProbeStatistics) -> ProbeRecord {
    let Bounds { min, max } = probe.influence;
    ProbeRecord {
        id: probe.id.clone(),
        position: probe.position.into(),
        influence: Influence { min: min.into(), max: max.into(), blend: probe.blend },
        proxy: probe.proxy,
        priority: 0,
        files,
        sh,
        statistics,
        estimated_error: None,
    }
}
