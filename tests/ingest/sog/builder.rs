//! Writes SOGs in all variants, from the bytes that their images hold.

use std::collections::BTreeMap;
use std::io::{Cursor, Write};
use std::path::Path;

use image_webp::{ColorType, WebPEncoder};
use serde_json::{Value, json};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// What one Gaussian's pixels hold.
#[derive(Clone)]
pub struct Pixels {
    /// 16 bits along x, y, z.
    pub mean: [u16; 3],
    pub quat: [u8; 4],
    pub scale: [u8; 3],
    pub sh0: [u8; 4],
    pub label: u16,
}

#[derive(Clone)]
pub struct Builder {
    pub meta: Value,
    pub gaussians: Vec<Pixels>,
    /// Per entry, red, green, blue of each coefficient above band 0.
    pub palette: Vec<Vec<[u8; 3]>>,
}

impl Builder {
    /// `count` Gaussians of `degree`, all usable, in the layout of `version`.
    pub fn new(version: u8, degree: u8, count: usize) -> Self {
        let byte = |i: usize, salt: usize| ((i * 7919 + salt * 104_729) % 251) as u8;
        let gaussians = (0..count).map(|i| Pixels {
            mean: [0, 1, 2].map(|axis| u16::from_le_bytes([byte(i, axis), byte(i, axis + 3)])),
            quat: [byte(i, 6), byte(i, 7), byte(i, 8), 252 + (i % 4) as u8],
            scale: [9, 10, 11].map(|salt| byte(i, salt)),
            sh0: [byte(i, 12), byte(i, 13), byte(i, 14), 2 + byte(i, 15)],
            label: (i % 3) as u16,
        });
        let coefficients = usize::from(degree) * (usize::from(degree) + 2);
        let entry = |label: usize| (0..coefficients).map(|k| [0, 1, 2].map(|c| byte(label * 16 + k, c))).collect();
        let palette = if degree > 0 { (0..3).map(entry).collect() } else { Vec::new() };
        let means =
            json!({"mins": [-1.0, -2.0, 0.5], "maxs": [1.5, 0.25, 3.0], "files": ["means_l.webp", "means_u.webp"]});
        let mut meta = match version {
            1 => json!({
                "means": {"shape": [count, 3], "dtype": "float32"},
                "scales": {"mins": [-6.0, -5.0, -4.0], "maxs": [-1.0, 0.0, 1.0]},
                "sh0": {"mins": [-1.0, -1.5, -2.0, -4.0], "maxs": [1.0, 1.5, 2.0, 6.0]},
            }),
            _ => json!({
                "version": 2, "count": count, "means": {},
                "scales": {"codebook": codebook(-6.0, 0.0)},
                "sh0": {"codebook": codebook(-1.5, 2.0)},
            }),
        };
        meta["means"].as_object_mut().unwrap().append(&mut means.as_object().unwrap().clone());
        meta["quats"] = json!({});
        for name in ["scales", "quats", "sh0"] {
            meta[name]["files"] = json!([format!("{name}.webp")]);
        }
        if degree > 0 {
            meta["shN"] = match version {
                1 => json!({"shape": [count, coefficients], "mins": -0.75, "maxs": 0.5}),
                _ => json!({"count": 3, "bands": degree, "codebook": codebook(-0.6, 0.8)}),
            };
            meta["shN"]["files"] = json!(["shN_centroids.webp", "shN_labels.webp"]);
        }
        Self { meta, gaussians: gaussians.collect(), palette }
    }

