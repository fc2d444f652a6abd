//! PLY as 3DGS trainers and editors write it (INRIA, Splatfacto, Brush, splat-transform).
//!
//! One row of `element vertex` is a Gaussian: `x y z`; `f_dc_0..2` and `f_rest_*`, spherical harmonics with all of red's
//! bands from 1 before all of green's before all of blue's; `opacity` as a logit; `scale_0..2` as natural logarithms of
//! standard deviations; `rot_0..3` as a quaternion w x y z of any length. Columns stand in any order and have any scalar
//! type; other columns (normals among them) are ignored.

mod compressed;
mod header;

use std::ops::Range;
use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3};
use memmap2::Mmap;

use self::compressed::CompressedPly;
use self::header::{Element, Encoding, Header, Kind, Scalar};
use super::CHUNK;
use super::sanitize::FileGaussian;
use super::source::{SplatFile, SplatPart, SplatSource};
use crate::error::{Error, Result};
use crate::job::Frame;
use crate::scene::SplatEncoding;
use crate::scene::sh::{MAX_DEGREE, coefficient_count};

/// What a PLY file begins with.
pub(super) const MAGIC: &[u8] = b"ply";

/// Opens a mapped PLY file, compressed or not. The format declares neither frame nor encoding: trainers write
/// right-down-forward and learn their colours from photographs. Errors as in [`Ply::new`] and [`CompressedPly::new`].
pub(super) fn open(path: &Path, bytes: Mmap) -> Result<SplatFile> {
    let header = Header::parse(path, &bytes)?;
    let (format, parts) = if CompressedPly::is_described_by(&header) {
        ("PLY compressed".to_string(), SplatPart::whole(CompressedPly::new(path, bytes, &header)?))
    } else {
        (format!("PLY {}", header.encoding.name()), SplatPart::whole(Ply::new(path, bytes, &header)?))
    };
    Ok(SplatFile {
        format,
        frame: Frame::RDF,
        encoding: SplatEncoding::SrgbDisplay,
        order: None,
        parts,
        files: Vec::new(),
    })
}

/// An opened PLY file whose header and size hold what a splat file must.
#[derive(Debug)]
struct Ply {
    path: PathBuf,
    bytes: Mmap,
    encoding: Encoding,
    count: usize,
    types: Vec<Scalar>,
    columns: Columns,
    rows: Rows,
}

/// Which column holds what.
#[derive(Debug)]
struct Columns {
    mean: [usize; 3],
    rotation_wxyz: [usize; 4],
    log_scale: [usize; 3],
    logit: usize,
    sh_degree: u8,
    /// In the order of [`FileGaussian::coefficients`].
    coefficients: Vec<usize>,
}

/// Where the rows of the vertices are, in bytes from the start of the file.
#[derive(Debug)]
enum Rows {
    /// Binary rows of one size, which the columns divide at `offsets`.
    Binary { start: usize, size: usize, offsets: Vec<usize> },
    /// Where each chunk of [`CHUNK`] rows begins in a text file.
    Ascii { chunk_starts: Vec<usize> },
}

impl Ply {
    /// Checks that all vertices that the header promises are there.
    ///
    /// # Errors
    /// [`Error::Invalid`] when the vertices are not Gaussians or the file is too short; [`Error::Unsupported`] for
    /// vertices with lists.
    fn new(path: &Path, bytes: Mmap, header: &Header) -> Result<Self> {
        let place = |element: &&Element| element.name == "vertex";
        let Some(vertex) = header.elements.iter().find(place) else {
            return Err(Error::invalid(path, "header", "no 'element vertex', so there are no Gaussians"));
        };
        let columns = Columns::find(path, vertex)?;
        if vertex.count == 0 {
            return Err(Error::invalid(path, "header", "element vertex has 0 rows: there are no Gaussians"));
        }
        let mut types = Vec::with_capacity(vertex.properties.len());
        for property in &vertex.properties {
            match property.kind {
                Kind::Scalar(scalar) => types.push(scalar),
                Kind::List(..) => {
                    let what =
                        format!("list property '{}' of element vertex; write the file without it", property.name);
                    return Err(Error::unsupported(path, what));
                }
            }
        }
        let before = header.elements.iter().take_while(|element| element.name != "vertex");
        let too_short = |element: &Element| too_short(path, &bytes, element);
        let mut cursor = Cursor { bytes: &bytes, offset: header.data_offset, encoding: header.encoding };
        for element in before {
            cursor.skip_element(element).ok_or_else(|| too_short(element))?;
        }
        let count = usize::try_from(vertex.count).map_err(|_| too_short(vertex))?;
        let rows = cursor.find_rows(count, &types).ok_or_else(|| too_short(vertex))?;
        Ok(Self { path: path.into(), encoding: header.encoding, count, types, columns, rows, bytes })
    }
}

