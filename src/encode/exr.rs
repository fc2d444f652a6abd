//! OpenEXR: what a probe's radiance is stored in.
//!
//! The strip has no `envmap` attribute: OpenEXR defines that one with texels on the edges of the faces (ImfEnvmap.h),
//! and these have their texels at pixel centres.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::ops::Range;
use std::path::Path;

use exr::meta::attribute::EnvironmentMap;
use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image as ExrImage, ImageAttributes,
    IntegerBounds, Layer, LayerAttributes, LineOrder, ReadChannels, ReadLayers, Vec2, WritableImage, f16, read,
};
use glam::Vec3;

use super::file::write_bytes_atomically;
use crate::bake::Cubemap;
use crate::error::{Error, Result};
use crate::job::Pixel;

/// File name of a probe's cubemap in the probe's folder.
pub const RADIANCE_FILE: &str = "radiance.exr";

/// Name of the distance channel: OpenEXR's name for the distance from the viewer.
pub const DISTANCE_CHANNEL: &str = "Z";

/// Most bytes of pixels that a file may claim per byte of its own: PIZ packs a flat block this well.
const MAX_EXPANSION: u64 = 1 << 16;

/// Most bytes of pixels, as stored, that are read.
const MAX_PIXEL_BYTES: u64 = 8 << 30;

/// Writes a cubemap as a vertical strip: `face_size` wide and `6 face_size` high, faces in the order +X -X +Y -Y +Z -Z.
///
/// Channels R, G, B (linear Rec.709, premultiplied) and A (coverage) as `pixel`; Z (metres, always float) when the cubemap
/// has distances. Returns and fails as [`write_parts`].
pub fn write_cubemap(path: &Path, cubemap: &Cubemap, pixel: Pixel) -> Result<usize> {
    let face_size = cubemap.face_size as usize;
    write_parts(path, vec![Part::cubemap(cubemap, 0..6 * face_size, pixel)])
}

/// An image in an EXR file.
#[derive(Debug, Clone)]
pub struct Part {
    /// Needed where a file has several, each another.
    pub name: Option<String>,
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Name, storage and values, row by row.
    pub channels: Vec<(&'static str, Pixel, Vec<f32>)>,
    /// Whether this is a strip of cube faces with texels on the edges: then it gets OpenEXR's `envmap` attribute.
    pub is_envmap: bool,
}

impl Part {
    /// Some rows of a cubemap's strip, with the channels of [`write_cubemap`].
    pub fn cubemap(cubemap: &Cubemap, rows: Range<usize>, pixel: Pixel) -> Self {
        let width = cubemap.face_size as usize;
        let texels = rows.start * width..rows.end * width;
        let values = |index: usize| cubemap.texels[texels.clone()].iter().map(|texel| texel[index]).collect();
        let mut channels: Vec<_> =
            ["R", "G", "B", "A"].into_iter().zip(0..).map(|(name, index)| (name, pixel, values(index))).collect();
        if let Some(distance) = &cubemap.distance {
            channels.push((DISTANCE_CHANNEL, Pixel::Float, distance[texels.clone()].to_vec()));
        }
        Self { name: None, width, height: rows.len(), channels, is_envmap: false }
    }

