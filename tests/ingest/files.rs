//! Files that tests write over and over, break, or find among the project's test data.

use std::cell::RefCell;
use std::io::{Seek, Write};
use std::path::PathBuf;

use splatprobe::ingest::{SceneReport, load_scene};
use splatprobe::job::SplatInput;
use splatprobe::scene::Scene;

use crate::common::Random;
use crate::common::gltf::data_folder;

/// A file of the project's test data, or `None` (with a message) where that is not at hand.
pub fn data(name: &str) -> Option<PathBuf> {
    let path = data_folder()?.join(name);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {} is absent", path.display());
    None
}

/// Loads `bytes` as a file without extension, with changes to the input.
pub fn load_with(bytes: &[u8], change: impl Fn(&mut SplatInput)) -> splatprobe::Result<(Scene, SceneReport)> {
    thread_local! {
        // Written over and over: creating thousands of files takes seconds on some file systems.
        static FILE: RefCell<tempfile::NamedTempFile> =
            RefCell::new(tempfile::NamedTempFile::new().expect("a temporary file"));
    }
    FILE.with_borrow_mut(|file| {
        file.rewind().expect("rewound");
        file.write_all(bytes).expect("written");
        file.as_file().set_len(bytes.len() as u64).expect("cut to length");
        let mut input = SplatInput::new(file.path());
        change(&mut input);
        load_scene(&[input], &[])
    })
}

/// Loads `bytes` as a file, in the frame that its format declares.
pub fn load(bytes: &[u8]) -> splatprobe::Result<(Scene, SceneReport)> {
    load_with(bytes, |_| {})
}

/// Every stored number, by its bits.
pub fn bits(scene: &Scene) -> Vec<u32> {
    let splats = &scene.splats;
    let means = splats.means.iter().flat_map(|mean| mean.to_array());
    let matrices = splats.unit_from_world.iter().flat_map(|matrix| matrix.to_cols_array());
    let numbers = means.chain(matrices).chain(splats.opacities.iter().copied()).chain(splats.sh.iter().copied());
    std::iter::once(u32::from(splats.sh_degree)).chain(numbers.map(f32::to_bits)).collect()
}

/// Hands `count` copies of `bytes` with one to three of them changed to `try_one`; gives for how many that is true.
pub fn with_flipped_bytes(bytes: &[u8], count: usize, seed: u64, mut try_one: impl FnMut(&[u8]) -> bool) -> usize {
    let mut random = Random(seed);
    let flipped = |random: &mut Random| {
        let mut broken = bytes.to_vec();
        for _ in 0..1 + random.below(3) {
            let at = random.below(broken.len());
            broken[at] = random.bits() as u8;
        }
        broken
    };
    (0..count).filter(|_| try_one(&flipped(&mut random))).count()
}
