//! A bake's files: made in a folder of their own, moved to their final place when all of them are done.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use bytemuck::cast_slice;
use glam::Vec3;

use super::files::ProbeFiles;
use super::workspace::Workspace;
use crate::bake::{Cubemap, ProbeStatistics};
use crate::cache::Bundle;
use crate::encode::file::write_bytes_atomically;
use crate::encode::preview::{self, ContactSheet, write_png};
use crate::encode::tonemap;
use crate::job::{Job, Tonemapper};
use crate::manifest::{self, FileRecord, Influence, Manifest, ProbeRecord, ShRecord};
use crate::place::Probe;
use crate::scene::Bounds;
use crate::{Error, Result};

/// Name of a probe's picture in its folder, and of the contact sheet of all probes in the output folder.
pub const PREVIEW_FILE: &str = "preview.png";

/// A bake's files on their way to the output folder.
pub(super) struct Output<'a> {
    job: &'a Job,
    folder: PathBuf,
    /// Inside `folder`, so that moving out of it is a rename.
    staging: PathBuf,
    /// By number.
    probes: Mutex<Vec<Option<Written>>>,
    /// Files in the output folder itself, beside the manifest.
    beside: Vec<String>,
}

/// A probe whose files are written.
#[derive(Clone)]
struct Written {
    record: ProbeRecord,
    /// For the contact sheet.
    thumbnail: Cubemap,
    clamped_values: usize,
}

/// What was moved to its final place.
pub(super) struct Published {
    /// The manifest's path.
    pub manifest: PathBuf,
    /// Channel values that half floats could not hold.
    pub clamped_values: usize,
}

impl<'a> Output<'a> {
    /// Room for `probes` probes.
    pub fn begin(job: &'a Job, workspace: &Workspace, probes: usize) -> Self {
        let (folder, staging) = (workspace.output().to_owned(), workspace.staging());
        Self { job, folder, staging, probes: Mutex::new(vec![None; probes]), beside: Vec::new() }
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
        let folder = self.folder_of(&probe.id)?;
        let mut files = ProbeFiles::new(self.job, &folder, probe);
        let sh = files.write(&mut cubemap)?;
        if self.has_images() {
            write_png(&folder.join(PREVIEW_FILE), &preview::cross(&cubemap))?;
        }
        let ProbeFiles { records, clamped_values, .. } = files;
        let record = probe_record(probe, records, sh, statistics);
        self.probes()[index] = Some(Written { record, thumbnail: preview::thumbnail(&cubemap), clamped_values });
        Ok(())
    }

    /// Writes the `envmap` of a probe whose other files are written. Called on many threads at once.
    pub fn write_envmap(&self, index: usize, probe: &Probe, cubemap: Cubemap) -> Result<()> {
        let folder = self.staging.join(&probe.id);
        let mut files = ProbeFiles::new(self.job, &folder, probe);
        files.write_envmap(&self.exposed(cubemap))?;
        let ProbeFiles { records, clamped_values, .. } = files;
        if let Some(written) = &mut self.probes()[index] {
            written.record.files.extend_from_slice(&records);
            written.clamped_values += clamped_values;
        }
        Ok(())
    }

    /// Writes a file beside the manifest.
    pub fn write_beside(&mut self, name: &str, content: &[u8]) -> Result<()> {
        write_bytes_atomically(&self.staging.join(name), |file| file.write_all(content))?;
        self.beside.push(name.into());
        Ok(())
    }

    /// The statistics of a probe that is written.
    pub fn statistics(&self, index: usize) -> Option<ProbeStatistics> {
        self.probes()[index].as_ref().map(|written| written.record.statistics)
    }

    /// A probe's files and all that the manifest and the contact sheet need of it; `None` if it is not written.
    ///
    /// Fails with [`Error::Read`] where a file is not there any more.
    pub fn bundle(&self, index: usize) -> Result<Option<Bundle>> {
        let Some(Written { record, thumbnail, clamped_values }) = self.probes()[index].clone() else { return Ok(None) };
        let mut bundle = Bundle::default();
        bundle.add_json("record", &record);
        bundle.add_json("clampedValues", &clamped_values);
        bundle.add_json("thumbnailSize", &thumbnail.face_size);
        bundle.add("thumbnail", cast_slice(&thumbnail.texels).to_vec());
        for file in files_of(&record) {
            let path = self.staging.join(&file);
            bundle.add(file, std::fs::read(&path).map_err(|source| Error::read(path, source))?);
        }
        Ok(Some(bundle))
    }

