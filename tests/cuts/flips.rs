//! Promise: any changed bit of a run is found, in a finished run and in one that was cut short.

use super::cut;
use super::scan::{create, goes_on, reference, store, stored, write};
use super::tiny::memory_folder;
use goniod::archive::disk::RealDisk;
use goniod::archive::seal::{ProductSeal, frames_digest};
use goniod::archive::verify::{accept_loss, verify};
use goniod::archive::{ArchiveError, RunDir};
use goniod_sim::truth::rng::Key;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

/// Bits flipped.
const FLIPS: u64 = 10_000;
/// Changes of an open journal that is then to be gone on with.
const RESUMES: u64 = 500;

/// A finished run with products.
fn finished(folder: &Path) -> PathBuf {
    reference(folder);
    let run = folder.join("reference/run");
    make_products(&run);
    run
}

/// Products as they are made from the frames that a run has.
fn make_products(run: &Path) {
    let frames = RunDir::open(run).unwrap().with(|j| j.frames()).unwrap();
    let seal = ProductSeal::lift(run, frames_digest(frames.iter())).unwrap();
    let products = ["bsdf.xml", "plots/a.png", "report.html"].map(|name| run.join("products").join(name));
    for (i, path) in products.iter().enumerate() {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, vec![i as u8; 3000]).unwrap();
    }
    seal.set(&products).unwrap();
}

/// What a killed process leaves of a run in its middle: closed never, its log beside the journal.
fn left(folder: &Path) -> PathBuf {
    let live = create(&folder.join("live"), Arc::new(RealDisk)).unwrap();
    let steps = live.with(|j| j.steps()).unwrap();
    for (seq, step) in (0..).zip(steps.iter().take(40)) {
        store(&live, &step.layout, seq).unwrap();
    }
    let left = folder.join("left");
    cut::copy(live.path(), &left);
    fs::copy(live.path().join("journal.sqlite-shm"), left.join("journal.sqlite-shm")).unwrap();
    left
}

/// Without a seal or a mark a change could stay unfound, and `verify` says so.
#[test]
fn what_nothing_is_left_to_prove_by_is_told() {
    let folder = memory_folder();
    let (finished, left) = (finished(folder.path()), left(folder.path()));
    let unproven = |run: &Path| verify(run).unwrap().unproven;
    assert!(verify(&finished).unwrap().whole() && unproven(&left).is_empty());
    for (run, file, told) in [
        (&finished, "products/products.seal", "`goniod reduce RUN`"),
        (&left, "journal.head", "a lost end of its log"),
        (&left, "journal.base", "a change of the journal's file"),
    ] {
        let before = unproven(run).len();
        fs::remove_file(run.join(file)).unwrap();
        let words = unproven(run);
        assert!(words.len() == before + 1 && words.iter().any(|w| w.contains(told)), "{words:?}");
        assert!(!verify(run).unwrap().whole());
    }
    fs::remove_file(finished.join("journal.seal")).unwrap();
    let report = verify(&finished).unwrap();
    assert!(!report.sealed && !report.whole());
}

/// Products of a run cut short are not those of the run that was gone on with.
#[test]
fn products_of_fewer_frames_are_told_until_they_are_made_again() {
    let folder = memory_folder();
    let run = left(folder.path());
    make_products(&run);
    assert!(verify(&run).unwrap().unproven.is_empty());
    let dir = RunDir::resume(&run).unwrap();
    write(&dir).unwrap();
    dir.close().unwrap();
    let report = verify(&run).unwrap();
    assert!(report.sound() && report.sealed && !report.whole(), "{report:?}");
    assert!(report.unproven.len() == 1 && report.unproven[0].contains("made from other frames"), "{report:?}");
    make_products(&run);
    assert!(verify(&run).unwrap().whole());
}