impl SplatSource for Ply {
    fn count(&self) -> usize {
        self.count
    }

    fn sh_degree(&self) -> u8 {
        self.columns.sh_degree
    }

    fn for_each_in_chunk(&self, chunk: usize, sink: &mut dyn FnMut(&mut FileGaussian)) -> Result<()> {
        let Range { start: first, end } = chunk * CHUNK..((chunk + 1) * CHUNK).min(self.count);
        let mut gaussian = FileGaussian::default();
        match &self.rows {
            Rows::Binary { start, size, offsets } => {
                let chunk = start + first * size..start + end * size;
                let rows = self.bytes[chunk.clone()].chunks_exact(*size);
                // The common case apart, so that the compiler sees a plain load for each value.
                if self.encoding == Encoding::LittleEndian && self.types.iter().all(|&scalar| scalar == Scalar::F32) {
                    for row in rows {
                        let (values, _) = row.as_chunks::<4>();
                        self.columns.decode(&mut gaussian, |column| f32::from_le_bytes(values[column]).into());
                        sink(&mut gaussian);
                    }
                } else {
                    let big_endian = self.encoding == Encoding::BigEndian;
                    for row in rows {
                        let value = |column: usize| self.types[column].read(&row[offsets[column]..], big_endian);
                        self.columns.decode(&mut gaussian, value);
                        sink(&mut gaussian);
                    }
                }
                super::release(&self.bytes, chunk);
            }
            Rows::Ascii { chunk_starts } => {
                let mut values = vec![0.0; self.types.len()];
                let mut words = Words { bytes: &self.bytes, offset: chunk_starts[chunk] };
                for row in first..end {
                    for (value, &scalar) in values.iter_mut().zip(&self.types) {
                        let word = words.next().unwrap_or_default();
                        *value = parse_number(word, scalar).ok_or_else(|| {
                            let shown = String::from_utf8_lossy(&word[..word.len().min(32)]);
                            let place = format!("vertex {row}, before byte {}", words.offset);
                            Error::invalid(&self.path, place, format!("'{shown}' is not a number"))
                        })?;
                    }
                    self.columns.decode(&mut gaussian, |column| values[column]);
                    sink(&mut gaussian);
                }
            }
        }
        Ok(())
    }
}

impl Columns {
    fn find(path: &Path, vertex: &Element) -> Result<Self> {
        let find = |name: &str| vertex.properties.iter().position(|property| property.name == name);
        let mut missing = Vec::new();
        let mut column = |name: String| {
            find(&name).unwrap_or_else(|| {
                missing.push(name);
                0
            })
        };
        let mean = ["x", "y", "z"].map(|name| column(name.into()));
        let dc = [0, 1, 2].map(|i| column(format!("f_dc_{i}")));
        let logit = column("opacity".into());
        let log_scale = [0, 1, 2].map(|i| column(format!("scale_{i}")));
        let rotation_wxyz = [0, 1, 2, 3].map(|i| column(format!("rot_{i}")));
        let rest_count = vertex.properties.iter().filter(|property| property.name.starts_with("f_rest_")).count();
        let Some(sh_degree) = (0..=MAX_DEGREE).find(|&degree| 3 * (coefficient_count(degree) - 1) == rest_count) else {
            let what = format!("{rest_count} properties f_rest_*; degree 0 to 4 has 0, 9, 24, 45 or 72");
            return Err(Error::invalid(path, "header", what));
        };
        let rest: Vec<usize> = (0..rest_count).map(|i| column(format!("f_rest_{i}"))).collect();
        if !missing.is_empty() {
            let what = format!(
                "not Gaussian splats: element vertex lacks {}. A point cloud or mesh cannot stand in for splats; \
                 give the file that 3DGS training wrote",
                missing.join(", ")
            );
            return Err(Error::invalid(path, "header", what));
        }
        let per_channel = rest_count / 3;
        let coefficients = (0..3)
            .flat_map(|c| std::iter::once(dc[c]).chain(rest[c * per_channel..(c + 1) * per_channel].iter().copied()))
            .collect();
        Ok(Self { mean, rotation_wxyz, log_scale, logit, sh_degree, coefficients })
    }

