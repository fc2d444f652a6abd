//! Where a stage's layers come from: the folder of its file, and nowhere else. Every layer is checked before it is parsed.

use std::io::{self, Cursor};
use std::ops::Range;
use std::path::{Path, PathBuf};

use openusd::ar::{self, Asset, DefaultResolver, ResolvedPath, Resolver};

use super::crate_check;
use crate::ingest::file_log::FileLog;

/// What a package (USDZ) begins with: it is a zip archive.
pub const PACKAGE_MAGIC: &[u8] = b"PK\x03\x04";

/// Deepest nesting of brackets in a text layer; the parser recurses.
const MAX_NESTING: usize = 256;

/// Resolves assets inside one folder.
#[derive(Clone)]
pub struct FolderResolver {
    /// Canonical.
    folder: PathBuf,
    /// Files that were read or looked for.
    pub log: FileLog,
}

impl FolderResolver {
    /// For the layers in `folder` and below it.
    pub fn new(folder: &Path) -> io::Result<Self> {
        Ok(Self { folder: folder.canonicalize()?, log: FileLog::default() })
    }

    /// The file that holds `asset`, and the entry in it where it is an archive.
    fn file_of(&self, asset: &str) -> io::Result<(PathBuf, Option<String>)> {
        let (file, entry) = match ar::split_package_relative_path_outer(asset) {
            Some((package, entry)) => (package, Some(entry)),
            None => (asset.to_owned(), None),
        };
        self.log.add(Path::new(&file));
        let file = Path::new(&file).canonicalize()?;
        if !file.starts_with(&self.folder) {
            return Err(io::Error::other("it leads out of the stage's folder; it must stay inside"));
        }
        Ok((file, entry))
    }

    /// The bytes of the asset at a resolved path, as they are.
    pub fn read(&self, resolved: &str) -> io::Result<Vec<u8>> {
        let (file, entry) = self.file_of(resolved)?;
        if !file.metadata()?.is_file() {
            return Err(io::Error::other("it is not a file"));
        }
        let mut bytes = std::fs::read(file)?;
        if let Some(entry) = entry {
            let mut package = open_package(&bytes)?;
            let index = package.index_for_name(&entry);
            let index = index.ok_or_else(|| io::Error::other(format!("the package has no '{entry}'")))?;
            let range = stored_entry(&bytes, &mut package, index)?;
            bytes.drain(range.end..);
            bytes.drain(..range.start);
        }
        Ok(bytes)
    }
}

impl Resolver for FolderResolver {
    fn create_identifier(&self, asset_path: &str, anchor: Option<&ResolvedPath>) -> String {
        DefaultResolver::new().create_identifier(asset_path, anchor)
    }

    fn resolve(&self, asset_path: &str) -> Option<ResolvedPath> {
        // Before the other looks into it: an archive's directory is read to resolve an entry.
        self.file_of(asset_path).ok()?;
        DefaultResolver::new().resolve(asset_path)
    }

    fn resolve_for_new_asset(&self, _: &str) -> Option<ResolvedPath> {
        None
    }

    fn open_asset(&self, resolved_path: &ResolvedPath) -> io::Result<Box<dyn Asset>> {
        let bytes = self.read(&resolved_path.to_string_lossy())?;
        check_layer(&bytes)?;
        Ok(Box::new(Cursor::new(bytes)))
    }

    fn identity(&self) -> String {
        DefaultResolver::new().identity()
    }
}

/// Whether the bytes of a layer or package are safe to parse. Other files, images among them, are not looked into.
fn check_layer(bytes: &[u8]) -> io::Result<()> {
    if bytes.starts_with(crate_check::MAGIC) {
        return crate_check::check(bytes).map_err(|(place, what)| io::Error::other(format!("{place}: {what}")));
    }
    if bytes.starts_with(b"#") {
        return check_nesting(bytes);
    }
    if !bytes.starts_with(PACKAGE_MAGIC) {
        return Ok(());
    }
    let mut package = open_package(bytes)?;
    // Entries that overlap would make the work quadratic.
    let mut left = bytes.len();
    for index in 0..package.len() {
        let entry = &bytes[stored_entry(bytes, &mut package, index)?];
        left = left.checked_sub(entry.len()).ok_or_else(|| io::Error::other("entries of the package overlap"))?;
        // Packages inside of packages are not opened.
        if !entry.starts_with(PACKAGE_MAGIC) {
            check_layer(entry)?;
        }
    }
    Ok(())
}

