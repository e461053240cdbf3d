//! The one door to the file system: every operation by which the archive changes a disk is a method of [`Disk`], so
//! that tests can cut the power, fill the disk or make it fail at each of them.
//!
//! Files are written whole or not at all: temporary file in the same folder, fsync, rename, fsync of the folder. An fsync
//! that failed is never repeated on the same file (the kernel may have dropped the pages and say "done" the second time;
//! fsync(2), errors): the attempt is thrown away and the next one writes a new file.

use super::error::{ArchiveError, Result};
use rustix::fs::{FallocateFlags, fallocate, statvfs};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Names that begin so are unfinished writes; a crash may leave one, nothing ever reads one.
pub const TEMPORARY_PREFIX: &str = ".tmp-";

/// What fills reserved room where the file system cannot reserve.
pub(super) const FILLING: u8 = 0xA5;

/// Where a journal commit stands when the disk is told of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Commit {
    /// About to be written; nothing of it is on the disk. An error here takes the transaction back.
    Begins,
    /// Written and synced.
    Done,
}

/// Where the archive's bytes go. What the methods do by themselves is the real disk; tests override some of them.
pub trait Disk: Send + Sync {
    /// Makes one folder.
    ///
    /// # Errors
    /// Those of the operating system; so for all methods.
    fn create_folder(&self, path: &Path) -> io::Result<()> {
        fs::create_dir(path)
    }

    /// Makes a file that is not there yet.
    ///
    /// # Errors
    /// Also when the file exists.
    fn create(&self, path: &Path) -> io::Result<File> {
        OpenOptions::new().write(true).create_new(true).open(path)
    }

    /// Writes all bytes at the end of a file just made at `path`.
    ///
    /// # Errors
    /// ENOSPC, EIO; part of the bytes may then be written.
    fn append(&self, file: &mut File, _path: &Path, bytes: &[u8]) -> io::Result<()> {
        file.write_all(bytes)
    }

    /// Takes room for `bytes` bytes in a file just made at `path`.
    ///
    /// # Errors
    /// ENOSPC.
    fn reserve(&self, file: &mut File, _path: &Path, bytes: u64) -> io::Result<()> {
        match fallocate(&*file, FallocateFlags::empty(), 0, bytes) {
            Err(rustix::io::Errno::OPNOTSUPP) => {
                io::copy(&mut io::Read::take(io::repeat(FILLING), bytes), file).map(drop)
            }
            other => Ok(other?),
        }
    }

    /// Brings a file's content to the disk.
    ///
    /// # Errors
    /// EIO: what was written may be lost, whatever a second call says.
    fn sync(&self, file: &File, _path: &Path) -> io::Result<()> {
        file.sync_all()
    }

    /// Gives a file or folder its final name.
    ///
    /// # Errors
    /// The old name then stays.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    /// Removes a file.
    ///
    /// # Errors
    /// The file then stays.
    fn remove(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }

    /// Brings a folder's entries to the disk.
    ///
    /// # Errors
    /// EIO: what was renamed in it may be lost.
    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        File::open(folder)?.sync_all()
    }

    /// Overwrites the first bytes of a small file; makes it where there is none. Nothing is synced.
    ///
    /// # Errors
    /// The old bytes then stay, or part of the new ones.
    fn mark(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let file = OpenOptions::new().write(true).create(true).truncate(false).open(path)?;
        file.write_all_at(bytes, 0)
    }

    /// Told around each commit of the journal at `path`, whose file operations are SQLite's own.
    ///
    /// # Errors
    /// The commit then fails with this error.
    fn commit(&self, _path: &Path, _at: Commit) -> io::Result<()> {
        Ok(())
    }

    /// Bytes that this user may still write on the file system of `folder`.
    ///
    /// # Errors
    /// A folder that is not there.
    fn free(&self, folder: &Path) -> io::Result<u64> {
        let system = statvfs(folder)?;
        Ok(system.f_bavail.saturating_mul(system.f_frsize))
    }

    /// Writes `bytes` to `path` so that after any crash the file is whole, old or absent.
    ///
    /// # Errors
    /// An old file of that name is then unchanged, unless the folder's sync was what failed.
    fn write_atomic(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        write_parts(self, path, bytes)
    }

    /// Removes a file where there is one.
    ///
    /// # Errors
    /// The file then stays.
    fn discard(&self, path: &Path) -> io::Result<()> {
        match path.symlink_metadata() {
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
            _ => self.remove(path),
        }
    }
}

/// The operating system's file system.
#[derive(Debug, Clone, Copy, Default)]
pub struct RealDisk;

impl Disk for RealDisk {}

/// Writes a file of a run or product atomically; makes the folder when it is missing.
///
/// # Errors
/// [`ArchiveError::Full`], [`ArchiveError::Failing`] or [`ArchiveError::Io`]; an old file of that name is then unchanged.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<()> {
    write_on(&RealDisk, path, bytes)
}

