//! Nights on a disk that fills, fails or panics in the middle, at each kind of operation: the bench safe or dark, nothing
//! half-written under a final name, and everything stored once there is room, or once the run is gone on with.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::fakes::{self, Shared};
use super::interlocks::Reason;
use super::run;
use super::state::Ending;
use super::tests::{Night, counts, is_safe, job, plan, stored_under_true_labels};
use super::trouble_tests::{S, all_is_stored, trouble, was_suspended_for};
use crate::archive::RunDir;
use crate::archive::disk::{Commit, Disk, RealDisk, TEMPORARY_PREFIX};
use crate::archive::verify::verify;
use crate::control::events::EventBus;
use goniod_drivers::clock::{Clock, UtcMicros};
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use tokio::sync::mpsc;

const FULL: i32 = 28;
const FAILS: i32 = 5;

/// Operations of a disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Op {
    Create,
    Append,
    Sync,
    Rename,
    SyncFolder,
    Commit,
}

const OPS: [Op; 6] = [Op::Create, Op::Append, Op::Sync, Op::Rename, Op::SyncFolder, Op::Commit];

/// A disk that is well until it is told to be ill; then one kind of operation gives an error, after `spared` more.
struct Ill {
    op: Op,
    error: i32,
    ill: AtomicBool,
    spared: AtomicUsize,
    met: AtomicUsize,
    /// Files whose sync failed, by inode, and how many of them were synced again.
    failed: Mutex<BTreeSet<u64>>,
    repeated: AtomicUsize,
}

// === impl Ill ===

impl Ill {
    fn new(op: Op, error: i32, spared: usize) -> Arc<Ill> {
        Arc::new(Ill {
            op,
            error,
            ill: AtomicBool::new(false),
            spared: AtomicUsize::new(spared),
            met: AtomicUsize::new(0),
            failed: Mutex::default(),
            repeated: AtomicUsize::new(0),
        })
    }

    fn turn(&self, op: Op) -> io::Result<()> {
        if op != self.op || !self.ill.load(Ordering::SeqCst) {
            return Ok(());
        }
        if self.spared.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |n| n.checked_sub(1)).is_ok() {
            return Ok(());
        }
        self.met.fetch_add(1, Ordering::SeqCst);
        Err(io::Error::from_raw_os_error(self.error))
    }
}

impl Disk for Ill {
    fn create(&self, path: &Path) -> io::Result<File> {
        self.turn(Op::Create)?;
        RealDisk.create(path)
    }
    fn append(&self, file: &mut File, _: &Path, bytes: &[u8]) -> io::Result<()> {
        if let Err(e) = self.turn(Op::Append) {
            file.write_all(&bytes[..bytes.len() / 2])?;
            return Err(e);
        }
        file.write_all(bytes)
    }
    fn sync(&self, file: &File, path: &Path) -> io::Result<()> {
        let inode = file.metadata()?.ino();
        self.repeated.fetch_add(usize::from(self.failed.lock().unwrap().contains(&inode)), Ordering::SeqCst);
        let turn = self.turn(Op::Sync);
        if turn.is_err() {
            self.failed.lock().unwrap().insert(inode);
        }
        turn.and_then(|()| RealDisk.sync(file, path))
    }
    fn remove(&self, path: &Path) -> io::Result<()> {
        // A new file may get the number of one that is gone.
        if let Ok(metadata) = path.symlink_metadata() {
            self.failed.lock().unwrap().remove(&metadata.ino());
        }
        RealDisk.remove(path)
    }
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.turn(Op::Rename)?;
        RealDisk.rename(from, to)
    }
    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        self.turn(Op::SyncFolder)?;
        RealDisk.sync_folder(folder)
    }
    fn commit(&self, _: &Path, at: Commit) -> io::Result<()> {
        if at == Commit::Begins { self.turn(Op::Commit) } else { Ok(()) }
    }
}

/// Temporary files in a run directory.
fn unfinished(folder: &Path) -> usize {
    let entries: Vec<_> = fs::read_dir(folder).unwrap().flatten().collect();
    let below = entries.iter().filter(|e| e.path().is_dir()).map(|e| unfinished(&e.path())).sum::<usize>();
    below + entries.iter().filter(|e| e.file_name().to_string_lossy().starts_with(TEMPORARY_PREFIX)).count()
}

