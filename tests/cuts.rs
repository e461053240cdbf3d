//! Promise: a run that is cut anywhere (killed process, power cut, full or failing disk) is gone on with and ends with
//! the same frames; at most the exposure in flight is taken again. And any changed bit of a finished run is found.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;
#[path = "common/cut.rs"]
mod cut;
#[path = "cuts/flips.rs"]
mod flips;
#[path = "cuts/kills.rs"]
mod kills;
#[path = "cuts/scan.rs"]
mod scan;
#[path = "common/tiny.rs"]
mod tiny;

use cut::{CutDisk, State, killed, powerless};
use goniod::archive::RunDir;
use goniod::archive::disk::{Commit, Disk, RealDisk};
use goniod::archive::verify::verify;
use goniod_sim::truth::rng::Key;
use scan::{create, goes_on, reference, stored, write};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use tiny::memory_folder;

/// Recovery is cut at each of its places after every so manieth cut of the scan: of all kinds in turn, as this is prime.
const EVERY: usize = 31;
/// Simulated power cuts.
const POWER_CUTS: u64 = 2000;

/// How a cut leaves a run directory: from where, to where, what was not durable, what is drawn.
type Leave = fn(&Path, &Path, &State, Key);

/// Copies of one run at each of its places, handed out as they are made.
fn copies(
    folder: PathBuf,
    (leave, salt): (Leave, u64),
    wanted: impl Fn(usize) -> bool + Send + 'static,
    give: mpsc::SyncSender<(usize, String, PathBuf, usize)>,
) -> usize {
    let runs = folder.join("live");
    let live = runs.join("run");
    let disk = CutDisk::new(move |n, what, state| {
        if !wanted(n) {
            return;
        }
        let copy = folder.join(format!("cut-{n}"));
        // Before the run has its name there is nothing to go on with.
        if live.is_dir() {
            leave(&live, &copy, state, Key::new(n as u64).with(salt));
        }
        give.send((n, what.to_owned(), copy, committed_in(&live, state))).unwrap();
    });
    let run = create(&runs, disk.clone()).unwrap();
    write(&run).unwrap();
    run.close().unwrap();
    disk.points()
}

/// Frames whose commit had returned when the copy was made.
fn committed_in(live: &Path, state: &State) -> usize {
    if !live.join("journal.sqlite").exists() {
        return 0;
    }
    let stored = stored(live);
    // In the middle of a commit the live journal has it already, the copy may not.
    if state.log_before.is_some() { stored.saturating_sub(1) } else { stored }
}

/// Works on what a maker gives, on all processors.
fn on_all_cores(
    make: impl FnOnce(mpsc::SyncSender<(usize, String, PathBuf, usize)>) -> usize + Send,
    work: impl Fn(usize, &str, &Path, usize) + Sync,
) -> usize {
    let (give, take) = mpsc::sync_channel(16);
    let take = Mutex::new(take);
    std::thread::scope(|scope| {
        let made = scope.spawn(|| make(give));
        for _ in 0..std::thread::available_parallelism().map_or(2, usize::from) {
            scope.spawn(|| {
                loop {
                    let next = take.lock().unwrap().recv();
                    let Ok((n, what, path, committed)) = next else { return };
                    work(n, &what, &path, committed);
                    let _ = fs::remove_dir_all(&path);
                }
            });
        }
        made.join().unwrap()
    })
}

#[test]
fn a_run_killed_at_any_place_and_killed_again_in_its_recovery_ends_the_same() {
    let folder = memory_folder();
    let expected = reference(folder.path());
    let again = AtomicUsize::new(0);
    let places = on_all_cores(
        |give| copies(folder.path().to_owned(), (killed, 0), |_| true, give),
        |n, what, path, committed| {
            let what = format!("place {n} ({what})");
            if n % EVERY == 0 && path.join("journal.sqlite").exists() {
                let (expected, what, at) = (expected.clone(), what.clone(), path.to_owned());
                let cut_again = path.with_extension("again");
                let count = Arc::new(AtomicUsize::new(0));
                let counted = Arc::clone(&count);
                let live = path.with_extension("live");
                cut::copy(&at, &live);
                let source = live.clone();
                // The recovery itself, and the first frames after it.
                let disk = CutDisk::new(move |m, place, state| {
                    if m < 40 {
                        let _ = fs::remove_dir_all(&cut_again);
                        killed(&source, &cut_again, state, Key::new((n * 1000 + m) as u64));
                        goes_on(&cut_again, &expected, committed, &format!("{what}, then place {m} ({place})"));
                        let _ = fs::remove_dir_all(&cut_again);
                        counted.fetch_add(1, Ordering::SeqCst);
                    }
                });
                let run = RunDir::resume_on(&live, disk).unwrap();
                write(&run).unwrap();
                run.close().unwrap();
                fs::remove_dir_all(&live).unwrap();
                again.fetch_add(count.load(Ordering::SeqCst), Ordering::SeqCst);
            }
            goes_on(path, &expected, committed, &what);
        },
    );
    let again = again.into_inner();
    eprintln!("{places} places cut once, {again} times cut again in the recovery");
    assert!(places > 500 && again > 800, "{places} {again}");
}

