//! USD as text, crate and package: meshes and splats.
#![no_main]

use splatprobe_fuzz::{file, load_meshes};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let name = match bytes {
        [b'#', ..] => "scene.usda",
        [b'P', b'K', ..] => "scene.usdz",
        _ => "scene.usdc",
    };
    load_meshes(&file(name, bytes));
});
