//! .ksplat, the format of mkkellogg's GaussianSplats3D, version 0.1.
//!
//! Facts from its reader and writer. A header of 4096 bytes, then a header of 1024 bytes for each section, then the
//! sections: the lengths of the buckets that are not full (u32 each), the buckets' centres (three f32 each), and the
//! Gaussians, bucket by bucket, full buckets first. Compression level 0 stores everything but colour and opacity as f32;
//! level 1 stores positions as u16 relative to the bucket's centre and the rest as half; level 2 is level 1 with spherical
//! harmonics as bytes between the header's least and greatest. A Gaussian is mean, standard deviations, rotation w x y z,
//! a byte each for red, green, blue (as degree 0 gives them) and opacity, then band 1 and band 2: all of red's values,
//! green's, blue's. Little-endian.

use std::path::Path;
use std::sync::Arc;

use glam::{DAffine3, DQuat, DVec3};
use half::f16;
use memmap2::Mmap;

use super::CHUNK;
use super::sanitize::FileGaussian;
use super::source::{SplatFile, SplatPart, SplatSource};
use crate::error::{Error, Result};
use crate::job::Frame;
use crate::scene::SplatEncoding;
use crate::scene::sh::{C0, coefficient_count};

/// What a .ksplat file begins with: version 0.1 and two bytes that are not used.
pub(super) const MAGIC: &[u8] = b"\x00\x01\x00\x00";

const HEADER_SIZE: usize = 4096;
const SECTION_HEADER_SIZE: usize = 1024;

/// Bounds of spherical harmonics at level 2 where the header has 0.
const DEFAULT_SH_BOUND: f32 = 1.5;

/// Opens a mapped .ksplat file, which declares neither frame nor encoding: its writer keeps those of the PLY it converts.
///
/// # Errors
/// [`Error::Unsupported`] for another version; [`Error::Invalid`] when a header contradicts itself or the file's size.
pub(super) fn open(path: &Path, bytes: Mmap) -> Result<SplatFile> {
    let bytes = Arc::new(bytes);
    let header = Header::parse(path, &bytes)?;
    let mut parts = Vec::with_capacity(header.section_count);
    let mut start = HEADER_SIZE + header.section_count * SECTION_HEADER_SIZE;
    for number in 0..header.section_count {
        let section = Section::parse(path, &bytes, &header, number, start)?;
        start = section.end;
        if section.count > 0 {
            parts.push(SplatPart { file_from_part: DAffine3::IDENTITY, source: Box::new(section) });
        }
    }
    let held: usize = parts.iter().map(|part| part.source.count()).sum();
    if held == 0 || held < header.count {
        let what = format!("{} Gaussians are promised, the sections hold {held}", header.count);
        return Err(Error::invalid(path, "header, byte 16", what));
    }
    Ok(SplatFile {
        format: format!(".ksplat 0.1, compression level {}", header.level),
        frame: Frame::RDF,
        encoding: SplatEncoding::SrgbDisplay,
        order: None,
        parts,
        files: Vec::new(),
    })
}

/// A number that stands `offset` bytes behind the start of `bytes`; 0 where they are too few.
fn u32_at(bytes: &[u8], offset: usize) -> u32 {
    bytes.get(offset..).and_then(<[u8]>::first_chunk).map_or(0, |&value| u32::from_le_bytes(value))
}

fn u16_at(bytes: &[u8], offset: usize) -> u16 {
    bytes.get(offset..).and_then(<[u8]>::first_chunk).map_or(0, |&value| u16::from_le_bytes(value))
}

fn f32_at(bytes: &[u8], offset: usize) -> f32 {
    f32::from_bits(u32_at(bytes, offset))
}

/// What all sections share.
struct Header {
    section_count: usize,
    /// Gaussians in all sections.
    count: usize,
    level: u16,
    /// Least and greatest coefficient at level 2.
    sh_bounds: [f32; 2],
}

