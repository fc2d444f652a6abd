//! What SPZ wraps its attributes in: gzip (versions 1 to 3) or one zstd stream for each attribute (version 4).

use std::io::Read;
use std::path::Path;

use flate2::bufread::GzDecoder;
use rayon::prelude::*;
use ruzstd::decoding::FrameDecoder;

use crate::error::{Error, Result};
use crate::ingest::pages::untouched;
use crate::job::Frame;
use crate::scene::sh::{MAX_DEGREE, coefficient_count};

/// What SPZ begins with; in versions 1 to 3 after decompression.
pub(in crate::ingest) const MAGIC: &[u8] = b"NGSP";

/// What gzip data begins with.
pub(in crate::ingest) const GZIP_MAGIC: &[u8] = b"\x1f\x8b";

/// Bytes of the header of versions 1 to 3, and of the fields that version 4 shares with it.
const HEADER_SIZE: usize = 16;

/// Bytes of version 4's header.
const HEADER_SIZE_4: usize = 32;

/// Decompressed bytes for each byte of the file. Captured scenes have 1.5 to 4; a file that claims more than this is made
/// to exhaust memory.
const MAX_RATIO: usize = 64;

/// Files below this size may claim as much as one of it: [`MAX_RATIO`] of these bytes exhaust nothing.
const SMALL_FILE: usize = 16 * 1024;

/// Extension records behind the attributes of versions 1 to 3 are not longer than this.
const MAX_TRAILER: u64 = 64 * 1024;

const FLAG_ANTIALIASED: u8 = 0x01;
const FLAG_EXTENSIONS: u8 = 0x02;
/// Spark's: coarser levels stand among the Gaussians.
const FLAG_LEVELS_OF_DETAIL: u8 = 0x80;

/// The extension record `SPZ_ADOBE_coordinate_system`.
const COORDINATE_SYSTEM: u32 = 0xadbe_0003;

/// The coordinate systems that the record names, from 1 on: what +X, +Y and +Z point at.
const FRAMES: [&str; 16] =
    ["ldb", "rdb", "lub", "rub", "ldf", "rdf", "luf", "ruf", "lfd", "rfd", "lfu", "rfu", "lbd", "rbd", "lbu", "rbu"];

/// What a file says about its attributes.
#[derive(Debug)]
pub(super) struct Header {
    version: u32,
    pub count: usize,
    pub sh_degree: u8,
    pub fractional_bits: u8,
    flags: u8,
}

/// An unwrapped file.
pub(super) struct Container {
    pub header: Header,
    /// Version and variant, as reports name them.
    pub format: String,
    pub frame: Frame,
    /// All attributes one behind the other, in the sizes of [`Header::sizes`].
    pub payload: Vec<u8>,
}

impl Header {
    /// The fields that all versions share, from the first [`HEADER_SIZE`] bytes.
    fn parse(path: &Path, bytes: &[u8; HEADER_SIZE]) -> Result<Self> {
        let invalid = |byte: usize, what: String| Error::invalid(path, format!("header, byte {byte}"), what);
        let &[_, _, _, _, v0, v1, v2, v3, c0, c1, c2, c3, sh_degree, fractional_bits, flags, _] = bytes;
        if !bytes.starts_with(MAGIC) {
            return Err(invalid(0, "gzip data, but not .spz, which would begin with 'NGSP' in it".into()));
        }
        let version = u32::from_le_bytes([v0, v1, v2, v3]);
        if !(1..=4).contains(&version) {
            return Err(Error::unsupported(path, format!(".spz version {version}; versions 1 to 4 are known")));
        }
        let count = u32::from_le_bytes([c0, c1, c2, c3]) as usize;
        if count == 0 {
            return Err(invalid(8, "0 points: there are no Gaussians".into()));
        }
        if sh_degree > MAX_DEGREE {
            return Err(invalid(12, format!("spherical harmonics of degree {sh_degree}; 0 to 4 are possible")));
        }
        if fractional_bits > 30 {
            return Err(invalid(13, format!("{fractional_bits} fractional bits of 24")));
        }
        if flags & FLAG_LEVELS_OF_DETAIL != 0 {
            let what = ".spz with a tree of levels of detail (flag 0x80); write it without levels";
            return Err(Error::unsupported(path, what));
        }
        Ok(Self { version, count, sh_degree, fractional_bits, flags })
    }

    /// Bytes that a Gaussian has of each attribute: position, opacity, colour, scale, rotation, bands from 1 on.
    pub fn sizes(&self) -> [usize; 6] {
        let position = if self.version == 1 { 6 } else { 9 };
        let rotation = if self.version <= 2 { 3 } else { 4 };
        [position, 1, 3, 3, rotation, 3 * (coefficient_count(self.sh_degree) - 1)]
    }

