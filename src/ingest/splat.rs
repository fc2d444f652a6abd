//! .splat, the format of antimatter15's viewer: 32 bytes a Gaussian and nothing else.
//!
//! Facts from the viewer and its converter: three f32 for the mean, three f32 for the standard deviations, four bytes for
//! red, green, blue (the colour that spherical harmonics of degree 0 give, 0 to 255) and opacity, and four bytes w, x, y, z
//! for the rotation, `(byte - 128) / 128` each. Little-endian.

use std::path::Path;

use glam::{DQuat, DVec3};
use memmap2::Mmap;

use super::CHUNK;
use super::sanitize::FileGaussian;
use super::source::{SplatFile, SplatPart, SplatSource};
use crate::error::{Error, Result};
use crate::job::Frame;
use crate::scene::SplatEncoding;
use crate::scene::sh::C0;

/// Bytes of a Gaussian.
const SIZE: usize = 32;

/// Whether `bytes` can hardly be anything but .splat, which has no header to know it by: whole Gaussians, most of which
/// have positions and sizes that scenes have. Of random bytes, one in ten thousand would pass for such a Gaussian.
pub(super) fn is_plausible(bytes: &[u8]) -> bool {
    /// As many Gaussians, evenly spaced, decide.
    const SAMPLES: usize = 1024;
    let (rows, rest) = bytes.as_chunks::<SIZE>();
    let sampled = || rows.iter().step_by(rows.len().div_ceil(SAMPLES).max(1));
    let plausible = |row: &&[u8; SIZE]| {
        let [position, sizes] = [0, 12].map(|start| vector(row, start));
        position.abs().max_element() < 1e6 && sizes.min_element() > 1e-9 && sizes.max_element() < 1e6
    };
    rest.is_empty() && 2 * sampled().filter(plausible).count() > sampled().count()
}

/// Opens a mapped .splat file, which declares nothing: its writers keep the axes and colours of the PLY they convert.
///
/// # Errors
/// [`Error::Invalid`] when the size is not a multiple of 32 bytes.
pub(super) fn open(path: &Path, bytes: Mmap) -> Result<SplatFile> {
    if !bytes.len().is_multiple_of(SIZE) {
        let what = format!(".splat has {SIZE} bytes for each Gaussian; the last one has {}", bytes.len() % SIZE);
        return Err(Error::invalid(path, format!("byte {}", bytes.len() - bytes.len() % SIZE), what));
    }
    Ok(SplatFile {
        format: ".splat".into(),
        frame: Frame::RDF,
        encoding: SplatEncoding::SrgbDisplay,
        order: None,
        parts: SplatPart::whole(Splat { bytes }),
        files: Vec::new(),
    })
}

#[derive(Debug)]
struct Splat {
    bytes: Mmap,
}

impl SplatSource for Splat {
    fn count(&self) -> usize {
        self.bytes.len() / SIZE
    }

    fn sh_degree(&self) -> u8 {
        0
    }

    fn for_each_in_chunk(&self, chunk: usize, sink: &mut dyn FnMut(&mut FileGaussian)) -> Result<()> {
        let (rows, _) = self.bytes.as_chunks::<SIZE>();
        let mut gaussian = FileGaussian::default();
        for row in rows.iter().skip(chunk * CHUNK).take(CHUNK) {
            let &[.., red, green, blue, opacity, w, x, y, z] = row;
            let [w, x, y, z] = [w, x, y, z].map(|byte| (f64::from(byte) - 128.0) / 128.0);
            gaussian.mean = vector(row, 0);
            gaussian.standard_deviations = vector(row, 12);
            gaussian.rotation = DQuat::from_xyzw(x, y, z, w);
            gaussian.opacity = f64::from(opacity) / 255.0;
            for (coefficient, byte) in gaussian.coefficients.iter_mut().zip([red, green, blue]) {
                *coefficient = ((f64::from(byte) / 255.0 - 0.5) / C0) as f32;
            }
            sink(&mut gaussian);
        }
        Ok(())
    }
}

/// Three f32 from byte `start` on.
fn vector(row: &[u8; SIZE], start: usize) -> DVec3 {
    let (values, _) = row[start..].as_chunks::<4>();
    DVec3::new(
        f32::from_le_bytes(values[0]).into(),
        f32::from_le_bytes(values[1]).into(),
        f32::from_le_bytes(values[2]).into(),
    )
}
