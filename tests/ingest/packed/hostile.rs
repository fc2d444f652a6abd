//! What every format's reader must bear.

use splatprobe::Error;

use super::ksplat::section;
use super::{Random, known, load};
use crate::packed_files::compressed_ply::Variant;
use crate::packed_files::{compressed_ply, ksplat, splat, spz};

struct SmallFile {
    format: &'static str,
    bytes: Vec<u8>,
    /// The places of the bytes that mean something.
    meaning: Vec<usize>,
}

impl SmallFile {
    fn new(format: &'static str, bytes: Vec<u8>) -> Self {
        let meaning = (0..bytes.len()).collect();
        Self { format, bytes, meaning }
    }
}

/// Small files of each format whose end can be told from its content.
fn small_files() -> Vec<SmallFile> {
    let gaussians = known(1, 3);
    let mut files = Vec::new();
    for chunk_colours in [false, true] {
        let bytes = compressed_ply::file(&gaussians, 1, Variant { chunk_colours, strangers: chunk_colours });
        files.push(SmallFile::new("compressed PLY", bytes));
    }
    for level in 0..=2 {
        let bytes = ksplat::file(level, &[section(known(1, 13), 1), section(known(2, 2), 2)]);
        let meaning = (0..44).chain(4096..4138).chain(5120..5162).chain(6144..bytes.len()).collect();
        files.push(SmallFile { format: ".ksplat", bytes, meaning });
    }
    for bytes in [
        spz::file(2, &gaussians),
        spz::uncompressed(3, &gaussians, 0, &[]),
        spz::uncompressed(1, &gaussians, 0, &[]),
        spz::version_4(&gaussians, 0, &[]),
    ] {
        files.push(SmallFile::new("SPZ", bytes));
    }
    files
}

#[test]
fn every_truncation_is_an_error_of_the_file() {
    for SmallFile { format, bytes, .. } in small_files() {
        assert!(load(&bytes).is_ok(), "{format}");
        for length in 0..bytes.len() {
            let error = load(&bytes[..length]).expect_err(format);
            assert!(matches!(error, Error::Invalid { .. }), "{format}, {length}: {error}");
        }
    }
}

/// Changes up to four bytes of `file` that mean something, `times` over, and tells how often it still loaded.
fn flip(file: &SmallFile, times: usize, random: &mut Random) -> usize {
    let mut loaded = 0;
    for _ in 0..times {
        let mut broken = file.bytes.clone();
        for _ in 0..1 + random.below(4) {
            broken[file.meaning[random.below(file.meaning.len())]] = random.bits() as u8;
        }
        if let Ok((scene, _)) = load(&broken) {
            loaded += 1;
            assert!(scene.splats.means.iter().all(|mean| mean.is_finite()));
            assert!(scene.splats.unit_from_world.iter().all(|matrix| matrix.is_finite()));
            assert!(scene.splats.opacities.iter().all(|opacity| (0.0..=1.0).contains(opacity)));
            assert!(scene.splats.sh.iter().all(|coefficient| coefficient.is_finite()));
        }
    }
    loaded
}

#[test]
fn ten_thousand_random_changes_per_format_never_panic_and_never_give_unusable_numbers() {
    let mut random = Random(0x1234_5678_9abc_def1);
    let files = small_files();
    for format in ["compressed PLY", ".ksplat", "SPZ"] {
        let of_format: Vec<_> = files.iter().filter(|file| file.format == format).collect();
        let times = 10_000 / of_format.len() + 1;
        let loaded: usize = of_format.iter().map(|file| flip(file, times, &mut random)).sum();
        assert!((500..9_900).contains(&loaded), "{format}: {loaded} of 10000 loaded, so only one side is tested");
    }
    let loaded = flip(&SmallFile::new(".splat", splat::file(&known(0, 3))), 10_000, &mut random);
    assert!((500..=10_000).contains(&loaded), ".splat: {loaded}");
}

#[test]
fn changes_behind_a_correct_checksum_are_borne_too() {
    let mut random = Random(0x0f0f_1234_5678_9abc);
    let raw = spz::uncompressed(3, &known(1, 3), 0, &[]);
    let mut loaded = 0;
    for _ in 0..2_000 {
        let mut broken = raw.clone();
        for _ in 0..1 + random.below(4) {
            let at = random.below(broken.len());
            broken[at] = random.bits() as u8;
        }
        loaded += usize::from(load(&spz::gzip(&broken)).is_ok());
    }
    assert!((100..1_900).contains(&loaded), "{loaded} of 2000 loaded");
}
