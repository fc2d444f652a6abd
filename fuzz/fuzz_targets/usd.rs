//! USD as text, crate and package: meshes and splats.
#![no_main]

use splatprobe_fuzz::{file, load_meshes};

/// The loader takes panics of the openusd crate for errors of the file; all others are findings.
fn let_caught_panics_pass() {
    let finding = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let is_of_a_dependency = panic.location().is_some_and(|at| at.file().contains("/registry/"));
        if !(is_of_a_dependency && std::thread::current().name() == Some("usd")) {
            finding(panic);
        }
    }));
}

libfuzzer_sys::fuzz_target!(init: let_caught_panics_pass(), |bytes: &[u8]| {
    let name = match bytes {
        [b'#', ..] => "scene.usda",
        [b'P', b'K', ..] => "scene.usdz",
        _ => "scene.usdc",
    };
    load_meshes(&file(name, bytes));
});