/// A night whose disk is ill from 8 s on; for ten minutes, or, with `for_ever`, until the end.
async fn ill_night(ill: &Arc<Ill>, for_ever: bool) -> Night {
    let disk = Arc::clone(ill);
    let script = async move |_verbs, world: Shared| {
        tokio::time::sleep(8 * S).await;
        disk.ill.store(true, Ordering::SeqCst);
        if !for_ever {
            tokio::time::sleep(600 * S).await;
            assert!(!world.lock().unwrap().open, "dark while the disk is full");
            disk.ill.store(false, Ordering::SeqCst);
        }
        std::future::pending().await
    };
    trouble(|_| (), ill.clone(), script).await
}

/// The run is gone on with on a good disk, by the next process, and is then whole.
async fn goes_on(night: &Night, what: &str) {
    let (plan, clock) = (plan(), Clock::starting_at(UtcMicros(0)));
    let (mut bench, _world) = fakes::bench(clock);
    let archive = Arc::new(RunDir::resume(&night.path).unwrap());
    let (_verbs, asked) = mpsc::channel(1);
    let outcome = run(&job(&plan), &mut bench, archive, clock, asked, &EventBus::default()).await.unwrap();
    assert_eq!((outcome.ending, counts(&outcome)), (Ending::Completed, (15, 0, 0)), "{what}");
    assert_eq!(stored_under_true_labels(&night.path), 15, "{what}");
    let report = verify(&night.path).unwrap();
    assert!(report.whole() && report.leftovers.is_empty(), "{what}: {report:?}");
}

#[tokio::test(start_paused = true)]
async fn a_disk_that_is_full_at_any_operation_suspends_the_night_and_it_goes_on_by_itself() {
    for op in OPS {
        for spared in [0, 1, 4] {
            let ill = Ill::new(op, FULL, spared);
            let night = ill_night(&ill, false).await;
            let what = format!("{op:?}, {spared} spared");
            assert!(ill.met.load(Ordering::SeqCst) > 0, "{what}: nothing was full");
            assert!(was_suspended_for(&night, Reason::Disk), "{what}");
            all_is_stored(&night);
            assert!(night.outcome.is_safe(), "{what}");
            assert_eq!((unfinished(&night.path), ill.repeated.load(Ordering::SeqCst)), (0, 0), "{what}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_disk_that_fails_at_any_operation_ends_the_night_safely_and_the_next_process_goes_on() {
    for op in OPS {
        for spared in [0, 1, 4] {
            let ill = Ill::new(op, FAILS, spared);
            let night = ill_night(&ill, true).await;
            let what = format!("{op:?}, {spared} spared");
            assert_eq!(night.outcome.ending, Ending::ArchiveFailed, "{what}");
            let message = night.outcome.message.as_deref().unwrap_or_default();
            assert!(message.contains("the disk fails"), "{what}: {message}");
            is_safe(&night);
            assert!(night.outcome.is_safe(), "{what}");
            let report = verify(&night.path).unwrap();
            assert!(report.sound(), "{what}: {report:?}");
            let (stored, missing, left) = counts(&night.outcome);
            assert!(left > 0 && missing == 0 && stored + left == 15, "{what}: {:?}", night.outcome);
            assert_eq!(report.summary.stored, stored, "{what}: nothing is told as stored that is not");
            assert_eq!(stored_under_true_labels(&night.path), stored as usize, "{what}");
            assert_eq!(ill.repeated.load(Ordering::SeqCst), 0, "{what}: no sync is repeated on the same file");
            goes_on(&night, &what).await;
        }
    }
}

/// A fault of the program itself in the middle of a write.
struct Panics(AtomicUsize);

impl Disk for Panics {
    fn append(&self, file: &mut File, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let in_the_night = path.to_string_lossy().contains("c.");
        assert!(!in_the_night || self.0.fetch_add(1, Ordering::SeqCst) != 5, "as the test wants it");
        file.write_all(bytes)
    }
}

#[tokio::test(start_paused = true)]
async fn a_panic_while_writing_ends_the_night_safely_and_the_next_process_goes_on() {
    let disk = Arc::new(Panics(AtomicUsize::new(0)));
    let night = trouble(|_| (), disk, async |_verbs, _world| std::future::pending().await).await;
    assert_eq!(night.outcome.ending, Ending::ArchiveFailed, "{:?}", night.outcome);
    is_safe(&night);
    assert!(verify(&night.path).unwrap().sound());
    goes_on(&night, "a panic").await;
}
