//! A picture of all directions as a bake's background: OpenEXR, or else Radiance HDR. The bake is cancelled behind it.
#![no_main]

use std::sync::atomic::AtomicBool;

use splatprobe::Error;
use splatprobe::job::{Background, Job, Placement, SplatInput};
use splatprobe_fuzz::{file, folder};

const SPLATS: &[u8] = include_bytes!("../../tests/fixtures/one_scene/scene-2.ksplat");

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let name = if bytes.starts_with(b"\x76\x2f\x31\x01") { "sky.exr" } else { "sky.hdr" };
    let job = Job {
        splats: vec![SplatInput::new(file("scene.ksplat", SPLATS))],
        background: Background::Map(file(name, bytes)),
        placement: Placement { probes: vec![[0.0; 3]], ..Placement::default() },
        output: Some(folder().join("out")),
        face_size: 4,
        threads: 1,
        ..Job::default()
    };
    let baked = splatprobe::pipeline::bake(&job, &splatprobe::bake::Silent, &AtomicBool::new(true));
    assert!(!matches!(baked, Ok(_) | Err(Error::Request { .. })), "the job itself is sound: {baked:?}");
});
