//! What was baked, for engines: `manifest.json` (schemas/manifest.schema.json).
//!
//! The manifest holds nothing that differs between two runs of the same job: no times, no absolute path, and of the machine
//! only the instruction level, on which the bytes of images depend.

mod model;
mod verify;

use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::encode::file::write_bytes_atomically;
use crate::{Error, Result};

pub use model::{
    Colour, DisplayTransform, FileFormat, FileRecord, FileRole, Frame, Influence, InputRecord, Layout, Manifest,
    MipRecord, PixelFormat, ProbeRecord, ShRecord, ShardRecord, TexelSampling, WindowedSh, path_in,
};
pub use verify::{check, verify};

/// Version of the manifest's format; readers refuse others.
pub const FORMAT_VERSION: u32 = 1;

/// The manifest's name in the output folder.
pub const FILE_NAME: &str = "manifest.json";

/// The folder inside the output folder in which a bake works, and which is there while it runs or has work left. Engines
/// and importers pass over names that begin with a dot.
pub const WORK_FOLDER: &str = ".splatprobe";

impl Manifest {
    /// Reads a manifest. Fails when it cannot be read, is not JSON of the schema (the error names line and column), is of
    /// another [`FORMAT_VERSION`], or names vertices or probes that are not there, and where it is missing because a bake
    /// has not ended.
    pub fn read(path: &Path) -> Result<Self> {
        #[derive(Deserialize)]
        #[serde(rename_all = "camelCase")]
        struct Version {
            format_version: u32,
        }
        let text = std::fs::read_to_string(path).map_err(|source| {
            if source.kind() == ErrorKind::NotFound && path.with_file_name(WORK_FOLDER).is_dir() {
                let what = "not there: the bake to this folder was interrupted, or runs still; bake again";
                return Error::invalid(path, "manifest", what);
            }
            Error::read(path, source)
        })?;
        let broken = |error: serde_json::Error| Error::invalid(path, "manifest", error.to_string());
        // The version comes first: what else another version holds is unknown.
        let Version { format_version } = serde_json::from_str(&text).map_err(broken)?;
        if format_version != FORMAT_VERSION {
            let what = format!("manifest format {format_version}; this program reads {FORMAT_VERSION}: bake again");
            return Err(Error::unsupported(path, what));
        }
        let manifest: Self = serde_json::from_str(&text).map_err(broken)?;
        match manifest.dangling() {
            Some(place) => Err(Error::invalid(path, place, "it names a vertex, triangle or probe that is not there")),
            None => Ok(manifest),
        }
    }

    /// Where a level of the placement names something that is not there, as a JSON pointer.
    fn dangling(&self) -> Option<String> {
        fn below(count: usize, mut indices: impl Iterator<Item = u32>) -> bool {
            indices.all(|index| (index as usize) < count)
        }
        let levels = self.placement.iter().flat_map(|placement| &placement.levels);
        levels.enumerate().find_map(|(i, level)| {
            let (vertices, triangles) = (level.vertices.len(), level.triangles.len());
            let shares = level.vertices.iter().flat_map(|vertex| &vertex.blend);
            let fields = [
                ("vertices", below(self.probes.len(), shares.map(|share| share.probe))),
                ("triangles", below(vertices, level.triangles.iter().flatten().copied())),
                ("neighbours", below(triangles, level.neighbours.iter().flatten().flatten().copied())),
                ("walls", below(vertices, level.walls.iter().flatten().copied())),
                ("blocked", below(vertices, level.blocked.iter().flatten().copied())),
            ];
            let (field, _) = fields.into_iter().find(|(_, is_whole)| !is_whole)?;
            Some(format!("/placement/levels/{i}/{field}"))
        })
    }

    /// Writes the manifest beside `path` and renames it, so that a reader never sees half of it.
    pub fn write(&self, path: &Path) -> Result<()> {
        write_json(path, self)
    }
}

/// The manifest of the bake at `path`, which is its folder or the manifest itself.
pub fn path_of(path: &Path) -> PathBuf {
    if path.is_dir() { path.join(FILE_NAME) } else { path.to_owned() }
}

/// Writes `value` as indented JSON with a final newline beside `path` and renames it.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    write_bytes_atomically(path, |file| {
        serde_json::to_writer_pretty(&mut *file, value)?;
        file.write_all(b"\n")
    })
}

/// Size in bytes and BLAKE3 hash, in hexadecimal, of a file.
pub fn digest(path: &Path) -> Result<(u64, String)> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_mmap_rayon(path).map_err(|source| Error::read(path, source))?;
    Ok((hasher.count(), hasher.finalize().to_hex().to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::Job;
    use crate::scene::SplatEncoding;

    #[test]
    fn a_manifest_of_another_version_is_refused_by_its_version() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE_NAME);
        std::fs::write(&path, r#"{"formatVersion": 2, "somethingNew": true}"#).unwrap();
        let error = Manifest::read(&path).unwrap_err();
        assert!(matches!(&error, Error::Unsupported { what, .. } if what.contains("format 2")), "{error}");
    }

    #[test]
    fn a_placement_whose_indices_point_nowhere_is_refused_with_their_place() {
        let manifest = Manifest::new(&Job::default(), SplatEncoding::default(), Vec::new(), Vec::new());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE_NAME);
        let read = |field: &str, indices: serde_json::Value| {
            let mut json = serde_json::to_value(&manifest).unwrap();
            let mut level = serde_json::json!({"height": {"y": 1.5, "floor": 0.0, "ceiling": 3.0}, "vertices": [],
                "triangles": [], "neighbours": [], "walls": [], "blocked": []});
            level[field] = indices;
            json["placement"] = serde_json::json!({"levels": [level], "sites": 0, "relocated": 0, "dropped": [],
                "checks": serde_json::to_value(crate::place::adaptive::Checks::default()).unwrap()});
            std::fs::write(&path, json.to_string()).unwrap();
            Manifest::read(&path)
        };
        assert!(read("triangles", serde_json::json!([])).is_ok());
        let vertex =
            serde_json::json!([{"position": [0.0, 0.0], "blend": [{"probe": 0, "weight": 1.0}], "isProbe": true}]);
        for (field, indices) in [
            ("vertices", vertex),
            ("triangles", serde_json::json!([[0, 0, 0]])),
            ("neighbours", serde_json::json!([[null, 0, null]])),
            ("walls", serde_json::json!([[0, 0]])),
            ("blocked", serde_json::json!([[0, 0]])),
        ] {
            let error = read(field, indices).unwrap_err().to_string();
            assert!(error.contains(&format!("/placement/levels/0/{field}")), "{error}");
        }
    }

    #[test]
    fn a_failed_write_leaves_the_earlier_file_and_no_rest() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        write_json(&path, &1).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "1\n");
        // A map with keys that are not text is no JSON.
        let unwritable = std::collections::BTreeMap::from([([0], 0)]);
        assert!(matches!(write_json(&path, &unwritable), Err(Error::Write { .. })));
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "1\n");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn the_digest_is_blake3s_of_the_content() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("empty");
        std::fs::write(&path, "").unwrap();
        // The empty input's hash, from the BLAKE3 specification's test vectors.
        let expected = "af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262";
        assert_eq!(digest(&path).unwrap(), (0, expected.into()));
    }
}
