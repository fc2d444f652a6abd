//! Whether a bake on disk is what its manifest says.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use exr::block::lines::LineRef;
use exr::block::reader::{ChunksReader, Reader};
use exr::prelude::SampleType;
use half::f16;
use image::ImageDecoder;

use super::{FileFormat, FileRecord, Layout, Manifest, PixelFormat, digest};
use crate::encode::exr::DISTANCE_CHANNEL;
use crate::job::MAX_FACE_SIZE;
use crate::{Error, Result};

/// Checks every file that the manifest at `path` lists: presence, size, hash, and that it opens with the declared size and
/// channels and holds finite values only.
///
/// Returns every problem found, none when all is well. Fails when the manifest itself cannot be read.
pub fn verify(path: &Path) -> Result<Vec<Error>> {
    let manifest = Manifest::read(path)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut problems = Vec::new();
    let mut ids = BTreeSet::new();
    // A placement has images of no probe; a bake has some of each.
    let has_images = manifest.probes.iter().any(|probe| !probe.files.is_empty());
    for (i, probe) in manifest.probes.iter().enumerate() {
        let place = |field: &str| format!("/probes/{i}{field}");
        if !ids.insert(&probe.id) {
            problems.push(Error::invalid(
                path,
                place("/id"),
                format!("'{}' is the id of an earlier probe too", probe.id),
            ));
        }
        if has_images && probe.files.is_empty() {
            problems.push(Error::invalid(path, place("/files"), "the probe has no files"));
        }
        for (k, record) in probe.files.iter().enumerate() {
            match check_record(folder, record) {
                Ok(file) => problems.extend(verify_file(&file, record)),
                Err(what) => problems.push(Error::invalid(path, place(&format!("/files/{k}")), what)),
            }
        }
    }
    Ok(problems)
}

/// Fails with the first problem that [`verify`] finds.
pub fn check(path: &Path) -> Result<()> {
    verify(path)?.into_iter().next().map_or(Ok(()), Err)
}

/// The file's path, when what the record says is sound by itself. The bound on its size also bounds what reading the file
/// may allocate.
fn check_record(folder: &Path, record: &FileRecord) -> std::result::Result<PathBuf, String> {
    for (width, height) in images(record) {
        if !has_layout(width, height, record.layout) {
            let shape = match record.layout {
                Layout::Strip => "a strip of six square faces",
                Layout::Latlong => "twice as wide as high",
                Layout::Face | Layout::Cube | Layout::Octahedral => "square",
            };
            return Err(format!("{width} x {height} pixels are not {shape}, or too large"));
        }
    }
    if record.mips.first().is_some_and(|mip| (mip.width, mip.height) != (record.width, record.height)) {
        return Err("the first mip is not of the file's size".into());
    }
    let path = record.path_in(folder);
    path.ok_or_else(|| format!("path '{}' does not stay in the manifest's folder", record.path))
}

fn has_layout(width: u32, height: u32, layout: Layout) -> bool {
    match layout {
        Layout::Strip => (1..=MAX_FACE_SIZE).contains(&width) && height == 6 * width,
        Layout::Face | Layout::Cube | Layout::Octahedral => (1..=MAX_FACE_SIZE).contains(&width) && height == width,
        Layout::Latlong => (1..=2 * MAX_FACE_SIZE).contains(&height) && width == 2 * height,
    }
}

/// Width and height of every image in a file: its mips, or the only one.
fn images(record: &FileRecord) -> Vec<(u32, u32)> {
    if record.mips.is_empty() {
        return vec![(record.width, record.height)];
    }
    record.mips.iter().map(|mip| (mip.width, mip.height)).collect()
}

