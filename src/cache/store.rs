//! A folder of entries: one file per key, checked when it is read, replaced by renaming.

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use serde::Serialize;

use super::Key;
use crate::encode::file::write_bytes_atomically;
use crate::{Error, Result};

/// What every entry begins with; then come its key, the hash of its content, and the content.
const MAGIC: &[u8; 20] = b"splatprobe cache 1\r\n";

/// Bytes before the content.
const HEADER: usize = MAGIC.len() + 32 + 32;

/// Tells backup programs that the folder can be made anew (bford.info/cachedir).
const TAG: (&str, &[u8]) = ("CACHEDIR.TAG", b"Signature: 8a477f597d28d172789f06886806bc55\n# Of splatprobe.\n");

/// What a temporary file that was never renamed is called (`tempfile`'s names).
const TEMPORARY: &str = ".tmp";

/// Temporary files older than this are of processes that were killed.
const ABANDONED: Duration = Duration::from_secs(24 * 60 * 60);

/// A folder of entries. It is made when the first is put.
#[derive(Debug, Clone)]
pub struct Store {
    folder: PathBuf,
}

/// How much a store holds, or lost.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct CacheStatistics {
    /// How many entries.
    pub entries: u64,
    /// Their size in bytes.
    pub bytes: u64,
}

/// An entry as the folder lists it.
struct Listed {
    path: PathBuf,
    bytes: u64,
    used: SystemTime,
}

impl Store {
    /// The store in `folder`.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into() }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The content put under `key`; `None` where there is none, or it is not whole.
    pub fn get(&self, key: &Key) -> Option<Vec<u8>> {
        let path = self.path_of(key);
        let mut file = File::open(&path).ok()?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).ok()?;
        let content = bytes.get(HEADER..)?;
        if bytes[..HEADER] != header(key, content) {
            return None;
        }
        // What was used last is pruned last. Where the folder is read-only, somebody else prunes it.
        let _ = File::options().write(true).open(&path).and_then(|file| file.set_modified(SystemTime::now()));
        bytes.drain(..HEADER);
        Some(bytes)
    }

    /// Puts `content` under `key`, in place of what is there.
    ///
    /// Fails with [`Error::Write`]; what was there before then still is.
    pub fn put(&self, key: &Key, content: &[u8]) -> Result<()> {
        let path = self.path_of(key);
        let folder = path.parent().unwrap_or(&self.folder);
        std::fs::create_dir_all(folder).map_err(|source| Error::write(folder, source))?;
        let tag = self.folder.join(TAG.0);
        if !tag.exists() {
            write_bytes_atomically(&tag, |file| file.write_all(TAG.1))?;
        }
        write_bytes_atomically(&path, |file| {
            file.write_all(&header(key, content))?;
            file.write_all(content)
        })
    }

    /// How much there is. Fails with [`Error::Read`] where the folder cannot be listed.
    pub fn statistics(&self) -> Result<CacheStatistics> {
        let mut statistics = CacheStatistics::default();
        self.for_each(|entry| {
            statistics.entries += 1;
            statistics.bytes += entry.bytes;
        })?;
        Ok(statistics)
    }

    /// Removes entries that were not used for `age`, and then those whose last use is longest ago until the rest takes at
    /// most `bytes`. Files that are no entries stay. Returns what was removed; what cannot be removed stays, too.
    ///
    /// Fails with [`Error::Read`] where the folder cannot be listed.
    pub fn prune(&self, bytes: Option<u64>, age: Option<Duration>) -> Result<CacheStatistics> {
        let mut entries = Vec::new();
        self.for_each(|entry| entries.push(entry))?;
        // The latest first; of equal ones the path decides.
        entries.sort_by(|a, b| b.used.cmp(&a.used).then_with(|| a.path.cmp(&b.path)));
        let now = SystemTime::now();
        let (mut kept, mut removed) = (0, CacheStatistics::default());
        for entry in entries {
            // Of an entry from the future nothing is known; it is new.
            let unused = now.duration_since(entry.used).unwrap_or_default();
            let fits = bytes.is_none_or(|bytes| kept + entry.bytes <= bytes);
            if fits && age.is_none_or(|age| unused <= age) {
                kept += entry.bytes;
            } else if std::fs::remove_file(&entry.path).is_ok() {
                removed.entries += 1;
                removed.bytes += entry.bytes;
            }
        }
        Ok(removed)
    }

    /// Removes all entries, and the folder if nothing else is in it.
    pub fn remove(&self) {
        let _ = self.prune(Some(0), None);
        let _ = std::fs::remove_file(self.folder.join(TAG.0));
        for entry in std::fs::read_dir(&self.folder).into_iter().flatten().flatten() {
            // Fails for what is not empty, as it should.
            let _ = std::fs::remove_dir(entry.path());
        }
        let _ = std::fs::remove_dir(&self.folder);
    }

    /// Calls `visit` for every entry, and clears away temporary files that were left behind.
    fn for_each(&self, mut visit: impl FnMut(Listed)) -> Result<()> {
        let list = |folder: &Path| match std::fs::read_dir(folder) {
            Ok(entries) => Ok(entries.filter_map(io::Result::ok).map(|entry| entry.path()).collect()),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
            Err(source) => Err(Error::read(folder, source)),
        };
        for folder in list(&self.folder)?.iter().filter(|path| is_hex(path, 2) && path.is_dir()) {
            for path in list(folder)? {
                let Ok(metadata) = path.symlink_metadata() else { continue };
                let used = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
                if is_hex(&path, 62) && metadata.is_file() {
                    visit(Listed { path, bytes: metadata.len(), used });
                } else if name_of(&path).starts_with(TEMPORARY) && used.elapsed().is_ok_and(|age| age > ABANDONED) {
                    let _ = std::fs::remove_file(&path);
                }
            }
        }
        Ok(())
    }

    fn path_of(&self, key: &Key) -> PathBuf {
        let hex = key.hex();
        self.folder.join(&hex[..2]).join(&hex[2..])
    }
}

