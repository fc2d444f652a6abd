//! OpenEXR's own tools open what is written (Debian: `apt-get install openexr`).

use std::path::Path;
use std::process::Command;

/// The answer of an OpenEXR tool about `file`; `None`, with a printed reason, where the tool is not installed.
fn ask(tool: &str, file: &Path) -> Option<String> {
    match Command::new(tool).arg(file).output() {
        Ok(output) => {
            assert!(output.status.success(), "{tool}: {}", String::from_utf8_lossy(&output.stderr));
            Some(String::from_utf8(output.stdout).unwrap())
        }
        Err(error) => {
            println!("skipped: {tool}: {error}");
            None
        }
    }
}

#[test]
fn openexrs_own_tools_open_the_demos_cubemap() {
    let folder = tempfile::tempdir().unwrap();
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/demo/demo.json");
    for (pixel, stored) in [("half", "16-bit floating-point"), ("float", "32-bit floating-point")] {
        let out = folder.path().join(pixel);
        let status = Command::new(env!("CARGO_BIN_EXE_splatprobe"))
            .arg("bake")
            .arg(&demo)
            .args(["--face-size", "16", "--distance", "--progress", "none", "--pixel", pixel, "-o"])
            .arg(&out)
            .status()
            .unwrap();
        assert!(status.success());
        let file = out.join("probe_002/radiance.exr");
        if let Some(header) = ask("exrheader", &file) {
            assert!(header.contains("dataWindow (type box2i): (0 0) - (15 95)"), "{header}");
            for channel in ["A", "B", "G", "R"] {
                assert!(header.contains(&format!("{channel}, {stored}")), "{header}");
            }
            assert!(header.contains("Z, 32-bit floating-point"), "{header}");
        }
        if let Some(info) = ask("exrinfo", &file) {
            assert!(info.contains("16 x 96"), "{info}");
        }
    }
}
