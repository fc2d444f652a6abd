//! The files of a SOG by the names that its `meta.json` gives: in a folder or in a zip archive, and never outside.

use std::collections::BTreeMap;
use std::io::{Cursor, Read};
use std::ops::{Deref, Range};
use std::path::{Component, Path, PathBuf};

use flate2::Crc;
use flate2::bufread::DeflateDecoder;
use memmap2::Mmap;
use zip::{CompressionMethod, ZipArchive};

use super::ZIP_MAGIC;
use crate::error::{Error, Result};
use crate::ingest::file_log::FileLog;

/// Name of the index in an archive.
const INDEX: &str = "meta.json";

/// A compressed entry may inflate to this many times its size and [`INFLATION_FLOOR`] bytes; images do not shrink when
/// they are zipped, and numbers written as text shrink less.
const INFLATION: u64 = 32;
const INFLATION_FLOOR: u64 = 1 << 20;

/// A SOG's files.
pub(super) struct Files {
    /// The archive or the `meta.json`, for messages.
    path: PathBuf,
    bytes: Mmap,
    place: Place,
    log: FileLog,
}

enum Place {
    Folder(PathBuf),
    Archive(BTreeMap<String, Entry>),
}

/// A file in an archive.
struct Entry {
    range: Range<usize>,
    size: u64,
    deflated: bool,
    crc32: u32,
}

/// A file's bytes.
pub(super) enum Content<'a> {
    Mapped(Mmap),
    Slice(&'a [u8]),
    Inflated(Vec<u8>),
}

impl Deref for Content<'_> {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Self::Mapped(bytes) => bytes,
            Self::Slice(bytes) => bytes,
            Self::Inflated(bytes) => bytes,
        }
    }
}

impl Files {
    /// The files of the SOG whose archive or `meta.json`, at `path`, has these `bytes`. Those that are read from beside it
    /// are noted in `log`.
    ///
    /// # Errors
    /// [`Error::Invalid`] when the archive's directory is broken.
    pub fn new(path: &Path, bytes: Mmap, log: FileLog) -> Result<Self> {
        let place = match bytes.starts_with(ZIP_MAGIC) {
            true => Place::Archive(entries(path, &bytes)?),
            false => Place::Folder(path.parent().unwrap_or(Path::new("")).into()),
        };
        Ok(Self { path: path.into(), bytes, place, log })
    }

    /// The archive or the `meta.json`.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The content of `meta.json`.
    ///
    /// # Errors
    /// [`Error::Invalid`] when the archive has none, or it is damaged.
    pub fn index(&self) -> Result<Content<'_>> {
        match &self.place {
            Place::Folder(_) => Ok(Content::Slice(&self.bytes)),
            Place::Archive(_) => self.read(INDEX),
        }
    }

    /// The content of the file that `meta.json` calls `name`.
    ///
    /// # Errors
    /// [`Error::Invalid`] when the name leads out, or no such file can be read.
    pub fn read(&self, name: &str) -> Result<Content<'_>> {
        match &self.place {
            Place::Folder(folder) => {
                let file = inside(&self.path, folder, name)?;
                self.log.add(&file);
                super::super::map(&file).map(Content::Mapped)
            }
            Place::Archive(entries) => {
                let entry = entries.get(name).ok_or_else(|| {
                    let what = match name {
                        INDEX => "the archive has none, so it is no bundled SOG",
                        _ => "meta.json names this file, but the archive has none of this name",
                    };
                    self.invalid(name, what)
                })?;
                self.extract(name, entry)
            }
        }
    }

    fn extract(&self, name: &str, entry: &Entry) -> Result<Content<'_>> {
        let slice = &self.bytes[entry.range.clone()];
        let content = match entry.deflated {
            false => Content::Slice(slice),
            true => {
                let limit = INFLATION_FLOOR + INFLATION * slice.len() as u64;
                if entry.size > limit {
                    let what = format!("{} bytes from {} compressed ones: at most {limit}", entry.size, slice.len());
                    return Err(self.invalid(name, what));
                }
                let mut inflated = Vec::new();
                let read = DeflateDecoder::new(slice).take(entry.size.saturating_add(1)).read_to_end(&mut inflated);
                read.map_err(|error| self.invalid(name, error.to_string()))?;
                Content::Inflated(inflated)
            }
        };
        if content.len() as u64 != entry.size {
            let what = format!("{} bytes; the archive's directory promises {}", content.len(), entry.size);
            return Err(self.invalid(name, what));
        }
        let mut crc = Crc::new();
        crc.update(&content);
        match crc.sum() == entry.crc32 {
            true => Ok(content),
            false => Err(self.invalid(name, "damaged: its CRC-32 is not what the archive's directory says")),
        }
    }

    /// Broken content of the file `name`.
    pub fn invalid(&self, name: &str, what: impl Into<String>) -> Error {
        Error::invalid(&self.path, name, what)
    }
}

/// The file called `name` in `folder`, or below it; `index` is the file that says so.
///
/// # Errors
/// [`Error::Invalid`] when it leads out, also by a link, or is not there.
pub(super) fn inside(index: &Path, folder: &Path, name: &str) -> Result<PathBuf> {
    let fault = |what: String| Error::invalid(index, format!("file name '{name}'"), what);
    let leads_out = || fault("leads out of the folder; it must stay inside".into());
    let is_plain = |part: Component| matches!(part, Component::Normal(_) | Component::CurDir);
    // A backslash separates folders on Windows only; refused everywhere, so that a file loads the same everywhere.
    if name.is_empty() || name.contains(['\\', '\0', ':']) || !Path::new(name).components().all(is_plain) {
        return Err(leads_out());
    }
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let resolve = |path: &Path| path.canonicalize().map_err(|error| fault(format!("cannot be read: {error}")));
    let file = resolve(&folder.join(name))?;
    if file.starts_with(resolve(folder)?) { Ok(file) } else { Err(leads_out()) }
}

/// What an archive's directory lists.
fn entries(path: &Path, bytes: &[u8]) -> Result<BTreeMap<String, Entry>> {
    let broken = |error: zip::result::ZipError| Error::invalid(path, "zip directory", error.to_string());
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(broken)?;
    let mut entries = BTreeMap::new();
    for i in 0..archive.len() {
        let file = archive.by_index_raw(i).map_err(broken)?;
        let name = file.name().to_owned();
        let deflated = match file.compression() {
            _ if file.encrypted() => return Err(Error::unsupported(path, format!("'{name}' is encrypted"))),
            CompressionMethod::Stored => false,
            CompressionMethod::DEFLATE => true,
            other => {
                let what = format!("'{name}' is compressed by {other}; store it or use deflate");
                return Err(Error::unsupported(path, what));
            }
        };
        let end = file.data_start().and_then(|start| start.checked_add(file.compressed_size()));
        let range = file.data_start().zip(end).filter(|&(_, end)| end <= bytes.len() as u64);
        let Some((start, end)) = range else {
            return Err(Error::invalid(path, name, "reaches past the end of the archive"));
        };
        // Within the map, so that both fit.
        let range = start as usize..end as usize;
        entries.insert(name, Entry { range, size: file.size(), deflated, crc32: file.crc32() });
    }
    Ok(entries)
}
