//! Bytes beside the JSON: buffers, buffer views and URIs. Nothing outside the asset's folder is ever opened.

use std::collections::BTreeMap;
use std::fmt;
use std::io::Read;
use std::ops::{Deref, Range};
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use base64::Engine;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use gltf::json::{Index, buffer};

use super::compressed::placeholders;
use super::container::{Asset, place};
use crate::Result;

/// Bytes that several owners share: of the mapped file itself, or read from beside it.
#[derive(Clone)]
pub struct Bytes {
    whole: Arc<dyn AsRef<[u8]> + Send + Sync>,
    range: Range<usize>,
}

impl Bytes {
    /// The bytes of `whole` in `range`, which must lie inside.
    pub fn new(whole: Arc<dyn AsRef<[u8]> + Send + Sync>, range: Range<usize>) -> Self {
        Self { whole, range }
    }

    /// Those of them in `range`, if it lies inside.
    pub fn part(&self, range: Range<usize>) -> Option<Self> {
        self.get(range.clone())?;
        let start = self.range.start;
        Some(Self { whole: self.whole.clone(), range: start + range.start..start + range.end })
    }
}

impl From<Vec<u8>> for Bytes {
    fn from(bytes: Vec<u8>) -> Self {
        let range = 0..bytes.len();
        Self::new(Arc::new(bytes), range)
    }
}

impl Deref for Bytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &(*self.whole).as_ref()[self.range.clone()]
    }
}

impl fmt::Debug for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} bytes", self.range.len())
    }
}

/// Content of every buffer, cut to its byteLength. A buffer without a URI is the GLB's binary chunk.
pub fn read_buffers(asset: &Asset, glb_chunk: Option<Bytes>) -> Result<Vec<Bytes>> {
    // A file may name one URI many times; it is held once.
    let mut by_uri: BTreeMap<&str, Bytes> = BTreeMap::new();
    let mut buffers = Vec::with_capacity(asset.root.buffers.len());
    let placeholders = placeholders(&asset.root);
    for (i, buffer) in asset.root.buffers.iter().enumerate() {
        if placeholders[i] {
            buffers.push(Vec::new().into());
            continue;
        }
        let here = place("buffers", i, buffer.name.as_deref());
        let bytes = match (buffer.uri.as_deref(), &glb_chunk) {
            (Some(uri), _) => match by_uri.get(uri) {
                Some(bytes) => bytes.clone(),
                None => {
                    let bytes: Bytes = read_uri(asset, uri, &here)?.into();
                    by_uri.entry(uri).or_insert(bytes).clone()
                }
            },
            (None, Some(chunk)) if i == 0 => chunk.clone(),
            (None, _) => return Err(asset.invalid(here, "it has neither a uri nor a GLB binary chunk")),
        };
        let length = usize::try_from(buffer.byte_length.0).ok().and_then(|length| bytes.part(0..length));
        buffers.push(length.ok_or_else(|| {
            let what = format!("byteLength is {}, but there are only {} bytes", buffer.byte_length.0, bytes.len());
            asset.invalid(here, what)
        })?);
    }
    Ok(buffers)
}

/// The bytes of a buffer view.
pub fn view_bytes(asset: &Asset, view: Index<buffer::View>, here: &str) -> Result<Bytes> {
    let index = view.value();
    let view = asset.get(view, here)?;
    let there = place("bufferViews", index, view.name.as_deref());
    asset.get(view.buffer, &there)?;
    let bytes = &asset.buffers[view.buffer.value()];
    let start = view.byte_offset.map_or(0, |offset| offset.0);
    let range = usize::try_from(start).ok().zip(usize::try_from(start.saturating_add(view.byte_length.0)).ok());
    range.and_then(|(start, end)| bytes.part(start..end)).ok_or_else(|| {
        let what = format!(
            "{} bytes from byte {start} reach past the end of buffer {}, which has {}",
            view.byte_length.0,
            view.buffer.value(),
            bytes.len()
        );
        asset.invalid(there, what)
    })
}

