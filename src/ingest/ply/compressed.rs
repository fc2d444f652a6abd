//! PlayCanvas compressed PLY: 16 bytes a Gaussian and as many as its spherical harmonics have coefficients.
//!
//! Facts from PlayCanvas' engine and splat-transform, which read and write it. 256 vertices in a row share one row of
//! `element chunk`: the least and greatest position and scale (as a natural logarithm), and in newer files the least and
//! greatest colour. A vertex is four 32-bit words: position and scale with 11, 10 and 11 bits for x, y, z from the highest
//! bit on, between the chunk's least and greatest; colour and opacity with 8 bits each for red, green, blue, opacity; and
//! the rotation, whose highest two bits tell which of w, x, y, z is the largest and left out, followed by the others with
//! 10 bits each, from -sqrt(1/2) to sqrt(1/2). `element sh`, when there, has bytes `f_rest_*` in the order of plain PLY.

use std::path::Path;

use glam::{DQuat, DVec3};
use memmap2::Mmap;

use super::header::{Element, Encoding, Header, Kind, Scalar};
use super::{CHUNK, Cursor, too_short};
use crate::error::{Error, Result};
use crate::ingest::sanitize::FileGaussian;
use crate::ingest::source::SplatSource;
use crate::scene::sh::{C0, MAX_COEFFICIENTS, MAX_DEGREE, coefficient_count};

/// Vertices that share a row of `element chunk`. [`CHUNK`] is a multiple of it.
const BLOCK: usize = 256;

/// A compressed PLY file whose header and size hold what they must.
#[derive(Debug)]
pub(super) struct CompressedPly {
    bytes: Mmap,
    count: usize,
    blocks: Table,
    block_columns: BlockColumns,
    vertices: Table,
    vertex_columns: VertexColumns,
    sh: Option<Table>,
    /// Byte offset in a row of `sh` of red's bands from 1; green's and blue's follow.
    sh_column: usize,
    sh_degree: u8,
}

/// Rows of one size, from byte `start` of the file.
#[derive(Debug, Clone, Copy)]
struct Table {
    start: usize,
    row_size: usize,
}

impl Table {
    /// The rows from number `first` on.
    fn rows(self, bytes: &[u8], first: usize) -> impl Iterator<Item = &[u8]> {
        bytes[self.start + first * self.row_size..].chunks_exact(self.row_size)
    }
}

/// Byte offsets in a row of `element chunk`, least before greatest.
#[derive(Debug)]
struct BlockColumns {
    position: [[usize; 3]; 2],
    log_scale: [[usize; 3]; 2],
    /// Older files have none: their colours lie between 0 and 1.
    colour: Option<[[usize; 3]; 2]>,
}

/// Byte offsets in a row of `element vertex`.
#[derive(Debug)]
struct VertexColumns {
    position: usize,
    rotation: usize,
    scale: usize,
    colour: usize,
}

/// The span that a block's fractions are of.
struct Span {
    least: DVec3,
    greatest: DVec3,
}

impl Span {
    fn read(row: &[u8], [least, greatest]: [[usize; 3]; 2]) -> Self {
        let read = |columns: [usize; 3]| DVec3::from(columns.map(|column| Scalar::F32.read(&row[column..], false)));
        Self { least: read(least), greatest: read(greatest) }
    }

    /// Exact at both ends.
    fn at(&self, fraction: DVec3) -> DVec3 {
        self.least * (DVec3::ONE - fraction) + self.greatest * fraction
    }
}

impl CompressedPly {
    /// Whether the vertices are packed.
    pub fn is_described_by(header: &Header) -> bool {
        let packed = |element: &Element| element.properties.iter().any(|property| property.name == "packed_position");
        header.elements.iter().any(|element| element.name == "vertex" && packed(element))
    }

