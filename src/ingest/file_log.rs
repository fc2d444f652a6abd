//! Which files an input was read from: the one that it names, and those that this one names.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Paths, noted on any thread. Copies share one list.
#[derive(Debug, Clone, Default)]
pub(super) struct FileLog(Arc<Mutex<BTreeSet<PathBuf>>>);

impl FileLog {
    /// Notes a file that is about to be looked for, whether it is there or not: what is read depends on that, too.
    pub fn add(&self, path: &Path) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(path.to_owned());
    }

    /// What was noted so far, sorted.
    pub fn files(&self) -> Vec<PathBuf> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).iter().cloned().collect()
    }
}
