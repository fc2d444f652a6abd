//! A manifest without its files: read, verified, and blended by.
#![no_main]

use glam::DVec3;
use splatprobe::manifest::{Manifest, verify};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let path = splatprobe_fuzz::file("manifest.json", bytes);
    let _ = verify(&path);
    let Ok(manifest) = Manifest::read(&path) else { return };
    let network = manifest.network();
    for position in [DVec3::ZERO, DVec3::new(1.0, 1.5, -2.0), DVec3::splat(1e30)] {
        network.weights(position);
    }
});