    /// Writes a probe from its bundle; false where the bundle is not one of this program. The same light can be found with
    /// other `statistics`, such as what rays do not see.
    pub fn restore(&self, index: usize, bundle: &Bundle, statistics: ProbeStatistics) -> Result<bool> {
        let parts = || {
            let record = ProbeRecord { statistics, ..bundle.get_json("record")? };
            let clamped_values = bundle.get_json("clampedValues")?;
            let face_size: u32 = bundle.get_json("thumbnailSize")?;
            let texels: Vec<[f32; 4]> =
                bundle.get("thumbnail")?.chunks_exact(16).map(bytemuck::pod_read_unaligned).collect();
            let is_whole = texels.len() == 6 * (face_size as usize).pow(2);
            let thumbnail = Cubemap { face_size, texels, distance: None };
            is_whole.then_some(Written { record, thumbnail, clamped_values })
        };
        let Some(written) = parts() else { return Ok(false) };
        let files: Option<Vec<(String, &[u8])>> =
            files_of(&written.record).map(|file| bundle.get(&file).map(|content| (file, content))).collect();
        let Some(files) = files else { return Ok(false) };
        self.folder_of(&written.record.id)?;
        for (file, content) in files {
            let path = self.staging.join(file);
            std::fs::write(&path, content).map_err(|source| Error::write(path, source))?;
        }
        self.probes()[index] = Some(written);
        Ok(true)
    }

    /// The folder of a probe's files; made if it has any.
    fn folder_of(&self, id: &str) -> Result<PathBuf> {
        let folder = self.staging.join(id);
        if self.has_images() {
            std::fs::create_dir_all(&folder).map_err(|source| Error::write(&folder, source))?;
        }
        Ok(folder)
    }

    /// A panic on another thread ends the bake by itself.
    fn probes(&self) -> MutexGuard<'_, Vec<Option<Written>>> {
        self.probes.lock().unwrap_or_else(PoisonError::into_inner)
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
    ///
    /// `manifest` gets the records of the probes that are written, by number.
    pub fn publish(mut self, manifest: impl FnOnce(Vec<Option<ProbeRecord>>) -> Manifest) -> Result<Published> {
        let probes = std::mem::take(&mut *self.probes());
        if self.has_images() {
            // Validation keeps the number of probes far below 2^32.
            let mut sheet = ContactSheet::new(probes.len() as u32, self.job.face_size);
            for (index, written) in probes.iter().enumerate() {
                written.iter().for_each(|written| sheet.draw(index as u32, &written.thumbnail));
            }
            write_png(&self.staging.join(PREVIEW_FILE), sheet.image())?;
            self.beside.push(PREVIEW_FILE.into());
        }
        let clamped_values = probes.iter().flatten().map(|written| written.clamped_values).sum();
        let manifest = manifest(probes.into_iter().map(|written| Some(written?.record)).collect());
        let path = publish(&self.staging, &self.folder, &self.beside, &manifest)?;
        Ok(Published { manifest: path, clamped_values })
    }
}

/// Moves the files of `manifest` and those `beside` it from `staging` to `folder`, and the manifest last, whose path it
/// returns. Files of an earlier bake that the new one does not have are removed, and nothing else.
///
/// Until all is done there is no manifest, so that nobody takes files of two bakes for one, also where this ends halfway.
/// The earlier one waits in the work folder, for this bake or the next to know its files by.
pub(super) fn publish(staging: &Path, folder: &Path, beside: &[String], manifest: &Manifest) -> Result<PathBuf> {
    // Before anything is moved: a full disk shows here.
    manifest.write(&staging.join(manifest::FILE_NAME))?;
    let path = folder.join(manifest::FILE_NAME);
    let earlier = folder.join(manifest::WORK_FOLDER).join("replaced.json");
    if path.is_file() {
        rename(&path, &earlier)?;
    }
    for file in probe_files(manifest).chain(beside.iter().cloned()) {
        rename(&staging.join(&file), &folder.join(&file))?;
    }
    if let Ok(earlier) = Manifest::read(&earlier) {
        remove_outdated(folder, &earlier, manifest);
    }
    rename(&staging.join(manifest::FILE_NAME), &path)?;
    let _ = std::fs::remove_file(earlier);
    Ok(path)
}

/// Removes files of an earlier bake that the new one does not have, and the folders that this leaves empty.
///
/// The new bake is complete whether they are there or not, so that a file which cannot be removed is no error.
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
    manifest.probes.iter().flat_map(files_of)
}

/// Every file in a probe's folder, relative to the manifest.
pub(super) fn files_of(probe: &ProbeRecord) -> impl Iterator<Item = String> + '_ {
    let preview = (!probe.files.is_empty()).then(|| format!("{}/{PREVIEW_FILE}", probe.id));
    probe.files.iter().map(|file| file.path.clone()).chain(preview)
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
