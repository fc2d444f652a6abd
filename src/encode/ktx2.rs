//! KTX 2.0 cube maps with mips, plain or each supercompressed with Zstandard (Khronos, "KTX File Format Specification",
//! version 2.0; the descriptor: "Khronos Data Format Specification", version 1.4).

use std::path::Path;

use glam::Vec3;
use half::f16;
use ruzstd::encoding::{CompressionLevel, compress_to_vec};

use std::io::Write;

use super::file::write_bytes_atomically;
use super::slots::Slots;
use crate::error::Result;
use crate::filter::RgbCubemap;
use crate::job::HdrEncoding;

const IDENTIFIER: [u8; 12] = *b"\xabKTX 20\xbb\r\n\x1a\n";

/// VK_FORMAT_R16G16B16A16_SFLOAT and VK_FORMAT_E5B9G9R9_UFLOAT_PACK32.
const VK_FORMATS: [u32; 2] = [97, 123];

/// What is done to each level by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Supercompression {
    /// Nothing: a reader needs no decoder.
    None = 0,
    /// Zstandard.
    Zstandard = 2,
}

/// Bytes of identifier, header and index, before the level index.
const HEADER_BYTES: usize = 80;

/// Largest value of a shared exponent's format: 511/512 of 2^16.
const RGB9E5_MAX: f32 = 65408.0;

/// Writes a [`file`] with Zstandard. Fails with [`crate::Error::Write`].
pub fn write(path: &Path, mips: &[&RgbCubemap], slots: &Slots, encoding: HdrEncoding) -> Result<()> {
    let bytes = file(mips, slots, encoding, Supercompression::Zstandard);
    write_bytes_atomically(path, |writer| writer.write_all(&bytes))
}

/// The bytes of a file of mips, the largest first and each half of the one before, with their faces in `slots`.
///
/// Alpha of half floats is 1. Values that the format cannot hold become the nearest that it can. The same mips give the
/// same bytes.
pub fn file(mips: &[&RgbCubemap], slots: &Slots, encoding: HdrEncoding, compression: Supercompression) -> Vec<u8> {
    let (format, type_size) = match encoding {
        HdrEncoding::Rgba16f => (VK_FORMATS[0], 2),
        HdrEncoding::Rgb9e5 => (VK_FORMATS[1], 4),
    };
    let levels: Vec<(usize, Vec<u8>)> = mips
        .iter()
        .map(|mip| {
            let texels = texels(&slots.texels(mip), encoding);
            let length = texels.len();
            match compression {
                Supercompression::None => (length, texels),
                Supercompression::Zstandard => (length, compress_to_vec(&texels[..], CompressionLevel::Fastest)),
            }
        })
        .collect();
    let descriptor = descriptor(encoding);
    let key_values = key_values();
    let size = mips.first().map_or(0, |mip| mip.size());
    let descriptor_start = HEADER_BYTES + 24 * levels.len();
    let key_values_start = descriptor_start + descriptor.len();

    let mut bytes = IDENTIFIER.to_vec();
    // Width, height, no depth, no array, six faces.
    let header = [format, type_size, size, size, 0, 0, 6, levels.len() as u32, compression as u32];
    let index = [descriptor_start, descriptor.len(), key_values_start, key_values.len()];
    words(&mut bytes, header.into_iter().chain(index.map(|value| value as u32)));
    // No global data of the supercompression.
    bytes.extend([0; 16]);
    // Plain levels begin at a multiple of their texels' size. The smallest lies first in the file, the largest first in the
    // index.
    let alignment = if compression == Supercompression::None { texel_bytes(encoding) } else { 1 };
    let mut start = key_values_start + key_values.len();
    let mut starts = vec![0; levels.len()];
    for (at, (_, stored)) in starts.iter_mut().zip(&levels).rev() {
        *at = start.next_multiple_of(alignment);
        start = *at + stored.len();
    }
    for (start, (length, stored)) in starts.iter().zip(&levels) {
        for value in [*start, stored.len(), *length] {
            bytes.extend((value as u64).to_le_bytes());
        }
    }
    bytes.extend(descriptor);
    bytes.extend(key_values);
    for (start, (_, stored)) in starts.into_iter().zip(&levels).rev() {
        bytes.resize(start, 0);
        bytes.extend(stored);
    }
    bytes
}

