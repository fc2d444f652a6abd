//! SPZ, versions 1 to 4: about 20 bytes a Gaussian and one for each coefficient above band 0.
//!
//! Facts from nianticlabs/spz. Each attribute of all Gaussians stands apart, in this order:
//!
//! ```text
//! positions   x y z: half (version 1), or 24-bit two's complement with the header's number of fractional bits
//! opacities   0 to 255
//! colours     red green blue: coefficient of band 0 = (byte / 255 - 1/2) / 0.15
//! scales      x y z: natural logarithm of the standard deviation = byte / 16 - 10
//! rotations   versions 1, 2: x y z = byte / 127.5 - 1, w >= 0; later: 32 bits, see smallest_three
//! harmonics   coefficients by band and order, each red green blue: (byte - 128) / 128
//! ```

mod container;

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use glam::{DQuat, DVec3};
use half::f16;
use memmap2::Mmap;

use self::container::{Container, Header};
use super::CHUNK;
use super::sanitize::FileGaussian;
use super::source::{SplatFile, SplatPart, SplatSource};
use crate::error::Result;
use crate::job::Frame;
use crate::scene::SplatEncoding;
use crate::scene::sh::{MAX_COEFFICIENTS, coefficient_count};

pub(super) use container::{GZIP_MAGIC, MAGIC};

/// Opens a mapped SPZ file. The format declares its frame, and no encoding: its writers keep the colours of the PLY they
/// convert. Errors as in [`Container::open`].
pub(super) fn open(path: &Path, bytes: Mmap) -> Result<SplatFile> {
    let Container { header, format, frame, payload } = Container::open(path, &bytes)?;
    let parts = SplatPart::whole(Spz::new(header, payload));
    Ok(SplatFile { format, frame, encoding: SplatEncoding::SrgbDisplay, order: None, parts, files: Vec::new() })
}

/// Opens SPZ data that another file wraps, and tells the frame that it declares. Errors as in [`Container::open`]; they
/// name `path`, the file around it.
pub(super) fn open_wrapped(path: &Path, bytes: &[u8]) -> Result<(Frame, Arc<dyn SplatSource>)> {
    let Container { header, frame, payload, .. } = Container::open(path, bytes)?;
    Ok((frame, Arc::new(Spz::new(header, payload))))
}

/// Decompressed attributes, still quantised.
#[derive(Debug)]
struct Spz {
    header: Header,
    payload: Vec<u8>,
    /// Where in `payload` each attribute is.
    attributes: [Range<usize>; 6],
    /// Metres of the lowest bit of a position, with its 24 bits as the highest of 32.
    position_unit: f64,
    /// What a byte of a scale means.
    standard_deviations: [f64; 256],
    /// What a byte of a colour means.
    colours: [f32; 256],
}

impl Spz {
    /// `payload` has the sizes that `header` says.
    fn new(header: Header, payload: Vec<u8>) -> Self {
        let mut start = 0;
        let attributes = header.sizes().map(|size| {
            let range = start..start + size * header.count;
            start = range.end;
            range
        });
        let standard_deviations = std::array::from_fn(|byte| (byte as f64 / 16.0 - 10.0).exp());
        let colours = std::array::from_fn(|byte| ((byte as f64 / 255.0 - 0.5) / 0.15) as f32);
        let position_unit = (-f64::from(header.fractional_bits) - 8.0).exp2();
        Self { header, payload, attributes, position_unit, standard_deviations, colours }
    }