fn verify_file(path: &Path, record: &FileRecord) -> Vec<Error> {
    let (bytes, blake3) = match digest(path) {
        Ok(digest) => digest,
        Err(error) => return vec![error],
    };
    let mut problems = Vec::new();
    if bytes != record.bytes {
        problems.push(Error::invalid(path, "size", format!("{bytes} bytes; the manifest says {}", record.bytes)));
    }
    if blake3 != record.blake3 {
        problems.push(Error::invalid(
            path,
            "content",
            format!("BLAKE3 is {blake3}; the manifest says {}", record.blake3),
        ));
    }
    let content = match record.format {
        FileFormat::Exr => verify_exr(path, record),
        FileFormat::Hdr | FileFormat::Png => verify_image(path, record),
        FileFormat::Ktx2 => verify_ktx2(path, record),
    };
    problems.extend(content.err());
    problems
}

/// Reads block by block, so that memory stays small whatever the file declares.
fn verify_exr(path: &Path, record: &FileRecord) -> Result<()> {
    let broken = |error: exr::error::Error| Error::invalid(path, "OpenEXR", error.to_string());
    let file = File::open(path).map_err(|source| Error::read(path, source))?;
    let reader = Reader::read_from_buffered(BufReader::new(file), false).map_err(broken)?;
    let expected = images(record);
    if reader.headers().len() != expected.len() {
        let what = format!("{} parts instead of {}", reader.headers().len(), expected.len());
        return Err(Error::invalid(path, "header", what));
    }
    for (header, &(width, height)) in reader.headers().iter().zip(&expected) {
        check_size(path, (header.layer_size.width(), header.layer_size.height()), (width, height))?;
        let channels = &header.channels.list;
        let names: Vec<String> = channels.iter().map(|channel| channel.name.to_string()).collect();
        if names != record.channels {
            let what = format!("channels {}; the manifest says {}", names.join(" "), record.channels.join(" "));
            return Err(Error::invalid(path, "header", what));
        }
        let sample_type = if record.pixel == PixelFormat::Half { SampleType::F16 } else { SampleType::F32 };
        for channel in channels.iter().filter(|channel| !channel.name.eq(DISTANCE_CHANNEL)) {
            if channel.sample_type != sample_type {
                let (name, found) = (&channel.name, channel.sample_type);
                let what = format!("channel {name} is {found:?}; the manifest says {:?}", record.pixel);
                return Err(Error::invalid(path, "header", what));
            }
        }
    }
    let parts: Vec<_> = reader.headers().iter().map(|header| header.channels.clone()).collect();
    let mut blocks = reader.all_chunks(false).map_err(broken)?.sequential_decompressor(false);
    while let Some(block) = blocks.decompress_next_block() {
        let block = block.map_err(broken)?;
        let Some(channels) = parts.get(block.index.layer) else {
            return Err(Error::invalid(path, "OpenEXR", "a block of no part"));
        };
        for line in block.lines(channels) {
            let channel = &channels.list[line.location.channel];
            if !is_finite(channel.sample_type, &line) {
                let place = format!("channel {}, row {}", channel.name, line.location.position.y());
                return Err(Error::invalid(path, place, "a value is not finite"));
            }
        }
    }
    Ok(())
}

fn check_size(path: &Path, found: (usize, usize), (width, height): (u32, u32)) -> Result<()> {
    if found == (width as usize, height as usize) {
        return Ok(());
    }
    let what = format!("{} x {} pixels; the manifest says {width} x {height}", found.0, found.1);
    Err(Error::invalid(path, "header", what))
}

/// Formats that hold finite values only.
fn verify_image(path: &Path, record: &FileRecord) -> Result<()> {
    let broken = |error: image::ImageError| Error::invalid(path, "image", error.to_string());
    let format = if record.format == FileFormat::Hdr { image::ImageFormat::Hdr } else { image::ImageFormat::Png };
    let file = File::open(path).map_err(|source| Error::read(path, source))?;
    let decoder = image::ImageReader::with_format(BufReader::new(file), format).into_decoder().map_err(broken)?;
    let (width, height) = decoder.dimensions();
    check_size(path, (width as usize, height as usize), (record.width, record.height))?;
    image::DynamicImage::from_decoder(decoder).map_err(broken).map(drop)
}

