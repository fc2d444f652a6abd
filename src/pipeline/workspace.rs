//! The folder inside the output folder in which a bake works: [`WORK_FOLDER`]. It is there while a bake runs or has work left,
//! and belongs to one process at a time.

use std::fs::{File, TryLockError};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use crate::cache::Store;
use crate::manifest::WORK_FOLDER;
use crate::{Error, Result};

/// Files on their way to the output folder. In the same folder, so that moving them is a rename.
const STAGING: &str = "staging";

/// Results that are done, until all are. A [`Store`], so that a half-written one is none.
const JOURNAL: &str = "done";

const LOCK: &str = "lock";

/// Another process may remove the folder between two steps of locking it; so often that does not happen by chance.
const ATTEMPTS: usize = 100;

/// A bake's place in its output folder, until it is dropped.
pub(super) struct Workspace {
    output: PathBuf,
    folder: PathBuf,
    journal: Store,
    /// Locked; the system unlocks it when the process ends in whatever way.
    _lock: File,
    made_output: bool,
    /// Whether the journal holds what a later run can use.
    is_resumable: AtomicBool,
}

impl Workspace {
    /// Makes `output` and takes it for this process. What a process that was killed left half-done is cleared away, what it
    /// had done stays.
    ///
    /// Fails with [`Error::Busy`] while another process has it, and with [`Error::Write`].
    pub fn begin(output: &Path) -> Result<Self> {
        let made_output = !output.exists();
        let folder = output.join(WORK_FOLDER);
        let lock = lock(output, &folder)?;
        let journal = Store::new(folder.join(JOURNAL));
        // What a bake that was killed had done outlives one that fails.
        let is_resumable = AtomicBool::new(journal.statistics().is_ok_and(|there| there.entries > 0));
        let workspace = Self { output: output.to_owned(), folder, journal, _lock: lock, made_output, is_resumable };
        let staging = workspace.staging();
        workspace.clear_staging();
        std::fs::create_dir(&staging).map_err(|source| Error::write(staging, source))?;
        Ok(workspace)
    }

    /// The output folder.
    pub fn output(&self) -> &Path {
        &self.output
    }

    /// Where files are made before they are moved into the output folder.
    pub fn staging(&self) -> PathBuf {
        self.folder.join(STAGING)
    }

    /// Where results are kept that a later run goes on from.
    pub fn journal(&self) -> &Store {
        &self.journal
    }

    /// Whether the journal outlives this bake: it does where something is done and something is left.
    pub fn set_resumable(&self, is_resumable: bool) {
        self.is_resumable.store(is_resumable, Ordering::Relaxed);
    }

    fn clear_staging(&self) {
        let _ = std::fs::remove_dir_all(self.staging());
    }
}

impl Drop for Workspace {
    fn drop(&mut self) {
        self.clear_staging();
        if !self.is_resumable.load(Ordering::Relaxed) {
            self.journal.remove();
        }
        let _ = std::fs::remove_file(self.folder.join(LOCK));
        // Both fail where something is in them, as they should.
        let _ = std::fs::remove_dir(&self.folder);
        if self.made_output {
            let _ = std::fs::remove_dir(&self.output);
        }
    }
}

fn lock(output: &Path, folder: &Path) -> Result<File> {
    let path = folder.join(LOCK);
    let mut last = None;
    for _ in 0..ATTEMPTS {
        let open = || {
            std::fs::create_dir_all(folder)?;
            File::options().create(true).truncate(false).write(true).open(&path)
        };
        let file = match open() {
            Ok(file) => file,
            Err(error) if error.kind() == ErrorKind::NotFound => {
                last = Some(error);
                continue;
            }
            Err(source) => return Err(Error::write(folder, source)),
        };
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => return Err(Error::Busy { path: output.into() }),
            // File systems without locks: there the user must see to it.
            Err(TryLockError::Error(error)) if error.kind() == ErrorKind::Unsupported => return Ok(file),
            Err(TryLockError::Error(source)) => return Err(Error::write(path, source)),
            // Unless the one before has removed it meanwhile, so that a third can make and lock another.
            Ok(()) if is_at(&file, &path) => return Ok(file),
            Ok(()) => {}
        }
    }
    Err(Error::write(path, last.unwrap_or(ErrorKind::WouldBlock.into())))
}

#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;

    let identity = |metadata: &std::fs::Metadata| (metadata.dev(), metadata.ino());
    matches!((file.metadata(), path.metadata()), (Ok(open), Ok(there)) if identity(&open) == identity(&there))
}

#[cfg(not(unix))]
fn is_at(_: &File, path: &Path) -> bool {
    path.exists()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cache::Key;

    #[test]
    fn a_second_bake_of_a_folder_is_refused_until_the_first_ends() {
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("out");
        let first = Workspace::begin(&output).unwrap();
        assert!(matches!(Workspace::begin(&output), Err(Error::Busy { path }) if path == output));
        drop(first);
        assert!(!output.exists(), "nothing is left of a bake that wrote nothing");
        drop(Workspace::begin(&output).unwrap());
    }

    #[test]
    fn what_is_done_stays_for_the_next_and_what_is_foreign_stays() {
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("out");
        let key = Key::of("test", &1);
        let first = Workspace::begin(&output).unwrap();
        first.journal().put(&key, b"done").unwrap();
        first.set_resumable(true);
        drop(first);
        std::fs::write(output.join(WORK_FOLDER).join("mine"), "").unwrap();
        let second = Workspace::begin(&output).unwrap();
        assert_eq!(second.journal().get(&key).unwrap(), b"done");
        second.set_resumable(false);
        drop(second);
        let left: Vec<_> =
            std::fs::read_dir(output.join(WORK_FOLDER)).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert_eq!(left, ["mine"]);
    }
}
