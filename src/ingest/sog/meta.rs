//! `meta.json` of versions 1 and 2, as tables that turn an image's bytes into values.
//!
//! Version 2 stores codebooks; version 1 the values of bytes 0 and 255, between which bytes lie evenly. Either way a byte
//! has one of 256 values.

use std::path::Path;

use glam::DVec3;
use serde::Deserialize;

use crate::error::{Error, Result};
use crate::scene::bounds::Bounds;

/// What each byte of an image means.
type Table<T> = [T; 256];

/// What `meta.json` says.
#[derive(Debug)]
pub(super) struct Meta {
    pub version: u64,
    /// Gaussians promised.
    pub count: usize,
    /// Positions along x, y, z.
    pub means: [LogAxis; 3],
    /// Standard deviations along the principal axes.
    pub scales: [Table<f64>; 3],
    /// Coefficients of band 0: red, green, blue.
    pub colours: [Table<f32>; 3],
    /// Peak opacities, 0 to 1.
    pub opacities: Table<f64>,
    pub palette: Option<PaletteMeta>,
    pub files: FileNames,
}

/// Names of the images that every SOG has.
#[derive(Debug)]
pub(super) struct FileNames {
    pub means_low: String,
    pub means_high: String,
    pub quats: String,
    pub scales: String,
    pub sh0: String,
}

/// The palette of coefficients above band 0.
#[derive(Debug)]
pub(super) struct PaletteMeta {
    /// Entries and degree; version 1 leaves both to the image's size.
    pub size: Option<(usize, u8)>,
    /// Of coefficients.
    pub values: Table<f32>,
    pub centroids_file: String,
    pub labels_file: String,
}

/// A coordinate axis: 16 bits that divide a range of `sign(x) ln(1 + |x|)` evenly.
#[derive(Debug)]
pub(super) struct LogAxis {
    /// `exp` of the range's start and of what the high byte adds.
    high: Table<f64>,
    /// `exp` of what the low byte adds.
    low: Table<f64>,
}

impl LogAxis {
    fn new(min: f64, max: f64) -> Self {
        let step = (max - min) / 65535.0;
        let table = |start: f64, step: f64| std::array::from_fn(|byte| (start + step * byte as f64).exp());
        Self { high: table(min, 256.0 * step), low: table(0.0, step) }
    }

    /// The coordinate that two bytes mean; an exponential turned into two products.
    pub fn coordinate(&self, high: u8, low: u8) -> f64 {
        let exp = self.high[usize::from(high)] * self.low[usize::from(low)];
        if exp >= 1.0 { exp - 1.0 } else { 1.0 - 1.0 / exp }
    }
}

impl Meta {
    /// The box that no mean can lie outside of, in the file's coordinates.
    pub fn bounds(&self) -> Bounds {
        let ends =
            [0, u8::MAX].map(|byte| DVec3::from_array(self.means.each_ref().map(|axis| axis.coordinate(byte, byte))));
        Bounds { min: ends[0].min(ends[1]), max: ends[0].max(ends[1]) }
    }
}

#[derive(Deserialize)]
struct Version {
    version: Option<serde_json::Value>,
}

impl Meta {
    /// Reads the `text` of the `meta.json` of the SOG at `path`.
    ///
    /// # Errors
    /// [`Error::Invalid`] when it is broken or promises nothing, [`Error::Unsupported`] when its version is unknown.
    pub fn parse(path: &Path, text: &[u8]) -> Result<Self> {
        let Version { version } = from_json(path, text)?;
        let meta = match version.as_ref().map_or(Some(1), serde_json::Value::as_u64) {
            Some(1) => Self::from(from_json::<MetaV1>(path, text)?),
            Some(2) => from_json::<MetaV2>(path, text)?.into_meta(path)?,
            _ => {
                let version = version.unwrap_or_default();
                return Err(Error::unsupported(path, format!("SOG version {version}; this program reads 1 and 2")));
            }
        };
        match meta.count {
            0 => Err(Error::invalid(path, "meta.json, count", "there are no Gaussians")),
            _ => Ok(meta),
        }
    }
}

fn from_json<'a, T: Deserialize<'a>>(path: &Path, text: &'a [u8]) -> Result<T> {
    serde_json::from_slice(text).map_err(|error| Error::invalid(path, "meta.json", error.to_string()))
}

#[derive(Deserialize)]
struct MetaV1 {
    means: MeansV1,
    scales: RangesV1<[f64; 3]>,
    quats: Quats,
    sh0: RangesV1<[f64; 4]>,
    #[serde(rename = "shN")]
    sh_n: Option<PaletteV1>,
}

#[derive(Deserialize)]
struct MeansV1 {
    /// Count, 3.
    shape: [usize; 2],
    #[serde(flatten)]
    means: Means,
}

#[derive(Deserialize)]
struct RangesV1<T> {
    mins: T,
    maxs: T,
    files: [String; 1],
}

#[derive(Deserialize)]
struct PaletteV1 {
    mins: f64,
    maxs: f64,
    files: [String; 2],
}

#[derive(Deserialize)]
struct MetaV2 {
    count: usize,
    means: Means,
    scales: CodebookV2,
    quats: Quats,
    sh0: CodebookV2,
    #[serde(rename = "shN")]
    sh_n: Option<PaletteV2>,
}

#[derive(Deserialize)]
struct Means {
    mins: [f64; 3],
    maxs: [f64; 3],
    files: [String; 2],
}

