//! How much two images, or two bakes, differ.
//!
//! Numbers are over the channels R, G and B. Linear means the values as stored; display means what a screen shows of
//! them: clamped to [0, 1] and sRGB-encoded. FLIP (Andersson et al. 2020, doi 10.1145/3406183; LDR-FLIP of version 1.7)
//! estimates what a viewer notices when flipping between the two, at its default of 67 pixels per degree.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use flip_rs::{DEFAULT_PPD, RgbImage, ldr_flip};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::encode::exr::{Image, RADIANCE_FILE, read_exr};
use crate::error::{Error, Result};
use crate::filter::RgbCubemap;
use crate::scene::LinearRgb;
use crate::scene::colour::linear_to_srgb;

/// How far below a bake's folder its probes' folders are looked for.
const MAX_DEPTH: usize = 2;

/// Norms of the difference of two sets of values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub struct ErrorNorms {
    /// Root of the mean squared difference.
    pub rmse: f64,
    /// Largest difference.
    pub max_abs: f64,
    /// Peak signal-to-noise ratio for a peak of 1, in decibels: `-20 log10(rmse)`; none when nothing differs.
    pub psnr_db: Option<f64>,
}

impl ErrorNorms {
    fn new(mean_square: f64, max_abs: f64) -> Self {
        let rmse = mean_square.sqrt();
        Self { rmse, max_abs, psnr_db: (rmse > 0.0).then(|| -20.0 * rmse.log10()) }
    }

    fn between(reference: &[[f32; 3]], test: &[[f32; 3]]) -> Self {
        let values = |pixels: &[[f32; 3]]| pixels.as_flattened().iter().map(|&value| f64::from(value)).collect();
        let (reference, test): (Vec<f64>, Vec<f64>) = (values(reference), values(test));
        let differences = || reference.iter().zip(&test).map(|(a, b)| (a - b).abs());
        let mean_square = differences().map(|d| d * d).sum::<f64>() / reference.len() as f64;
        Self::new(mean_square, differences().fold(0.0, f64::max))
    }

    /// Norms over several sets; `weights` are shares of all values and sum to 1.
    pub(crate) fn pooled(norms: impl Iterator<Item = Self> + Clone, weights: &[f64]) -> Self {
        let mean_square = norms.clone().zip(weights).map(|(norms, weight)| norms.rmse.powi(2) * weight).sum();
        Self::new(mean_square, norms.map(|norms| norms.max_abs).fold(0.0, f64::max))
    }
}

/// How much an image differs from a reference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub struct ImageError {
    /// Pixels compared.
    pub pixels: u64,
    /// Of linear values, unclamped.
    pub linear: ErrorNorms,
    /// Of sRGB-encoded values, clamped to [0, 1].
    pub display: ErrorNorms,
    /// Mean FLIP, 0 to 1. Of a strip of six square faces each face is judged by itself.
    pub flip: f64,
}

/// How much a probe of a bake differs from its counterpart.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub struct ProbeError {
    /// The probe's folder, relative to the bake's.
    pub probe: String,
    /// The difference.
    #[serde(flatten)]
    pub error: ImageError,
}

/// How much a bake differs from a reference.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub struct BakeError {
    /// Over all pixels of all probes in both bakes.
    pub overall: ImageError,
    /// Each probe that both bakes have, by name.
    pub probes: Vec<ProbeError>,
    /// Probes that the test does not have.
    pub only_in_reference: Vec<String>,
    /// Probes that the reference does not have.
    pub only_in_test: Vec<String>,
}

/// Compares two EXR files.
///
/// Fails with [`Error::Request`] when their sizes differ, [`Error::Invalid`] when one has no R, G or B or holds a value
/// that is not finite, and the errors of [`read_exr`].
pub fn compare_images(reference: &Path, test: &Path) -> Result<ImageError> {
    let [reference_image, test_image] = [read_exr(reference)?, read_exr(test)?];
    let sizes = [&reference_image, &test_image].map(|image| (image.width, image.height));
    if sizes[0] != sizes[1] {
        let [(aw, ah), (bw, bh)] = sizes;
        let why = format!("{aw} x {ah} pixels, but {} has {bw} x {bh}; only equal sizes compare", test.display());
        return Err(Error::request(reference.display().to_string(), why));
    }
    let (width, height) = sizes[0];
    let linear = [rgb(reference, &reference_image)?, rgb(test, &test_image)?];
    image_error(&linear, width, height).map_err(|error| Error::unsupported(test, error.to_string()))
}