type Package<'a> = zip::ZipArchive<Cursor<&'a [u8]>>;

fn open_package(bytes: &[u8]) -> io::Result<Package<'_>> {
    zip::ZipArchive::new(Cursor::new(bytes)).map_err(io::Error::other)
}

/// Where the content of an entry of the package in `bytes` lies. USDZ stores entries as they are.
fn stored_entry(bytes: &[u8], package: &mut Package, index: usize) -> io::Result<Range<usize>> {
    let entry = package.by_index_raw(index).map_err(io::Error::other)?;
    let name = entry.name();
    if entry.compression() != zip::CompressionMethod::Stored || entry.encrypted() {
        return Err(io::Error::other(format!("'{name}' is compressed or encrypted, which USDZ forbids")));
    }
    let place = entry.data_start().and_then(|start| {
        let start = usize::try_from(start).ok()?;
        Some(start..start.checked_add(usize::try_from(entry.size()).ok()?)?)
    });
    let whole = place.filter(|range| range.end <= bytes.len());
    whole.ok_or_else(|| io::Error::other(format!("'{name}' reaches past the end of the package")))
}

/// Refuses text whose brackets, outside of strings, paths and comments, are nested deeper than any scene's, and paths with
/// stray braces, over which the reader loops without end. Tokens end where the reader's lexer ends them.
fn check_nesting(text: &[u8]) -> io::Result<()> {
    let mut depth = 0usize;
    let mut at = 0;
    while let Some(&byte) = text.get(at) {
        let mut next = at + 1;
        match byte {
            b'(' | b'[' | b'{' => depth += 1,
            b')' | b']' | b'}' => depth = depth.saturating_sub(1),
            b'"' | b'\'' | b'@' => next = string_end(text, at),
            b'#' => next = end_of(text, at, b"\n"),
            b'<' => {
                next = end_of(text, at + 1, b">");
                if !has_whole_variants(&text[at..next]) {
                    return Err(io::Error::other(format!("byte {at}: a path with stray braces")));
                }
            }
            _ => {}
        }
        if depth > MAX_NESTING {
            return Err(io::Error::other(format!("byte {at}: nested deeper than {MAX_NESTING} brackets")));
        }
        at = next;
    }
    Ok(())
}

/// The byte after the string or asset path that begins at `start`, with one mark or three.
fn string_end(text: &[u8], start: usize) -> usize {
    let mark = text[start];
    let triple = [mark; 3];
    if text[start..].starts_with(&triple) {
        let end = end_of(text, start + 3, &triple);
        if text[..end].ends_with(&triple) && end >= start + 6 {
            return end;
        }
    }
    let mut at = start + 1;
    while let Some(&byte) = text.get(at) {
        match byte {
            b'\\' if mark != b'@' => at += 1,
            _ if byte == mark => return at + 1,
            _ => {}
        }
        at += 1;
    }
    text.len()
}

/// The byte after the first `mark` from `start` on, or the end of the text.
fn end_of(text: &[u8], start: usize, mark: &[u8]) -> usize {
    let found = text.get(start..).and_then(|rest| rest.windows(mark.len()).position(|window| window == mark));
    found.map_or(text.len(), |position| start + position + mark.len())
}

/// Whether every brace of a path belongs to a variant, `{set=selection}`.
fn has_whole_variants(path: &[u8]) -> bool {
    let mut inside = false;
    path.iter().all(|byte| match byte {
        b'{' => !std::mem::replace(&mut inside, true),
        b'}' => std::mem::replace(&mut inside, false),
        b'/' => !inside,
        _ => true,
    }) && !inside
}