    /// Linear RGB, row by row.
    pub fn rgb(width: usize, pixels: &[Vec3], pixel: Pixel) -> Self {
        let values = |axis: usize| pixels.iter().map(|colour| colour[axis]).collect();
        let channels = ["R", "G", "B"].into_iter().zip(0..).map(|(name, axis)| (name, pixel, values(axis))).collect();
        Self { name: None, width, height: pixels.len() / width, channels, is_envmap: false }
    }
}

/// Writes an EXR file: scan lines, PIZ. The same parts give the same bytes.
///
/// Half holds no more than 65504 in magnitude: larger values are written as that, never as infinity. Returns how many
/// were. Fails with [`Error::Write`]; an earlier file is then untouched.
pub fn write_parts(path: &Path, parts: Vec<Part>) -> Result<usize> {
    let mut clamped = 0;
    // Half's largest magnitude, in f32.
    let limit = f16::MAX.to_f32();
    let mut samples = |(name, pixel, values): (&str, Pixel, Vec<f32>)| {
        let samples = match pixel {
            Pixel::Float => FlatSamples::F32(values),
            Pixel::Half => {
                clamped += values.iter().filter(|value| value.abs() > limit).count();
                FlatSamples::F16(values.iter().map(|value| f16::from_f32(value.clamp(-limit, limit))).collect())
            }
        };
        AnyChannel::new(name, samples)
    };
    // An increasing line order, and no more than one custom attribute, keep the bytes the same from run to run.
    let encoding =
        Encoding { compression: Compression::PIZ, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let layers: Vec<_> = parts
        .into_iter()
        .map(|part| {
            let attributes = LayerAttributes {
                layer_name: part.name.map(|name| name.as_str().into()),
                environment_map: part.is_envmap.then_some(EnvironmentMap::Cube),
                ..LayerAttributes::default()
            };
            let channels = AnyChannels::sort(part.channels.into_iter().map(&mut samples).collect());
            Layer::new((part.width, part.height), attributes, encoding, channels)
        })
        .collect();
    // The first part is the largest.
    let size = layers.first().map_or(Vec2(0, 0), |layer| layer.size);
    let image = ExrImage::from_layers(ImageAttributes::new(IntegerBounds::new(Vec2(0, 0), size)), layers);
    // Probes are encoded in parallel already, and the crate would start a thread pool for each file.
    write_bytes_atomically(path, |writer| image.write().non_parallel().to_buffered(writer).map_err(io_error))?;
    Ok(clamped)
}

fn io_error(error: exr::error::Error) -> std::io::Error {
    match error {
        exr::error::Error::Io(source) => source,
        other => std::io::Error::other(other.to_string()),
    }
}

/// The channels of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// Pixels per row.
    pub width: usize,
    /// Rows; row 0 is the top.
    pub height: usize,
    /// Values by channel name, row by row.
    pub channels: BTreeMap<String, Vec<f32>>,
}

/// Reads all channels of the first layer of an EXR file, the largest level of those with several.
///
/// Fails with [`Error::Read`], with [`Error::Invalid`] when the file is broken or claims more pixels than a file of its
/// size can hold, and with [`Error::Unsupported`] for deep data, subsampled channels and over 8 GiB of pixels.
pub fn read_exr(path: &Path) -> Result<Image> {
    let file = File::open(path).map_err(|source| Error::read(path, source))?;
    let file_bytes = file.metadata().map_err(|source| Error::read(path, source))?.len();
    let mut reader = BufReader::new(file);
    check_claims(path, &mut reader, file_bytes)?;
    reader.rewind().map_err(|source| Error::read(path, source))?;
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(reader)
        .map_err(|error| read_error(path, error))?;
    let layer = image.layer_data;
    let (width, height) = (layer.size.width(), layer.size.height());
    let mut channels = BTreeMap::new();
    for channel in layer.channel_data.list {
        let name = channel.name.to_string();
        let values: Vec<f32> = match channel.sample_data {
            FlatSamples::F32(values) => values,
            other => other.values_as_f32().collect(),
        };
        if values.len() != width * height {
            return Err(Error::unsupported(path, format!("channel {name} is subsampled; store it in full")));
        }
        channels.insert(name, values);
    }
    Ok(Image { width, height, channels })
}

/// Fails when the headers ask for more memory than the file can fill.
fn check_claims(path: &Path, reader: &mut (impl Read + Seek), file_bytes: u64) -> Result<()> {
    let meta = exr::meta::MetaData::read_from_buffered(reader, false).map_err(|error| read_error(path, error))?;
    let claimed = meta.headers.iter().try_fold(0_u64, |sum, header| {
        let pixel_bytes: u64 = header.channels.list.iter().map(|c| c.sample_type.bytes_per_sample() as u64).sum();
        let pixels = (header.layer_size.width() as u64).checked_mul(header.layer_size.height() as u64)?;
        sum.checked_add(pixels.checked_mul(pixel_bytes)?)
    });
    match claimed {
        Some(claimed) if claimed <= file_bytes.saturating_mul(MAX_EXPANSION) => {
            if claimed <= MAX_PIXEL_BYTES {
                return Ok(());
            }
            Err(Error::unsupported(path, format!("{claimed} bytes of pixels; the most is {MAX_PIXEL_BYTES}")))
        }
        _ => Err(Error::invalid(path, "header", format!("the image cannot fit a file of {file_bytes} bytes"))),
    }
}

fn read_error(path: &Path, error: exr::error::Error) -> Error {
    match error {
        exr::error::Error::Io(source) => Error::read(path, source),
        exr::error::Error::NotSupported(what) => Error::unsupported(path, what),
        other => Error::invalid(path, "OpenEXR data", other.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::Face;

    /// Every channel of every texel differs; distances are in quarter metres.
    fn numbered(face_size: u32, distance: bool) -> Cubemap {
        let len = 6 * face_size.pow(2);
        let texels = (0..len).map(|i| [i as f32, -(i as f32), 0.5, (i % 2) as f32]).collect();
        Cubemap { face_size, texels, distance: distance.then(|| (0..len).map(|i| i as f32 / 4.0).collect()) }
    }

    fn round_trip(cubemap: &Cubemap, pixel: Pixel) -> (Image, usize) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(RADIANCE_FILE);
        let clamped = write_cubemap(&path, cubemap, pixel).unwrap();
        (read_exr(&path).unwrap(), clamped)
    }

    #[test]
    fn values_that_both_types_hold_come_back_exactly() {
        let cubemap = numbered(12, true);
        for pixel in [Pixel::Half, Pixel::Float] {
            let (image, clamped) = round_trip(&cubemap, pixel);
            assert_eq!((image.width, image.height, clamped), (12, 72, 0));
            assert!(image.channels.keys().eq(["A", "B", "G", "R", "Z"]));
            for (index, name) in ["R", "G", "B", "A"].into_iter().enumerate() {
                let expected: Vec<f32> = cubemap.texels.iter().map(|texel| texel[index]).collect();
                assert_eq!(image.channels[name], expected, "{name} as {pixel:?}");
            }
            assert_eq!(Some(&image.channels["Z"]), cubemap.distance.as_ref());
        }
    }

    #[test]
    fn a_cubemap_without_distances_has_no_distance_channel() {
        assert!(round_trip(&numbered(2, false), Pixel::Half).0.channels.keys().eq(["A", "B", "G", "R"]));
    }

    #[test]
    fn half_clamps_what_it_cannot_hold_and_counts_it() {
        let mut cubemap = numbered(1, false);
        cubemap.texels[0] = [65504.0, 65519.0, 1e9, f32::INFINITY];
        cubemap.texels[1][0] = -1e9;
        let (image, clamped) = round_trip(&cubemap, Pixel::Half);
        assert_eq!(clamped, 4);
        for name in ["R", "G", "B", "A"] {
            assert_eq!(image.channels[name][0], 65504.0);
        }
        assert_eq!(image.channels["R"][1], -65504.0);
        assert_eq!(round_trip(&cubemap, Pixel::Float).0.channels["B"][0], 1e9);
    }

    #[test]
    fn writing_twice_gives_the_same_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let [a, b] = ["a.exr", "b.exr"].map(|name| {
            let path = folder.path().join(name);
            write_cubemap(&path, &numbered(40, true), Pixel::Half).unwrap();
            std::fs::read(path).unwrap()
        });
        assert!(a == b);
    }

    #[test]
    fn broken_files_are_errors_and_never_panics() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("broken.exr");
        write_cubemap(&path, &numbered(4, true), Pixel::Half).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for end in (0..whole.len()).step_by(3) {
            std::fs::write(&path, &whole[..end]).unwrap();
            assert!(matches!(read_exr(&path), Err(Error::Invalid { .. })), "cut at {end}");
        }
        for (i, flip) in (0..whole.len()).zip([0xff, 0x80, 0x01].into_iter().cycle()).step_by(2) {
            let mut bytes = whole.clone();
            bytes[i] ^= flip;
            std::fs::write(&path, &bytes).unwrap();
            // Pixel data has no checksum, so that a changed byte may still give an image.
            if let Ok(image) = read_exr(&path) {
                assert!(image.channels.values().all(|values| values.len() == image.width * image.height));
            }
        }
    }

