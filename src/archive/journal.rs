//! The journal: steps, frames and events of a run in SQLite (WAL, synchronous = FULL).
//!
//! A commit that returned survives a power failure. Nothing in the file depends on time or chance beyond the rows
//! themselves, so two equal runs give equal files. The layout has its version in `user_version`.

use super::disk::{Commit, Disk, RealDisk};
use super::error::{ArchiveError, Result};
use super::layout::{ArrayLayout, RunLayout, StepLayout};
use super::marks::Marks;
use super::rows::{EventRow, FileRow, FrameRow, StepRow, StepState, Summary};
use super::space::Ballast;
use crate::digest::TextDigest;
use rusqlite::config::DbConfig;
use rusqlite::{Connection, OpenFlags, Params, Row, Transaction, params};
use std::fmt::Write;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Version of the tables below.
pub const SCHEMA_VERSION: i64 = 1;

/// How long a reader waits for the writer's lock before it gives an error.
const BUSY_LIMIT: std::time::Duration = std::time::Duration::from_secs(5);

/// The log is folded into the file after so many bytes, so that closing the journal needs little room.
const FOLD_BYTES: u64 = 4 << 20;

const SCHEMA: &str = "
CREATE TABLE run(key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE files(path TEXT PRIMARY KEY, digest TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE arrays(camera TEXT PRIMARY KEY, layout TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE steps(number INTEGER PRIMARY KEY, view INTEGER NOT NULL, camera TEXT NOT NULL, array_index INTEGER NOT NULL,
  exposure_index INTEGER NOT NULL, exposure_us INTEGER NOT NULL,
  state TEXT NOT NULL CHECK(state IN ('planned', 'stored', 'missing')), reason TEXT NOT NULL);
CREATE TABLE frames(step INTEGER PRIMARY KEY REFERENCES steps(number), digest TEXT NOT NULL, bytes INTEGER NOT NULL,
  utc_us INTEGER NOT NULL, device_frame_id INTEGER NOT NULL, exposure_us INTEGER NOT NULL, camera_serial TEXT NOT NULL,
  attempts INTEGER NOT NULL, rejected INTEGER NOT NULL);
CREATE TABLE events(seq INTEGER PRIMARY KEY, utc_us INTEGER NOT NULL, kind TEXT NOT NULL, json TEXT NOT NULL);
";

const STEPS: &str = "SELECT number, view, camera, array_index, exposure_index, exposure_us, state, reason
  FROM steps ORDER BY number";
const FRAME_ROWS: &str =
    "SELECT step, digest, bytes, utc_us, device_frame_id, exposure_us, camera_serial, attempts, rejected
  FROM frames ORDER BY step";
const EVENTS: &str = "SELECT seq, utc_us, kind, json FROM events ORDER BY seq";

/// The open journal of a run.
pub struct Journal {
    db: Connection,
    path: PathBuf,
    disk: Arc<dyn Disk>,
    ballast: Ballast,
    marks: Marks,
    /// Device and inode of the file as it was opened.
    opened: Option<(u64, u64)>,
    /// Length of the log at which it is folded into the file.
    fold_at: u64,
    /// A commit met a failing disk; what it wrote is unknown, so nothing more is written through this connection.
    failed: Option<String>,
}

// === impl Journal ===

impl Journal {
    /// Makes the journal of a new run: all steps planned, no frame, no event.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`] and the disk's kinds.
    pub fn create(
        path: &Path,
        run_id: &str,
        layout: &RunLayout,
        files: &[FileRow],
        disk: Arc<dyn Disk>,
    ) -> Result<Journal> {
        let db = Connection::open(path).map_err(|e| ArchiveError::sql(path, &e))?;
        let mut journal = Journal::on(db, path, disk);
        journal.db.busy_timeout(BUSY_LIMIT).map_err(|e| journal.error(&e))?;
        journal.pragmas()?;
        journal.transaction(|tx| {
            tx.execute_batch(SCHEMA)?;
            tx.pragma_update(None, "user_version", SCHEMA_VERSION)?;
            tx.execute("INSERT INTO run VALUES('run_id', ?1)", [run_id])?;
            tx.execute("INSERT INTO run VALUES('plan_hash', ?1)", [&layout.plan_hash])?;
            for file in files {
                tx.execute("INSERT INTO files VALUES(?1, ?2)", params![file.path, file.digest])?;
            }
            for array in &layout.arrays {
                let text =
                    serde_json::to_string(array).map_err(|e| rusqlite::Error::ToSqlConversionFailure(e.into()))?;
                tx.execute("INSERT INTO arrays VALUES(?1, ?2)", params![array.camera, text])?;
            }
            let mut insert = tx.prepare("INSERT INTO steps VALUES(?1, ?2, ?3, ?4, ?5, ?6, 'planned', '')")?;
            for s in &layout.steps {
                let us = s.exposure_us as i64;
                insert.execute(params![s.number, s.view, s.camera, s.array_index, s.exposure_index, us])?;
            }
            Ok(())
        })?;
        Ok(journal)
    }

    /// Opens a journal to write on.
    ///
    /// # Errors
    /// [`ArchiveError::NotARun`] for another schema version, [`ArchiveError::Journal`] when it cannot be opened.
    pub fn open(path: &Path, disk: Arc<dyn Disk>) -> Result<Journal> {
        let mut journal = Journal::on(connect(path)?, path, disk);
        journal.check_version()?;
        journal.pragmas()?;
        journal.fold();
        Ok(journal)
    }

    /// Opens a journal to read: beside a run under way, or a closed one without leaving a trace.
    ///
    /// # Errors
    /// As [`Journal::open`].
    pub fn open_read_only(path: &Path) -> Result<Journal> {
        let live = path.with_extension("sqlite-wal").exists();
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let opened = if live {
            Connection::open_with_flags(path, flags)
        } else {
            Connection::open_with_flags(immutable_uri(path), flags | OpenFlags::SQLITE_OPEN_URI)
        };
        let db = opened.map_err(|e| ArchiveError::sql(path, &e))?;
        let journal = Journal::on(db, path, Arc::new(RealDisk));
        journal.check_version()?;
        Ok(journal)
    }

    /// Commits a stored frame: its row, its step's state and its event, all or none.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`] also for a step that does not exist or has a frame already.
    pub fn frame_stored(&mut self, frame: &FrameRow, event: &EventRow) -> Result<()> {
        self.transaction(|tx| {
            let f = frame;
            let numbers = (f.bytes as i64, f.device_frame_id as i64, f.exposure_us as i64);
            tx.prepare_cached("INSERT INTO frames VALUES(?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)")?.execute(params![
                f.step,
                f.digest,
                numbers.0,
                f.utc_us,
                numbers.1,
                numbers.2,
                f.camera_serial,
                f.attempts,
                f.rejected
            ])?;
            set_state(tx, f.step, "stored", "")?;
            insert_event(tx, event)
        })
    }

    /// Commits that a step is missing, with the reason.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`] also for a step that does not exist.
    pub fn step_missing(&mut self, step: u32, reason: &str, event: &EventRow) -> Result<()> {
        self.transaction(|tx| {
            set_state(tx, step, "missing", reason)?;
            insert_event(tx, event)
        })
    }

    /// Puts missing steps back to planned, so that a continuation tries them again; gives their number.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`] and the disk's kinds.
    pub fn plan_missing_again(&mut self) -> Result<usize> {
        self.transaction(|tx| tx.execute("UPDATE steps SET state = 'planned', reason = '' WHERE state = 'missing'", []))
    }

    /// Puts every step of a view back to planned and forgets its frames, so that the view is taken again as a whole; gives
    /// the number of frames forgotten. Their files stay until the new frames replace them.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`] and the disk's kinds.
    pub fn plan_view_again(&mut self, view: u32, event: &EventRow) -> Result<usize> {
        self.transaction(|tx| {
            let of_view = "DELETE FROM frames WHERE step IN (SELECT number FROM steps WHERE view = ?1)";
            let forgotten = tx.execute(of_view, [view])?;
            tx.execute("UPDATE steps SET state = 'planned', reason = '' WHERE view = ?1", [view])?;
            insert_event(tx, event)?;
            Ok(forgotten)
        })
    }

    /// Puts steps back to planned and forgets their frames, each with its event; all or none.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`] also for a step that does not exist, and the disk's kinds.
    pub fn plan_steps_again(&mut self, steps: &[(u32, EventRow)]) -> Result<()> {
        if steps.is_empty() {
            return Ok(());
        }
        self.transaction(|tx| {
            for (step, event) in steps {
                tx.execute("DELETE FROM frames WHERE step = ?1", [step])?;
                set_state(tx, *step, "planned", "")?;
                insert_event(tx, event)?;
            }
            Ok(())
        })
    }

    /// Commits one event.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`] and the disk's kinds.
    pub fn event(&mut self, event: &EventRow) -> Result<()> {
        self.transaction(|tx| insert_event(tx, event))
    }

    /// A value of the `run` table: `run_id`, `plan_hash`.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`] when there is none of that name.
    pub fn value(&self, key: &str) -> Result<String> {
        self.db.query_row("SELECT value FROM run WHERE key = ?1", [key], |row| row.get(0)).map_err(|e| self.error(&e))
    }

    /// The files copied in at the start, with their digests, by path.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`].
    pub fn files(&self) -> Result<Vec<FileRow>> {
        self.rows("SELECT path, digest FROM files ORDER BY path", [], |r| {
            Ok(FileRow { path: r.get(0)?, digest: r.get(1)? })
        })
    }

    /// The shapes of the frame arrays.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`], also for a shape that cannot be read.
    pub fn arrays(&self) -> Result<Vec<ArrayLayout>> {
        self.rows("SELECT layout FROM arrays ORDER BY camera", [], |r| {
            let text: String = r.get(0)?;
            serde_json::from_str(&text)
                .map_err(|e| rusqlite::Error::FromSqlConversionFailure(0, rusqlite::types::Type::Text, e.into()))
        })
    }

    /// All steps in their order.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`].
    pub fn steps(&self) -> Result<Vec<StepRow>> {
        self.rows(STEPS, [], read_step)
    }

    /// All frames in the order of their steps.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`].
    pub fn frames(&self) -> Result<Vec<FrameRow>> {
        self.rows(FRAME_ROWS, [], read_frame)
    }

    /// All events in their order.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`].
    pub fn events(&self) -> Result<Vec<EventRow>> {
        self.rows(EVENTS, [], read_event)
    }

    /// The sequence number the next event gets.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`].
    pub fn next_seq(&self) -> Result<u64> {
        let last: Result<i64> = self
            .db
            .query_row("SELECT coalesce(max(seq), -1) FROM events", [], |row| row.get(0))
            .map_err(|e| self.error(&e));
        Ok((last? + 1) as u64)
    }

    /// How far the run is.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`].
    pub fn summary(&self) -> Result<Summary> {
        let sql = "SELECT (SELECT count(*) FROM steps WHERE state = 'planned'),
            (SELECT count(*) FROM steps WHERE state = 'stored'), (SELECT count(*) FROM steps WHERE state = 'missing'),
            (SELECT coalesce(sum(rejected), 0) FROM frames), (SELECT coalesce(sum(bytes), 0) FROM frames)";
        let read = |r: &Row<'_>| {
            let bytes: i64 = r.get(4)?;
            let (planned, stored, missing, rejected) = (r.get(0)?, r.get(1)?, r.get(2)?, r.get(3)?);
            Ok(Summary { planned, stored, missing, rejected, bytes: bytes as u64 })
        };
        self.db.query_row(sql, [], read).map_err(|e| self.error(&e))
    }

    /// SHA-256 over all rows in a fixed text form, independent of how SQLite lays out its pages.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`].
    pub fn row_digest(&self) -> Result<String> {
        let mut text = TextDigest::default();
        // Writing to a digest cannot fail.
        let _ = writeln!(text, "{} {}", self.value("run_id")?, self.value("plan_hash")?);
        let _ = writeln!(text, "{:?}\n{:?}", self.files()?, self.arrays()?);
        // Row by row: of a long night they are too many to be held at once.
        self.write_rows(&mut text, STEPS, read_step)?;
        self.write_rows(&mut text, FRAME_ROWS, read_frame)?;
        self.write_rows(&mut text, EVENTS, read_event)?;
        Ok(text.hex())
    }

    /// Writes rows as the list of them would be written.
    fn write_rows<T: std::fmt::Debug>(
        &self,
        text: &mut TextDigest,
        sql: &str,
        read: impl Fn(&Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<()> {
        let write = || {
            let mut statement = self.db.prepare(sql)?;
            let mut separator = "[";
            for row in statement.query_map([], read)? {
                let _ = write!(text, "{separator}{:?}", row?);
                separator = ", ";
            }
            let _ = writeln!(text, "{}]", if separator == "[" { "[" } else { "" });
            Ok(())
        };
        write().map_err(|e| self.error(&e))
    }

    /// SQLite's own check of pages and indices; empty when all is well.
    ///
    /// # Errors
    /// [`ArchiveError::Journal`] when the file is too damaged to be checked.
    pub fn integrity(&self) -> Result<Vec<String>> {
        let found: Vec<String> = self.rows("PRAGMA integrity_check", [], |row| row.get(0))?;
        Ok(found.into_iter().filter(|line| line != "ok").collect())
    }

    /// The journal that is open lies where it was opened: else rows and marks would go to files that nobody finds.
    ///
    /// # Errors
    /// [`ArchiveError::Moved`].
    pub fn still_there(&self) -> Result<()> {
        if self.opened.is_some() && self.opened == identity(&self.path) {
            return Ok(());
        }
        Err(ArchiveError::Moved { path: self.path.parent().unwrap_or(Path::new("")).to_path_buf() })
    }

    /// Brings everything into the one file and closes it; no side file stays. A journal that was moved is only let go, as
    /// a killed process lets it go: it can be gone on with once it is put back.
    ///
    /// # Errors
    /// [`ArchiveError::Moved`], [`ArchiveError::Journal`] and the disk's kinds.
    pub fn close(mut self) -> Result<()> {
        self.must_work()?;
        self.still_there()?;
        self.marks.remove()?;
        let checkpoint = self.db.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |row| row.get::<_, i64>(0));
        checkpoint.map_err(|e| self.error(&e))?;
        let tidy = self.db.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, false);
        tidy.map_err(|e| self.error(&e))?;
        self.db.close().map_err(|(_, e)| ArchiveError::sql(&self.path, &e))
    }

    fn pragmas(&self) -> Result<()> {
        let set = || {
            self.db.busy_timeout(BUSY_LIMIT)?;
            self.db.pragma_update_and_check(None, "journal_mode", "WAL", |_| Ok(()))?;
            self.db.pragma_update(None, "synchronous", "FULL")?;
            // The file changes only where its marks are lifted before: in `fold` and `close`.
            self.db.pragma_update_and_check(None, "wal_autocheckpoint", 0, |_| Ok(()))?;
            self.db.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)?;
            self.db.pragma_update(None, "foreign_keys", "ON")
        };
        set().map_err(|e| self.error(&e))
    }

    fn check_version(&self) -> Result<()> {
        let version: i64 =
            self.db.pragma_query_value(None, "user_version", |row| row.get(0)).map_err(|e| self.error(&e))?;
        if version == SCHEMA_VERSION {
            return Ok(());
        }
        let message = format!("its journal has version {version}, this program reads version {SCHEMA_VERSION}");
        Err(ArchiveError::NotARun { path: self.path.clone(), message })
    }

    fn on(db: Connection, path: &Path, disk: Arc<dyn Disk>) -> Journal {
        let run = path.parent().unwrap_or(Path::new(""));
        let (ballast, marks) = (Ballast::of(run, Arc::clone(&disk)), Marks::of(path, Arc::clone(&disk)));
        let opened = identity(path);
        Journal { db, path: path.to_path_buf(), disk, ballast, marks, opened, fold_at: FOLD_BYTES, failed: None }
    }

    /// One transaction, all or nothing. A full disk is tried once more with the ballast's room; a failing one ends the
    /// journal's use, because what its commit left behind is known only after it was opened anew.
    fn transaction<T>(&mut self, work: impl Fn(&Transaction<'_>) -> rusqlite::Result<T>) -> Result<T> {
        self.must_work()?;
        let mut result = self.once(&work);
        if result.as_ref().is_err_and(ArchiveError::is_full) && self.ballast.release() {
            result = self.once(&work);
        }
        match &result {
            Err(ArchiveError::Failing { message, .. }) => self.failed = Some(message.clone()),
            Ok(_) if self.marks.committed().is_some_and(|log| log >= self.fold_at) => self.fold(),
            _ => {}
        }
        result
    }

    /// Brings the log into the file and marks the file. Where that fails, the log stays and goes on growing: no commit
    /// depends on it, and a disk that is ill is told by the next commit.
    fn fold(&mut self) {
        if self.still_there().is_ok() && self.marks.lift().is_ok() {
            // Busy readers leave part of the log; it is as good as before.
            let _ = self.db.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |row| row.get::<_, i64>(0));
            if let Err(e) = self.mark_file() {
                self.failed = Some(e.to_string());
            }
        }
        let log = std::fs::metadata(self.path.with_extension("sqlite-wal")).map_or(0, |m| m.len());
        self.fold_at = log + FOLD_BYTES;
    }

    fn once<T>(&mut self, work: &impl Fn(&Transaction<'_>) -> rusqlite::Result<T>) -> Result<T> {
        let Journal { db, path, disk, .. } = self;
        let sql = |e: rusqlite::Error| ArchiveError::sql(path, &e);
        let told = |at| disk.commit(path, at).map_err(|e| ArchiveError::io("commit to", path, &e));
        let tx = db.transaction().map_err(sql)?;
        let value = work(&tx).map_err(sql)?;
        told(Commit::Begins)?;
        tx.commit().map_err(sql)?;
        told(Commit::Done)?;
        Ok(value)
    }

    /// Marks the file as it is now. A process that closes a file loses all its locks on it (fcntl(2)), so SQLite has the
    /// journal closed while it is read.
    fn mark_file(&mut self) -> Result<()> {
        let aside = Connection::open_in_memory().map_err(|e| self.error(&e))?;
        drop(std::mem::replace(&mut self.db, aside));
        self.marks.set();
        self.db = connect(&self.path)?;
        self.pragmas()
    }

    fn must_work(&self) -> Result<()> {
        match &self.failed {
            Some(message) => Err(ArchiveError::Failing { path: self.path.clone(), message: message.clone() }),
            None => Ok(()),
        }
    }

    fn rows<T>(
        &self,
        sql: &str,
        with: impl Params,
        read: impl FnMut(&Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Vec<T>> {
        let all = || {
            let mut statement = self.db.prepare(sql)?;
            let rows = statement.query_map(with, read)?;
            rows.collect::<rusqlite::Result<Vec<T>>>()
        };
        all().map_err(|e| self.error(&e))
    }

    fn error(&self, source: &rusqlite::Error) -> ArchiveError {
        ArchiveError::sql(&self.path, source)
    }
}

fn connect(path: &Path) -> Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let open = || -> rusqlite::Result<Connection> {
        let db = Connection::open_with_flags(path, flags)?;
        // First of all: a connection that is let go early must leave the file as it is.
        db.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)?;
        Ok(db)
    };
    open().map_err(|e| ArchiveError::sql(path, &e))
}

/// Device and inode of a file.
fn identity(path: &Path) -> Option<(u64, u64)> {
    std::fs::metadata(path).ok().map(|meta| (meta.dev(), meta.ino()))
}

fn set_state(tx: &Transaction<'_>, step: u32, state: &str, reason: &str) -> rusqlite::Result<()> {
    let changed = tx
        .prepare_cached("UPDATE steps SET state = ?2, reason = ?3 WHERE number = ?1")?
        .execute(params![step, state, reason])?;
    if changed == 1 { Ok(()) } else { Err(rusqlite::Error::StatementChangedRows(changed)) }
}

fn insert_event(tx: &Transaction<'_>, e: &EventRow) -> rusqlite::Result<()> {
    let seq = e.seq as i64;
    tx.prepare_cached("INSERT INTO events VALUES(?1, ?2, ?3, ?4)")?.execute(params![seq, e.utc_us, e.kind, e.json])?;
    Ok(())
}

fn read_event(r: &Row<'_>) -> rusqlite::Result<EventRow> {
    let seq: i64 = r.get(0)?;
    Ok(EventRow { seq: seq as u64, utc_us: r.get(1)?, kind: r.get(2)?, json: r.get(3)? })
}

fn read_frame(r: &Row<'_>) -> rusqlite::Result<FrameRow> {
    Ok(FrameRow {
        step: r.get(0)?,
        digest: r.get(1)?,
        bytes: r.get::<_, i64>(2)? as u64,
        utc_us: r.get(3)?,
        device_frame_id: r.get::<_, i64>(4)? as u64,
        exposure_us: r.get::<_, i64>(5)? as u64,
        camera_serial: r.get(6)?,
        attempts: r.get(7)?,
        rejected: r.get(8)?,
    })
}

fn read_step(r: &Row<'_>) -> rusqlite::Result<StepRow> {
    let state: String = r.get(6)?;
    let exposure_us: i64 = r.get(5)?;
    let layout = StepLayout {
        number: r.get(0)?,
        view: r.get(1)?,
        camera: r.get(2)?,
        array_index: r.get(3)?,
        exposure_index: r.get(4)?,
        exposure_us: exposure_us as u64,
    };
    let state = match state.as_str() {
        "stored" => StepState::Stored,
        "missing" => StepState::Missing(r.get(7)?),
        _ => StepState::Planned,
    };
    Ok(StepRow { layout, state })
}

/// A file name as SQLite's URI syntax wants it (sqlite.org/uri.html), declared not to change while it is open.
fn immutable_uri(path: &Path) -> String {
    let mut uri = String::from("file:");
    for c in path.to_string_lossy().chars() {
        match c {
            '%' => uri.push_str("%25"),
            '?' => uri.push_str("%3f"),
            '#' => uri.push_str("%23"),
            c => uri.push(c),
        }
    }
    uri.push_str("?immutable=1");
    uri
}