    /// Checks that all columns are there and all rows that the header promises.
    ///
    /// # Errors
    /// [`Error::Invalid`] when a column or rows are missing; [`Error::Unsupported`] for another byte order or text.
    pub fn new(path: &Path, bytes: Mmap, header: &Header) -> Result<Self> {
        if header.encoding != Encoding::LittleEndian {
            let what = format!("compressed PLY as {}; only binary_little_endian is known", header.encoding.name());
            return Err(Error::unsupported(path, what));
        }
        let find = |name: &str| header.elements.iter().find(|element| element.name == name);
        let missing = |name: &str| Error::invalid(path, "header", format!("compressed PLY without 'element {name}'"));
        let vertex = find("vertex").ok_or_else(|| missing("vertex"))?;
        let chunk = find("chunk").ok_or_else(|| missing("chunk"))?;
        let sh = find("sh");
        if vertex.count == 0 {
            return Err(Error::invalid(path, "header", "element vertex has 0 rows: there are no Gaussians"));
        }
        let blocks_needed = vertex.count.div_ceil(BLOCK as u64);
        if chunk.count != blocks_needed {
            let what = format!("{} vertices need {blocks_needed} rows of element chunk", vertex.count);
            return Err(Error::invalid(path, "header", format!("{what}, which has {}", chunk.count)));
        }
        if let Some(sh) = sh.filter(|sh| sh.count != vertex.count) {
            let what = format!("element sh has {} rows for {} vertices", sh.count, vertex.count);
            return Err(Error::invalid(path, "header", what));
        }

        let block_columns = BlockColumns::find(path, chunk)?;
        let vertex_columns = VertexColumns::find(path, vertex)?;
        let (sh_degree, sh_column) = sh.map_or(Ok((0, 0)), |sh| sh_columns(path, sh))?;
        let table = |element: &Element| table(path, &bytes, header, element);
        let (blocks, vertices, sh) = (table(chunk)?, table(vertex)?, sh.map(table).transpose()?);
        let count = usize::try_from(vertex.count).map_err(|_| too_short(path, &bytes, vertex))?;
        Ok(Self { bytes, count, blocks, block_columns, vertices, vertex_columns, sh, sh_column, sh_degree })
    }

    /// A vertex without its bands from 1 on.
    fn decode(&self, gaussian: &mut FileGaussian, row: &[u8], [position, log_scale, colour]: &[Span; 3]) {
        let word = |column: usize| row[column..].first_chunk().map_or(0, |&bytes| u32::from_le_bytes(bytes));
        let columns = &self.vertex_columns;
        gaussian.mean = position.at(fractions_11_10_11(word(columns.position)));
        gaussian.standard_deviations =
            DVec3::from(log_scale.at(fractions_11_10_11(word(columns.scale))).to_array().map(f64::exp));
        gaussian.rotation = rotation(word(columns.rotation));
        let [opacity, blue, green, red] = word(columns.colour).to_le_bytes().map(|byte| f64::from(byte) / 255.0);
        gaussian.opacity = opacity;
        let per_channel = coefficient_count(self.sh_degree);
        for (c, channel) in colour.at(DVec3::new(red, green, blue)).to_array().into_iter().enumerate() {
            gaussian.coefficients[c * per_channel] = ((channel - 0.5) / C0) as f32;
        }
    }
}

impl SplatSource for CompressedPly {
    fn count(&self) -> usize {
        self.count
    }

    fn sh_degree(&self) -> u8 {
        self.sh_degree
    }

    fn for_each_in_chunk(&self, chunk: usize, sink: &mut dyn FnMut(&mut FileGaussian)) -> Result<()> {
        let first = chunk * CHUNK;
        let mut gaussian = FileGaussian::default();
        let rest_per_channel = coefficient_count(self.sh_degree) - 1;
        let mut values = [0.0; 3 * MAX_COEFFICIENTS];
        let mut sh_rows = self.sh.map(|sh| sh.rows(&self.bytes, first));
        let mut vertices = self.vertices.rows(&self.bytes, first).take((self.count - first).min(CHUNK));
        let blocks = self.blocks.rows(&self.bytes, first / BLOCK).take(CHUNK / BLOCK);
        for block in blocks {
            let columns = &self.block_columns;
            let colour =
                columns.colour.map_or(Span { least: DVec3::ZERO, greatest: DVec3::ONE }, |c| Span::read(block, c));
            let spans = [Span::read(block, columns.position), Span::read(block, columns.log_scale), colour];
            for vertex in vertices.by_ref().take(BLOCK) {
                self.decode(&mut gaussian, vertex, &spans);
                if let Some(row) = sh_rows.as_mut().and_then(Iterator::next) {
                    // All of them first, because a channel's few bytes are too short a loop for vectors.
                    let bytes = &row[self.sh_column..self.sh_column + 3 * rest_per_channel];
                    bytes.iter().zip(&mut values).for_each(|(&byte, value)| *value = sh_value(byte));
                    let channels = gaussian.coefficients.chunks_exact_mut(rest_per_channel + 1);
                    for (channel, values) in channels.zip(values[..bytes.len()].chunks_exact(rest_per_channel)) {
                        channel[1..].copy_from_slice(values);
                    }
                }
                sink(&mut gaussian);
            }
        }
        Ok(())
    }
}