    /// Content by name.
    pub fn files(&self) -> BTreeMap<String, Vec<u8>> {
        let of = |pixel: fn(&Pixels) -> [u8; 4]| -> Vec<[u8; 4]> { self.gaussians.iter().map(pixel).collect() };

        let mut images = vec![
            ("means_l.webp", of(|p| opaque(p.mean.map(|bits| bits as u8)))),
            ("means_u.webp", of(|p| opaque(p.mean.map(|bits| (bits >> 8) as u8)))),
            ("quats.webp", of(|p| p.quat)),
            ("scales.webp", of(|p| opaque(p.scale))),
            ("sh0.webp", of(|p| p.sh0)),
        ];
        if !self.palette.is_empty() {
            images.push(("shN_labels.webp", of(|p| opaque([p.label as u8, (p.label >> 8) as u8, 0]))));
        }
        let mut files: BTreeMap<String, Vec<u8>> = images
            .into_iter()
            .map(|(name, mut pixels)| {
                let width = (pixels.len() as f64).sqrt().ceil().max(1.0) as usize;
                pixels.resize(width * pixels.len().div_ceil(width).max(1), [0; 4]);
                (name.to_owned(), webp(width, &pixels))
            })
            .collect();
        if let Some(entry) = self.palette.first() {
            let mut pixels: Vec<[u8; 4]> = self.palette.iter().flatten().copied().map(opaque).collect();
            pixels.resize(64 * entry.len() * self.palette.len().div_ceil(64), [0, 0, 0, 255]);
            files.insert("shN_centroids.webp".into(), webp(64 * entry.len(), &pixels));
        }
        files.insert("meta.json".into(), self.meta.to_string().into_bytes());
        files
    }

    /// The bundled form.
    pub fn bundle(&self) -> Vec<u8> {
        bundle(&self.files())
    }

    /// The loose form, in an existing folder.
    pub fn write_loose(&self, folder: &Path) {
        for (name, bytes) in self.files() {
            std::fs::write(folder.join(name), bytes).expect("written");
        }
    }
}

fn opaque([r, g, b]: [u8; 3]) -> [u8; 4] {
    [r, g, b, 255]
}

/// 256 values that rise unevenly from `first` to `last`.
pub fn codebook(first: f64, last: f64) -> Vec<f64> {
    (0..256).map(|i| first + (last - first) * (f64::from(i) / 255.0).powf(1.25)).collect()
}

/// A lossless WebP, with alpha where a pixel has any.
pub fn webp(width: usize, pixels: &[[u8; 4]]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let height = (pixels.len() / width) as u32;
    let encoder = WebPEncoder::new(&mut bytes);
    match pixels.iter().all(|pixel| pixel[3] == 255) {
        true => {
            let rgb: Vec<u8> = pixels.iter().flat_map(|&[r, g, b, _]| [r, g, b]).collect();
            encoder.encode(&rgb, width as u32, height, ColorType::Rgb8)
        }
        false => encoder.encode(pixels.as_flattened(), width as u32, height, ColorType::Rgba8),
    }
    .expect("encoded");
    bytes
}

/// A zip archive that stores `files`.
pub fn bundle(files: &BTreeMap<String, Vec<u8>>) -> Vec<u8> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    for (name, bytes) in files {
        archive.start_file(name.as_str(), stored).expect("begun");
        archive.write_all(bytes).expect("written");
    }
    archive.finish().expect("finished").into_inner()
}

/// A zip archive of one deflated file, whose directory says that it has `size` bytes. The zip crate is built without
/// compression, so that it is written by hand (APPNOTE 4.3.7, 4.3.12, 4.3.16).
pub fn deflated(name: &str, content: &[u8], size: u32) -> Vec<u8> {
    let mut encoder = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::best());
    encoder.write_all(content).expect("deflated");
    let data = encoder.finish().expect("deflated");
    let mut crc = flate2::Crc::new();
    crc.update(content);
    // Version, flags, method, time, date, CRC-32, sizes, name length, extra length: the same in both headers.
    let mut common = Vec::new();
    [20_u16, 0, 8, 0, 0x21].iter().for_each(|field| common.extend(field.to_le_bytes()));
    [crc.sum(), data.len() as u32, size].iter().for_each(|field| common.extend(field.to_le_bytes()));
    [name.len() as u16, 0].iter().for_each(|field| common.extend(field.to_le_bytes()));
    let local = [b"PK\x03\x04", &common[..], name.as_bytes(), &data].concat();
    let central = [b"PK\x01\x02\x14\x00", &common[..], &[0; 14], name.as_bytes()].concat();
    let mut end = b"PK\x05\x06\0\0\0\0\x01\0\x01\0".to_vec();
    [central.len() as u32, local.len() as u32].iter().for_each(|field| end.extend(field.to_le_bytes()));
    [local, central, end, vec![0; 2]].concat()
}