#[test]
fn a_power_cut_at_any_place_loses_at_most_the_exposure_in_flight() {
    let folder = memory_folder();
    let expected = reference(folder.path());
    let places = {
        let (give, take) = mpsc::sync_channel(1 << 16);
        let places = copies(folder.path().join("count"), (killed, 0), |_| false, give);
        drop(take);
        places as u64
    };
    let per_place = POWER_CUTS.div_ceil(places);
    let cuts = AtomicU64::new(0);
    for round in 0..per_place {
        let base = folder.path().join(format!("round-{round}"));
        on_all_cores(
            |give| copies(base.clone(), (powerless, round), |_| true, give),
            |n, what, path, committed| {
                cuts.fetch_add(1, Ordering::SeqCst);
                goes_on(path, &expected, committed, &format!("round {round}, place {n} ({what})"));
            },
        );
        let _ = fs::remove_dir_all(&base);
    }
    let cuts = cuts.into_inner();
    eprintln!("{cuts} power cuts at {places} places");
    assert!(cuts >= POWER_CUTS);
}

/// A disk that fails from its n-th operation on, until it is mended.
struct FailingDisk {
    error: i32,
    left: AtomicUsize,
    broken: AtomicUsize,
}

impl FailingDisk {
    fn turn(&self) -> io::Result<()> {
        let left = self.left.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |n| n.checked_sub(1));
        match (left, self.broken.load(Ordering::SeqCst)) {
            (Err(_), 1) => Err(io::Error::from_raw_os_error(self.error)),
            _ => Ok(()),
        }
    }
}

impl Disk for FailingDisk {
    fn create(&self, path: &Path) -> io::Result<File> {
        self.turn()?;
        RealDisk.create(path)
    }
    fn append(&self, file: &mut File, _: &Path, bytes: &[u8]) -> io::Result<()> {
        if let Err(e) = self.turn() {
            file.write_all(&bytes[..bytes.len() / 2])?;
            return Err(e);
        }
        file.write_all(bytes)
    }
    fn sync(&self, file: &File, path: &Path) -> io::Result<()> {
        self.turn()?;
        RealDisk.sync(file, path)
    }
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.turn()?;
        RealDisk.rename(from, to)
    }
    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        self.turn()?;
        RealDisk.sync_folder(folder)
    }
    fn commit(&self, _: &Path, at: Commit) -> io::Result<()> {
        if at == Commit::Begins { self.turn() } else { Ok(()) }
    }
}

/// Full, failing and refusing fsync, each beginning at each operation: no partial file under a final name, and the run is
/// gone on with when the disk is well, without another process where it was only full.
#[test]
fn a_disk_that_fills_or_fails_at_any_operation_leaves_a_sound_run() {
    let folder = memory_folder();
    let expected = reference(folder.path());
    let (mut full, mut failing) = (0, 0);
    for error in [28, 5] {
        for first in (0..).step_by(7) {
            let runs = folder.path().join(format!("{error}-{first}"));
            let disk = Arc::new(FailingDisk { error, left: AtomicUsize::new(first), broken: AtomicUsize::new(1) });
            let what = format!("error {error} from operation {first} on");
            let Ok(run) = create(&runs, disk.clone()) else {
                assert!(!runs.join("run/journal.sqlite").exists(), "{what}: half a run under its final name");
                continue;
            };
            let Err(e) = write(&run) else { break };
            assert!(e.to_string().contains("disk"), "{what}: {e}");
            let report = verify(run.path()).unwrap();
            assert!(report.sound(), "{what}: {:?}", report.findings);
            let before = stored(run.path());
            disk.broken.store(0, Ordering::SeqCst);
            if error == 28 {
                full += 1;
                write(&run).unwrap_or_else(|e| panic!("{what}: {e}"));
                run.close().unwrap();
            } else {
                failing += 1;
                drop(run);
            }
            goes_on(&runs.join("run"), &expected, before, &what);
            fs::remove_dir_all(&runs).unwrap();
        }
    }
    eprintln!("full at {full} operations, failing at {failing}");
    assert!(full > 30 && failing > 30);
}
