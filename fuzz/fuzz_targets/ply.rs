//! PLY, plain and compressed.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| splatprobe_fuzz::load_splats(&splatprobe_fuzz::file("scene.ply", bytes)));
