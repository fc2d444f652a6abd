//! Whether a bake on disk is what its manifest says.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use exr::block::lines::LineRef;
use exr::block::reader::{ChunksReader, Reader};
use exr::prelude::SampleType;
use half::f16;

use super::{FileRecord, Manifest, digest};
use crate::encode::exr::DISTANCE_CHANNEL;
use crate::job::{MAX_FACE_SIZE, Pixel};
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
    for (i, probe) in manifest.probes.iter().enumerate() {
        let place = |field: &str| format!("/probes/{i}{field}");
        if !ids.insert(&probe.id) {
            problems.push(Error::invalid(
                path,
                place("/id"),
                format!("'{}' is the id of an earlier probe too", probe.id),
            ));
        }
        if probe.files.is_empty() {
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

/// The file's path, when what the record says is sound by itself. The bound on its size also bounds what reading the file
/// may allocate.
fn check_record(folder: &Path, record: &FileRecord) -> std::result::Result<PathBuf, String> {
    if !(1..=MAX_FACE_SIZE).contains(&record.width) || record.height != 6 * record.width {
        return Err(format!("{} x {} pixels are not a strip of six square faces", record.width, record.height));
    }
    let path = record.path_in(folder);
    path.ok_or_else(|| format!("path '{}' does not stay in the manifest's folder", record.path))
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
    problems.extend(verify_exr(path, record).err());
    problems
}

/// Reads block by block, so that memory stays small whatever the file declares.
fn verify_exr(path: &Path, record: &FileRecord) -> Result<()> {
    let broken = |error: exr::error::Error| Error::invalid(path, "OpenEXR", error.to_string());
    let file = File::open(path).map_err(|source| Error::read(path, source))?;
    let reader = Reader::read_from_buffered(BufReader::new(file), false).map_err(broken)?;
    let [header] = reader.headers() else {
        return Err(Error::invalid(path, "header", format!("{} parts instead of 1", reader.headers().len())));
    };
    let (width, height) = (header.layer_size.width(), header.layer_size.height());
    if (width, height) != (record.width as usize, record.height as usize) {
        let what = format!("{width} x {height} pixels; the manifest says {} x {}", record.width, record.height);
        return Err(Error::invalid(path, "header", what));
    }
    let channels = header.channels.clone();
    let names: Vec<String> = channels.list.iter().map(|channel| channel.name.to_string()).collect();
    if names != record.channels {
        let what = format!("channels {}; the manifest says {}", names.join(" "), record.channels.join(" "));
        return Err(Error::invalid(path, "header", what));
    }
    let sample_type = match record.pixel {
        Pixel::Half => SampleType::F16,
        Pixel::Float => SampleType::F32,
    };
    for channel in channels.list.iter().filter(|channel| !channel.name.eq(DISTANCE_CHANNEL)) {
        if channel.sample_type != sample_type {
            let what =
                format!("channel {} is {:?}; the manifest says {:?}", channel.name, channel.sample_type, record.pixel);
            return Err(Error::invalid(path, "header", what));
        }
    }
    let mut blocks = reader.all_chunks(false).map_err(broken)?.sequential_decompressor(false);
    while let Some(block) = blocks.decompress_next_block() {
        let block = block.map_err(broken)?;
        for line in block.lines(&channels) {
            let channel = &channels.list[line.location.channel];
            if !is_finite(channel.sample_type, &line) {
                let place = format!("channel {}, row {}", channel.name, line.location.position.y());
                return Err(Error::invalid(path, place, "a value is not finite"));
            }
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
    use crate::manifest::{FILE_NAME, FileFormat, FileRole, Influence, Layout, ProbeRecord, TexelSampling};
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
            pixel: Pixel::Half,
            texel_sampling: TexelSampling::Center,
            channels: ["B", "G", "R"].map(String::from).into(),
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
            statistics: ProbeStatistics { mean_coverage: 1.0, distance: None, rays: 96, surface_noise: None },
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
        let faults: [Fault; 8] = [
            ("channel B is F16; the manifest says Float", |record| record.pixel = Pixel::Float),
            ("cannot be read", |record| record.path = "absent.exr".into()),
            ("does not stay in the manifest's folder", |record| record.path = "../radiance.exr".into()),
            ("does not stay in the manifest's folder", |record| record.path = "/radiance.exr".into()),
            ("the manifest says 1", |record| record.bytes = 1),
            ("BLAKE3 is", |record| record.blake3 = "0".repeat(64)),
            ("4 x 24 pixels; the manifest says 8 x 48", |record| (record.width, record.height) = (8, 48)),
            ("channels B G R; the manifest says A B G R", |record| record.channels.insert(0, "A".into())),
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