fn words(bytes: &mut Vec<u8>, words: impl IntoIterator<Item = u32>) {
    words.into_iter().for_each(|word| bytes.extend(word.to_le_bytes()));
}

fn texels(colours: &[Vec3], encoding: HdrEncoding) -> Vec<u8> {
    match encoding {
        HdrEncoding::Rgba16f => {
            let limit = Vec3::splat(f16::MAX.to_f32());
            let half = |colour: &Vec3| {
                colour.clamp(-limit, limit).extend(1.0).to_array().map(|value| f16::from_f32(value).to_le_bytes())
            };
            colours.iter().flat_map(half).flatten().collect()
        }
        HdrEncoding::Rgb9e5 => colours.iter().flat_map(|&colour| rgb9e5(colour).to_le_bytes()).collect(),
    }
}

/// Nine bits per channel with a shared exponent of bias 15 (Khronos Data Format Specification, section "Unsigned shared
/// exponent"; the algorithm of EXT_texture_shared_exponent).
pub fn rgb9e5(colour: Vec3) -> u32 {
    let colour = colour.clamp(Vec3::ZERO, Vec3::splat(RGB9E5_MAX));
    let largest = colour.max_element();
    let exponent = |value: f32| ((value.to_bits() >> 23) as i32 - 127).max(-16) + 16;
    let mut shared = exponent(largest);
    let unit = |shared: i32| ((shared - 24) as f32).exp2();
    // Rounding may carry into a tenth bit.
    if (largest / unit(shared)).round() > 511.0 {
        shared += 1;
    }
    let [r, g, b] = (colour / unit(shared)).round().to_array().map(|mantissa| mantissa as u32);
    (shared as u32) << 27 | b << 18 | g << 9 | r
}

/// The colour of [`rgb9e5`].
pub fn from_rgb9e5(packed: u32) -> Vec3 {
    let unit = ((packed >> 27) as f32 - 24.0).exp2();
    Vec3::new((packed & 511) as f32, (packed >> 9 & 511) as f32, (packed >> 18 & 511) as f32) * unit
}

fn texel_bytes(encoding: HdrEncoding) -> usize {
    match encoding {
        HdrEncoding::Rgba16f => 8,
        HdrEncoding::Rgb9e5 => 4,
    }
}

/// The basic data format descriptor, with its total size before it.
fn descriptor(encoding: HdrEncoding) -> Vec<u8> {
    // Bit offset, bits, channel with qualifiers, and the values that stand for 0 and 1.
    let samples: Vec<[u32; 5]> = match encoding {
        HdrEncoding::Rgba16f => {
            const SIGNED_FLOAT: u32 = 0xc0;
            let channels = [0, 1, 2, 15].into_iter().zip(0..);
            channels
                .map(|(channel, i)| [16 * i, 16, channel | SIGNED_FLOAT, (-1_f32).to_bits(), 1_f32.to_bits()])
                .collect()
        }
        HdrEncoding::Rgb9e5 => {
            const EXPONENT: u32 = 0x20;
            // A mantissa of 256 at the largest exponent less the bias, 2^(31 - 15 - 9), stands for 1 of it: 8448.
            let channel = |channel| [[9 * channel, 9, channel, 0, 8448], [27, 5, channel | EXPONENT, 15, 31]];
            (0..3).flat_map(channel).collect()
        }
    };
    let texel_bytes = texel_bytes(encoding) as u32;
    let block = 24 + 16 * samples.len() as u32;
    // RGBSDA, BT.709 primaries, linear transfer, straight alpha.
    const MODEL: u32 = 1 | 1 << 8 | 1 << 16;
    let mut bytes = Vec::new();
    // Khronos's basic block (0), version 2, texel blocks of 1 x 1 (0), bytes of the one plane.
    words(&mut bytes, [4 + block, 0, 2 | block << 16, MODEL, 0, texel_bytes, 0]);
    for [offset, bits, channel, lower, upper] in samples {
        // All channels lie at the texel's origin.
        words(&mut bytes, [offset | (bits - 1) << 16 | channel << 24, 0, lower, upper]);
    }
    bytes
}

