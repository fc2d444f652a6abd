//! Broken and hostile files: always an error that tells where and what, never a panic.

use serde_json::{Value, json};
use splatprobe::Error;
use splatprobe::ingest::load_scene;
use splatprobe::job::SplatInput;

use super::builder::{Builder, bundle, deflated, webp};
use super::{load, load_path};

fn error_of(bytes: &[u8]) -> String {
    load(bytes).expect_err("an error").to_string()
}

#[test]
fn every_truncation_of_a_bundle_is_an_error() {
    let bytes = Builder::new(2, 1, 4).bundle();
    load(&bytes).expect("whole, it loads");
    for length in 0..bytes.len() {
        let error = load(&bytes[..length]).expect_err("truncated");
        assert!(matches!(error, Error::Invalid { .. }), "{length}: {error}");
    }
}

#[test]
fn every_truncation_of_a_loose_file_is_an_error_that_names_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = Builder::new(1, 1, 4);
    file.write_loose(folder.path());
    for (name, bytes) in file.files() {
        for length in 0..bytes.len() {
            // The last byte of a RIFF chunk may be padding.
            if name != "meta.json" && length + 1 == bytes.len() {
                continue;
            }
            std::fs::write(folder.path().join(&name), &bytes[..length]).expect("written");
            let error = load_path(&folder.path().join("meta.json")).expect_err(&name).to_string();
            assert!(error.contains(&name), "{name}, {length}: {error}");
        }
        std::fs::write(folder.path().join(&name), &bytes).expect("written");
    }
}

#[test]
fn random_byte_changes_never_panic_and_never_give_unusable_numbers() {
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut random = |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state % below as u64) as usize
    };
    let files = Builder::new(2, 1, 4).files();
    let names: Vec<&String> = files.keys().collect();
    let mut loaded = 0;
    for round in 0..10_000 {
        let broken = match round % 4 {
            // In the archive itself.
            0 => {
                let mut bytes = bundle(&files);
                let at = random(bytes.len());
                bytes[at] ^= 1 << random(8);
                bytes
            }
            // Or behind its checksums.
            _ => {
                let mut files = files.clone();
                let bytes = files.get_mut(names[random(names.len())]).expect("a file");
                let at = random(bytes.len());
                bytes[at] ^= 1 << random(8);
                bundle(&files)
            }
        };
        if let Ok((scene, _)) = load(&broken) {
            loaded += 1;
            assert!(scene.splats.means.iter().all(|mean| mean.is_finite()));
            assert!(scene.splats.unit_from_world.iter().all(|matrix| matrix.is_finite()));
            assert!(scene.splats.sh.iter().all(|coefficient| coefficient.is_finite()));
        }
    }
    assert!((500..9500).contains(&loaded), "{loaded} of 10000 loaded: the changes test only one side");
}

#[test]
fn wrong_properties_are_errors_that_name_them() {
    type Fault = fn(&mut Value);
    let faults: [(&str, Fault); 17] = [
        ("SOG version 3", |meta| meta["version"] = 3.into()),
        ("SOG version \"2\"", |meta| meta["version"] = "2".into()),
        ("SOG version -1", |meta| meta["version"] = (-1).into()),
        ("count: there are no Gaussians", |meta| meta["count"] = 0.into()),
        ("invalid value", |meta| meta["count"] = (-4).into()),
        ("cannot hold them", |meta| meta["count"] = u64::MAX.into()),
        ("cannot hold them", |meta| meta["count"] = 1_000_000.into()),
        ("means_l.webp: 2 x 2 pixels; meta.json asks for 5", |meta| meta["count"] = 5.into()),
        ("missing field `scales`", |meta| drop(meta.as_object_mut().unwrap().remove("scales"))),
        ("scales.codebook: 0 entries", |meta| meta["scales"]["codebook"] = json!([])),
        ("sh0.codebook: 257 entries", |meta| meta["sh0"]["codebook"] = json!(vec![0.5; 257])),
        ("shN.codebook: entry 1 is null", |meta| meta["shN"]["codebook"][1] = Value::Null),
        ("shN.bands: 4", |meta| meta["shN"]["bands"] = 4.into()),
        ("shN_centroids.webp: 192 pixels wide", |meta| meta["shN"]["bands"] = 2.into()),
        ("invalid length 1", |meta| meta["means"]["files"] = json!(["means_l.webp"])),
        ("sky.webp: meta.json names this file", |meta| meta["quats"]["files"][0] = "sky.webp".into()),
        ("image 'meta.json' is not WebP", |meta| meta["quats"]["files"][0] = "meta.json".into()),
    ];
    for (expected, fault) in faults {
        let mut file = Builder::new(2, 1, 4);
        fault(&mut file.meta);
        let error = error_of(&file.bundle());
        assert!(error.contains(expected), "{expected}: {error}");
    }
}

#[test]
fn numbers_beyond_floats_are_errors_and_values_beyond_use_are_dropped_and_counted() {
    let huge = Builder::new(2, 0, 4).meta.to_string().replace("[1.5,", "[1e999,");
    let mut files = Builder::new(2, 0, 4).files();
    files.insert("meta.json".into(), huge.into_bytes());
    assert!(error_of(&bundle(&files)).contains("number out of range"));

    let mut file = Builder::new(2, 0, 4);
    file.meta["means"]["maxs"] = json!([1e300, 0.25, 3.0]);
    file.gaussians[2].mean[0] = 0;
    let (_, report) = load(&file.bundle()).expect("one is left");
    assert_eq!((report.splats[0].kept, report.splats[0].dropped.non_finite), (1, 3));
}

