//! Whole files or none: a product is written under a temporary name, made durable, then renamed.

use super::ExportError;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Writes `bytes` to `path`: temporary file beside it, fsync, rename, fsync of the folder.
///
/// # Errors
/// [`ExportError::Io`]; the old file, if there was one, is then untouched.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), ExportError> {
    let temporary = temporary_name(path);
    let io = |source| ExportError::Io { path: path.to_owned(), source };
    let mut file = File::create(&temporary).map_err(io)?;
    file.write_all(bytes).map_err(io)?;
    drop(file);
    commit(&temporary, path)
}

/// Makes the finished temporary file durable and gives it its name.
///
/// # Errors
/// [`ExportError::Io`].
pub fn commit(temporary: &Path, path: &Path) -> Result<(), ExportError> {
    let io = |source| ExportError::Io { path: path.to_owned(), source };
    File::open(temporary).and_then(|f| f.sync_all()).map_err(io)?;
    std::fs::rename(temporary, path).map_err(io)?;
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    File::open(folder).and_then(|f| f.sync_all()).map_err(io)
}

/// The temporary name beside `path`; keeps the suffix, because some writers choose the format by it.
pub fn temporary_name(path: &Path) -> PathBuf {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    path.with_file_name(format!(".tmp-{name}"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_file_is_replaced_whole_and_nothing_stays_behind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.xml");
        write_whole(&path, b"old").unwrap();
        write_whole(&path, b"new and longer").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new and longer");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_missing_folder_is_told_with_its_path() {
        let folder = tempfile::tempdir().unwrap();
        let text = write_whole(&folder.path().join("none/a.xml"), b"").unwrap_err().to_string();
        assert!(text.contains("none/a.xml") && text.contains("folder exists"), "{text}");
    }
}