/// Keys and values, sorted by key: rows go down, columns right, and who wrote it.
fn key_values() -> Vec<u8> {
    let mut bytes = Vec::new();
    for (key, value) in [("KTXorientation", "rd"), ("KTXwriter", concat!("splatprobe ", env!("CARGO_PKG_VERSION")))] {
        let entry = format!("{key}\0{value}\0");
        words(&mut bytes, [entry.len() as u32]);
        bytes.extend(entry.as_bytes());
        bytes.resize(bytes.len().next_multiple_of(4), 0);
    }
    bytes
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use ktx2::{Format, Reader, SupercompressionScheme};

    use super::*;

    #[test]
    fn shared_exponents_hold_every_colour_to_nine_bits() {
        for i in 0..1790 {
            let colour = Vec3::new(1.0, 0.71, 0.013) * (i as f32 / 60.0 - 14.0).exp2();
            let found = from_rgb9e5(rgb9e5(colour));
            assert!((found - colour).abs().max_element() <= colour.max_element() / 511.0 + 6e-8, "{colour}: {found}");
        }
        assert_eq!(from_rgb9e5(rgb9e5(Vec3::new(-1.0, 1.0, 1e9))), Vec3::new(0.0, 0.0, RGB9E5_MAX));
        assert_eq!(from_rgb9e5(rgb9e5(Vec3::ONE)), Vec3::ONE);
        // Just below a power of two, rounding carries.
        assert_eq!(from_rgb9e5(rgb9e5(Vec3::splat(0.999_99))), Vec3::ONE);
    }

    #[test]
    fn a_reader_of_the_format_finds_every_texel_of_every_mip() {
        let mips: Vec<RgbCubemap> =
            [8, 4, 2].map(|size| RgbCubemap::from_fn(size, |d| ((d + 1.0) * f64::from(size)).as_vec3())).into();
        let expected = [
            (HdrEncoding::Rgba16f, Format::R16G16B16A16_SFLOAT),
            (HdrEncoding::Rgb9e5, Format::E5B9G9R9_UFLOAT_PACK32),
        ];
        for (encoding, format) in expected {
            let mips_by_reference: Vec<&RgbCubemap> = mips.iter().collect();
            let bytes = file(&mips_by_reference, &Slots::DIRECT, encoding, Supercompression::Zstandard);
            let reader = Reader::new(&bytes[..]).unwrap();
            let header = reader.header();
            assert_eq!((header.pixel_width, header.pixel_height, header.face_count, header.level_count), (8, 8, 6, 3));
            assert_eq!(
                (header.format, header.supercompression_scheme),
                (Some(format), Some(SupercompressionScheme::Zstandard))
            );
            // The crate leaves the terminating 0 on.
            assert_eq!(reader.writer(), Some(concat!("splatprobe ", env!("CARGO_PKG_VERSION"), "\0")));
            assert!(reader.basic_dfd().is_some());
            for (level, mip) in reader.levels().zip(&mips) {
                let mut inflated = Vec::new();
                ruzstd::decoding::StreamingDecoder::new(level.data).unwrap().read_to_end(&mut inflated).unwrap();
                assert_eq!(inflated.len() as u64, level.uncompressed_byte_length);
                assert!(inflated == texels(&Slots::DIRECT.texels(mip), encoding));
            }
            let bytes = file(&mips_by_reference, &Slots::DIRECT, encoding, Supercompression::None);
            let reader = Reader::new(&bytes[..]).unwrap();
            assert_eq!(reader.header().supercompression_scheme, None);
            for (level, mip) in reader.levels().zip(&mips) {
                assert!(level.data == texels(&Slots::DIRECT.texels(mip), encoding));
                let start = level.data.as_ptr() as usize - bytes.as_ptr() as usize;
                assert_eq!(start % texel_bytes(encoding), 0);
            }
        }
    }
}
