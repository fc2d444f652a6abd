use splatprobe::job::{Frame, SplatInput};
use splatprobe::scene::SplatEncoding;
use splatprobe::scene::sh::C0;

use super::{Tolerance, assert_holds, assert_is_the_published_square, error_of, known, load, load_raw};
use crate::packed_files::splat::file;

#[test]
fn known_gaussians_come_back_within_the_steps_of_a_byte() {
    let gaussians = known(0, 5000);
    let (scene, report) = load_raw(&file(&gaussians));
    let tolerance = Tolerance { mean: 1e-6, covariance: 0.03, opacity: 0.002, dc: 0.5 / 255.0 / C0 + 1e-6, rest: 0.0 };
    assert_holds(&scene, &gaussians, &tolerance);
    assert_eq!((report.splats[0].format.as_str(), report.splats[0].sh_degree), (".splat", 0));
}

#[test]
fn axes_and_encoding_are_those_of_3dgs_trainers() {
    let (_, report) = load(&file(&known(0, 3))).expect("loads");
    assert_eq!((report.splats[0].frame, report.splats[0].encoding), (Frame::RDF, SplatEncoding::SrgbDisplay));
}

#[test]
fn the_published_square_is_read() {
    assert_is_the_published_square("splats/minimal/minimal.splat", None);
}

#[test]
fn a_cut_file_ends_with_the_last_whole_gaussian_or_is_an_error() {
    let bytes = file(&known(0, 4));
    for length in 1..bytes.len() {
        match length % 32 {
            0 => assert_eq!(load(&bytes[..length]).expect("loads").0.splats.len(), length / 32),
            _ => assert!(load(&bytes[..length]).is_err(), "{length}"),
        }
    }
}

#[test]
fn the_name_decides_only_where_the_content_cannot() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("written");
        splatprobe::ingest::load_scene(&[SplatInput::new(path)], &[]).map(|(scene, _)| scene.splats.len())
    };
    let bytes = file(&known(0, 3));
    assert_eq!(write("scene.bin", &bytes).expect("known by content"), 3);
    assert_eq!(write("scene.ksplat", &bytes).expect("known by content"), 3);
    let cut = write("scene.splat", &bytes[..70]).expect_err("cut").to_string();
    assert!(cut.contains("byte 64") && cut.contains("the last one has 6"), "{cut}");
    // Sizes of 0 are not plausible; by its name the file is .splat all the same, and nothing of it can be used.
    let flat = [bytes[..12].to_vec(), vec![0; 12], bytes[24..32].to_vec()].concat();
    assert!(error_of(&flat).contains("unknown format"));
    let flat = write("flat.splat", &flat).expect_err("flat").to_string();
    assert!(flat.contains("degenerate_scale: 1"), "{flat}");
}

#[test]
fn noise_and_text_are_not_taken_for_splats() {
    let mut random = super::Random(11);
    let noise: Vec<u8> = (0..64 * 1024).map(|_| random.bits() as u8).collect();
    let text = "x,y,z\n0.1234567,0.2345678,0.3456\n".repeat(32).into_bytes();
    for bytes in [noise, text, vec![0; 3200], vec![0xff; 3200]] {
        assert!(error_of(&bytes[..bytes.len() / 32 * 32]).contains("unknown format"));
    }
}

#[test]
fn values_that_are_no_numbers_are_dropped() {
    let mut gaussians = known(0, 40);
    gaussians[1].mean.y = f64::NAN;
    gaussians[2].deviations.x = f64::INFINITY;
    gaussians[3].deviations.z = -1.0;
    let dropped = load_raw(&file(&gaussians)).1.splats[0].dropped;
    assert_eq!((dropped.non_finite, dropped.degenerate_scale, dropped.total()), (1, 2, 3));
}
