//! EXT_meshopt_compression: the three bitstreams of its appendix A and the filters of its appendix B.

use std::collections::VecDeque;

use serde::Deserialize;

/// What a compressed buffer view says about its content.
#[derive(Debug, Clone, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Compression {
    /// Index of the buffer that holds the compressed bytes.
    pub buffer: u32,
    #[serde(default)]
    pub byte_offset: u64,
    pub byte_length: u64,
    pub byte_stride: usize,
    pub count: usize,
    mode: Mode,
    #[serde(default)]
    filter: Filter,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
enum Mode {
    Attributes,
    Triangles,
    Indices,
}

#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
enum Filter {
    #[default]
    None,
    Octahedral,
    Quaternion,
    Exponential,
}

/// Why bytes cannot be unpacked.
pub type Broken = &'static str;

const TRUNCATED: Broken = "its data end too early";

/// Elements of a group, which shares one width.
const GROUP: usize = 16;

impl Compression {
    /// The elements, `count` times `byte_stride` bytes.
    ///
    /// Every group of 16 elements and every index has bits of its own in `data`, so that what is allocated is bounded by it.
    pub fn unpack(&self, data: &[u8]) -> Result<Vec<u8>, Broken> {
        let (stride, count) = (self.byte_stride, self.count);
        let is_index = matches!(stride, 2 | 4);
        let fits = match (self.mode, self.filter) {
            (Mode::Attributes, Filter::None | Filter::Exponential) => {
                stride.is_multiple_of(4) && (4..=256).contains(&stride)
            }
            (Mode::Attributes, Filter::Octahedral) => stride == 4 || stride == 8,
            (Mode::Attributes, Filter::Quaternion) => stride == 8,
            (Mode::Triangles, Filter::None) => is_index && count.is_multiple_of(3),
            (Mode::Indices, Filter::None) => is_index,
            _ => false,
        };
        if !fits {
            return Err("its mode, filter, byteStride and count do not fit each other");
        }
        match self.mode {
            Mode::Attributes => {
                let mut bytes = attributes(data, stride, count)?;
                self.filter.apply(&mut bytes, stride);
                Ok(bytes)
            }
            Mode::Triangles => Ok(index_bytes(&triangles(data, count)?, stride)),
            Mode::Indices => Ok(index_bytes(&indices(data, count)?, stride)),
        }
    }
}

fn index_bytes(indices: &[u32], stride: usize) -> Vec<u8> {
    indices.iter().flat_map(|index| index.to_le_bytes().into_iter().take(stride)).collect()
}

/// Bytes that are read one after the other.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    /// What stands between the byte `header` and `tail` bytes at the end, and those.
    fn of(data: &'a [u8], header: u8, tail: usize) -> Result<(Self, &'a [u8]), Broken> {
        let body = data.strip_prefix(&[header]).ok_or("its data are of another mode or version")?;
        let (body, tail) = body.split_at(body.len().checked_sub(tail).ok_or(TRUNCATED)?);
        Ok((Self(body), tail))
    }

    fn bytes(&mut self, count: usize) -> Result<&'a [u8], Broken> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(TRUNCATED)?;
        self.0 = rest;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8, Broken> {
        Ok(self.bytes(1)?[0])
    }

    /// Unsigned LEB128 of 32 bits.
    fn varint(&mut self) -> Result<u32, Broken> {
        let mut value = 0;
        for shift in (0..35).step_by(7) {
            let byte = self.byte()?;
            value |= u32::from(byte & 0x7F).wrapping_shl(shift);
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err("a number in its data has more than 32 bits")
    }
}

fn zigzag_byte(v: u8) -> u8 {
    if v & 1 == 1 { !(v >> 1) } else { v >> 1 }
}

fn zigzag(v: u32) -> u32 {
    if v & 1 == 1 { !(v >> 1) } else { v >> 1 }
}

/// Mode 0.
fn attributes(data: &[u8], stride: usize, count: usize) -> Result<Vec<u8>, Broken> {
    let (mut reader, tail) = Reader::of(data, 0xA0, stride.max(32))?;
    // Four groups share one byte of header for each byte of an element.
    if count.div_ceil(4 * GROUP).saturating_mul(stride) > reader.0.len() {
        return Err(TRUNCATED);
    }
    let mut last = tail[tail.len() - stride..].to_vec();
    let mut elements = vec![0; count * stride];
    let block_bytes = ((8192 / stride) & !(GROUP - 1)).min(256) * stride;
    for block in elements.chunks_mut(block_bytes) {
        let groups = (block.len() / stride).div_ceil(GROUP);
        for (k, last) in last.iter_mut().enumerate() {
            let header = reader.bytes(groups.div_ceil(4))?;
            for (g, group) in block.chunks_mut(GROUP * stride).enumerate() {
                let deltas = group_deltas(&mut reader, header[g / 4] >> (g % 4 * 2) & 3)?;
                for (element, delta) in group.chunks_exact_mut(stride).zip(deltas) {
                    *last = last.wrapping_add(zigzag_byte(delta));
                    element[k] = *last;
                }
            }
        }
    }
    Ok(elements)
}

