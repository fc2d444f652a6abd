//! SPZ. Inputs that begin as the content of versions 1 to 3 does are packed first: no mutation gets past gzip's checksum.
#![no_main]

use std::io::Write;

use flate2::{Compression, write::GzEncoder};
use splatprobe_fuzz::{file, load_splats};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let is_unpacked = bytes.starts_with(b"NGSP") && bytes.get(4).is_some_and(|&version| version < 4);
    if is_unpacked {
        let mut packed = GzEncoder::new(Vec::new(), Compression::none());
        packed.write_all(bytes).expect("written");
        load_splats(&file("scene.spz", &packed.finish().expect("packed")));
    } else {
        load_splats(&file("scene.spz", bytes));
    }
});
