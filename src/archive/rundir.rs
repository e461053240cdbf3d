//! One run directory: made whole or not at all, opened to read, opened to go on, closed with a seal.

use super::disk::{Disk, RealDisk, TEMPORARY_PREFIX, make_folders, write_on};
use super::error::{ArchiveError, Result};
use super::frames::{FrameStore, Stored};
use super::journal::Journal;
use super::layout::RunLayout;
use super::rows::{EventRow, FileRow, FrameRow};
use super::seal::{PRODUCTS, SEAL, journal_seal};
use super::space::Ballast;
use super::verify::journal_must_be_sound;
use crate::digest::{sha256_hex, sha256_of_file};
use goniod_drivers::frame::Pixels;
use std::fs;
use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The resolved plan inside a run directory.
pub const PLAN: &str = "plan.toml";
/// The journal inside a run directory.
pub const JOURNAL: &str = "journal.sqlite";

/// What a new run starts from.
#[derive(Debug, Clone)]
pub struct NewRun<'a> {
    /// Name of the run and of its folder.
    pub run_id: &'a str,
    /// Everything resolved, as TOML text.
    pub plan_toml: &'a str,
    /// Files copied in so that the run stands alone: path inside the run directory, bytes.
    pub files: &'a [(PathBuf, Vec<u8>)],
    /// Arrays and steps.
    pub layout: &'a RunLayout,
}

/// An open run directory. Shared by the threads that store and read; each call is whole in itself.
pub struct RunDir {
    path: PathBuf,
    store: FrameStore,
    journal: Mutex<Option<Journal>>,
    disk: Arc<dyn Disk>,
    writable: bool,
}

// === impl RunDir ===

impl RunDir {
    /// Makes `<runs_dir>/<run_id>` and leaves it open to write. It appears whole, by one rename, or not at all.
    ///
    /// # Errors
    /// [`ArchiveError::Exists`], [`ArchiveError::BadRunId`], [`ArchiveError::BadPath`], and the disk's kinds.
    pub fn create(runs_dir: &Path, new: &NewRun<'_>) -> Result<RunDir> {
        RunDir::create_on(runs_dir, new, Arc::new(RealDisk))
    }

    /// As [`RunDir::create`], everything going through `disk`.
    ///
    /// # Errors
    /// As [`RunDir::create`].
    pub fn create_on(runs_dir: &Path, new: &NewRun<'_>, disk: Arc<dyn Disk>) -> Result<RunDir> {
        check_id(new.run_id)?;
        let path = runs_dir.join(new.run_id);
        if path.exists() {
            return Err(ArchiveError::Exists { path });
        }
        make_folders(&*disk, runs_dir)?;
        let building = runs_dir.join(format!(".new-{}", new.run_id));
        // Left by a run that was killed while it was being made: it never had a frame.
        let _ = fs::remove_dir_all(&building);
        let built = fill(&building, new, Arc::clone(&disk)).and_then(|()| {
            disk.rename(&building, &path).map_err(|e| ArchiveError::io("put the run into place", &path, &e))?;
            disk.sync_folder(runs_dir).map_err(|e| ArchiveError::io("sync the folder", runs_dir, &e))
        });
        if let Err(e) = built {
            let _ = fs::remove_dir_all(&building);
            return Err(e);
        }
        RunDir::to_write(&path, disk)
    }

    /// Opens a run to read; it may be under way or closed.
    ///
    /// # Errors
    /// [`ArchiveError::NotARun`] and [`ArchiveError::Journal`].
    pub fn open(path: &Path) -> Result<RunDir> {
        RunDir::with_journal(path, Journal::open_read_only(&journal_of(path)?)?, Arc::new(RealDisk), false)
    }

    /// Opens a run that was closed or cut short, to go on with it; its journal must be as it was written. Its seal is broken
    /// until it is closed again, and what unfinished writes left is removed.
    ///
    /// # Errors
    /// As [`RunDir::open`], [`ArchiveError::Damaged`], and the disk's kinds.
    pub fn resume(path: &Path) -> Result<RunDir> {
        RunDir::resume_on(path, Arc::new(RealDisk))
    }