/// A log copied in from another run is as whole as any, and its rows are not this run's.
#[test]
fn a_log_of_another_run_is_set_aside_and_not_read() {
    let folder = memory_folder();
    let expected = reference(folder.path());
    let (run, other) = (left(&folder.path().join("this")), left(&folder.path().join("other")));
    let log = fs::read(other.join("journal.sqlite-wal")).unwrap();
    fs::write(run.join("journal.sqlite-wal"), &log).unwrap();
    let refused = RunDir::resume(&run).err().unwrap().to_string();
    assert!(refused.contains("--accept-loss"), "{refused}");
    accept_loss(&run, &RealDisk).unwrap();
    assert_eq!(fs::read(run.join("journal.sqlite-wal.foreign")).unwrap(), log);
    assert_eq!(stored(&run), 0, "rows of another run");
    goes_on(&run, &expected, 0, "a foreign log");
}

/// Every file of a finished run, products too, is covered, and every record of one that was cut short.
#[test]
fn every_flipped_bit_of_ten_thousand_is_found() {
    let folder = memory_folder();
    let runs = [finished(folder.path()), left(folder.path())];
    let flips = std::env::var("GONIOD_FLIPS").ok().and_then(|n| n.parse().ok()).unwrap_or(FLIPS);
    let (next, flipped) = (AtomicU64::new(0), Mutex::new(BTreeMap::<String, u64>::new()));
    std::thread::scope(|scope| {
        for worker in 0..std::thread::available_parallelism().map_or(2, usize::from) {
            let (next, flipped, runs, folder) = (&next, &flipped, &runs, folder.path());
            scope.spawn(move || {
                let mine = [0, 1].map(|which| folder.join(format!("flips-{worker}-{which}")));
                for (mine, run) in mine.iter().zip(runs) {
                    cut::copy(run, mine);
                    assert!(verify(mine).unwrap().sound());
                }
                let files = [0, 1].map(|which| files_of(&mine[which]));
                loop {
                    let n = next.fetch_add(1, Ordering::SeqCst);
                    if n >= flips {
                        return;
                    }
                    let which = usize::from(n % 5 == 0);
                    let name = flip(&mine[which], &files[which], Key::new(n));
                    *flipped
                        .lock()
                        .unwrap()
                        .entry(["finished ", "cut short "][which].to_owned() + &name)
                        .or_default() += 1;
                }
            });
        }
    });
    let flipped = flipped.into_inner().unwrap();
    eprintln!("{flips} of {flips} found: {flipped:?}");
    for kind in ["plan.toml", "journal.sqlite", "journal.seal", "inputs", "frames.zarr", "products"] {
        assert!(flipped.get(&format!("finished {kind}")).is_some_and(|n| *n * 100 > flips), "{kind}: {flipped:?}");
    }
    for kind in
        ["journal.sqlite", "journal.sqlite-wal", "journal.base", "journal.head", "journal.ballast", "frames.zarr"]
    {
        assert!(flipped.get(&format!("cut short {kind}")).is_some_and(|n| *n * 200 > flips), "{kind}: {flipped:?}");
    }
}

/// Flips one bit of one file, which must be found, and puts it back; gives the file's name at the top of the run.
fn flip(run: &Path, files: &[(PathBuf, u64)], draw: Key) -> String {
    let path = pick(files, draw);
    let good = fs::read(path).unwrap();
    let bit = draw.bits(3) as usize % (good.len() * 8);
    let mut bad = good.clone();
    bad[bit / 8] ^= 1 << (bit % 8);
    fs::write(path, bad).unwrap();
    let report = verify(run);
    assert!(!report.is_ok_and(|r| r.sound()), "{} bit {bit} was not found", path.display());
    fs::write(path, good).unwrap();
    let name = path.strip_prefix(run).unwrap().components().next().unwrap();
    name.as_os_str().to_string_lossy().into_owned()
}