/// The bytes that a URI means: a data URI, or a file in the asset's folder or below it.
pub fn read_uri(asset: &Asset, uri: &str, here: &str) -> Result<Vec<u8>> {
    if let Some(data) = uri.strip_prefix("data:") {
        return decode_data_uri(data).map_err(|why| asset.invalid(here, format!("its data URI is broken: {why}")));
    }
    let relative = relative_path(uri).map_err(|why| asset.invalid(here, format!("uri '{uri}' {why}")))?;
    let cannot = |e: std::io::Error| asset.invalid(here, format!("uri '{uri}' cannot be read: {e}"));
    let folder = asset.folder.canonicalize().map_err(cannot)?;
    let file = folder.join(relative);
    asset.log.add(&file);
    let file = file.canonicalize().map_err(cannot)?;
    if !file.starts_with(&folder) {
        return Err(asset.invalid(here, format!("uri '{uri}' leads out of the asset's folder; it must stay inside")));
    }
    let mut bytes = Vec::new();
    let mut reader = std::fs::File::open(&file).map_err(cannot)?;
    if !reader.metadata().map_err(cannot)?.is_file() {
        return Err(asset.invalid(here, format!("uri '{uri}' is not a file")));
    }
    reader.read_to_end(&mut bytes).map_err(cannot)?;
    Ok(bytes)
}

/// The path that a relative URI means, if it has no way up or out.
fn relative_path(uri: &str) -> std::result::Result<PathBuf, &'static str> {
    let scheme = uri.split(['/', '?', '#']).next().unwrap_or("");
    if scheme.contains(':') {
        return Err("has a scheme; only relative and data URIs are read");
    }
    let decoded = String::from_utf8(percent_decode(uri)).map_err(|_| "is not UTF-8")?;
    let inside = |path: &Path| path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    // A backslash separates folders on Windows only; refused everywhere, so that a file loads the same everywhere.
    if decoded.is_empty() || decoded.contains(['\\', '\0']) || !inside(Path::new(&decoded)) {
        return Err("leads out of the asset's folder; it must stay inside");
    }
    Ok(PathBuf::from(decoded))
}

/// Replaces %XX by the byte it means; a percent sign without two hex digits stands for itself.
fn percent_decode(text: &str) -> Vec<u8> {
    let bytes = text.as_bytes();
    let digit = |at: usize| bytes.get(at).and_then(|&b| char::from(b).to_digit(16));
    let mut decoded = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        match (bytes[at], digit(at + 1), digit(at + 2)) {
            (b'%', Some(high), Some(low)) => {
                decoded.push((high * 16 + low) as u8);
                at += 3;
            }
            (byte, ..) => {
                decoded.push(byte);
                at += 1;
            }
        }
    }
    decoded
}

/// The bytes of a data URI, given what follows `data:` (RFC 2397).
fn decode_data_uri(data: &str) -> std::result::Result<Vec<u8>, String> {
    let (media_type, data) = data.split_once(',').ok_or("it has no comma")?;
    if !media_type.ends_with(";base64") {
        return Ok(percent_decode(data));
    }
    let config = GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent);
    GeneralPurpose::new(&base64::alphabet::STANDARD, config).decode(data).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relative_uris_are_percent_decoded() {
        assert_eq!(relative_path("a%20b/./%C3%A9.bin").unwrap(), PathBuf::from("a b/./é.bin"));
        assert_eq!(relative_path("100%.png").unwrap(), PathBuf::from("100%.png"));
    }

    #[test]
    fn uris_that_leave_the_folder_or_have_a_scheme_are_refused() {
        for uri in
            ["../a", "a/../../b", "/etc/passwd", "%2e%2e/a", "%2Fetc", "file:///a", "http://a/b", "C:\\a", "..\\a"]
        {
            assert!(relative_path(uri).is_err(), "{uri}");
        }
    }

    #[test]
    fn data_uris_decode_with_and_without_padding_and_base64() {
        assert_eq!(decode_data_uri("application/octet-stream;base64,AAEC/w==").unwrap(), [0, 1, 2, 255]);
        assert_eq!(decode_data_uri(";base64,AAEC/w").unwrap(), [0, 1, 2, 255]);
        assert_eq!(decode_data_uri("text/plain,a%00b").unwrap(), *b"a\0b");
        assert!(decode_data_uri("application/octet-stream;base64").is_err());
        assert!(decode_data_uri(";base64,*").is_err());
    }
}
