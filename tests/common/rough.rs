//! What is rough around the bench of a night: a disk that is slow, full or failing for a while, people who ask, edit and
//! start second daemons, a process that is killed.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used)]

use goniod::archive::disk::{Commit, Disk};
use goniod::control::sequencer::verbs::Verb;
use goniod::front::bench::verb;
use goniod::front::night;
use goniod_sim::faults::Around;
use goniod_sim::faults::catalogue::{DiskKind, ProcessKind};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::mpsc;

/// Files that people edit while a run that was started from them is under way.
const EDITED: [&str; 3] = ["instrument.sim.toml", "scans/night.toml", "calibration/ccd.sim.toml"];
/// Real time that a slow disk takes for each write.
const SLOW: Duration = Duration::from_micros(500);
/// Numbers of the operating system.
const ENOSPC: i32 = 28;
const EIO: i32 = 5;

/// A disk over another one.
pub struct RoughDisk {
    under: Arc<dyn Disk>,
    now: Mutex<Now>,
}

/// How the disk is now.
#[derive(Debug, Clone, Copy, Default)]
struct Now {
    slow: bool,
    full: bool,
    /// The next operation fails.
    fails: bool,
    /// The next fsync fails.
    sync_fails: bool,
}

/// What is around one process that works on a run.
pub struct Surroundings {
    run: PathBuf,
    config: PathBuf,
    disk: Arc<RoughDisk>,
    verbs: mpsc::Sender<Verb>,
    kill: mpsc::Sender<ProcessKind>,
    wrong: Arc<Mutex<Vec<String>>>,
}

// === impl RoughDisk ===

impl RoughDisk {
    pub fn over(under: Arc<dyn Disk>) -> RoughDisk {
        RoughDisk { under, now: Mutex::default() }
    }

    pub fn set(&self, kind: DiskKind, on: bool) {
        let mut now = self.now.lock().unwrap();
        match kind {
            DiskKind::Slow => now.slow = on,
            DiskKind::Full => now.full = on,
            DiskKind::Fails => now.fails = on,
            DiskKind::SyncFails => now.sync_fails = on,
        }
    }

    /// It is well again.
    pub fn mend(&self) {
        *self.now.lock().unwrap() = Now::default();
    }

    /// An operation begins; `takes_room` where a full disk refuses it.
    fn turn(&self, takes_room: bool) -> io::Result<()> {
        let now = {
            let mut now = self.now.lock().unwrap();
            let then = *now;
            now.fails = false;
            then
        };
        if now.slow {
            std::thread::sleep(SLOW);
        }
        match (now.fails, now.full && takes_room) {
            (true, _) => Err(io::Error::from_raw_os_error(EIO)),
            (false, true) => Err(io::Error::from_raw_os_error(ENOSPC)),
            (false, false) => Ok(()),
        }
    }

    fn sync_turn(&self) -> io::Result<()> {
        self.turn(false)?;
        match std::mem::take(&mut self.now.lock().unwrap().sync_fails) {
            true => Err(io::Error::from_raw_os_error(EIO)),
            false => Ok(()),
        }
    }
}

impl Disk for RoughDisk {
    fn create(&self, path: &Path) -> io::Result<File> {
        self.turn(true)?;
        self.under.create(path)
    }
    fn append(&self, file: &mut File, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.turn(true)?;
        self.under.append(file, path, bytes)
    }
    fn sync(&self, file: &File, path: &Path) -> io::Result<()> {
        self.sync_turn()?;
        self.under.sync(file, path)
    }
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.turn(false)?;
        self.under.rename(from, to)
    }
    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        self.sync_turn()?;
        self.under.sync_folder(folder)
    }
    fn commit(&self, path: &Path, at: Commit) -> io::Result<()> {
        if at == Commit::Begins {
            self.turn(true)?;
        }
        self.under.commit(path, at)
    }
}

// === impl Surroundings ===

impl Surroundings {
    pub fn new(
        run: &Path,
        config: &Path,
        (disk, verbs, kill): (Arc<RoughDisk>, mpsc::Sender<Verb>, mpsc::Sender<ProcessKind>),
    ) -> Surroundings {
        let (run, config) = (run.to_owned(), config.to_owned());
        Surroundings { run, config, disk, verbs, kill, wrong: Arc::default() }
    }

    /// What must not be, so far.
    pub fn wrong(&self) -> Arc<Mutex<Vec<String>>> {
        Arc::clone(&self.wrong)
    }

    /// Does what the fault plan asks for.
    pub fn is_done(&self, what: Around) -> bool {
        match what {
            Around::Ask(wish) => self.verbs.try_send(verb(wish)).is_ok(),
            Around::SecondDaemon => {
                let refused = night::hold(&self.run).is_err();
                if !refused {
                    self.wrong.lock().unwrap().push("a second daemon got hold of the run".to_owned());
                }
                refused
            }
            Around::Edit => EDITED.iter().all(|name| fs::write(self.config.join(name), "edited, and no TOML").is_ok()),
            Around::Disk(kind, on) => {
                self.disk.set(kind, on);
                true
            }
            Around::Process(kind) => self.kill.try_send(kind).is_ok(),
        }
    }
}
