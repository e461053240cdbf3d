//! The atomic write everything goes through: temporary file in the same folder, fsync, rename, fsync of the folder.
//! After a power failure a file is there whole or not at all.

use super::error::{ArchiveError, Result};
use sha2::{Digest, Sha256};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Names that begin so are unfinished writes; a crash may leave one, nothing ever reads one.
pub const TEMPORARY_PREFIX: &str = ".tmp-";

/// Where the archive's bytes go. The real disk, or one with faults in tests.
pub trait Disk: Send + Sync {
    /// Writes `bytes` to `path` so that after any crash the file is whole, old or absent.
    ///
    /// # Errors
    /// Those of the operating system; a file of that name is then unchanged.
    fn write_atomic(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;
}

/// The operating system's file system.
#[derive(Debug, Clone, Copy, Default)]
pub struct RealDisk;

// === impl RealDisk ===

impl Disk for RealDisk {
    fn write_atomic(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let (folder, temporary) = temporary_beside(path)?;
        let written = write_synced(&temporary, bytes).and_then(|()| fs::rename(&temporary, path));
        if let Err(e) = written {
            // What is left of the attempt only takes space; its own failure tells nothing new.
            let _ = fs::remove_file(&temporary);
            return Err(e);
        }
        sync_folder(&folder)
    }
}

/// Writes a file of a run or product atomically; makes the folder when it is missing.
///
/// # Errors
/// [`ArchiveError::Full`], [`ArchiveError::Failing`] or [`ArchiveError::Io`]; an old file of that name is then unchanged.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<()> {
    if let Some(folder) = path.parent() {
        make_folders(folder)?;
    }
    RealDisk.write_atomic(path, bytes).map_err(|e| ArchiveError::io("write", path, &e))
}

/// Makes a folder with its parents and syncs each folder that got a new entry.
pub(crate) fn make_folders(folder: &Path) -> Result<()> {
    if folder.as_os_str().is_empty() || folder.is_dir() {
        return Ok(());
    }
    let parent = folder.parent().unwrap_or(Path::new(""));
    make_folders(parent)?;
    match fs::create_dir(folder) {
        Err(e) if e.kind() != io::ErrorKind::AlreadyExists => {
            return Err(ArchiveError::io("create the folder", folder, &e));
        }
        _ => {}
    }
    sync_folder(parent).map_err(|e| ArchiveError::io("sync the folder", parent, &e))
}

/// Brings a folder's entries to the disk.
pub(crate) fn sync_folder(folder: &Path) -> io::Result<()> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    File::open(folder)?.sync_all()
}

/// SHA-256 of bytes, hexadecimal.
pub fn sha256_hex(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(64);
    for byte in Sha256::digest(bytes) {
        text.push(char::from_digit(u32::from(byte >> 4), 16).unwrap_or('0'));
        text.push(char::from_digit(u32::from(byte & 15), 16).unwrap_or('0'));
    }
    text
}

fn temporary_beside(path: &Path) -> io::Result<(PathBuf, PathBuf)> {
    let name = path.file_name().ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "no file name"))?;
    let folder = path.parent().map(Path::to_path_buf).unwrap_or_default();
    let mut temporary = std::ffi::OsString::from(TEMPORARY_PREFIX);
    temporary.push(name);
    let temporary = folder.join(temporary);
    Ok((folder, temporary))
}

fn write_synced(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn a_write_replaces_the_whole_file_and_leaves_nothing_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b/file.txt");
        write_atomic(&path, b"old and long").unwrap();
        write_atomic(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn a_write_that_fails_keeps_the_old_file() {
        // A folder in the place of the temporary file makes the write fail as a whole.
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        write_atomic(&path, b"old").unwrap();
        fs::create_dir(folder.path().join(".tmp-file")).unwrap();
        assert!(write_atomic(&path, b"new").is_err());
        assert_eq!(fs::read(&path).unwrap(), b"old");
    }

    #[test]
    fn digests_are_those_of_the_standard() {
        // FIPS 180-4, message "abc".
        assert_eq!(sha256_hex(b"abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }
}