#[derive(Deserialize)]
struct Quats {
    files: [String; 1],
}

#[derive(Deserialize)]
struct CodebookV2 {
    codebook: Vec<Option<f64>>,
    files: [String; 1],
}

#[derive(Deserialize)]
struct PaletteV2 {
    count: usize,
    bands: u8,
    codebook: Vec<Option<f64>>,
    files: [String; 2],
}

impl Means {
    fn axes(&self) -> [LogAxis; 3] {
        std::array::from_fn(|i| LogAxis::new(self.mins[i], self.maxs[i]))
    }
}

impl FileNames {
    fn new(means: Means, Quats { files: [quats] }: Quats, [scales]: [String; 1], [sh0]: [String; 1]) -> Self {
        let [means_low, means_high] = means.files;
        Self { means_low, means_high, quats, scales, sh0 }
    }
}

impl From<MetaV1> for Meta {
    fn from(meta: MetaV1) -> Self {
        let even = |min: f64, max: f64| -> Table<f64> {
            std::array::from_fn(|byte| min + (max - min) * (byte as f64 / 255.0))
        };
        let colour = |c: usize| even(meta.sh0.mins[c], meta.sh0.maxs[c]);
        let palette = meta.sh_n.map(|palette| {
            let [centroids_file, labels_file] = palette.files;
            let values = even(palette.mins, palette.maxs).map(|value| value as f32);
            PaletteMeta { size: None, values, centroids_file, labels_file }
        });
        Self {
            version: 1,
            count: meta.means.shape[0],
            means: meta.means.means.axes(),
            scales: std::array::from_fn(|i| even(meta.scales.mins[i], meta.scales.maxs[i]).map(f64::exp)),
            colours: [0, 1, 2].map(|c| colour(c).map(|value| value as f32)),
            opacities: colour(3).map(|logit| 1.0 / (1.0 + (-logit).exp())),
            palette,
            files: FileNames::new(meta.means.means, meta.quats, meta.scales.files, meta.sh0.files),
        }
    }
}

impl MetaV2 {
    fn into_meta(self, path: &Path) -> Result<Meta> {
        let colours = codebook(path, "sh0", &self.sh0.codebook)?.map(|value| value as f32);
        let palette = self.sh_n.filter(|palette| palette.bands > 0).map(|palette| {
            if palette.bands > 3 {
                let what = format!("meta.json, shN.bands: {}; SOG version 2 has 1 to 3", palette.bands);
                return Err(Error::unsupported(path, what));
            }
            let [centroids_file, labels_file] = palette.files;
            let values = codebook(path, "shN", &palette.codebook)?.map(|value| value as f32);
            let size = Some((palette.count, palette.bands));
            Ok(PaletteMeta { size, values, centroids_file, labels_file })
        });
        Ok(Meta {
            version: 2,
            count: self.count,
            means: self.means.axes(),
            scales: [codebook(path, "scales", &self.scales.codebook)?.map(f64::exp); 3],
            colours: [colours; 3],
            opacities: std::array::from_fn(|byte| byte as f64 / 255.0),
            palette: palette.transpose()?,
            files: FileNames::new(self.means, self.quats, self.scales.files, self.sh0.files),
        })
    }
}

/// A codebook as a table. Bytes beyond a short codebook mean NaN, so that a Gaussian that uses one is dropped and counted.
///
/// Early writers left NaN, which JSON writes as null, in the first entry; the engine takes it to continue the others'
/// trend downwards.
fn codebook(path: &Path, property: &str, entries: &[Option<f64>]) -> Result<Table<f64>> {
    let fault = |what: String| Error::invalid(path, format!("meta.json, {property}.codebook"), what);
    if !(1..=256).contains(&entries.len()) {
        return Err(fault(format!("{} entries; there must be 1 to 256", entries.len())));
    }
    let mut table = [f64::NAN; 256];
    for (i, (value, &entry)) in table.iter_mut().zip(entries).enumerate() {
        *value = match (entry, entries) {
            (Some(entry), _) => entry,
            (None, [None, Some(second), .., Some(last)]) if i == 0 => second + (second - last) / 255.0,
            (None, _) => return Err(fault(format!("entry {i} is null"))),
        };
    }
    Ok(table)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_bits_divide_the_logarithmic_range_evenly() {
        let axis = LogAxis::new(-3.0, 5.0);
        for bits in [0_u16, 1, 255, 256, 24575, 24576, 30000, 65535] {
            let log = -3.0 + 8.0 * f64::from(bits) / 65535.0;
            let expected = log.signum() * log.abs().exp_m1();
            let [high, low] = bits.to_be_bytes();
            assert!((axis.coordinate(high, low) - expected).abs() < 1e-13 * (1.0 + expected.abs()), "{bits}");
        }
    }

    #[test]
    fn a_null_first_entry_continues_the_codebook_and_any_other_is_an_error() {
        let path = Path::new("a.sog");
        let mut entries: Vec<_> = (0..256).map(|i| Some(f64::from(i))).collect();
        entries[0] = None;
        let table = codebook(path, "scales", &entries).unwrap();
        assert!((table[0] - (1.0 - 254.0 / 255.0)).abs() < 1e-12 && table[255] == 255.0);
        entries[7] = None;
        assert!(codebook(path, "scales", &entries).unwrap_err().to_string().contains("scales.codebook: entry 7"));
    }
}
