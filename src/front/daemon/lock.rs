//! One at a time: the locks that `goniod serve` and `goniod run` take on an instrument, and the daemon on its state.
//!
//! A lock is `flock(2)` on a small file: the kernel lets it go when the process ends, however it ends. Its text says
//! who holds it, for the sentence that refuses the second one; the text alone locks nothing.

use super::error::DaemonError;
use super::snapshot::plain;
use crate::archive::disk::{RealDisk, make_folders};
use crate::config::instrument::{Instrument, Link};
use crate::digest::sha256_hex;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Where the locks of instruments lie, where the machine has this folder.
const LOCKS: &str = "/run/lock";
/// What to do when the instrument is taken.
const INSTRUMENT_HINT: &str = "put the scan into its queue with `goniod queue add`, or wait until it is done";
/// What to do when the state folder is taken.
const STATE_HINT: &str = "talk to that daemon with `goniod status`, or give this one a folder of its own with --state";

/// Locks that are held until the value is dropped or the process ends.
#[derive(Debug)]
pub struct Locks {
    files: Mutex<Vec<File>>,
    who: String,
}

// === impl Locks ===

impl Locks {
    /// Takes the instrument: by its file, and by each real port that it names, so that two files for one bench exclude
    /// each other too.
    ///
    /// # Errors
    /// [`DaemonError::InUse`] with the holder, [`DaemonError::Lock`].
    pub fn of_instrument(path: &Path, instrument: &Instrument, who: &str) -> Result<Locks, DaemonError> {
        Locks::of_instrument_in(&folder(), path, instrument, who)
    }

    fn of_instrument_in(folder: &Path, path: &Path, instrument: &Instrument, who: &str) -> Result<Locks, DaemonError> {
        let locks = Locks { files: Mutex::new(Vec::new()), who: who.to_owned() };
        let real = std::fs::canonicalize(path).unwrap_or_else(|_| plain(path));
        let mut things = vec![(format!("the instrument {}", path.display()), real)];
        for Link { port, .. } in instrument.links().into_iter().filter(|link| !link.is_simulated()) {
            let real = std::fs::canonicalize(port).unwrap_or_else(|_| PathBuf::from(port));
            things.push((format!("the port {port}"), real));
        }
        things.sort_by(|a, b| a.1.cmp(&b.1));
        things.dedup_by(|a, b| a.1 == b.1);
        for (what, real) in things {
            let name = sha256_hex(real.to_string_lossy().as_bytes());
            let file = folder.join(format!("goniod-{}.lock", name.get(..16).unwrap_or(&name)));
            locks.take(&file, &what, INSTRUMENT_HINT)?;
        }
        Ok(locks)
    }

    /// Takes a state folder too.
    ///
    /// # Errors
    /// As [`Locks::of_instrument`].
    pub fn and_state(self, state: &Path) -> Result<Locks, DaemonError> {
        make_folders(&RealDisk, state)?;
        self.take(&state.join("daemon.lock"), &format!("the state folder {}", state.display()), STATE_HINT)?;
        Ok(self)
    }

    /// Writes into the locks what their holder is doing.
    pub fn tell(&self, run: Option<&str>) {
        let run = run.map_or_else(String::new, |run| format!(", run {run}"));
        for file in self.files.lock().unwrap_or_else(PoisonError::into_inner).iter_mut() {
            // The text helps a reader; the lock holds without it.
            let _ = sign(file, &format!("process {} ({}{run})", std::process::id(), self.who));
        }
    }

    fn take(&self, path: &Path, what: &str, hint: &'static str) -> Result<(), DaemonError> {
        let failed = |source| DaemonError::Lock { path: path.to_owned(), source };
        let mut file = open(path).map_err(failed)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let mut holder = String::new();
                // Whoever holds it may not have signed yet.
                let _ = Read::take(&mut file, 500).read_to_string(&mut holder);
                let holder =
                    if holder.trim().is_empty() { "another goniod".to_owned() } else { holder.trim().to_owned() };
                return Err(DaemonError::InUse { what: what.to_owned(), holder, hint });
            }
            Err(TryLockError::Error(source)) => return Err(failed(source)),
        }
        // As in `tell`.
        let _ = sign(&mut file, &format!("process {} ({})", std::process::id(), self.who));
        self.files.lock().unwrap_or_else(PoisonError::into_inner).push(file);
        Ok(())
    }
}

fn folder() -> PathBuf {
    let usual = Path::new(LOCKS);
    if usual.is_dir() { usual.to_owned() } else { std::env::temp_dir() }
}

/// Opens the lock file; made so that another user of this machine can lock it too. It is never removed: a lock on a
/// file without a name would lock nobody out.
fn open(path: &Path) -> std::io::Result<File> {
    match OpenOptions::new().read(true).write(true).open(path) {
        Err(e) if e.kind() == ErrorKind::NotFound => {
            let made = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
            // Not ours when somebody else made it in between; then its maker does this.
            let _ = made.set_permissions(std::fs::Permissions::from_mode(0o666));
            Ok(made)
        }
        Err(e) if e.kind() == ErrorKind::PermissionDenied => OpenOptions::new().read(true).open(path),
        opened => opened,
    }
}

fn sign(file: &mut File, text: &str) -> std::io::Result<()> {
    file.seek(SeekFrom::Start(0))?;
    file.set_len(0)?;
    file.write_all(text.as_bytes())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::config::load::load;

    fn shipped(name: &str) -> (PathBuf, Instrument) {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(name);
        let instrument = load::<Instrument>(&path, "instrument").unwrap().value;
        (path, instrument)
    }

    #[test]
    fn the_second_is_refused_with_process_and_run_of_the_first() {
        let folder = tempfile::tempdir().unwrap();
        let (path, instrument) = shipped("instrument.sim.toml");
        let take = || Locks::of_instrument_in(folder.path(), &path, &instrument, "goniod serve");
        let first = take().unwrap();
        first.tell(Some("20260101T180000Z-blind-1a2b3c4d"));
        let refused = take().unwrap_err().to_string();
        for words in ["instrument.sim.toml", &format!("process {}", std::process::id()), "20260101T180000Z-blind"] {
            assert!(refused.contains(words), "{refused}");
        }
        drop(first);
        take().unwrap();
    }

    #[test]
    fn two_files_for_one_bench_exclude_each_other() {
        let folder = tempfile::tempdir().unwrap();
        let (path, instrument) = shipped("instrument.example.toml");
        let _first = Locks::of_instrument_in(folder.path(), &path, &instrument, "goniod run").unwrap();
        let other = folder.path().join("other.toml");
        let refused = Locks::of_instrument_in(folder.path(), &other, &instrument, "goniod run").unwrap_err();
        assert!(refused.to_string().starts_with("the port /dev/"), "{refused}");
    }
}