fn header(key: &Key, content: &[u8]) -> [u8; HEADER] {
    let mut hasher = blake3::Hasher::new();
    hasher.update_rayon(content);
    let mut header = [0; HEADER];
    header[..20].copy_from_slice(MAGIC);
    header[20..52].copy_from_slice(&key.0);
    header[52..].copy_from_slice(hasher.finalize().as_bytes());
    header
}

fn is_hex(path: &Path, digits: usize) -> bool {
    let name = name_of(path);
    name.len() == digits && name.bytes().all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte))
}

fn name_of(path: &Path) -> &str {
    path.file_name().and_then(|name| name.to_str()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn store() -> (tempfile::TempDir, Store) {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::new(folder.path().join("cache"));
        (folder, store)
    }

    #[test]
    fn what_is_put_can_be_got_and_put_anew() {
        let (_folder, store) = store();
        let key = Key::of("test", &1);
        assert_eq!(store.get(&key), None);
        for content in [&b"one"[..], b"", b"another"] {
            store.put(&key, content).unwrap();
            assert_eq!(store.get(&key).unwrap(), content);
        }
        assert_eq!(store.get(&Key::of("test", &2)), None);
    }

    #[test]
    fn no_flipped_bit_and_no_cut_goes_unseen() {
        let (_folder, store) = store();
        let (key, other) = (Key::of("test", &1), Key::of("test", &2));
        store.put(&key, b"content").unwrap();
        let path = store.path_of(&key);
        let whole = std::fs::read(&path).unwrap();
        for i in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[i] ^= 1 << (i % 8);
            std::fs::write(&path, &damaged).unwrap();
            assert_eq!(store.get(&key), None, "byte {i}");
            std::fs::write(&path, &whole[..i]).unwrap();
            assert_eq!(store.get(&key), None, "{i} bytes");
        }
        // A whole entry under another's name.
        std::fs::create_dir_all(store.path_of(&other).parent().unwrap()).unwrap();
        std::fs::write(store.path_of(&other), &whole).unwrap();
        assert_eq!(store.get(&other), None);
        store.put(&key, b"content").unwrap();
        assert_eq!(store.get(&key).unwrap(), b"content");
    }

    #[test]
    fn pruning_removes_what_was_unused_longest_and_nothing_foreign() {
        let (_folder, store) = store();
        let keys = [1, 2, 3, 4].map(|i| Key::of("test", &i));
        for (key, days) in keys.iter().zip([4, 3, 2, 1]) {
            store.put(key, &[0; 100]).unwrap();
            let used = SystemTime::now() - Duration::from_secs(days * 86400);
            File::options().write(true).open(store.path_of(key)).unwrap().set_modified(used).unwrap();
        }
        let foreign = store.path_of(&keys[0]).parent().unwrap().join("mine.txt");
        std::fs::write(&foreign, "mine").unwrap();
        std::fs::write(store.folder().join("notes"), "mine").unwrap();
        let size = (HEADER + 100) as u64;
        assert_eq!(store.statistics().unwrap(), CacheStatistics { entries: 4, bytes: 4 * size });
        assert_eq!(store.prune(None, Some(Duration::from_secs(86400 * 7 / 2))).unwrap().entries, 1);
        assert_eq!(store.get(&keys[0]), None);
        // Used now, so that the third is the oldest.
        store.get(&keys[1]).unwrap();
        assert_eq!(store.prune(Some(2 * size), None).unwrap(), CacheStatistics { entries: 1, bytes: size });
        assert!(store.get(&keys[2]).is_none() && store.get(&keys[1]).is_some() && store.get(&keys[3]).is_some());
        store.remove();
        assert_eq!(store.statistics().unwrap().entries, 0);
        assert!(foreign.exists() && store.folder().join("notes").exists());
    }

    #[test]
    fn an_absent_folder_is_an_empty_store_and_removed_without_a_trace() {
        let (_folder, store) = store();
        assert_eq!(store.statistics().unwrap(), CacheStatistics::default());
        store.put(&Key::of("test", &1), b"x").unwrap();
        store.remove();
        assert!(!store.folder().exists());
    }
}
