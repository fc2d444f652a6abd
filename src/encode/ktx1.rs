//! KTX 1 cube maps as Filament's cmgen writes them, R11F_G11F_B10F (Khronos, "KTX File Format Specification", version 1;
//! Filament's cmgen.cpp for what it puts into the header).

use std::io::Write;
use std::path::Path;

use glam::Vec3;
use half::f16;

use super::file::write_bytes_atomically;
use super::slots::Slots;
use crate::error::Result;
use crate::filter::RgbCubemap;

const IDENTIFIER: [u8; 12] = *b"\xabKTX 11\xbb\r\n\x1a\n";

/// Says that the file is little-endian.
const ENDIANNESS: u32 = 0x0403_0201;

/// GL_R11F_G11F_B10F. cmgen writes it for the type and all formats, where the specification has several constants, and
/// Filament reads no other.
const R11F_G11F_B10F: u32 = 0x8c3a;

/// Writes mips, the largest first and each half of the one before, looked up by the direction as it is.
///
/// `metadata` is pairs of keys and texts. Values that the format cannot hold become the nearest that it can. Fails with
/// [`crate::Error::Write`].
pub fn write(path: &Path, mips: &[&RgbCubemap], metadata: &[(&str, &str)]) -> Result<()> {
    let size = mips.first().map_or(0, |mip| mip.size());
    let mut key_values = Vec::new();
    for (key, value) in metadata {
        let entry = format!("{key}\0{value}\0");
        key_values.extend((entry.len() as u32).to_le_bytes());
        key_values.extend(entry.as_bytes());
        key_values.resize(key_values.len().next_multiple_of(4), 0);
    }
    let mut bytes = IDENTIFIER.to_vec();
    // Type, size of the type, format, internal format, base format; width, height, no depth, no array, six faces.
    let format = [R11F_G11F_B10F, 1, R11F_G11F_B10F, R11F_G11F_B10F, R11F_G11F_B10F];
    let shape = [size, size, 0, 0, 6, mips.len() as u32, key_values.len() as u32];
    for word in [ENDIANNESS].into_iter().chain(format).chain(shape) {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend(key_values);
    for mip in mips {
        // The size of one face, of those that follow.
        bytes.extend((4 * mip.size().pow(2)).to_le_bytes());
        for texel in Slots::DIRECT.texels(mip) {
            bytes.extend(r11g11b10(texel).to_le_bytes());
        }
    }
    write_bytes_atomically(path, |writer| writer.write_all(&bytes))
}

/// Unsigned floats of five bits of exponent, with six bits of mantissa for red and green and five for blue (OpenGL 4.6,
/// sections 2.3.4.3 and 2.3.4.4): halves without the sign and the last bits of the mantissa.
fn r11g11b10(colour: Vec3) -> u32 {
    let short = |value: f32, dropped: u32| {
        let half = u32::from(f16::from_f32(value.max(0.0).min(f16::MAX.to_f32())).to_bits());
        // Rounding must not end in infinity.
        let largest = (u32::from(f16::MAX.to_bits())) >> dropped;
        ((half + (1 << (dropped - 1))) >> dropped).min(largest)
    };
    short(colour.x, 4) | short(colour.y, 4) << 11 | short(colour.z, 5) << 22
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A short float's value, by the specification's formula.
    fn value(bits: u32, mantissa_bits: i32) -> f64 {
        let (exponent, mantissa) = (bits >> mantissa_bits, f64::from(bits & ((1 << mantissa_bits) - 1)));
        let share = mantissa / f64::from(1 << mantissa_bits);
        if exponent == 0 { 2f64.powi(-14) * share } else { 2f64.powi(exponent as i32 - 15) * (1.0 + share) }
    }

    #[test]
    fn short_floats_are_the_nearest() {
        for i in 0..1200 {
            let colour = Vec3::new(1.0, 0.43, 0.013) * (i as f32 / 40.0 - 14.0).exp2();
            let packed = r11g11b10(colour);
            let found = [value(packed & 0x7ff, 6), value(packed >> 11 & 0x7ff, 6), value(packed >> 22, 5)];
            for (found, (expected, bits)) in found.into_iter().zip(colour.to_array().into_iter().zip([6, 6, 5])) {
                let expected = f64::from(expected);
                // Half a unit of the mantissa, and of what halves had before; below 2^-14 units are fixed.
                let unit = expected.max(2f64.powi(-14)) * 2f64.powi(-bits);
                assert!((found - expected).abs() <= 0.51 * unit + 2f64.powi(-25), "{found} is not {expected}");
            }
        }
        assert_eq!(r11g11b10(Vec3::new(-1.0, 1e9, f32::MAX)), 0x7bf << 11 | 0x3df << 22);
    }
}