    /// As [`RunDir::resume`], everything going through `disk`.
    ///
    /// # Errors
    /// As [`RunDir::resume`].
    pub fn resume_on(path: &Path, disk: Arc<dyn Disk>) -> Result<RunDir> {
        journal_must_be_sound(path)?;
        let seal = path.join(SEAL);
        if seal.exists() {
            // Durably gone before the journal changes: a seal beside another journal would tell of damage.
            let remove = || disk.remove(&seal).and_then(|()| disk.sync_folder(path));
            remove().map_err(|e| ArchiveError::io("remove the seal", &seal, &e))?;
        }
        let run = RunDir::to_write(path, disk)?;
        run.remove_unfinished();
        Ok(run)
    }

    /// The run's folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The frames.
    pub fn frames(&self) -> &FrameStore {
        &self.store
    }

    /// The resolved plan's text.
    ///
    /// # Errors
    /// [`ArchiveError::Io`] and the disk's kinds.
    pub fn plan_toml(&self) -> Result<String> {
        let path = self.path.join(PLAN);
        fs::read_to_string(&path).map_err(|e| ArchiveError::io("read", &path, &e))
    }

    /// Works on the journal; one thread at a time.
    ///
    /// # Errors
    /// [`ArchiveError::Closed`] after [`RunDir::close`], and those of `work`.
    pub fn with<T>(&self, work: impl FnOnce(&mut Journal) -> Result<T>) -> Result<T> {
        match self.lock().as_mut() {
            Some(journal) => work(journal),
            None => Err(ArchiveError::Closed { path: self.path.clone() }),
        }
    }

    /// Stores a frame; when it returns, file and journal row survive a power failure. `row` comes without digest and size.
    /// `event` makes the journal's event from what was stored. Blocks: call it on a blocking thread.
    ///
    /// # Errors
    /// Those of [`FrameStore::put_frame`] and [`Journal::frame_stored`], [`ArchiveError::Moved`]; the step then stays planned.
    pub fn store(
        &self,
        place: (&str, u32, u32),
        pixels: &Pixels,
        row: FrameRow,
        event: impl FnOnce(&Stored) -> EventRow,
    ) -> Result<FrameRow> {
        let (camera, array_index, exposure_index) = place;
        self.with(|journal| journal.still_there())?;
        let put = self.store.put_frame(camera, array_index, exposure_index, pixels);
        if put.as_ref().is_err_and(ArchiveError::is_full) {
            // What is told of the end needs room now.
            self.ballast().release();
        }
        let stored = put?;
        let event = event(&stored);
        let row = FrameRow { digest: stored.digest, bytes: stored.bytes, ..row };
        // The file stays even when the commit fails: a failing disk may have kept the row after all. Without a row it is
        // left over, and the step's next frame replaces it.
        self.with(|journal| journal.frame_stored(&row, &event))?;
        self.ballast().take_again();
        Ok(row)
    }

    /// Removes the file of a frame that no row tells of: taken, then forgotten for a retake or by a process that was cut short.
    ///
    /// # Errors
    /// The disk's kinds.
    pub fn forget_frame(&self, camera: &str, array_index: u32, exposure_index: u32) -> Result<()> {
        let path = self.store.chunk_path(camera, array_index, exposure_index);
        if !path.exists() {
            return Ok(());
        }
        let folder = path.parent().unwrap_or(&path);
        let removed = self.disk.discard(&path).and_then(|()| self.disk.sync_folder(folder));
        removed.map_err(|e| ArchiveError::io("remove a forgotten frame", &path, &e))
    }

    /// Closes the journal into its one file and seals it with digests. A run opened to read is only let go.
    ///
    /// # Errors
    /// [`ArchiveError::Closed`] the second time, [`ArchiveError::Moved`], [`ArchiveError::Journal`] and the disk's kinds.
    pub fn close(&self) -> Result<()> {
        let journal = self.lock().take().ok_or_else(|| ArchiveError::Closed { path: self.path.clone() })?;
        if !self.writable {
            return Ok(());
        }
        journal.still_there()?;
        self.ballast().release();
        let rows = journal.row_digest()?;
        journal.close()?;
        let file = self.path.join(JOURNAL);
        let digest = sha256_of_file(&file).map_err(|e| ArchiveError::io("read", &file, &e))?;
        write_on(&*self.disk, &self.path.join(SEAL), journal_seal(&digest, &rows).as_bytes())
    }