/// As [`write_atomic`], on `disk`.
pub(super) fn write_on(disk: &dyn Disk, path: &Path, bytes: &[u8]) -> Result<()> {
    if let Some(folder) = path.parent() {
        make_folders(disk, folder)?;
    }
    write_parts(disk, path, bytes).map_err(|e| ArchiveError::io("write", path, &e))
}

/// The bytes of a file; `None` where there is none.
///
/// # Errors
/// The disk's kinds for a file that is there and cannot be read.
pub(super) fn read_where_there(path: &Path) -> Result<Option<Vec<u8>>> {
    match fs::read(path) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
        read => read.map(Some).map_err(|e| ArchiveError::io("read", path, &e)),
    }
}

/// Gives the finished file `temporary` of another writer its name `path`, durably. On failure it is removed.
///
/// # Errors
/// As [`write_atomic`].
pub fn commit_file(temporary: &Path, path: &Path) -> Result<()> {
    let disk = RealDisk;
    let commit = || disk.sync(&File::open(temporary)?, temporary).and_then(|()| disk.rename(temporary, path));
    let committed = commit().inspect_err(|_| {
        // Only takes space; its own failure tells nothing new.
        let _ = disk.discard(temporary);
    });
    committed
        .and_then(|()| disk.sync_folder(path.parent().unwrap_or(Path::new(""))))
        .map_err(|e| ArchiveError::io("write", path, &e))
}

fn write_parts<D: Disk + ?Sized>(disk: &D, path: &Path, bytes: &[u8]) -> io::Result<()> {
    let temporary = temporary_name(path);
    disk.discard(&temporary)?;
    let write = || {
        let mut file = disk.create(&temporary)?;
        disk.append(&mut file, &temporary, bytes)?;
        disk.sync(&file, &temporary)?;
        disk.rename(&temporary, path)
    };
    if let Err(e) = write() {
        // What is left of the attempt only takes space; its own failure tells nothing new.
        let _ = disk.discard(&temporary);
        return Err(e);
    }
    disk.sync_folder(path.parent().unwrap_or(Path::new("")))
}

/// The temporary name beside `path`.
pub fn temporary_name(path: &Path) -> PathBuf {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    path.with_file_name(format!("{TEMPORARY_PREFIX}{name}"))
}

/// Makes a folder with its parents and syncs each folder that got a new entry.
///
/// # Errors
/// The disk's kinds.
pub fn make_folders(disk: &dyn Disk, folder: &Path) -> Result<()> {
    if folder.as_os_str().is_empty() || folder.is_dir() {
        return Ok(());
    }
    let parent = folder.parent().unwrap_or(Path::new(""));
    make_folders(disk, parent)?;
    match disk.create_folder(folder) {
        Err(e) if e.kind() != io::ErrorKind::AlreadyExists => {
            return Err(ArchiveError::io("create the folder", folder, &e));
        }
        _ => {}
    }
    disk.sync_folder(parent).map_err(|e| ArchiveError::io("sync the folder", parent, &e))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use std::sync::atomic::{AtomicU32, Ordering};

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
    fn what_another_writer_made_gets_its_name_or_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("picture.png");
        let temporary = temporary_name(&path);
        fs::write(&temporary, b"pixels").unwrap();
        commit_file(&temporary, &path).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"pixels");
        fs::write(&temporary, b"more").unwrap();
        let text = commit_file(&temporary, &folder.path().join("none/a.png")).unwrap_err().to_string();
        assert!(text.contains("none/a.png"), "{text}");
        assert!(!temporary.exists());
    }

    /// A disk whose first sync of a file fails and which notes the files it synced, by inode.
    #[derive(Default)]
    struct FirstSyncFails(AtomicU32);

    impl Disk for FirstSyncFails {
        fn sync(&self, file: &File, _: &Path) -> io::Result<()> {
            if self.0.fetch_add(1, Ordering::SeqCst) == 0 {
                return Err(io::Error::from_raw_os_error(5));
            }
            file.sync_all()
        }
    }

    #[test]
    fn a_failed_sync_is_not_tried_again_on_the_same_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frame");
        let disk = FirstSyncFails::default();
        assert!(disk.write_atomic(&path, b"one").is_err());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "the attempt is thrown away");
        disk.write_atomic(&path, b"two").unwrap();
        assert_eq!((fs::read(&path).unwrap(), disk.0.load(Ordering::SeqCst)), (b"two".to_vec(), 2));
    }

    #[test]
    fn free_room_is_told_and_room_can_be_reserved() {
        let folder = tempfile::tempdir().unwrap();
        assert!(RealDisk.free(folder.path()).unwrap() > 0);
        assert!(RealDisk.free(&folder.path().join("none")).is_err());
        let path = folder.path().join("ballast");
        let mut file = RealDisk.create(&path).unwrap();
        RealDisk.reserve(&mut file, &path, 10_000).unwrap();
        assert_eq!(fs::metadata(&path).unwrap().len(), 10_000);
    }
}