    /// One row, given what stands in each column.
    #[inline(always)]
    fn decode(&self, gaussian: &mut FileGaussian, value: impl Fn(usize) -> f64) {
        let [w, x, y, z] = self.rotation_wxyz.map(&value);
        gaussian.mean = DVec3::from(self.mean.map(&value));
        gaussian.rotation = DQuat::from_xyzw(x, y, z, w);
        gaussian.standard_deviations = DVec3::from(self.log_scale.map(|column| value(column).exp()));
        // Editors store fully opaque as an infinite logit, which this takes to 1.
        gaussian.opacity = 1.0 / (1.0 + (-value(self.logit)).exp());
        for (coefficient, &column) in gaussian.coefficients.iter_mut().zip(&self.coefficients) {
            *coefficient = value(column) as f32;
        }
    }
}

fn too_short(path: &Path, bytes: &[u8], element: &Element) -> Error {
    let what = format!("the file ends before the {} rows of element {}", element.count, element.name);
    Error::invalid(path, format!("byte {}", bytes.len()), what)
}

/// A position in the data behind the header. Every step checks the file's end and returns `None` past it.
struct Cursor<'a> {
    bytes: &'a [u8],
    offset: usize,
    encoding: Encoding,
}

impl Cursor<'_> {
    fn skip(&mut self, byte_count: usize) -> Option<()> {
        self.offset = self.offset.checked_add(byte_count).filter(|&end| end <= self.bytes.len())?;
        Some(())
    }

    /// Reads one number.
    fn number(&mut self, scalar: Scalar) -> Option<f64> {
        if self.encoding == Encoding::Ascii {
            let mut words = Words { bytes: self.bytes, offset: self.offset };
            let number = parse_number(words.next()?, scalar);
            self.offset = words.offset;
            return number;
        }
        let start = self.offset;
        self.skip(scalar.size())?;
        Some(scalar.read(&self.bytes[start..], self.encoding == Encoding::BigEndian))
    }

    /// Skips all rows of `element`. The work is bounded by the file's size: a row of numbers takes bytes, and rows
    /// without any are not walked.
    fn skip_element(&mut self, element: &Element) -> Option<()> {
        if element.properties.is_empty() {
            return Some(());
        }
        if let (Some(size), true) = (element.row_size(), self.encoding != Encoding::Ascii) {
            return self.skip(size.checked_mul(usize::try_from(element.count).ok()?)?);
        }
        for _ in 0..element.count {
            for property in &element.properties {
                match property.kind {
                    Kind::Scalar(scalar) => {
                        self.number(scalar)?;
                    }
                    Kind::List(count, item) => {
                        let count = self.number(count).filter(|&count| count >= 0.0)? as u64;
                        if self.encoding == Encoding::Ascii {
                            for _ in 0..count {
                                self.number(item)?;
                            }
                        } else {
                            self.skip(item.size().checked_mul(usize::try_from(count).ok()?)?)?;
                        }
                    }
                }
            }
        }
        Some(())
    }

    /// The `count` rows that begin here.
    fn find_rows(mut self, count: usize, types: &[Scalar]) -> Option<Rows> {
        if self.encoding != Encoding::Ascii {
            let start = self.offset;
            let offsets = types.iter().scan(0, |next, scalar| Some(std::mem::replace(next, *next + scalar.size())));
            let size = types.iter().map(|scalar| scalar.size()).sum::<usize>();
            let rows = Rows::Binary { start, size, offsets: offsets.collect() };
            self.skip(size.checked_mul(count)?)?;
            return Some(rows);
        }
        let mut words = Words { bytes: self.bytes, offset: self.offset };
        let mut chunk_starts = Vec::new();
        for row in 0..count {
            if row % CHUNK == 0 {
                chunk_starts.push(words.offset);
            }
            for _ in types {
                words.next()?;
            }
        }
        Some(Rows::Ascii { chunk_starts })
    }
}

/// Words between ASCII white space.
struct Words<'a> {
    bytes: &'a [u8],
    offset: usize,
}

impl<'a> Iterator for Words<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        let rest = &self.bytes[self.offset..];
        let start = rest.iter().position(|byte| !byte.is_ascii_whitespace())?;
        let rest = &rest[start..];
        let length = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        self.offset += start + length;
        Some(&rest[..length])
    }
}

/// A number of a text file, rounded once to the declared type's precision.
fn parse_number(word: &[u8], scalar: Scalar) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    if scalar == Scalar::F32 { text.parse::<f32>().ok().map(f64::from) } else { text.parse().ok() }
}
