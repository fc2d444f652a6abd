//! glTF and GLB: meshes, splats, lights, and their compressed forms.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| splatprobe_fuzz::load_meshes(&splatprobe_fuzz::file("scene.glb", bytes)));