impl Header {
    fn parse(path: &Path, bytes: &[u8]) -> Result<Self> {
        if !bytes.starts_with(MAGIC) {
            let version = bytes.get(..2).unwrap_or_default();
            return Err(Error::unsupported(path, format!(".ksplat version {version:?}; version [0, 1] is known")));
        }
        let invalid = |place: &str, what: String| Error::invalid(path, place, what);
        if bytes.len() < HEADER_SIZE {
            return Err(invalid(
                &format!("byte {}", bytes.len()),
                format!("the file ends in its header of {HEADER_SIZE} bytes"),
            ));
        }
        let level = u16_at(bytes, 20);
        if level > 2 {
            return Err(Error::unsupported(
                path,
                format!(".ksplat compression level {level}; levels 0 to 2 are known"),
            ));
        }
        let sections_that_fit = (bytes.len() - HEADER_SIZE) / SECTION_HEADER_SIZE;
        let section_count = usize::try_from(u32_at(bytes, 4)).unwrap_or(usize::MAX);
        if section_count > sections_that_fit {
            let what = format!("{section_count} sections, but the file ends after the headers of {sections_that_fit}");
            return Err(invalid("header, byte 4", what));
        }
        let count = usize::try_from(u32_at(bytes, 16)).unwrap_or(usize::MAX);
        let or_default = |value: f32, default: f32| if value == 0.0 { default } else { value };
        let sh_bounds =
            [or_default(f32_at(bytes, 36), -DEFAULT_SH_BOUND), or_default(f32_at(bytes, 40), DEFAULT_SH_BOUND)];
        Ok(Self { section_count, count, level, sh_bounds })
    }
}

/// A section whose header and size hold what they must.
#[derive(Debug)]
struct Section {
    bytes: Arc<Mmap>,
    level: u16,
    sh_bounds: [f32; 2],
    sh_degree: u8,
    count: usize,
    /// Where the first Gaussian is, in bytes from the start of the file.
    start: usize,
    /// Bytes of a Gaussian.
    size: usize,
    /// Where the section ends.
    end: usize,
    /// From level 1 on.
    buckets: Option<Buckets>,
}

/// What the positions of levels 1 and 2 are relative to.
#[derive(Debug)]
struct Buckets {
    /// Where the first bucket's centre is, in bytes from the start of the file.
    centres: usize,
    full_count: usize,
    /// Gaussians of a full bucket.
    capacity: usize,
    /// The number of the Gaussian that follows each bucket which is not full.
    partial_ends: Vec<usize>,
    /// Metres of one step of a position.
    step: f64,
    /// The position at the bucket's centre.
    middle: f64,
}

impl Section {
    fn parse(path: &Path, bytes: &Arc<Mmap>, file: &Header, number: usize, base: usize) -> Result<Self> {
        let header_start = HEADER_SIZE + number * SECTION_HEADER_SIZE;
        let header = &bytes[header_start..header_start + SECTION_HEADER_SIZE];
        let invalid = |offset: usize, what: String| {
            Error::invalid(path, format!("header of section {number}, byte {}", header_start + offset), what)
        };
        let number_at = |offset| usize::try_from(u32_at(header, offset)).unwrap_or(usize::MAX);
        let [count, room, bucket_capacity, bucket_count] = [0, 4, 8, 12].map(number_at);
        let [full_count, partial_count] = [32, 36].map(number_at);
        if count > room {
            return Err(invalid(0, format!("{count} Gaussians in a section that has room for {room}")));
        }
        let sh_degree = match u16_at(header, 40) {
            degree @ 0..=2 => degree as u8,
            degree => return Err(invalid(40, format!("spherical harmonics of degree {degree}; 0 to 2 are possible"))),
        };
        let sh_count = 3 * (coefficient_count(sh_degree) - 1);
        let size = match file.level {
            0 => 44 + 4 * sh_count,
            1 => 24 + 2 * sh_count,
            _ => 24 + sh_count,
        };
        let bucket_bytes = usize::from(u16_at(header, 20));
        let place = || {
            let centres = base.checked_add(partial_count.checked_mul(4)?)?;
            let start = centres.checked_add(bucket_bytes.checked_mul(bucket_count)?)?;
            let end = start.checked_add(size.checked_mul(room)?)?;
            (end <= bytes.len()).then_some((centres, start, end))
        };
        let Some((centres, start, end)) = place() else {
            let what = format!("{room} Gaussians of {size} bytes and {bucket_count} buckets from byte {base} on");
            return Err(invalid(4, format!("{what} do not fit into the file, which ends at byte {}", bytes.len())));
        };
        let buckets = if file.level == 0 || count == 0 {
            None
        } else {
            if bucket_bytes != 12 || full_count.checked_add(partial_count) != Some(bucket_count) {
                let what = format!("{full_count} full and {partial_count} other buckets, {bucket_bytes} bytes each");
                return Err(invalid(12, format!("{what}: expected {bucket_count} together, 12 bytes each")));
            }
            let full_end = full_count.checked_mul(bucket_capacity);
            let lengths = (0..partial_count).map(|i| u32_at(bytes, base + 4 * i) as usize);
            let ends = lengths.scan(full_end, |end, length| {
                *end = end.and_then(|end| end.checked_add(length));
                Some(*end)
            });
            let partial_ends: Vec<usize> = ends.collect::<Option<_>>().unwrap_or_default();
            let last = partial_ends.last().copied().or(full_end).unwrap_or(0);
            if last < count {
                let what = format!("the buckets hold {last} Gaussians of the section's {count}");
                return Err(invalid(32, what));
            }
            let range = match number_at(24) {
                0 => 32767.0,
                range => range as f64,
            };
            let step = f64::from(f32_at(header, 16)) / 2.0 / range;
            Some(Buckets { centres, full_count, capacity: bucket_capacity, partial_ends, step, middle: range })
        };
        let (bytes, level, sh_bounds) = (Arc::clone(bytes), file.level, file.sh_bounds);
        Ok(Self { bytes, level, sh_bounds, sh_degree, count, start, size, end, buckets })
    }