/// Compares two cubemaps in memory.
///
/// Fails with [`Error::Request`] when their sizes differ.
pub fn compare_cubemaps(reference: &RgbCubemap, test: &RgbCubemap) -> Result<ImageError> {
    let [size, test_size] = [reference, test].map(|cubemap| cubemap.size() as usize);
    if size != test_size {
        return Err(Error::request("cubemap", format!("faces of {size} and of {test_size} texels do not compare")));
    }
    let pixels = |cubemap: &RgbCubemap| cubemap.texels().iter().map(|texel| texel.to_array()).collect::<Vec<_>>();
    image_error(&[pixels(reference), pixels(test)], size, 6 * size)
        .map_err(|error| Error::request("cubemap", error.to_string()))
}

/// Norms of what a screen shows of colours that are no image. There is at least one, and as many in both.
pub fn compare_colours(reference: &[LinearRgb], test: &[LinearRgb]) -> ErrorNorms {
    let shown =
        |colours: &[LinearRgb]| displayed(&colours.iter().map(|colour| colour.0.to_array()).collect::<Vec<_>>());
    ErrorNorms::between(&shown(reference), &shown(test))
}

fn image_error(
    linear: &[Vec<[f32; 3]>; 2],
    width: usize,
    height: usize,
) -> std::result::Result<ImageError, flip_rs::FlipError> {
    let display = linear.each_ref().map(|pixels| displayed(pixels));
    Ok(ImageError {
        pixels: linear[0].len() as u64,
        linear: ErrorNorms::between(&linear[0], &linear[1]),
        display: ErrorNorms::between(&display[0], &display[1]),
        flip: mean_flip(&display, width, height)?,
    })
}

/// What a screen shows.
fn displayed(pixels: &[[f32; 3]]) -> Vec<[f32; 3]> {
    pixels.iter().map(|pixel| pixel.map(|value| linear_to_srgb(value).clamp(0.0, 1.0))).collect()
}

/// Compares two bakes, each given by its folder or its manifest, probe by probe: folders of the same name, up to two
/// levels down, that hold a [`RADIANCE_FILE`].
///
/// Fails with [`Error::Request`] when they have no probe in common, [`Error::Read`] when a folder cannot be listed, and
/// the errors of [`compare_images`].
pub fn compare_bakes(reference: &Path, test: &Path) -> Result<BakeError> {
    let [mut reference_probes, mut test_probes] = [probe_files(reference)?, probe_files(test)?];
    let only_in_reference: Vec<String> =
        reference_probes.extract_if(.., |name, _| !test_probes.contains_key(name)).map(|(name, _)| name).collect();
    let only_in_test: Vec<String> =
        test_probes.extract_if(.., |name, _| !reference_probes.contains_key(name)).map(|(name, _)| name).collect();
    let probes = reference_probes
        .into_iter()
        .zip(test_probes.values())
        .map(|((probe, reference), test)| Ok(ProbeError { probe, error: compare_images(&reference, test)? }));
    let probes = probes.collect::<Result<Vec<_>>>()?;
    let pixels: u64 = probes.iter().map(|probe| probe.error.pixels).sum();
    if pixels == 0 {
        let why = format!("no probe folder with a {RADIANCE_FILE} in common with {}", test.display());
        return Err(Error::request(reference.display().to_string(), why));
    }
    let weights: Vec<f64> = probes.iter().map(|probe| probe.error.pixels as f64 / pixels as f64).collect();
    let overall = ImageError {
        pixels,
        linear: ErrorNorms::pooled(probes.iter().map(|probe| probe.error.linear), &weights),
        display: ErrorNorms::pooled(probes.iter().map(|probe| probe.error.display), &weights),
        flip: probes.iter().zip(&weights).map(|(probe, weight)| probe.error.flip * weight).sum(),
    };
    Ok(BakeError { overall, probes, only_in_reference, only_in_test })
}