fn verify_ktx2(path: &Path, record: &FileRecord) -> Result<()> {
    let bytes = std::fs::read(path).map_err(|source| Error::read(path, source))?;
    let broken = |place: String, what: String| Error::invalid(path, place, what);
    let reader = ktx2::Reader::new(&bytes[..]).map_err(|error| broken("KTX2".into(), error.to_string()))?;
    let header = reader.header();
    check_size(path, (header.pixel_width as usize, header.pixel_height as usize), (record.width, record.height))?;
    let (format, texel_bytes) = match record.pixel {
        PixelFormat::Rgb9e5 => (ktx2::Format::E5B9G9R9_UFLOAT_PACK32, 4),
        _ => (ktx2::Format::R16G16B16A16_SFLOAT, 8),
    };
    if header.format != Some(format) {
        return Err(broken("header".into(), format!("{:?}; the manifest says {:?}", header.format, record.pixel)));
    }
    let images = images(record);
    if header.face_count != 6 || reader.levels().len() != images.len() {
        let what = format!(
            "{} faces and {} levels instead of 6 and {}",
            header.face_count,
            reader.levels().len(),
            images.len()
        );
        return Err(broken("header".into(), what));
    }
    for (i, (level, (width, height))) in reader.levels().zip(images).enumerate() {
        let place = || format!("level {i}");
        let length = 6 * u64::from(width) * u64::from(height) * texel_bytes;
        let decoder = ruzstd::decoding::StreamingDecoder::new(level.data);
        let mut texels = Vec::new();
        decoder
            .map_err(std::io::Error::other)
            // A byte more than it must have tells a level that is too long.
            .and_then(|decoder| decoder.take(length + 1).read_to_end(&mut texels))
            .map_err(|error| broken(place(), error.to_string()))?;
        if texels.len() as u64 != length {
            return Err(broken(place(), format!("{} bytes instead of {length}", texels.len())));
        }
        let is_finite = |half: &[u8]| f16::from_le_bytes([half[0], half[1]]).is_finite();
        if record.pixel == PixelFormat::Half && !texels.chunks_exact(2).all(is_finite) {
            return Err(broken(place(), "a value is not finite".into()));
        }
    }
    Ok(())
}

fn is_finite(sample_type: SampleType, line: &LineRef<'_>) -> bool {
    match sample_type {
        SampleType::F16 => line.read_samples::<f16>().flatten().all(f16::is_finite),
        SampleType::F32 => line.read_samples::<f32>().flatten().all(f32::is_finite),
        SampleType::U32 => true,
    }
}

#[cfg(test)]
mod tests {
    use exr::prelude::*;
    use glam::DVec3;

    use super::*;
    use crate::bake::ProbeStatistics;
    use crate::job::Job;
    use crate::manifest::{FILE_NAME, FileRole, Influence, MipRecord, ProbeRecord, ShRecord, TexelSampling};
    use crate::scene::SplatEncoding;
    use crate::scene::bounds::Bounds;