/// The deltas of a group, still zigzag-coded: all 0, of 2 or 4 bits with all bits set for a byte that follows, or bytes.
fn group_deltas(reader: &mut Reader, mode: u8) -> Result<[u8; GROUP], Broken> {
    let mut deltas = [0; GROUP];
    match mode {
        0 => {}
        3 => deltas.copy_from_slice(reader.bytes(GROUP)?),
        _ => {
            let bits = 2 * usize::from(mode);
            let per_byte = 8 / bits;
            let sentinel = (1u8 << bits) - 1;
            let packed = reader.bytes(GROUP / per_byte)?;
            for (i, delta) in deltas.iter_mut().enumerate() {
                // The first in a byte are its highest bits.
                let code = packed[i / per_byte] >> (8 - bits * (i % per_byte + 1)) & sentinel;
                *delta = if code == sentinel { reader.byte()? } else { code };
            }
        }
    }
    Ok(deltas)
}

/// The last 16 of what was pushed, the most recent first; zeros before that.
struct Fifo<T>(VecDeque<T>);

impl<T: Copy + Default> Fifo<T> {
    fn new() -> Self {
        Self(VecDeque::from(vec![T::default(); 16]))
    }

    fn push(&mut self, value: T) {
        self.0.pop_back();
        self.0.push_front(value);
    }

    /// Element `i`, below 16.
    fn get(&self, i: u8) -> T {
        self.0[usize::from(i & 15)]
    }
}

/// An index told by its difference from the last one told so.
fn told_index(reader: &mut Reader, last: &mut u32) -> Result<u32, Broken> {
    *last = last.wrapping_add(zigzag(reader.varint()?));
    Ok(*last)
}

/// The index after all that were used so far.
fn new_index(next: &mut u32) -> u32 {
    *next = next.wrapping_add(1);
    next.wrapping_sub(1)
}

/// Mode 1.
fn triangles(data: &[u8], count: usize) -> Result<Vec<u32>, Broken> {
    let (mut reader, table) = Reader::of(data, 0xE1, 16)?;
    let codes = reader.bytes(count / 3)?;
    let mut indices = Vec::with_capacity(count);
    let (mut next, mut last) = (0u32, 0u32);
    let (mut edges, mut vertices) = (Fifo::<[u32; 2]>::new(), Fifo::<u32>::new());
    for &code in codes {
        let (high, low) = (code >> 4, code & 15);
        if high < 15 {
            let [a, b] = edges.get(high);
            let c = match low {
                0 => new_index(&mut next),
                1..=12 => vertices.get(low),
                13 | 14 => {
                    last = if low == 13 { last.wrapping_sub(1) } else { last.wrapping_add(1) };
                    last
                }
                _ => told_index(&mut reader, &mut last)?,
            };
            edges.push([c, b]);
            edges.push([a, c]);
            if !(1..=12).contains(&low) {
                vertices.push(c);
            }
            indices.extend([a, b, c]);
            continue;
        }
        let is_explicit = low >= 14;
        let pair = if is_explicit { reader.byte()? } else { table[usize::from(low)] };
        if is_explicit && pair == 0 {
            next = 0;
        }
        let a = if low == 15 { told_index(&mut reader, &mut last)? } else { new_index(&mut next) };
        let mut other = |nibble: u8| match nibble {
            0 => Ok(new_index(&mut next)),
            15 if is_explicit => told_index(&mut reader, &mut last),
            _ => Ok(vertices.get(nibble - 1)),
        };
        let is_new = |nibble: u8| nibble == 0 || nibble == 15 && is_explicit;
        let (b, c) = (other(pair >> 4)?, other(pair & 15)?);
        edges.push([b, a]);
        edges.push([c, b]);
        edges.push([a, c]);
        vertices.push(a);
        if is_new(pair >> 4) {
            vertices.push(b);
        }
        if is_new(pair & 15) {
            vertices.push(c);
        }
        indices.extend([a, b, c]);
    }
    Ok(indices)
}