/// Flips and cuts in each file of an open journal. What SQLite would read over in silence is refused; where only the end of the
/// log is lost, the run is gone on with once somebody accepts that, and ends the same.
#[test]
fn a_run_whose_open_journal_is_damaged_is_not_gone_on_with_unasked() {
    let folder = memory_folder();
    let expected = reference(folder.path());
    let (left, run) = (left(folder.path()), folder.path().join("damaged"));
    let (mut refused, mut same, mut accepted) = (0, 0, 0);
    for n in 0..RESUMES {
        cut::copy(&left, &run);
        let what = damage(&run, Key::new(n));
        match RunDir::resume(&run) {
            Ok(dir) => {
                drop(dir);
                goes_on(&run, &expected, 40, &what);
                same += 1;
            }
            Err(e @ ArchiveError::Damaged { .. }) => {
                refused += 1;
                let text = e.to_string();
                assert!(text.contains("journal.sqlite") && text.contains("`goniod verify`"), "{what}: {text}");
                accept_loss(&run, &RealDisk).unwrap();
                if text.contains("--accept-loss") {
                    goes_on(&run, &expected, 0, &what);
                    accepted += 1;
                } else {
                    assert!(matches!(RunDir::resume(&run), Err(ArchiveError::Damaged { .. })), "{what}");
                }
            }
            Err(e) => panic!("{what}: {e}"),
        }
        fs::remove_dir_all(&run).unwrap();
    }
    eprintln!(
        "{RESUMES} changes of an open journal: {refused} refused, {same} without loss; {accepted} gone on with as accepted"
    );
    assert!(refused * 10 > RESUMES * 9 && accepted * 3 > RESUMES, "{refused} {accepted}");
}

/// Changes one file of an open journal: one bit, or its end cut off.
fn damage(run: &Path, draw: Key) -> String {
    let names = ["journal.sqlite", "journal.sqlite-wal", "journal.base", "journal.head"];
    let name = names[draw.bits(0) as usize % names.len()];
    let mut bytes = fs::read(run.join(name)).unwrap();
    let at = draw.bits(1) as usize % (bytes.len() * 8);
    // What is left of a head that was being written when the power was cut has no end either, and is no damage.
    let cut = draw.bits(2).is_multiple_of(5) && name != "journal.head";
    if cut {
        bytes.truncate(at / 8)
    } else {
        bytes[at / 8] ^= 1 << (at % 8)
    }
    fs::write(run.join(name), bytes).unwrap();
    format!("{name}, {} {}", if cut { "cut at byte" } else { "bit" }, if cut { at / 8 } else { at })
}

/// The memory that processes shared is no record: whatever it holds, the run reads as it was and goes on.
#[test]
fn what_is_left_of_shared_memory_changes_nothing() {
    let folder = memory_folder();
    let expected = reference(folder.path());
    let left = left(folder.path());
    let shared = fs::read(left.join("journal.sqlite-shm")).unwrap();
    let draw = Key::new(5);
    for n in 0..40 {
        let mut bad = shared.clone();
        match n {
            0 => bad.iter_mut().enumerate().for_each(|(i, b)| *b = draw.bits(i as u64) as u8),
            1 => bad.truncate(100),
            n => bad[draw.bits(n) as usize % 136] ^= 1 << (n % 8),
        }
        let run = folder.path().join("again");
        cut::copy(&left, &run);
        fs::write(run.join("journal.sqlite-shm"), bad).unwrap();
        goes_on(&run, &expected, 40, &format!("shared memory {n}"));
        fs::remove_dir_all(&run).unwrap();
    }
}

/// Half the time a file by its size, half the time any file of a kind.
fn pick(files: &[(PathBuf, u64)], draw: Key) -> &Path {
    if draw.bits(0).is_multiple_of(2) {
        let total: u64 = files.iter().map(|(_, n)| n).sum();
        let mut at = draw.bits(1) % total;
        for (path, n) in files {
            if at < *n {
                return path;
            }
            at -= n;
        }
    }
    let mut kinds: BTreeMap<String, Vec<&PathBuf>> = BTreeMap::new();
    for (path, _) in files {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let kind = if name.starts_with("c.") { "chunk".to_owned() } else { name };
        kinds.entry(kind).or_default().push(path);
    }
    let kind = kinds.values().nth(draw.bits(1) as usize % kinds.len()).unwrap();
    kind[draw.bits(2) as usize % kind.len()]
}

fn files_of(folder: &Path) -> Vec<(PathBuf, u64)> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        if path.is_dir() { files.extend(files_of(&path)) } else { files.push((path, entry.metadata().unwrap().len())) }
    }
    files.sort();
    files.retain(|(path, n)| *n > 0 && !path.to_string_lossy().ends_with("-shm"));
    files
}
