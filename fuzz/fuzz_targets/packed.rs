//! .splat and .ksplat: which one, the content says, or else the name.
#![no_main]

use splatprobe_fuzz::{file, load_splats};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    load_splats(&file("scene.splat", bytes));
    load_splats(&file("scene.ksplat", bytes));
});