/// The image's colours; fails unless it has them all and all are finite.
fn rgb(path: &Path, image: &Image) -> Result<Vec<[f32; 3]>> {
    let mut pixels = vec![[0.0; 3]; image.width * image.height];
    for (index, name) in ["R", "G", "B"].into_iter().enumerate() {
        let Some(values) = image.channels.get(name) else {
            return Err(Error::invalid(
                path,
                "channels",
                format!("there is no channel {name}; R, G and B are compared"),
            ));
        };
        for (i, (pixel, &value)) in pixels.iter_mut().zip(values).enumerate() {
            if !value.is_finite() {
                let place = format!("channel {name}, column {}, row {}", i % image.width, i / image.width);
                return Err(Error::invalid(path, place, format!("{value} is not finite")));
            }
            pixel[index] = value;
        }
    }
    Ok(pixels)
}

fn mean_flip(
    display: &[Vec<[f32; 3]>; 2],
    width: usize,
    height: usize,
) -> std::result::Result<f64, flip_rs::FlipError> {
    // Faces that touch in a strip do not touch in the world, and FLIP looks at neighbourhoods.
    let face_height = if height == 6 * width { width } else { height };
    let face_len = width * face_height;
    let [mut reference, mut test] = display.each_ref().map(|pixels| pixels.chunks_exact(face_len));
    let mut sum = 0.0;
    while let (Some(reference), Some(test)) = (reference.next(), test.next()) {
        let image = |pixels: &[[f32; 3]]| RgbImage::new(width, face_height, pixels.as_flattened().to_vec());
        let map = ldr_flip(&image(reference)?, &image(test)?, DEFAULT_PPD)?;
        sum += map.pixels().iter().map(|&error| f64::from(error)).sum::<f64>();
    }
    Ok(sum / (width * height) as f64)
}

