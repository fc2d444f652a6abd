//! An OpenEXR file that `compare` reads.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let path = splatprobe_fuzz::file("image.exr", bytes);
    let _ = splatprobe::compare::compare_images(&path, &path);
});
