//! What can go wrong in the archive; full and failing disks are kinds of their own, because they end a night.

use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Result of anything the archive does.
pub type Result<T> = std::result::Result<T, ArchiveError>;

/// An error of the run directory, in one sentence for the person who must act.
#[derive(Debug, Error)]
pub enum ArchiveError {
    /// No space is left (ENOSPC, EDQUOT, SQLITE_FULL).
    #[error("{}: the disk is full; free space on this file system and go on with the run", path.display())]
    Full {
        /// File that could not be written.
        path: PathBuf,
    },
    /// A run would not fit.
    #[error(
        "{}: the run needs {:.1} MB (forecast with margin), {:.1} MB are free; free space there, or choose another folder \
         with --runs or runs_dir",
        path.display(), *needed as f64 / 1e6, *free as f64 / 1e6
    )]
    NoRoom {
        /// Folder of the runs.
        path: PathBuf,
        /// Bytes needed.
        needed: u64,
        /// Bytes free.
        free: u64,
    },
    /// The disk itself fails (EIO) or has become read-only.
    #[error("{}: the disk fails ({message}); check the device and its cables before going on", path.display())]
    Failing {
        /// File that could not be written or read.
        path: PathBuf,
        /// What the operating system says.
        message: String,
    },
    /// Any other refusal of the file system.
    #[error("{}: cannot {what}: {message}; check the path and the rights of this user", path.display())]
    Io {
        /// What was tried: "write", "create the folder".
        what: &'static str,
        /// File or folder.
        path: PathBuf,
        /// What the operating system says.
        message: String,
    },
    /// A run of that name is there already.
    #[error("{}: this run exists already; choose another run id, or go on with the existing run", path.display())]
    Exists {
        /// The run directory.
        path: PathBuf,
    },
    /// The run id cannot be a folder name.
    #[error("run id \"{id}\": allowed are letters, digits, '.', '_' and '-', not starting with '.', at most 100")]
    BadRunId {
        /// The id as given.
        id: String,
    },
    /// A path inside the run directory leads out of it or names one of the archive's own files.
    #[error("{}: a file copied into a run needs a relative path without \"..\" that is none of the run's own files", path.display())]
    BadPath {
        /// The path as given.
        path: PathBuf,
    },
    /// The folder is not a run directory of this version.
    #[error("{}: not a run directory that can be read: {message}", path.display())]
    NotARun {
        /// The folder.
        path: PathBuf,
        /// What is missing or different.
        message: String,
    },
    /// The run's folder was moved, replaced or removed while the run was under way.
    #[error("{}: the run's folder is no longer the one that was opened; put it back where it was and go on with `goniod resume`", path.display())]
    Moved {
        /// Where it was.
        path: PathBuf,
    },
    /// The journal refuses or is damaged.
    #[error("{}: the journal gives an error: {message}; `goniod verify` on the run tells whether it is damaged", path.display())]
    Journal {
        /// The journal file.
        path: PathBuf,
        /// What SQLite says.
        message: String,
    },
    /// A run is not as it was written, beyond what can be taken again; nobody goes on with such a run unasked.
    #[error("{}: damaged, this is not as it was written: {message}; {advice}", path.display())]
    Damaged {
        /// The journal file, a frame's file or the run directory.
        path: PathBuf,
        /// What is changed.
        message: String,
        /// What can be done.
        advice: &'static str,
    },
    /// A frame does not fit its array, or no array has that name.
    #[error("{what}: the frame store of this run has no place for it")]
    NoPlace {
        /// Camera, view, exposure and size.
        what: String,
    },
    /// A chunk could not be encoded or decoded.
    #[error("{}: the frame cannot be {what}: {message}; the file is damaged or not ours", path.display())]
    Codec {
        /// "encoded" or "decoded".
        what: &'static str,
        /// The chunk's file.
        path: PathBuf,
        /// What the codec says.
        message: String,
    },
    /// The journal was closed before.
    #[error("{}: the run is closed", path.display())]
    Closed {
        /// The run directory.
        path: PathBuf,
    },
}

/// EIO of Linux: the device could not carry the transfer out.
const EIO: i32 = 5;

// === impl ArchiveError ===

impl ArchiveError {
    /// The error of a file operation, sorted by what recovery needs.
    pub fn io(what: &'static str, path: &Path, source: &io::Error) -> ArchiveError {
        let path = path.to_path_buf();
        match source.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => ArchiveError::Full { path },
            io::ErrorKind::ReadOnlyFilesystem => ArchiveError::Failing { path, message: source.to_string() },
            _ if source.raw_os_error() == Some(EIO) => ArchiveError::Failing { path, message: source.to_string() },
            _ => ArchiveError::Io { what, path, message: source.to_string() },
        }
    }

    /// What is not as it was written, and cannot be taken again.
    pub(super) fn damaged(path: &Path, message: impl Into<String>) -> ArchiveError {
        let advice = "`goniod verify` lists all of it; put the files back from a copy, or measure the scan anew";
        ArchiveError::Damaged { path: path.to_path_buf(), message: message.into(), advice }
    }

    /// The error of a journal operation. A file or folder that refuses this user is no damage.
    pub fn sql(path: &Path, source: &rusqlite::Error) -> ArchiveError {
        use rusqlite::ErrorCode::{CannotOpen, DiskFull, PermissionDenied, ReadOnly, SystemIoFailure};
        let (path, message) = (path.to_path_buf(), source.to_string());
        match source.sqlite_error_code() {
            Some(DiskFull) => ArchiveError::Full { path },
            Some(SystemIoFailure) => ArchiveError::Failing { path, message },
            Some(CannotOpen | PermissionDenied | ReadOnly) => {
                let what = "open the journal, whose folder must be writable as long as the run is not closed";
                ArchiveError::Io { what, path, message }
            }
            _ => ArchiveError::Journal { path, message },
        }
    }

    /// True when no space is left.
    pub fn is_full(&self) -> bool {
        matches!(self, ArchiveError::Full { .. } | ArchiveError::NoRoom { .. })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn full_and_failing_disks_are_kinds_of_their_own() {
        let at = Path::new("frames");
        let of = |code| ArchiveError::io("write", at, &io::Error::from_raw_os_error(code));
        assert!(of(28).is_full(), "ENOSPC");
        assert!(of(122).is_full(), "EDQUOT");
        assert!(matches!(of(EIO), ArchiveError::Failing { .. }));
        assert!(matches!(of(30), ArchiveError::Failing { .. }), "EROFS");
        assert!(matches!(of(13), ArchiveError::Io { .. }), "EACCES");
    }

    #[test]
    fn a_journal_that_refuses_this_user_is_not_damaged() {
        use rusqlite::ffi;
        let at = Path::new("journal.sqlite");
        let of = |code| ArchiveError::sql(at, &rusqlite::Error::SqliteFailure(ffi::Error::new(code), None));
        for code in [ffi::SQLITE_CANTOPEN, ffi::SQLITE_PERM, ffi::SQLITE_READONLY] {
            let error = of(code);
            assert!(matches!(error, ArchiveError::Io { .. }), "{error}");
            assert!(error.to_string().contains("must be writable") && error.to_string().contains("rights"), "{error}");
        }
        for code in [ffi::SQLITE_CORRUPT, ffi::SQLITE_NOTADB] {
            assert!(matches!(of(code), ArchiveError::Journal { .. }), "{code}");
        }
    }
}
