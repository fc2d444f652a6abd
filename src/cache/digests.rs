//! Hashes of input files, kept while the files are as they were: inputs of gigabytes are not read to learn that nothing
//! has changed.
//!
//! A hash is kept with what the file system says of the file: size, time of modification and of the last change of its
//! properties, inode. It is trusted when all of them are the same and lie two seconds before the hashing: a file that was
//! written just then may be written again without its time moving on (git's "racily clean" entries, of file systems whose
//! clock ticks every two seconds). So a clock that was set back, or a file from the future, costs a hash and never hides a
//! change. What no rule of this kind sees is a file whose content changed and whose size, inode and times were all put
//! back; on Unix the second time cannot be set by programs.

use std::collections::BTreeMap;
use std::fs::Metadata;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use super::{Key, Store};
use crate::manifest;
use crate::{Error, Result};

/// Coarsest clock of a file system in use (FAT), in nanoseconds.
const TICK: u64 = 2_000_000_000;

/// Size and BLAKE3 hash, in hexadecimal, of a file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Digest {
    /// Size in bytes.
    pub bytes: u64,
    /// The hash.
    pub blake3: String,
}

/// Hashes of files, kept in memory and, where there is one, in a store.
#[derive(Debug)]
pub struct Digests<'a> {
    store: Option<&'a Store>,
    seen: Mutex<BTreeMap<PathBuf, Kept>>,
}

/// What the file system says of a file; times in nanoseconds since 1970.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Stamp {
    bytes: u64,
    modified: u64,
    changed: u64,
    inode: u64,
}

/// A digest and when it was true.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Kept {
    stamp: Stamp,
    hashed: u64,
    digest: Digest,
}

impl<'a> Digests<'a> {
    /// None yet, but those that `store` has.
    pub fn new(store: Option<&'a Store>) -> Self {
        Self { store, seen: Mutex::default() }
    }

    /// The digest of the file at `path`.
    ///
    /// Fails with [`Error::Read`], and with [`Error::Changed`] where the file changes meanwhile.
    pub fn of(&self, path: &Path) -> Result<Digest> {
        let read = |source| Error::read(path, source);
        let absolute = std::path::absolute(path).map_err(read)?;
        let stamp = Stamp::of(path)?;
        if let Some(kept) = self.kept(&absolute)
            && kept.stamp == stamp
            && stamp.modified.max(stamp.changed) + TICK < kept.hashed
        {
            return Ok(kept.digest);
        }
        let hashed = nanoseconds(SystemTime::now());
        let (bytes, blake3) = manifest::digest(path)?;
        let digest = Digest { bytes, blake3 };
        if Stamp::of(path)? != stamp {
            return Err(Error::Changed { path: path.into() });
        }
        let kept = Kept { stamp, hashed, digest: digest.clone() };
        if let (Some(store), Ok(json)) = (self.store, serde_json::to_vec(&kept)) {
            // Without it the file is hashed again.
            let _ = store.put(&key_of(&absolute), &json);
        }
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).insert(absolute, kept);
        Ok(digest)
    }

    /// The digest of the file at `path`; `None` where there is nothing. Fails as [`Self::of`] does.
    pub fn of_existing(&self, path: &Path) -> Result<Option<Digest>> {
        path.exists().then(|| self.of(path)).transpose()
    }

    fn kept(&self, absolute: &Path) -> Option<Kept> {
        let seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner).get(absolute).cloned();
        seen.or_else(|| serde_json::from_slice(&self.store?.get(&key_of(absolute))?).ok())
    }
}

fn key_of(absolute: &Path) -> Key {
    Key::of("digest", &absolute.to_string_lossy())
}

impl Stamp {
    fn of(path: &Path) -> Result<Self> {
        let read = |source| Error::read(path, source);
        let metadata = std::fs::metadata(path).map_err(read)?;
        if !metadata.is_file() {
            return Err(read(std::io::Error::other("not a regular file")));
        }
        let modified = metadata.modified().map_err(read)?;
        let (changed, inode) = changed_and_inode(&metadata);
        Ok(Self { bytes: metadata.len(), modified: nanoseconds(modified), changed, inode })
    }
}