    /// Mean of Gaussian number `i`, which has the position `steps`.
    fn mean(&self, buckets: &Buckets, i: usize, steps: DVec3) -> DVec3 {
        let in_full = i.checked_div(buckets.capacity).filter(|&bucket| bucket < buckets.full_count);
        let bucket =
            in_full.unwrap_or_else(|| buckets.full_count + buckets.partial_ends.partition_point(|&end| end <= i));
        let start = buckets.centres + 12 * bucket;
        let centre = [0, 4, 8].map(|offset| f64::from(f32_at(&self.bytes, start + offset)));
        (steps - buckets.middle) * buckets.step + DVec3::from(centre)
    }

    /// Gaussian number `i`, whose bytes are `row`.
    fn decode(&self, gaussian: &mut FileGaussian, i: usize, row: &[u8]) {
        let wide = |offset| f64::from(f32_at(row, offset));
        let narrow = |offset| f64::from(f16::from_bits(u16_at(row, offset)));
        let colours = match &self.buckets {
            None => {
                gaussian.mean = DVec3::from([0, 4, 8].map(wide));
                gaussian.standard_deviations = DVec3::from([12, 16, 20].map(wide));
                gaussian.rotation = DQuat::from_array([28, 32, 36, 24].map(wide));
                40
            }
            Some(buckets) => {
                let steps = DVec3::from([0, 2, 4].map(|offset| f64::from(u16_at(row, offset))));
                gaussian.mean = self.mean(buckets, i, steps);
                gaussian.standard_deviations = DVec3::from([6, 8, 10].map(narrow));
                gaussian.rotation = DQuat::from_array([14, 16, 18, 12].map(narrow));
                20
            }
        };
        let per_channel = coefficient_count(self.sh_degree);
        for c in 0..3 {
            gaussian.coefficients[c * per_channel] = ((f64::from(row[colours + c]) / 255.0 - 0.5) / C0) as f32;
        }
        gaussian.opacity = f64::from(row[colours + 3]) / 255.0;
        let sh = &row[colours + 4..];
        let [least, greatest] = self.sh_bounds;
        let value = |i: usize| match self.level {
            0 => f32_at(sh, 4 * i),
            1 => f16::from_bits(u16_at(sh, 2 * i)).to_f32(),
            _ => least + f32::from(sh[i]) / 255.0 * (greatest - least),
        };
        for band in 1..=usize::from(self.sh_degree) {
            // All bands before it, in all channels.
            let (before, width) = (3 * (band * band - 1), 2 * band + 1);
            for (c, k) in (0..3).flat_map(|c| (0..width).map(move |k| (c, k))) {
                gaussian.coefficients[c * per_channel + band * band + k] = value(before + c * width + k);
            }
        }
    }
}

impl SplatSource for Section {
    fn count(&self) -> usize {
        self.count
    }

    fn sh_degree(&self) -> u8 {
        self.sh_degree
    }

    fn for_each_in_chunk(&self, chunk: usize, sink: &mut dyn FnMut(&mut FileGaussian)) -> Result<()> {
        let mut gaussian = FileGaussian::default();
        let rows = self.bytes[self.start..self.end].chunks_exact(self.size).enumerate();
        for (i, row) in rows.take(self.count).skip(chunk * CHUNK).take(CHUNK) {
            self.decode(&mut gaussian, i, row);
            sink(&mut gaussian);
        }
        Ok(())
    }
}