#[test]
fn bytes_beyond_a_short_codebook_are_dropped_and_counted() {
    let mut file = Builder::new(2, 0, 4);
    for (i, gaussian) in file.gaussians.iter_mut().enumerate() {
        gaussian.scale = [7 + u8::from(i == 3); 3];
    }
    file.meta["scales"]["codebook"] = json!([-5.0, -4.5, -4.0, -3.5, -3.0, -2.5, -2.0, -1.5]);
    let (_, report) = load(&file.bundle()).expect("three are left");
    assert_eq!((report.splats[0].kept, report.splats[0].dropped.non_finite), (3, 1));
}

#[test]
fn wrong_palette_labels_and_rotation_modes_are_errors_that_name_the_gaussian() {
    for version in [1, 2] {
        let mut file = Builder::new(version, 1, 5000);
        file.gaussians[4998].label = 70;
        let error = error_of(&file.bundle());
        assert!(error.contains("Gaussian 4998: palette label 70"), "{error}");
    }
    // In version 2 the count limits labels where the image does not.
    let mut file = Builder::new(2, 1, 4);
    file.gaussians[3].label = 3;
    assert!(error_of(&file.bundle()).contains("Gaussian 3: palette label 3; the palette has 3 entries"));
    let mut file = Builder::new(2, 0, 4);
    file.gaussians[1].quat[3] = 251;
    assert!(error_of(&file.bundle()).contains("Gaussian 1: rotation mode 251"));
}

#[test]
fn images_larger_than_the_count_justifies_are_refused_before_they_are_decoded() {
    let file = Builder::new(2, 1, 4);
    let large = webp(4000, &vec![[1, 2, 3, 255]; 4000 * 4000]);
    assert!(large.len() < 100_000, "a bomb is small: {}", large.len());
    for name in ["means_l.webp", "sh0.webp", "shN_centroids.webp"] {
        let mut files = file.files();
        files.insert(name.into(), large.clone());
        let error = error_of(&bundle(&files));
        assert!(error.contains(&format!("{name}: 4000 x 4000 pixels")), "{error}");
    }
    // A header that claims the largest size that WebP has, over data for four pixels.
    let mut files = file.files();
    let header = files.get_mut("means_l.webp").expect("an image");
    header[21..25].copy_from_slice(&(16382_u32 | 16382 << 14).to_le_bytes());
    assert!(error_of(&bundle(&files)).contains("16383 x 16383 pixels"));
}

#[test]
fn an_archive_that_inflates_beyond_measure_is_refused() {
    let bomb = deflated("meta.json", &vec![b' '; 64 << 20], 64 << 20);
    assert!(bomb.len() < 100_000, "a bomb is small: {}", bomb.len());
    assert!(error_of(&bomb).contains("67108864 bytes from"));
    // One that lies about its size is read no further than it says.
    let error = error_of(&deflated("meta.json", &vec![b' '; 64 << 20], 1000));
    assert!(error.contains("1001 bytes; the archive's directory promises 1000"), "{error}");
}

#[test]
fn damaged_and_foreign_archives_are_told() {
    let files = Builder::new(2, 0, 4).files();
    let mut damaged = bundle(&files);
    let at = damaged.windows(4).position(|window| window == b"WEBP").expect("an image");
    damaged[at + 20] ^= 1;
    assert!(error_of(&damaged).contains("CRC-32"));
    let text = [("readme.txt".to_owned(), b"hello".to_vec())].into();
    assert!(error_of(&bundle(&text)).contains("no bundled SOG"));
    assert!(error_of(b"PK\x03\x04 and no more").contains("zip directory"));
}

#[test]
fn a_lossy_image_is_refused() {
    // The header of a lossy image of 2 x 2 pixels: a key frame's tag, its start code, its size (RFC 6386, 9.1).
    let frame = [0x10, 0, 0, 0x9d, 0x01, 0x2a, 2, 0, 2, 0];
    let mut lossy = b"RIFF\x16\0\0\0WEBPVP8 \x0a\0\0\0".to_vec();
    lossy.extend(frame);
    let mut files = Builder::new(2, 0, 4).files();
    files.insert("quats.webp".into(), lossy);
    assert!(error_of(&bundle(&files)).contains("quats.webp: a lossy"));
}

#[test]
fn names_that_lead_out_of_the_folder_are_refused() {
    let outer = tempfile::tempdir().expect("a folder");
    let folder = outer.path().join("inner");
    std::fs::create_dir(&folder).expect("a folder");
    let mut file = Builder::new(2, 0, 4);
    file.write_loose(&folder);
    std::fs::copy(folder.join("quats.webp"), outer.path().join("quats.webp")).expect("copied");
    let absolute = outer.path().join("quats.webp").display().to_string();
    for name in ["../quats.webp", "a/../../quats.webp", "..\\quats.webp", "C:quats.webp", "", &absolute] {
        file.meta["quats"]["files"][0] = name.into();
        file.write_loose(&folder);
        let error = load_scene(&[SplatInput::new(&folder)], &[]).expect_err("outside").to_string();
        assert!(error.contains("leads out of the folder"), "{name}: {error}");
    }
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(outer.path().join("quats.webp"), folder.join("link.webp")).expect("linked");
        file.meta["quats"]["files"][0] = "link.webp".into();
        file.write_loose(&folder);
        let error = load_scene(&[SplatInput::new(&folder)], &[]).expect_err("outside").to_string();
        assert!(error.contains("leads out of the folder"), "{error}");
    }
}