#[cfg(unix)]
fn changed_and_inode(metadata: &Metadata) -> (u64, u64) {
    use std::os::unix::fs::MetadataExt;

    let seconds = u64::try_from(metadata.ctime()).unwrap_or(0);
    (seconds * 1_000_000_000 + u64::try_from(metadata.ctime_nsec()).unwrap_or(0), metadata.ino())
}

#[cfg(not(unix))]
fn changed_and_inode(_: &Metadata) -> (u64, u64) {
    (0, 0)
}

/// Since 1970; what is older is as old as that.
fn nanoseconds(time: SystemTime) -> u64 {
    time.duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos() as u64
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::time::Duration;

    use super::*;

    /// A file last written long before it is hashed, so that its digest is kept.
    struct Old {
        folder: tempfile::TempDir,
        store: Store,
    }

    impl Old {
        fn new() -> Self {
            let folder = tempfile::tempdir().unwrap();
            let store = Store::new(folder.path().join("cache"));
            let old = Self { folder, store };
            old.write("first", 100);
            old
        }

        fn path(&self) -> PathBuf {
            self.folder.path().join("input")
        }

        /// In place: the inode stays.
        fn write(&self, content: &str, seconds_ago: u64) {
            std::fs::write(self.path(), content).unwrap();
            let time = SystemTime::now() - Duration::from_secs(seconds_ago);
            File::options().write(true).open(self.path()).unwrap().set_modified(time).unwrap();
        }

        fn digest(&self) -> Digest {
            Digests::new(Some(&self.store)).of(&self.path()).unwrap()
        }

        /// Says that the file was hashed `seconds` later than now, and as something else.
        fn forge(&self, seconds: u64) {
            let hashed = nanoseconds(SystemTime::now() + Duration::from_secs(seconds));
            let digest = Digest { bytes: 5, blake3: "forged".into() };
            let kept = Kept { stamp: Stamp::of(&self.path()).unwrap(), hashed, digest };
            self.store.put(&key_of(&self.path()), &serde_json::to_vec(&kept).unwrap()).unwrap();
        }
    }

    #[test]
    fn a_file_that_has_rested_is_not_read_again() {
        let old = Old::new();
        old.forge(10);
        assert_eq!(old.digest().blake3, "forged");
    }

    #[test]
    fn a_file_hashed_within_a_tick_of_its_change_is_read_again() {
        let old = Old::new();
        // Its times were set just now, by the operating system's clock.
        old.forge(1);
        assert_eq!(old.digest().blake3, blake3::hash(b"first").to_hex().as_str());
    }

    #[test]
    fn a_changed_file_is_read_again_whatever_its_size_and_its_time_say() {
        let old = Old::new();
        old.forge(10);
        let time = std::fs::metadata(old.path()).unwrap().modified().unwrap();
        std::fs::write(old.path(), "other").unwrap();
        File::options().write(true).open(old.path()).unwrap().set_modified(time).unwrap();
        if cfg!(unix) {
            assert_eq!(old.digest().blake3, blake3::hash(b"other").to_hex().as_str());
        }
        old.forge(10);
        old.write("longer than before", 100);
        assert_eq!(old.digest().bytes, 18);
    }

    #[test]
    fn a_file_from_the_future_is_read_every_time() {
        let old = Old::new();
        let future = SystemTime::now() + Duration::from_secs(3600);
        File::options().write(true).open(old.path()).unwrap().set_modified(future).unwrap();
        old.forge(10);
        assert_eq!(old.digest().blake3, blake3::hash(b"first").to_hex().as_str());
    }

    #[test]
    fn a_folder_and_an_absent_file_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        for path in [folder.path().to_owned(), folder.path().join("absent")] {
            assert!(matches!(Digests::new(None).of(&path), Err(Error::Read { .. })));
        }
    }
}
