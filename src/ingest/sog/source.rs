//! A SOG's images, and Gaussians out of them.

use std::f64::consts::FRAC_1_SQRT_2;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Arc, LazyLock};

use glam::{DQuat, DVec3};
use rayon::prelude::*;

use super::super::CHUNK;
use super::super::sanitize::FileGaussian;
use super::super::source::SplatSource;
use super::files::{Content, Files};
use super::image::Image;
use super::meta::{Meta, PaletteMeta};
use crate::error::{Error, Result};
use crate::scene::sh::coefficient_count;

/// A file may promise this many Gaussians, and this many more per byte of its images. Captures have about 10 bytes per
/// Gaussian; images of one colour compress to nothing, so that a small file could otherwise ask for any memory.
const GAUSSIANS_PER_FILE: usize = 1 << 16;
const GAUSSIANS_PER_BYTE: usize = 4;

/// Entries of the palette in a row of its image.
const PALETTE_ROW: usize = 64;

/// A decoded SOG.
#[derive(Debug)]
pub(super) struct Sog {
    path: PathBuf,
    meta: Meta,
    means_low: Image,
    means_high: Image,
    quats: Image,
    scales: Image,
    sh0: Image,
    palette: Option<Palette>,
}

/// Spherical harmonics above band 0, shared by Gaussians.
#[derive(Debug)]
struct Palette {
    /// Per Gaussian, the number of its entry.
    labels: Image,
    /// Per entry red's, green's and blue's coefficients above band 0.
    entries: Vec<u8>,
    /// What the entries' bytes mean.
    values: [f32; 256],
    /// Entries that labels may name.
    count: usize,
    degree: u8,
}

impl Sog {
    /// Decodes all images of the SOG that `meta` describes, on all threads.
    ///
    /// # Errors
    /// As [`super::open`]'s.
    pub fn read(files: &Files, meta: Meta) -> Result<Self> {
        let names = &meta.files;
        let mut names = vec![&names.means_low, &names.means_high, &names.quats, &names.scales, &names.sh0];
        names.extend(meta.palette.as_ref().map(|palette| &palette.labels_file));
        let contents: Vec<Content> = names.iter().map(|name| files.read(name)).collect::<Result<_>>()?;
        let bytes: usize = contents.iter().map(|content| content.len()).sum();
        if meta.count > GAUSSIANS_PER_FILE.saturating_add(bytes.saturating_mul(GAUSSIANS_PER_BYTE)) {
            let what = format!("{} Gaussians in images of {bytes} bytes: the file cannot hold them", meta.count);
            return Err(files.invalid("meta.json, count", what));
        }
        let pixels = meta.count..=4 * meta.count + GAUSSIANS_PER_FILE;
        let centroids = || meta.palette.as_ref().map(|palette| read_centroids(files, palette)).transpose();
        let per_gaussian = || -> Vec<Result<Image>> {
            let images = names.par_iter().zip(&contents);
            images.map(|(name, webp)| Image::decode(files, name, webp, pixels.clone())).collect()
        };
        let (centroids, images) = rayon::join(centroids, per_gaussian);
        // In order, so that the same error is told whichever thread was first.
        let mut images = images.into_iter().collect::<Result<Vec<_>>>()?.into_iter();
        let centroids = centroids?;
        let mut next = || images.next().ok_or_else(|| files.invalid("meta.json", "an image is missing"));
        let (means_low, means_high, quats, scales, sh0) = (next()?, next()?, next()?, next()?, next()?);
        let palette = match (centroids, &meta.palette) {
            (Some(centroids), Some(meta)) => Some(Palette::new(next()?, centroids, meta)),
            _ => None,
        };
        Ok(Self { path: files.path().into(), meta, means_low, means_high, quats, scales, sh0, palette })
    }

    pub fn version(&self) -> u64 {
        self.meta.version
    }

    pub fn count(&self) -> usize {
        self.meta.count
    }
}

impl Palette {
    fn new(labels: Image, (centroids, degree): (Image, u8), meta: &PaletteMeta) -> Self {
        let held = PALETTE_ROW * centroids.height;
        let above_band_0 = coefficient_count(degree) - 1;
        let mut entries = Vec::with_capacity(3 * held * above_band_0);
        for entry in 0..held {
            // Rows are whole entries, so that entries follow one another.
            let pixels = centroids.pixels(entry * above_band_0..(entry + 1) * above_band_0);
            (0..3).for_each(|c| entries.extend(pixels.clone().map(|pixel| pixel[c])));
        }
        let count = meta.size.map_or(held, |(count, _)| count.min(held));
        Self { labels, entries, values: meta.values, count, degree }
    }
}