    /// Bytes that may still be written beside this run.
    ///
    /// # Errors
    /// [`ArchiveError::Io`].
    pub fn free(&self) -> Result<u64> {
        self.disk.free(&self.path).map_err(|e| ArchiveError::io("tell the free room of", &self.path, &e))
    }

    /// Writes one of the run's own small files again, as it was.
    pub(super) fn put_back(&self, name: &Path, bytes: &[u8]) -> Result<()> {
        write_on(&*self.disk, &self.path.join(name), bytes)
    }

    fn to_write(path: &Path, disk: Arc<dyn Disk>) -> Result<RunDir> {
        let journal = Journal::open(&journal_of(path)?, Arc::clone(&disk))?;
        let run = RunDir::with_journal(path, journal, disk, true)?;
        run.ballast().take();
        Ok(run)
    }

    fn ballast(&self) -> Ballast {
        Ballast::of(&self.path, Arc::clone(&self.disk))
    }

    /// Removes temporary files of the frame store. One that cannot be removed only takes space.
    fn remove_unfinished(&self) {
        let folders = self.store.layouts().map(|layout| self.path.join(super::frames::FRAMES).join(&layout.camera));
        for folder in folders.chain([self.path.clone()]) {
            for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
                if entry.file_name().to_string_lossy().starts_with(TEMPORARY_PREFIX) {
                    let _ = self.disk.discard(&entry.path());
                }
            }
        }
    }

    fn with_journal(path: &Path, journal: Journal, disk: Arc<dyn Disk>, writable: bool) -> Result<RunDir> {
        let store = FrameStore::new(path, &journal.arrays()?, Arc::clone(&disk))?;
        Ok(RunDir { path: path.to_path_buf(), store, journal: Mutex::new(Some(journal)), disk, writable })
    }

    fn lock(&self) -> MutexGuard<'_, Option<Journal>> {
        // A thread that panicked has rolled its transaction back; the journal itself is sound.
        self.journal.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn journal_of(path: &Path) -> Result<PathBuf> {
    let journal = path.join(JOURNAL);
    if journal.is_file() {
        return Ok(journal);
    }
    let message = format!("there is no {JOURNAL} in it");
    Err(ArchiveError::NotARun { path: path.to_path_buf(), message })
}

fn fill(building: &Path, new: &NewRun<'_>, disk: Arc<dyn Disk>) -> Result<()> {
    make_folders(&*disk, building)?;
    let store = FrameStore::new(building, &new.layout.arrays, Arc::clone(&disk))?;
    let mut files = vec![(PathBuf::from(PLAN), new.plan_toml.as_bytes().to_vec())];
    files.append(&mut store.metadata_files()?);
    for (path, bytes) in new.files {
        check_copied(path)?;
        files.push((path.clone(), bytes.clone()));
    }
    let mut rows = Vec::with_capacity(files.len());
    for (path, bytes) in &files {
        write_on(&*disk, &building.join(path), bytes)?;
        let parts: Vec<_> = path.components().map(|c| c.as_os_str().to_string_lossy().into_owned()).collect();
        rows.push(FileRow { path: parts.join("/"), digest: sha256_hex(bytes) });
    }
    Journal::create(&building.join(JOURNAL), new.run_id, new.layout, &rows, Arc::clone(&disk))?.close()?;
    disk.sync_folder(building).map_err(|e| ArchiveError::io("sync the folder", building, &e))
}

fn check_id(id: &str) -> Result<()> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
    if id.is_empty() || id.len() > 100 || id.starts_with('.') || !id.chars().all(allowed) {
        return Err(ArchiveError::BadRunId { id: id.to_owned() });
    }
    Ok(())
}

fn check_copied(path: &Path) -> Result<()> {
    let plain = path.components().all(|c| matches!(c, Component::Normal(_)));
    let first = path.components().next().map(|c| c.as_os_str().to_string_lossy().into_owned()).unwrap_or_default();
    let ours = first == PLAN || first.starts_with("journal.") || first == super::frames::FRAMES || first == PRODUCTS;
    if !plain || first.is_empty() || ours {
        return Err(ArchiveError::BadPath { path: path.to_path_buf() });
    }
    Ok(())
}
