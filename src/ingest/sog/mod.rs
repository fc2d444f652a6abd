//! SOG, PlayCanvas's compressed splats: versions 1 and 2, bundled and loose, and the streamed form with levels of detail.
//!
//! A SOG is a `meta.json` and lossless WebP images beside it, or a zip archive (`.sog`) of the same files. The same pixel
//! of every image but the palette belongs to the same Gaussian, row by row from the top. Facts are from the format's
//! specification (developer.playcanvas.com, "The SOG Format", "The Streamed SOG Format") and, for version 1, which has
//! none, from what splat-transform and the PlayCanvas engine read.
//!
//! The specification names the axes right, up, back. Writers put the coordinates of the PLY they are given into the file
//! unchanged, though, and viewers show both alike: a SOG stands as its PLY does.

mod files;
mod image;
mod meta;
mod source;
mod streamed;

use std::path::{Path, PathBuf};

use memmap2::Mmap;

use self::files::Files;
use self::meta::Meta;
use self::source::{Sog, SogRange};
use super::file_log::FileLog;
use super::source::{SplatFile, SplatPart};
use crate::error::Result;
use crate::job::Frame;
use crate::scene::SplatEncoding;

pub(super) use streamed::open as open_streamed;

/// What the axes of files point at, unless a request says otherwise.
const FRAME: Frame = Frame::RDF;

/// What a zip archive begins with.
const ZIP_MAGIC: &[u8] = b"PK\x03\x04";

/// Whether `bytes` are a bundled SOG (or another zip archive), or the `meta.json` of a loose one.
pub(super) fn is_sog(bytes: &[u8]) -> bool {
    bytes.starts_with(ZIP_MAGIC) || is_json_with(bytes, ["\"means\"", "\"quats\""])
}

/// Whether `bytes` are the `lod-meta.json` of a streamed SOG.
pub(super) fn is_streamed(bytes: &[u8]) -> bool {
    is_json_with(bytes, ["\"lodLevels\"", "\"filenames\""])
}

/// Whether JSON mentions all `keys` early on. What they mean is read later: a file that is cut off or broken behind them
/// is still known by them.
fn is_json_with(bytes: &[u8], keys: [&str; 2]) -> bool {
    /// Before both keys stand at most a codebook or the names of a few hundred files.
    const SEARCHED: usize = 1 << 16;
    let head = &bytes[..bytes.len().min(SEARCHED)];
    let mentions = |key: &str| head.windows(key.len()).any(|window| window == key.as_bytes());
    head.starts_with(b"{") && keys.into_iter().all(mentions)
}

/// Names of the files that describe a SOG, that of a streamed one first.
pub const INDEX_NAMES: [&str; 2] = ["lod-meta.json", "meta.json"];

/// The file that a splat input's `path` stands for: the index of a SOG's folder, or else `path` itself.
pub fn index_file(path: &Path) -> PathBuf {
    let indices = INDEX_NAMES.map(|name| path.join(name));
    indices.into_iter().find(|index| index.is_file()).unwrap_or_else(|| path.into())
}

/// Opens a SOG, bundled or loose, and decodes its images.
///
/// # Errors
/// [`Error::Invalid`](crate::Error::Invalid) when its files are broken or do not hold what `meta.json` promises;
/// [`Error::Unsupported`](crate::Error::Unsupported) for other versions, and images other than WebP.
pub(super) fn open(path: &Path, bytes: Mmap) -> Result<SplatFile> {
    let log = FileLog::default();
    let files = Files::new(path, bytes, log.clone())?;
    let sog = Sog::read(&files, Meta::parse(path, &files.index()?)?)?;
    Ok(splat_file(format!("SOG version {}", sog.version()), SplatPart::whole(SogRange::all(sog)), &log))
}

/// The format declares neither frame nor encoding.
fn splat_file(format: String, parts: Vec<SplatPart>, log: &FileLog) -> SplatFile {
    SplatFile { format, frame: FRAME, encoding: SplatEncoding::SrgbDisplay, order: None, parts, files: log.files() }
}
