//! SOG: a bundle, or one file among the sound ones of a folder: `meta.json`, `lod-meta.json`, or an image.
#![no_main]

use std::io::{Cursor, Read};
use std::path::Path;
use std::sync::LazyLock;

use splatprobe_fuzz::{file, folder, load_splats};

/// The bundle's files by name.
static SOUND: LazyLock<Vec<(String, Vec<u8>)>> = LazyLock::new(|| {
    let bundle = include_bytes!("../../tests/fixtures/one_scene/scene.sog");
    let mut archive = zip::ZipArchive::new(Cursor::new(bundle)).expect("an archive");
    let mut files = Vec::new();
    for i in 0..archive.len() {
        let mut entry = archive.by_index(i).expect("an entry");
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes).expect("read");
        files.push((entry.name().to_owned(), bytes));
    }
    // The parts of a streamed scene.
    for part in ["a", "b"] {
        let within = folder().join(part);
        std::fs::create_dir_all(&within).expect("a folder");
        write(&within, &files);
    }
    files
});

fn write(folder: &Path, files: &[(String, Vec<u8>)]) {
    files.iter().for_each(|(name, bytes)| std::fs::write(folder.join(name), bytes).expect("written"));
}

libfuzzer_sys::fuzz_target!(init: { write(folder(), &SOUND); }, |bytes: &[u8]| {
    let mentions = |key: &[u8]| bytes.windows(key.len()).any(|window| window == key);
    match bytes {
        [b'R', b'I', b'F', b'F', ..] => {
            // In place of any one of the sound images.
            let images: Vec<_> = SOUND.iter().filter(|(name, _)| name.ends_with(".webp")).collect();
            let (name, sound) = images[bytes.len() % images.len()];
            file(name, bytes);
            load_splats(&folder().join("meta.json"));
            file(name, sound);
        }
        [b'{', ..] if mentions(b"\"lodLevels\"") => load_splats(&file("lod-meta.json", bytes)),
        [b'{', ..] => {
            load_splats(&file("index.json", bytes));
        }
        _ => load_splats(&file("scene.sog", bytes)),
    }
});