/// Mode 2.
fn indices(data: &[u8], count: usize) -> Result<Vec<u32>, Broken> {
    let (mut reader, _) = Reader::of(data, 0xD1, 4)?;
    if count > reader.0.len() {
        return Err(TRUNCATED);
    }
    let mut last = [0u32; 2];
    let next = |_| {
        let code = reader.varint()?;
        let baseline = &mut last[code as usize & 1];
        *baseline = baseline.wrapping_add(zigzag(code >> 1));
        Ok(*baseline)
    };
    (0..count).map(next).collect()
}

impl Filter {
    fn apply(self, bytes: &mut [u8], stride: usize) {
        match (self, stride) {
            (Self::None, _) => {}
            (Self::Octahedral, 4) => bytes.as_chunks_mut::<4>().0.iter_mut().for_each(|element| {
                let [x, y, one, _] = element.map(|byte| f32::from(byte as i8));
                let [x, y, z] = octahedral(x, y, one).map(|v| (v * 127.0).round() as i8 as u8);
                element[..3].copy_from_slice(&[x, y, z]);
            }),
            (Self::Octahedral, _) => of_shorts(bytes, |[x, y, one, w]| {
                let [x, y, z] = octahedral(f32::from(x), f32::from(y), f32::from(one)).map(to_short);
                [x, y, z, w]
            }),
            (Self::Quaternion, _) => of_shorts(bytes, quaternion),
            (Self::Exponential, _) => bytes.as_chunks_mut::<4>().0.iter_mut().for_each(|element| {
                let packed = i32::from_le_bytes(*element);
                let (exponent, mantissa) = (packed >> 24, packed << 8 >> 8);
                *element = ((f64::from(mantissa) * f64::from(exponent).exp2()) as f32).to_le_bytes();
            }),
        }
    }
}

fn of_shorts(bytes: &mut [u8], filter: impl Fn([i16; 4]) -> [i16; 4]) {
    for element in bytes.as_chunks_mut::<8>().0 {
        let [a, b, c, d, e, f, g, h] = *element;
        let filtered = filter([[a, b], [c, d], [e, f], [g, h]].map(i16::from_le_bytes));
        element.copy_from_slice(filtered.map(i16::to_le_bytes).as_flattened());
    }
}

fn to_short(v: f32) -> i16 {
    (v * 32767.0).round() as i16
}

/// A unit vector of its octahedral coordinates, as multiples of `one`.
fn octahedral(x: f32, y: f32, one: f32) -> [f32; 3] {
    let (x, y) = (x / one, y / one);
    let z = 1.0 - x.abs() - y.abs();
    let fold = z.min(0.0);
    let (x, y) = (x - fold.copysign(x), y - fold.copysign(y));
    let length = (x * x + y * y + z * z).sqrt();
    [x / length, y / length, z / length]
}

/// A unit quaternion of its three smaller components; the fourth number says how they are scaled, and in its two lowest
/// bits which one is missing.
fn quaternion([x, y, z, scale]: [i16; 4]) -> [i16; 4] {
    let one = f32::from(scale | 3) * std::f32::consts::SQRT_2;
    let [x, y, z] = [x, y, z].map(|v| f32::from(v) / one);
    let w = (1.0 - x * x - y * y - z * z).max(0.0).sqrt();
    let mut rotated = [w, x, y, z].map(to_short);
    rotated.rotate_right(usize::from(scale as u16 & 3));
    rotated
}

#[cfg(test)]
mod tests {
    use super::*;

    fn compression(mode: Mode, byte_stride: usize, count: usize) -> Compression {
        Compression { buffer: 0, byte_offset: 0, byte_length: 0, byte_stride, count, mode, filter: Filter::None }
    }

    #[test]
    fn a_group_of_deltas_of_four_bits_decodes_as_the_extensions_page_says() {
        let bytes = [0x17, 0x5f, 0xf0, 0xbc, 0x77, 0xa9, 0x21, 0x00, 0x34, 0xb5];
        let mut reader = Reader(&bytes);
        let deltas = group_deltas(&mut reader, 2).unwrap().map(|delta| zigzag_byte(delta) as i8);
        assert_eq!(deltas, [-1, -4, -3, 26, -91, 0, -6, 6, -4, -4, 5, -5, 1, -1, 0, 0]);
        assert!(reader.0.is_empty());
    }

    #[test]
    fn variable_length_numbers_decode_as_the_extensions_page_says() {
        // The page's third example reads its bytes in the other order, against LEB128 and its own second example.
        for (bytes, value) in [(&[0x7f][..], 0x7f), (&[0x81, 0x04], 0x201), (&[0xff, 0xa0, 0x05], 0x1507f)] {
            assert_eq!(Reader(bytes).varint(), Ok(value));
        }
        assert!(Reader(&[0x80; 6]).varint().is_err());
    }