    /// Zeros for all attributes, when a file of `file_size` bytes may hold them.
    fn allocate(&self, path: &Path, file_size: usize) -> Result<Vec<u8>> {
        let size = self.sizes().into_iter().sum::<usize>().saturating_mul(self.count);
        if size / MAX_RATIO > file_size.max(SMALL_FILE) {
            let what = format!("{} points are {size} bytes, over {MAX_RATIO} times the file's {file_size}", self.count);
            return Err(Error::invalid(path, "header, byte 8", what));
        }
        Ok(untouched(size))
    }

    /// The file's frame, given its extension records. Right, up, back unless one tells otherwise.
    fn frame(&self, path: &Path, records: &[u8]) -> Result<Frame> {
        let mut rest = if self.flags & FLAG_EXTENSIONS == 0 { &[] } else { records };
        while let Some((kind, payload, next)) = split_record(rest) {
            rest = next;
            if kind != COORDINATE_SYSTEM {
                continue;
            }
            let code = payload.first_chunk().map_or(u32::MAX, |&code| u32::from_le_bytes(code));
            // 0 stands for a system that its writer did not know.
            let name = if code == 0 { Some(&"rub") } else { FRAMES.get((code as usize).wrapping_sub(1)) };
            return name.and_then(|name| name.parse().ok()).ok_or_else(|| {
                Error::invalid(path, "extension SPZ_ADOBE_coordinate_system", format!("unknown system {code}"))
            });
        }
        if self.version == 4 && !rest.is_empty() {
            let place = format!("byte {}", HEADER_SIZE_4 + records.len() - rest.len());
            return Err(Error::invalid(path, place, "an extension record ends behind the records' end"));
        }
        Ok(Frame::RUB)
    }

    fn format(&self, wrapping: &str) -> String {
        let antialiased = if self.flags & FLAG_ANTIALIASED == 0 { "" } else { ", antialiased" };
        format!("SPZ {}{wrapping}{antialiased}", self.version)
    }
}

/// The first of the extension records in `bytes`: its type, what it holds, and what follows it.
fn split_record(bytes: &[u8]) -> Option<(u32, &[u8], &[u8])> {
    let (&kind, rest) = bytes.split_first_chunk()?;
    let (&length, rest) = rest.split_first_chunk()?;
    let (payload, next) = rest.split_at_checked(u32::from_le_bytes(length) as usize)?;
    Some((u32::from_le_bytes(kind), payload, next))
}

impl Container {
    /// Unwraps a file.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for versions and variants that are not known; [`Error::Invalid`] when a header contradicts
    /// itself or the file's size, or when compressed data is broken.
    pub fn open(path: &Path, bytes: &[u8]) -> Result<Self> {
        if bytes.starts_with(GZIP_MAGIC) {
            return Self::inflate(path, bytes);
        }
        let Some(start) = bytes.first_chunk() else {
            return Err(ends_too_early(path, bytes, "the header"));
        };
        let header = Header::parse(path, start)?;
        if header.version == 4 { Self::decode_streams(path, bytes, header) } else { Self::copy(path, bytes, header) }
    }

    /// Versions 1 to 3 as they are stored.
    fn inflate(path: &Path, bytes: &[u8]) -> Result<Self> {
        let mut decoder = GzDecoder::new(bytes);
        let mut start = [0; HEADER_SIZE];
        let read = decoder.read_exact(&mut start);
        read.map_err(|error| broken_gzip(path, bytes, &decoder, &error))?;
        let header = Header::parse(path, &start)?;
        if header.version == 4 {
            return Err(Error::unsupported(path, ".spz version 4 inside gzip; only versions 1 to 3 are"));
        }
        let mut payload = header.allocate(path, bytes.len())?;
        let read = decoder.read_exact(&mut payload);
        read.map_err(|error| broken_gzip(path, bytes, &decoder, &error))?;
        // To the very end, so that the checksum is compared.
        let mut trailer = Vec::new();
        let read = decoder.by_ref().take(MAX_TRAILER + 1).read_to_end(&mut trailer);
        read.map_err(|error| broken_gzip(path, bytes, &decoder, &error))?;
        if trailer.len() as u64 > MAX_TRAILER {
            let what = format!("more data than the header's {} points need", header.count);
            return Err(Error::invalid(path, "gzip data", what));
        }
        let frame = header.frame(path, &trailer)?;
        Ok(Self { format: header.format(""), header, frame, payload })
    }

    /// Versions 1 to 3 without gzip, as some tools keep them.
    fn copy(path: &Path, bytes: &[u8], header: Header) -> Result<Self> {
        let mut payload = header.allocate(path, bytes.len())?;
        let Some((stored, trailer)) = bytes[HEADER_SIZE..].split_at_checked(payload.len()) else {
            return Err(ends_too_early(path, bytes, &format!("the header's {} points", header.count)));
        };
        payload.copy_from_slice(stored);
        let frame = header.frame(path, trailer)?;
        Ok(Self { format: header.format(", uncompressed"), header, frame, payload })
    }