    /// A bake of one probe with faces of 4 pixels; `value` is one of its pixels.
    fn bake(folder: &Path, value: f32, change: impl FnOnce(&mut FileRecord)) -> PathBuf {
        let file = folder.join("radiance.exr");
        let pixel = move |position: Vec2<usize>| match position {
            Vec2(3, 20) => (f16::from_f32(value), f16::ONE, f16::ONE),
            _ => (f16::ONE, f16::ONE, f16::ONE),
        };
        Image::from_channels((4, 24), SpecificChannels::rgb(pixel)).write().to_file(&file).unwrap();
        let (bytes, blake3) = digest(&file).unwrap();
        let mut record = FileRecord {
            path: "radiance.exr".into(),
            role: FileRole::Radiance,
            format: FileFormat::Exr,
            layout: Layout::Strip,
            width: 4,
            height: 24,
            pixel: PixelFormat::Half,
            texel_sampling: TexelSampling::Center,
            channels: ["B", "G", "R"].map(String::from).into(),
            face: None,
            mips: Vec::new(),
            max_distance: None,
            bytes,
            blake3,
        };
        change(&mut record);
        let probe = ProbeRecord {
            id: "probe_000".into(),
            position: [0.0; 3],
            influence: Influence { min: [-1.0; 3], max: [1.0; 3], blend: [0.0; 6] },
            proxy: Bounds { min: DVec3::NEG_ONE, max: DVec3::ONE },
            priority: 0,
            files: vec![record],
            sh: ShRecord { degree: 2, basis: ShRecord::BASIS.into(), coefficients: vec![[0.0; 3]; 9], windowed: None },
            statistics: ProbeStatistics {
                mean_coverage: 1.0,
                distance: None,
                rays: 96,
                hidden_backs: None,
                surface_noise: None,
            },
            estimated_error: None,
        };
        let path = folder.join(FILE_NAME);
        Manifest::new(&Job::default(), SplatEncoding::SrgbDisplay, Vec::new(), vec![probe]).write(&path).unwrap();
        path
    }

    fn problems(value: f32, change: impl FnOnce(&mut FileRecord)) -> Vec<String> {
        let folder = tempfile::tempdir().unwrap();
        let path = bake(folder.path(), value, change);
        verify(&path).unwrap().iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_bake_as_written_has_no_problems() {
        assert_eq!(problems(0.5, |_| ()), [""; 0]);
    }

    #[test]
    fn every_difference_from_the_manifest_is_found() {
        type Fault = (&'static str, fn(&mut FileRecord));
        let faults: [Fault; 13] = [
            ("channel B is F16; the manifest says Float", |record| record.pixel = PixelFormat::Float),
            ("cannot be read", |record| record.path = "absent.exr".into()),
            ("does not stay in the manifest's folder", |record| record.path = "../radiance.exr".into()),
            ("does not stay in the manifest's folder", |record| record.path = "/radiance.exr".into()),
            ("the manifest says 1", |record| record.bytes = 1),
            ("BLAKE3 is", |record| record.blake3 = "0".repeat(64)),
            ("4 x 24 pixels; the manifest says 8 x 48", |record| (record.width, record.height) = (8, 48)),
            ("channels B G R; the manifest says A B G R", |record| record.channels.insert(0, "A".into())),
            ("4 x 24 pixels are not square", |record| record.layout = Layout::Cube),
            ("1 parts instead of 2", |record| {
                record.mips = vec![MipRecord { roughness: 0.0, width: 4, height: 24 }; 2]
            }),
            ("the first mip is not", |record| record.mips = vec![MipRecord { roughness: 0.0, width: 2, height: 12 }]),
            ("radiance.exr: image", |record| record.format = FileFormat::Png),
            ("radiance.exr: KTX2", |record| record.format = FileFormat::Ktx2),
        ];
        for (expected, change) in faults {
            let found = problems(0.5, change);
            assert!(found.len() == 1 && found[0].contains(expected), "{expected}: {found:?}");
        }
    }

    #[test]
    fn a_value_that_is_not_finite_is_found_with_its_row() {
        for value in [f32::NAN, f32::INFINITY] {
            let found = problems(value, |_| ());
            assert!(found.len() == 1 && found[0].contains("channel R, row 20: a value is not finite"), "{found:?}");
        }
    }

    #[test]
    fn a_truncated_image_is_three_problems_and_no_panic() {
        let folder = tempfile::tempdir().unwrap();
        let path = bake(folder.path(), 0.5, |_| ());
        let file = folder.path().join("radiance.exr");
        let content = std::fs::read(&file).unwrap();
        for length in 0..content.len() {
            std::fs::write(&file, &content[..length]).unwrap();
            assert_eq!(verify(&path).unwrap().len(), 3, "{length} bytes");
        }
    }
}