/// The image of the palette's coefficients and their degree.
fn read_centroids(files: &Files, meta: &PaletteMeta) -> Result<(Image, u8)> {
    /// Labels have 16 bits.
    const MOST: usize = 1 << 16;
    let above_band_0 = |degree: u8| coefficient_count(degree) - 1;
    let name = &meta.centroids_file;
    let degree = meta.size.map(|(_, degree)| degree);
    let most = MOST * above_band_0(degree.unwrap_or(3));
    let image = Image::decode(files, name, &files.read(name)?, 1..=most)?;
    let fits = |degree: &u8| image.width == PALETTE_ROW * above_band_0(*degree);
    match (1..=3).filter(|one| degree.is_none_or(|degree| degree == *one)).find(fits) {
        Some(degree) => Ok((image, degree)),
        None => {
            let what = format!("{} pixels wide; degree 1, 2, 3 has 192, 512, 960", image.width);
            Err(files.invalid(name, what))
        }
    }
}

/// Gaussians of a SOG that follow one another.
#[derive(Debug)]
pub(super) struct SogRange {
    sog: Arc<Sog>,
    range: Range<usize>,
}

impl SogRange {
    /// Those in `range`, which must lie within the count.
    pub fn new(sog: Arc<Sog>, range: Range<usize>) -> Self {
        Self { sog, range }
    }

    pub fn all(sog: Sog) -> Self {
        let range = 0..sog.count();
        Self { sog: Arc::new(sog), range }
    }
}

impl SplatSource for SogRange {
    fn count(&self) -> usize {
        self.range.len()
    }

    fn sh_degree(&self) -> u8 {
        self.sog.palette.as_ref().map_or(0, |palette| palette.degree)
    }

    fn for_each_in_chunk(&self, chunk: usize, sink: &mut dyn FnMut(&mut FileGaussian)) -> Result<()> {
        let first = self.range.start + chunk * CHUNK;
        let range = first..(first + CHUNK).min(self.range.end);
        let Sog { meta, palette, .. } = &*self.sog;
        let images = [&self.sog.means_low, &self.sog.means_high, &self.sog.quats, &self.sog.scales, &self.sog.sh0];
        let [lows, highs, quats, scales, sh0s] = images.map(|image| image.pixels(range.clone()));
        let mut labels = palette.iter().flat_map(|palette| palette.labels.pixels(range.clone()));
        let stride = coefficient_count(self.sh_degree());
        let mut gaussian = FileGaussian::default();
        for (i, ((((low, high), quat), scale), sh0)) in
            range.clone().zip(lows.zip(highs).zip(quats).zip(scales).zip(sh0s))
        {
            let fault = |what: String| Error::invalid(&self.sog.path, format!("Gaussian {i}"), what);
            let coordinate = |axis: usize| meta.means[axis].coordinate(high[axis], low[axis]);
            gaussian.mean = DVec3::new(coordinate(0), coordinate(1), coordinate(2));
            gaussian.rotation =
                rotation(quat).ok_or_else(|| fault(format!("rotation mode {}; there are 252 to 255", quat[3])))?;
            let deviation = |axis: usize| meta.scales[axis][usize::from(scale[axis])];
            gaussian.standard_deviations = DVec3::new(deviation(0), deviation(1), deviation(2));
            gaussian.opacity = meta.opacities[usize::from(sh0[3])];
            let channels = gaussian.coefficients.chunks_exact_mut(stride);
            for ((channel, table), byte) in channels.zip(&meta.colours).zip(sh0) {
                channel[0] = table[usize::from(byte)];
            }
            if let (Some(palette), Some([low, high, ..])) = (palette, labels.next()) {
                let label = usize::from(u16::from_le_bytes([low, high]));
                if label >= palette.count {
                    return Err(fault(format!("palette label {label}; the palette has {} entries", palette.count)));
                }
                let entry = &palette.entries[3 * label * (stride - 1)..3 * (label + 1) * (stride - 1)];
                let channels = gaussian.coefficients.chunks_exact_mut(stride);
                for (channel, bytes) in channels.zip(entry.chunks_exact(stride - 1)) {
                    for (coefficient, &byte) in channel[1..].iter_mut().zip(bytes) {
                        *coefficient = palette.values[usize::from(byte)];
                    }
                }
            }
            sink(&mut gaussian);
        }
        Ok(())
    }
}

/// The quaternion whose three smaller components, in the order w x y z, are red, green and blue, from -sqrt(1/2) to
/// sqrt(1/2); alpha tells which one is left out, which is the rest of a unit's length. `None` for an unknown alpha.
fn rotation(pixel: [u8; 4]) -> Option<DQuat> {
    static COMPONENT: LazyLock<[f64; 256]> =
        LazyLock::new(|| std::array::from_fn(|byte| (byte as f64 / 127.5 - 1.0) * FRAC_1_SQRT_2));
    /// Where w x y z stand among the three and the one left out. A branch would be mispredicted as often as not.
    const ORDER: [[usize; 4]; 4] = [[3, 0, 1, 2], [0, 3, 1, 2], [0, 1, 3, 2], [0, 1, 2, 3]];
    let [a, b, c] = [0, 1, 2].map(|i| COMPONENT[usize::from(pixel[i])]);
    let largest = (1.0 - (a * a + b * b + c * c)).max(0.0).sqrt();
    let components = [a, b, c, largest];
    let [w, x, y, z] = ORDER.get(usize::from(pixel[3].checked_sub(252)?))?.map(|i: usize| components[i]);
    Some(DQuat::from_xyzw(x, y, z, w))
}