    #[test]
    fn attributes_add_deltas_to_the_tails_baseline() {
        // Elements of 4 bytes: byte 0 rises by 1 (zigzag 2) each time from 10, the others stay at 1, 2, 3.
        let mut data = vec![0xA0];
        data.extend([1, 0b1010_1010, 0b1010_1010, 0b1010_1010, 0b1010_1010]);
        data.extend([0, 0, 0]);
        data.extend([0; 28]);
        data.extend([10, 1, 2, 3]);
        let bytes = compression(Mode::Attributes, 4, 5).unpack(&data).unwrap();
        let expected: Vec<u8> = (11..16).flat_map(|first| [first, 1, 2, 3]).collect();
        assert_eq!(bytes, expected);
        for length in 0..data.len() {
            assert!(compression(Mode::Attributes, 4, 5).unpack(&data[..length]).is_err(), "{length}");
        }
    }

    #[test]
    fn triangles_continue_at_edges_and_vertices() {
        // 0xf0 with table entry 0x00: three new vertices. 0x00: edge (a, c) = (0, 2) and a new vertex. 0x12: edge 1 is
        // (c, b) = (3, 2), with the vertex before the one before the last.
        let mut data = vec![0xE1, 0xF0, 0x00, 0x12];
        data.extend([0; 16]);
        let bytes = compression(Mode::Triangles, 2, 9).unpack(&data).unwrap();
        let indices: Vec<u16> = bytes.as_chunks::<2>().0.iter().map(|pair| u16::from_le_bytes(*pair)).collect();
        assert_eq!(indices, [0, 1, 2, 0, 2, 3, 3, 2, 1]);
        // Everything explicit: 0xff, pair 0xff, then 5, 7 and 6 as differences from the index before.
        let mut data = vec![0xE1, 0xFF, 0xFF, 10, 4, 1];
        data.extend([0; 16]);
        let bytes = compression(Mode::Triangles, 4, 3).unpack(&data).unwrap();
        assert_eq!(bytes, [5u32, 7, 6].map(u32::to_le_bytes).as_flattened());
        assert!(compression(Mode::Triangles, 4, 3).unpack(&data[..data.len() - 1]).is_err());
    }

    #[test]
    fn indices_count_from_two_baselines() {
        // (delta zigzag << 1) | baseline: +5 from 0, +100 from the other 0, +1, -1.
        let mut data = vec![0xD1, 5 << 2, 0x91, 0x03, 1 << 2, (1 << 1) | 1];
        data.extend([0; 4]);
        let bytes = compression(Mode::Indices, 4, 4).unpack(&data).unwrap();
        assert_eq!(bytes, [5u32, 100, 6, 99].map(u32::to_le_bytes).as_flattened());
    }

    #[test]
    fn filters_give_unit_vectors_unit_quaternions_and_floats() {
        let mut bytes = [[0i8, 0, 127, 5], [127, 0, 127, 5], [127, 127, 127, 5]].map(|v| v.map(|v| v as u8));
        Filter::Octahedral.apply(bytes.as_flattened_mut(), 4);
        assert_eq!(bytes.map(|v| v.map(|v| v as i8)), [[0, 0, 127, 5], [127, 0, 0, 5], [0, 0, -127, 5]]);
        // The third component, y, is missing: it is the largest, here all.
        assert_eq!(quaternion([0, 0, 0, 0x7FFC | 1]), [0, 32767, 0, 0]);
        let half = (32767.0 / std::f32::consts::SQRT_2) as i16;
        let [x, y, z, w] = quaternion([32767, 0, 0, 0x7FFC | 3]);
        assert!((x - half).abs() <= 1 && y == 0 && z == 0 && (w - half).abs() <= 1, "{x} {y} {z} {w}");
        let mut bytes = (((-3i32) << 24) | 20).to_le_bytes();
        Filter::Exponential.apply(&mut bytes, 4);
        assert_eq!(f32::from_le_bytes(bytes), 2.5);
    }

    #[test]
    fn shapes_that_do_not_fit_their_mode_are_refused() {
        assert!(compression(Mode::Attributes, 3, 4).unpack(&[0xA0; 64]).is_err());
        assert!(compression(Mode::Attributes, 0, 4).unpack(&[0xA0; 64]).is_err());
        assert!(compression(Mode::Triangles, 2, 4).unpack(&[0xE1; 64]).is_err());
        assert!(compression(Mode::Attributes, 4, usize::MAX).unpack(&[0xA0; 64]).is_err());
        assert!(compression(Mode::Indices, 4, usize::MAX).unpack(&[0xD1; 64]).is_err());
    }
}