    /// Version 4: extension records, a table of the streams' sizes, and the streams.
    fn decode_streams(path: &Path, bytes: &[u8], header: Header) -> Result<Self> {
        let Some(start) = bytes.first_chunk::<HEADER_SIZE_4>() else {
            return Err(ends_too_early(path, bytes, "the header"));
        };
        let (stream_count, table) = (usize::from(start[15]), u32_at(start, 16) as usize);
        let sizes = header.sizes().map(|size| size.saturating_mul(header.count));
        // Without bands from 1 on their stream may be left out.
        let stored = if header.sh_degree == 0 && stream_count == 5 { &sizes[..5] } else { &sizes[..] };
        if stream_count != stored.len() {
            let what = format!("{stream_count} streams; degree {} needs {}", header.sh_degree, stored.len());
            return Err(Error::invalid(path, "header, byte 15", what));
        }
        if !(HEADER_SIZE_4..=bytes.len()).contains(&table) {
            let what = format!("the table of streams at byte {table}, behind the header and before {}", bytes.len());
            return Err(Error::invalid(path, "header, byte 16", what));
        }
        let frame = header.frame(path, &bytes[HEADER_SIZE_4..table])?;
        let Some((entries, mut streams)) = bytes[table..].split_at_checked(16 * stream_count) else {
            return Err(ends_too_early(path, bytes, "the table of streams"));
        };

        let mut payload = header.allocate(path, bytes.len())?;
        let mut room = payload.as_mut_slice();
        let mut tasks = Vec::with_capacity(stream_count);
        for (i, (entry, &size)) in entries.as_chunks::<16>().0.iter().zip(stored).enumerate() {
            let place = || format!("table of streams, byte {}", table + 16 * i);
            let [compressed, decompressed] = [0, 8].map(|start| u64_at(entry, start));
            if decompressed != size as u64 {
                let what = format!("stream {i} has {decompressed} bytes, {} points need {size}", header.count);
                return Err(Error::invalid(path, place(), what));
            }
            let split = usize::try_from(compressed).ok().and_then(|size| streams.split_at_checked(size));
            let Some((stream, next)) = split else {
                let what =
                    format!("stream {i} has {compressed} compressed bytes, {} are left in the file", streams.len());
                return Err(Error::invalid(path, place(), what));
            };
            let (target, others) = room.split_at_mut(size);
            tasks.push((bytes.len() - streams.len(), stream, target));
            (streams, room) = (next, others);
        }
        // The last is by far the longest, and must not wait for others; but of errors, the first in the file is told.
        tasks.reverse();
        let decoded = tasks.into_par_iter().with_max_len(1);
        let decoded = decoded.map(|(start, stream, target)| decode_stream(path, start, stream, target));
        decoded.collect::<Vec<Result<()>>>().into_iter().rev().collect::<Result<()>>()?;
        Ok(Self { format: header.format(""), header, frame, payload })
    }
}

/// Fills `target` with what the zstd data `stream`, from byte `start` of the file, decompresses to.
fn decode_stream(path: &Path, start: usize, stream: &[u8], target: &mut [u8]) -> Result<()> {
    /// RFC 8878 asks decoders to bear windows of 8 MiB.
    const MIN_WINDOW: u64 = 8 << 20;
    let invalid = |what: String| Error::invalid(path, format!("zstd stream at byte {start}"), what);
    let size = target.len();
    let mut decoder = FrameDecoder::new();
    decoder.set_max_window_size(MIN_WINDOW.max(size as u64));
    let decoded = decoder.decode_all(stream, target).map_err(|error| invalid(error.to_string()))?;
    if decoded == size { Ok(()) } else { Err(invalid(format!("{decoded} bytes in it, expected {size}"))) }
}

fn broken_gzip(path: &Path, bytes: &[u8], decoder: &GzDecoder<&[u8]>, error: &std::io::Error) -> Error {
    let consumed = bytes.len() - decoder.get_ref().len();
    let what = match error.kind() {
        std::io::ErrorKind::UnexpectedEof => "the gzip data ends before the points that its header promises".into(),
        _ => format!("broken gzip data: {error}"),
    };
    Error::invalid(path, format!("byte {consumed}"), what)
}

fn ends_too_early(path: &Path, bytes: &[u8], expected: &str) -> Error {
    Error::invalid(path, format!("byte {}", bytes.len()), format!("the file ends before the end of {expected}"))
}

fn u32_at(bytes: &[u8], offset: usize) -> u32 {
    bytes.get(offset..).and_then(<[u8]>::first_chunk).map_or(0, |&value| u32::from_le_bytes(value))
}

fn u64_at(bytes: &[u8], offset: usize) -> u64 {
    bytes.get(offset..).and_then(<[u8]>::first_chunk).map_or(0, |&value| u64::from_le_bytes(value))
}
