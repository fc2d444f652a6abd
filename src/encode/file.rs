//! Files that appear whole or not at all.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use crate::error::{Error, Result};

/// Writes a file beside its final name and renames it, so that a reader never sees half of it. The folder must exist.
///
/// Fails with [`Error::Write`] when the folder does not take the file or `write` fails (a full disk); a file that was at
/// `path` before is then untouched and nothing is left beside it.
pub fn write_bytes_atomically(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<()> {
    write_and_rename(path, write).map_err(|source| Error::write(path, source))
}

fn write_and_rename(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> io::Result<()> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let (file, temporary_path) = temporary_file(folder)?.into_parts();
    let mut writer = BufWriter::with_capacity(1 << 16, file);
    write(&mut writer)?;
    writer.flush()?;
    // Windows renames no open files.
    drop(writer);
    temporary_path.persist(path)?;
    Ok(())
}

/// Others may read what a bake wrote as far as the umask lets them; temporary files are private by default.
#[cfg(unix)]
fn temporary_file(folder: &Path) -> io::Result<tempfile::NamedTempFile> {
    use std::os::unix::fs::PermissionsExt;

    tempfile::Builder::new().permissions(std::fs::Permissions::from_mode(0o666)).tempfile_in(folder)
}

#[cfg(not(unix))]
fn temporary_file(folder: &Path) -> io::Result<tempfile::NamedTempFile> {
    tempfile::NamedTempFile::new_in(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failing_write_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("probe.exr");
        std::fs::write(&path, "old").unwrap();
        let result = write_bytes_atomically(&path, |writer| {
            writer.write_all(b"new")?;
            Err(io::ErrorKind::StorageFull.into())
        });
        assert!(matches!(&result, Err(Error::Write { path: p, .. }) if *p == path), "{result:?}");
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_write_replaces_the_old_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("probe.exr");
        std::fs::write(&path, "old").unwrap();
        write_bytes_atomically(&path, |writer| writer.write_all(b"new")).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_folder_that_does_not_exist_is_a_write_error() {
        let path = tempfile::tempdir().unwrap().path().join("gone/probe.exr");
        let result = write_bytes_atomically(&path, |_| Ok(()));
        assert!(matches!(result, Err(Error::Write { .. })), "{result:?}");
    }

    #[cfg(unix)]
    #[test]
    fn the_file_has_the_permissions_of_any_new_file() {
        use std::os::unix::fs::PermissionsExt;

        let folder = tempfile::tempdir().unwrap();
        let mode = |name: &str| folder.path().join(name).metadata().unwrap().permissions().mode();
        std::fs::write(folder.path().join("usual"), "").unwrap();
        write_bytes_atomically(&folder.path().join("ours"), |_| Ok(())).unwrap();
        assert_eq!(mode("ours"), mode("usual"));
    }
}
