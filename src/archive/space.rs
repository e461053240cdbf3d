//! Room on the disk: proven before a run begins, and a ballast that a full disk gives back for the last records.

use super::disk::{Disk, FILLING};
use super::error::{ArchiveError, Result};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// File that keeps room for the last records of a run; gone once the run is closed.
pub const BALLAST: &str = "journal.ballast";

/// Its size: the journal's last pages, their log and the seal many times over.
pub const BALLAST_BYTES: u64 = 1 << 20;

/// Free room from which on a ballast that was given back is taken again.
const ROOM_AGAIN: u64 = 32 * BALLAST_BYTES;

/// Room asked for, relative to the forecast: compression helps, other programs write too.
pub const FORECAST_MARGIN: f64 = 1.2;

/// The ballast of one run.
pub(super) struct Ballast {
    path: PathBuf,
    disk: Arc<dyn Disk>,
}

/// Proves that a run of `forecast_bytes` fits on the file system of `folder`, with margin and ballast.
///
/// # Errors
/// [`ArchiveError::NoRoom`], [`ArchiveError::Io`] where free room cannot be told.
pub fn must_fit(disk: &dyn Disk, folder: &Path, forecast_bytes: u64) -> Result<()> {
    // The runs folder may not be there yet; its file system is that of the nearest parent that is.
    let standing = folder.ancestors().find(|f| f.is_dir()).unwrap_or(Path::new("."));
    let free = disk.free(standing).map_err(|e| ArchiveError::io("tell the free room of", standing, &e))?;
    let needed = (forecast_bytes as f64 * FORECAST_MARGIN) as u64 + BALLAST_BYTES;
    if free >= needed {
        return Ok(());
    }
    Err(ArchiveError::NoRoom { path: folder.to_path_buf(), needed, free })
}

/// True when the ballast of the run directory `run` has a byte that was never written into it.
pub(super) fn ballast_changed(run: &Path) -> bool {
    std::fs::read(run.join(BALLAST)).is_ok_and(|bytes| bytes.iter().any(|b| *b != 0 && *b != FILLING))
}

// === impl Ballast ===

impl Ballast {
    /// The ballast of the run directory `run`, whether it lies there or not.
    pub(super) fn of(run: &Path, disk: Arc<dyn Disk>) -> Ballast {
        Ballast { path: run.join(BALLAST), disk }
    }

    /// Puts the ballast there where it is missing. A disk too full even for it is told by the first write.
    pub(super) fn take(&self) {
        if self.path.exists() {
            return;
        }
        let reserve = || {
            let mut file = self.disk.create(&self.path)?;
            self.disk.reserve(&mut file, &self.path, BALLAST_BYTES)
        };
        if reserve().is_err() {
            self.release();
        }
    }

    /// Puts a ballast that was given back there again, once there is room for much more than it.
    pub(super) fn take_again(&self) {
        let folder = self.path.parent().unwrap_or(Path::new(""));
        if !self.path.exists() && self.disk.free(folder).is_ok_and(|free| free >= ROOM_AGAIN) {
            self.take();
        }
    }

    /// Gives its room back; true when there was some.
    pub(super) fn release(&self) -> bool {
        let gone = || -> io::Result<()> {
            self.disk.remove(&self.path)?;
            self.disk.sync_folder(self.path.parent().unwrap_or(Path::new("")))
        };
        self.path.exists() && gone().is_ok()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::archive::disk::RealDisk;

    struct Free(u64);

    impl Disk for Free {
        fn free(&self, _: &Path) -> io::Result<u64> {
            Ok(self.0)
        }
    }

    #[test]
    fn a_run_that_would_not_fit_is_refused_in_one_sentence() {
        let folder = tempfile::tempdir().unwrap();
        let runs = folder.path().join("not/there/yet");
        must_fit(&Free(120_000_000 + BALLAST_BYTES), &runs, 100_000_000).unwrap();
        let text = must_fit(&Free(120_000_000), &runs, 100_000_000).unwrap_err().to_string();
        for part in ["not/there/yet", "121.0 MB", "120.0 MB", "free"] {
            assert!(text.contains(part), "{text}");
        }
    }

    #[test]
    fn ballast_is_there_once_and_gives_its_room_back_once() {
        let run = tempfile::tempdir().unwrap();
        let ballast = Ballast::of(run.path(), Arc::new(RealDisk));
        ballast.take();
        ballast.take();
        assert_eq!(std::fs::metadata(run.path().join(BALLAST)).unwrap().len(), BALLAST_BYTES);
        assert!(ballast.release());
        assert!(!ballast.release());
        Ballast::of(run.path(), Arc::new(Free(ROOM_AGAIN - 1))).take_again();
        assert!(!run.path().join(BALLAST).exists(), "a disk that is nearly full keeps its room");
        Ballast::of(run.path(), Arc::new(Free(ROOM_AGAIN))).take_again();
        assert!(run.path().join(BALLAST).exists());
    }
}