    #[test]
    fn a_header_that_claims_more_than_the_file_holds_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("liar.exr");
        write_cubemap(&path, &numbered(4, false), Pixel::Half).unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        let name = b"dataWindow\0box2i\0\x10\0\0\0";
        let start = bytes.windows(name.len()).position(|window| window == name).unwrap() + name.len();
        bytes[start + 8..start + 16].copy_from_slice(&[0xff, 0xff, 0xff, 0x0f, 0xff, 0xff, 0xff, 0x0f]);
        std::fs::write(&path, &bytes).unwrap();
        let error = read_exr(&path).unwrap_err();
        assert!(matches!(&error, Error::Invalid { what, .. } if what.contains("cannot fit")), "{error}");
    }

    /// OpenEXR's own `exrenvmap` wrote the file: its colour is (direction + 1) / 2 of the unit direction.
    #[test]
    fn faces_lie_as_openexr_lays_them() {
        let data = std::env::var_os("SPLATPROBE_DATA")
            .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), Into::into);
        let path = data.join("openexr_direction_cube_64.exr");
        if !path.exists() {
            println!("skipped: {} is absent", path.display());
            return;
        }
        let image = read_exr(&path).unwrap();
        let size = image.width;
        assert_eq!(image.height, 6 * size);
        for face in Face::ALL {
            for (x, y) in (0..size).flat_map(|y| (0..size).map(move |x| (x, y))) {
                // OpenEXR's texels are edge-inclusive: the image point of texel i is at i / (n - 1).
                let point = |i: usize| i as f64 / (size - 1) as f64;
                let expected = face.direction(1, point(x), point(y)).normalize();
                let pixel = (face as usize * size + y) * size + x;
                let colour = ["R", "G", "B"].map(|name| f64::from(image.channels[name][pixel]));
                let direction = (glam::DVec3::from(colour) * 2.0 - 1.0).normalize();
                let angle = direction.angle_between(expected).to_degrees();
                assert!(angle < 0.1, "{face:?} {x},{y}: {direction} instead of {expected}");
            }
        }
    }
}