    /// Everything but the bands from 1 on.
    fn decode(&self, gaussian: &mut FileGaussian, values: [&[u8]; 5]) {
        let [position, opacity, colour, scale, rotation] = values;
        gaussian.mean = match *position {
            [x0, x1, x2, y0, y1, y2, z0, z1, z2] => {
                // The 24 bits stand above 8 of zero, so that the sign is where it belongs.
                let fixed = |low, middle, high| f64::from(i32::from_le_bytes([0, low, middle, high]));
                DVec3::new(fixed(x0, x1, x2), fixed(y0, y1, y2), fixed(z0, z1, z2)) * self.position_unit
            }
            [x0, x1, y0, y1, z0, z1] => {
                let half = |bytes| f64::from(f16::from_le_bytes(bytes));
                DVec3::new(half([x0, x1]), half([y0, y1]), half([z0, z1]))
            }
            _ => DVec3::NAN,
        };
        gaussian.rotation = match *rotation {
            [x, y, z] => {
                let [x, y, z] = [x, y, z].map(|byte| f64::from(byte) / 127.5 - 1.0);
                DQuat::from_xyzw(x, y, z, (1.0 - (x * x + y * y + z * z)).max(0.0).sqrt())
            }
            [a, b, c, d] => smallest_three(u32::from_le_bytes([a, b, c, d])),
            _ => DQuat::NAN,
        };
        if let &[x, y, z] = scale {
            gaussian.standard_deviations =
                DVec3::from([x, y, z].map(|byte| self.standard_deviations[usize::from(byte)]));
        }
        gaussian.opacity = opacity.iter().map(|&byte| f64::from(byte) / 255.0).sum();
        let per_channel = coefficient_count(self.header.sh_degree);
        for (channel, &byte) in gaussian.coefficients.chunks_exact_mut(per_channel).zip(colour) {
            channel[0] = self.colours[usize::from(byte)];
        }
    }
}

impl SplatSource for Spz {
    fn count(&self) -> usize {
        self.header.count
    }

    fn sh_degree(&self) -> u8 {
        self.header.sh_degree
    }

    fn for_each_in_chunk(&self, chunk: usize, sink: &mut dyn FnMut(&mut FileGaussian)) -> Result<()> {
        let mut gaussian = FileGaussian::default();
        let mut values = [0.0; 3 * MAX_COEFFICIENTS];
        let sizes = self.header.sizes();
        let per_channel = coefficient_count(self.header.sh_degree);
        for i in chunk * CHUNK..((chunk + 1) * CHUNK).min(self.header.count) {
            let [position, opacity, colour, scale, rotation, harmonics] = std::array::from_fn(|attribute| {
                let start = self.attributes[attribute].start + i * sizes[attribute];
                &self.payload[start..start + sizes[attribute]]
            });
            self.decode(&mut gaussian, [position, opacity, colour, scale, rotation]);
            // All of them first: together they make a loop for vectors.
            harmonics.iter().zip(&mut values).for_each(|(&byte, value)| *value = (f32::from(byte) - 128.0) / 128.0);
            let (reds, others) = gaussian.coefficients.split_at_mut(per_channel);
            let (greens, blues) = others.split_at_mut(per_channel);
            let channels = reds[1..].iter_mut().zip(&mut greens[1..]).zip(&mut blues[1..per_channel]);
            for (((red, green), blue), &value) in channels.zip(values.as_chunks::<3>().0) {
                [*red, *green, *blue] = value;
            }
            sink(&mut gaussian);
        }
        Ok(())
    }
}

/// A rotation without its largest component, which is positive. From the highest bit on: two bits that tell which of x, y,
/// z, w that is, then the others, a sign and 9 bits of magnitude up to sqrt(1/2) each.
fn smallest_three(word: u32) -> DQuat {
    let component = |shift: u32| {
        let magnitude = f64::from(word >> shift & 0x1ff) / 511.0 * std::f64::consts::FRAC_1_SQRT_2;
        if word >> shift & 0x200 == 0 { magnitude } else { -magnitude }
    };
    let [a, b, c] = [20, 10, 0].map(component);
    let largest = (1.0 - (a * a + b * b + c * c)).max(0.0).sqrt();
    DQuat::from_array(match word >> 30 {
        0 => [largest, a, b, c],
        1 => [a, largest, b, c],
        2 => [a, b, largest, c],
        _ => [a, b, c, largest],
    })
}
