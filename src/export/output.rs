//! The folder that an export is written to.

use std::io::Write;
use std::path::{Path, PathBuf};

use glam::Vec3;
use serde::Serialize;

use super::Export;
use crate::encode::exr::{Part, write_parts};
use crate::encode::file::write_bytes_atomically;
use crate::filter::RgbCubemap;
use crate::job::Pixel;
use crate::manifest::write_json;
use crate::{Error, Result};

/// Files on their way to an export's folder. Each appears whole or not at all.
pub struct Output {
    folder: PathBuf,
    export: Export,
}

impl Output {
    /// Makes the folder, where there is none.
    pub fn create(folder: &Path) -> Result<Self> {
        std::fs::create_dir_all(folder).map_err(|source| Error::write(folder, source))?;
        Ok(Self { folder: folder.to_owned(), export: Export { files: Vec::new(), notes: Vec::new() } })
    }

    /// Where the file `name`, with forward slashes, is to be written; makes its folder and remembers it.
    pub fn path(&mut self, name: &str) -> Result<PathBuf> {
        let path = self.folder.join(name);
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(|source| Error::write(folder, source))?;
        }
        self.export.files.push(path.clone());
        Ok(path)
    }

    /// Writes bytes or text.
    pub fn file(&mut self, name: &str, content: impl AsRef<[u8]>) -> Result<()> {
        write_bytes_atomically(&self.path(name)?, |writer| writer.write_all(content.as_ref()))
    }

    /// Writes indented JSON.
    pub fn json(&mut self, name: &str, value: &impl Serialize) -> Result<()> {
        write_json(&self.path(name)?, value)
    }

    /// Writes linear RGB, row by row, as EXR.
    pub fn exr(&mut self, name: &str, width: u32, pixels: &[Vec3], pixel: Pixel) -> Result<()> {
        write_parts(&self.path(name)?, vec![Part::rgb(width as usize, pixels, pixel)]).map(drop)
    }

    /// The cubemap with faces of a power of two and at most `largest`, which is one: reduced, with a note, where it is not.
    pub fn power_of_two(&mut self, id: &str, cubemap: RgbCubemap, largest: u32) -> RgbCubemap {
        let size = cubemap.size();
        let fitting = (1 << size.ilog2()).min(largest);
        if fitting == size {
            return cubemap;
        }
        self.note(format!("{id}: faces of {size} pixels reduced to {fitting}, a power of two that the engine takes"));
        cubemap.reduced(fitting)
    }

    /// Tells the user something about this export.
    pub fn note(&mut self, note: String) {
        self.export.notes.push(note);
    }

    /// What was written.
    pub fn finish(self) -> Export {
        self.export
    }
}