impl BlockColumns {
    fn find(path: &Path, chunk: &Element) -> Result<Self> {
        let find = |names: [&str; 3]| -> Result<[usize; 3]> {
            let [x, y, z] = names.map(|name| column(path, chunk, name, Scalar::F32));
            Ok([x?, y?, z?])
        };
        let has_colours = chunk.properties.iter().any(|property| property.name == "min_r");
        let colour = if has_colours {
            Some([find(["min_r", "min_g", "min_b"])?, find(["max_r", "max_g", "max_b"])?])
        } else {
            None
        };
        Ok(Self {
            position: [find(["min_x", "min_y", "min_z"])?, find(["max_x", "max_y", "max_z"])?],
            log_scale: [
                find(["min_scale_x", "min_scale_y", "min_scale_z"])?,
                find(["max_scale_x", "max_scale_y", "max_scale_z"])?,
            ],
            colour,
        })
    }
}

impl VertexColumns {
    fn find(path: &Path, vertex: &Element) -> Result<Self> {
        let find = |name: &str| column(path, vertex, name, Scalar::U32);
        Ok(Self {
            position: find("packed_position")?,
            rotation: find("packed_rotation")?,
            scale: find("packed_scale")?,
            colour: find("packed_color")?,
        })
    }
}

/// Degree of `element sh` and the byte offset of its first column; all stand together and in order.
fn sh_columns(path: &Path, sh: &Element) -> Result<(u8, usize)> {
    let count = sh.properties.iter().filter(|property| property.name.starts_with("f_rest_")).count();
    let Some(degree) = (1..=MAX_DEGREE).find(|&degree| 3 * (coefficient_count(degree) - 1) == count) else {
        let what = format!("element sh has {count} properties f_rest_*; degree 1 to 4 has 9, 24, 45 or 72");
        return Err(Error::invalid(path, "header", what));
    };
    let first = column(path, sh, "f_rest_0", Scalar::U8)?;
    for i in 1..count {
        let name = format!("f_rest_{i}");
        if column(path, sh, &name, Scalar::U8)? != first + i {
            let what = format!("compressed PLY with property '{name}' not after 'f_rest_{}'", i - 1);
            return Err(Error::unsupported(path, what));
        }
    }
    Ok((degree, first))
}

/// Byte offset in a row of `element` of the property `name`, which must have the type `scalar`.
fn column(path: &Path, element: &Element, name: &str, scalar: Scalar) -> Result<usize> {
    let mut offset = 0;
    for property in &element.properties {
        match property.kind {
            Kind::Scalar(found) if property.name == name && found == scalar => return Ok(offset),
            Kind::Scalar(other) if property.name != name => offset += other.size(),
            _ => break,
        }
    }
    let what = format!("compressed PLY needs property '{name}' of type {scalar:?} in element {}", element.name);
    Err(Error::invalid(path, "header", what))
}

/// Where the rows of `element` are; all of them are there.
fn table(path: &Path, bytes: &[u8], header: &Header, element: &Element) -> Result<Table> {
    let mut cursor = Cursor { bytes, offset: header.data_offset, encoding: header.encoding };
    for before in header.elements.iter().take_while(|before| before.name != element.name) {
        cursor.skip_element(before).ok_or_else(|| too_short(path, bytes, before))?;
    }
    let start = cursor.offset;
    cursor.skip_element(element).ok_or_else(|| too_short(path, bytes, element))?;
    let row_size = element
        .row_size()
        .ok_or_else(|| Error::unsupported(path, format!("a list in element {} of a compressed PLY", element.name)))?;
    Ok(Table { start, row_size })
}

/// A byte of `element sh`: buckets between -4 and 4 by their centres, except the first and the last, which are the ends.
fn sh_value(byte: u8) -> f32 {
    match byte {
        0 => -4.0,
        255 => 4.0,
        _ => (f32::from(byte) - 127.5) / 32.0,
    }
}

/// The lowest `bits` of `word` as a fraction, 0 to 1.
fn fraction(word: u32, bits: u32) -> f64 {
    let greatest = (1 << bits) - 1;
    f64::from(word & greatest) / f64::from(greatest)
}

fn fractions_11_10_11(word: u32) -> DVec3 {
    DVec3::new(fraction(word >> 21, 11), fraction(word >> 11, 10), fraction(word, 11))
}

fn rotation(word: u32) -> DQuat {
    let component = |shift: u32| (fraction(word >> shift, 10) - 0.5) * std::f64::consts::SQRT_2;
    let [a, b, c] = [20, 10, 0].map(component);
    let largest = (1.0 - (a * a + b * b + c * c)).max(0.0).sqrt();
    let [w, x, y, z] = match word >> 30 {
        0 => [largest, a, b, c],
        1 => [a, largest, b, c],
        2 => [a, b, largest, c],
        _ => [a, b, c, largest],
    };
    DQuat::from_xyzw(x, y, z, w)
}