/// Radiance files of a bake by their folders' names relative to it, with `/` between levels.
fn probe_files(bake: &Path) -> Result<BTreeMap<String, PathBuf>> {
    let folder = if bake.is_file() { bake.parent().unwrap_or(bake) } else { bake };
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let mut files = BTreeMap::new();
    let mut pending = vec![(folder.to_path_buf(), String::new(), 0)];
    while let Some((folder, name, depth)) = pending.pop() {
        for entry in std::fs::read_dir(&folder).map_err(|source| Error::read(&folder, source))? {
            let path = entry.map_err(|source| Error::read(&folder, source))?.path();
            if !path.is_dir() || depth == MAX_DEPTH {
                continue;
            }
            let last = path.file_name().unwrap_or_default().to_string_lossy();
            let name = if name.is_empty() { last.into_owned() } else { format!("{name}/{last}") };
            let radiance = path.join(RADIANCE_FILE);
            if radiance.is_file() {
                files.insert(name, radiance);
            } else {
                pending.push((path, name, depth + 1));
            }
        }
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::Cubemap;
    use crate::encode::exr::write_cubemap;
    use crate::job::Pixel;

    fn write(path: &Path, texel: impl Fn(usize) -> f32) {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let texels = (0..6 * 64).map(|i| [texel(i), texel(i), texel(i), 1.0]).collect();
        write_cubemap(path, &Cubemap { face_size: 8, texels, distance: None }, Pixel::Float).unwrap();
    }

    #[test]
    fn equal_images_have_no_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        write(&path, |i| i as f32 / 50.0);
        let error = compare_images(&path, &path).unwrap();
        let none = ErrorNorms { rmse: 0.0, max_abs: 0.0, psnr_db: None };
        assert_eq!(error, ImageError { pixels: 384, linear: none, display: none, flip: 0.0 });
    }

    #[test]
    fn norms_agree_with_their_closed_forms() {
        let folder = tempfile::tempdir().unwrap();
        let [a, b] = ["a.exr", "b.exr"].map(|name| folder.path().join(name));
        write(&a, |_| 0.0);
        // A quarter of the pixels is 0.5 off; sRGB(0.5) is 0.735357.
        write(&b, |i| if i % 4 == 0 { 0.5 } else { 0.0 });
        let error = compare_images(&a, &b).unwrap();
        assert!((error.linear.rmse - 0.25).abs() < 1e-12);
        assert_eq!(error.linear.max_abs, 0.5);
        assert!((error.linear.psnr_db.unwrap() - 20.0 * 4.0_f64.log10()).abs() < 1e-9);
        assert!((error.display.rmse - 0.735_357 / 2.0).abs() < 1e-6);
        assert!((error.display.max_abs - 0.735_357).abs() < 1e-6);
        assert!(error.flip > 0.05 && error.flip < 1.0, "{}", error.flip);
    }

    #[test]
    fn values_above_white_differ_in_linear_light_only() {
        let folder = tempfile::tempdir().unwrap();
        let [a, b] = ["a.exr", "b.exr"].map(|name| folder.path().join(name));
        write(&a, |_| 2.0);
        write(&b, |_| 5.0);
        let error = compare_images(&a, &b).unwrap();
        assert!((error.linear.rmse - 3.0).abs() < 1e-12);
        assert_eq!((error.display.max_abs, error.flip), (0.0, 0.0));
    }

    #[test]
    fn black_against_white_is_the_largest_flip() {
        let folder = tempfile::tempdir().unwrap();
        let [a, b] = ["a.exr", "b.exr"].map(|name| folder.path().join(name));
        write(&a, |_| 0.0);
        write(&b, |_| 1.0);
        let flip = compare_images(&a, &b).unwrap().flip;
        assert!(flip > 0.9 && flip <= 1.0, "{flip}");
    }

    #[test]
    fn values_that_are_not_finite_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        write(&path, |i| if i == 19 { f32::NAN } else { 0.0 });
        let error = compare_images(&path, &path).unwrap_err();
        assert!(matches!(&error, Error::Invalid { place, .. } if place == "channel R, column 3, row 2"), "{error}");
    }

    #[test]
    fn bakes_are_compared_by_probe_name_and_pooled() {
        let folder = tempfile::tempdir().unwrap();
        let [a, b] = ["a", "b"].map(|name| folder.path().join(name));
        for probe in ["probe_000", "probe_001", "probe_002"] {
            write(&a.join("probes").join(probe).join(RADIANCE_FILE), |_| 0.5);
        }
        for (probe, value) in [("probe_001", 0.9), ("probe_002", 0.8), ("probe_003", 0.0)] {
            write(&b.join("probes").join(probe).join(RADIANCE_FILE), |_| value);
        }
        std::fs::write(a.join("manifest.json"), "{}").unwrap();
        let error = compare_bakes(&a.join("manifest.json"), &b).unwrap();
        assert_eq!(error.only_in_reference, ["probes/probe_000"]);
        assert_eq!(error.only_in_test, ["probes/probe_003"]);
        let rmse: Vec<f64> = error.probes.iter().map(|probe| probe.error.linear.rmse).collect();
        assert!((rmse[0] - 0.4).abs() < 1e-6 && (rmse[1] - 0.3).abs() < 1e-6);
        let pooled = ((0.4_f64.powi(2) + 0.3_f64.powi(2)) / 2.0).sqrt();
        assert!((error.overall.linear.rmse - pooled).abs() < 1e-6);
        assert!((error.overall.linear.max_abs - 0.4).abs() < 1e-6);
        assert_eq!(error.overall.pixels, 2 * 384);
    }

    #[test]
    fn bakes_without_a_common_probe_are_a_request_error() {
        let folder = tempfile::tempdir().unwrap();
        let result = compare_bakes(folder.path(), folder.path());
        assert!(matches!(result, Err(Error::Request { .. })), "{result:?}");
        let missing = folder.path().join("missing");
        assert!(matches!(compare_bakes(&missing, &missing), Err(Error::Read { .. })));
    }
}
