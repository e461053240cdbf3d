//! Promise: a run that is cut anywhere (killed process, power cut, full or failing disk) is gone on with and ends with
//! the same frames; at most the exposure in flight is taken again. And any changed bit of a finished run is found.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;
#[path = "common/cut.rs"]
mod cut;
#[path = "common/tiny.rs"]
mod tiny;

use cut::{CutDisk, State, killed, powerless};
use goniod::archive::disk::{Commit, Disk, RealDisk};
use goniod::archive::rows::{EventRow, FrameRow, StepState};
use goniod::archive::seal::seal_products;
use goniod::archive::verify::verify;
use goniod::archive::{ArchiveError, ArrayLayout, NewRun, RunDir, RunLayout, StepLayout};
use goniod_drivers::frame::{PixelFormat, Pixels};
use goniod_sim::truth::rng::Key;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use tiny::{Tiny, memory_folder, scan_text};

/// Exposures of the scan that is cut.
const EXPOSURES: u32 = 60;
/// Recovery is cut at each of its places after every so manieth cut of the scan.
const EVERY: usize = 12;
/// Simulated power cuts.
const POWER_CUTS: u64 = 2000;
/// Bits flipped.
const FLIPS: u64 = 10_000;
/// Real kills of the real program.
const KILLS: u32 = 100;

fn layout() -> RunLayout {
    let format = PixelFormat::Mono8;
    let array =
        |camera: &str| ArrayLayout { camera: camera.into(), views: 5, exposures: 6, rows: 8, columns: 16, format };
    let step = |number: u32| StepLayout {
        number,
        view: number / 6,
        camera: if number < EXPOSURES / 2 { "ccd" } else { "ingaas" }.to_owned(),
        array_index: number % (EXPOSURES / 2) / 6,
        exposure_index: number % 6,
        exposure_us: 1000 << (number % 6),
    };
    RunLayout {
        plan_hash: "cuts".to_owned(),
        arrays: vec![array("ccd"), array("ingaas")],
        steps: (0..EXPOSURES).map(step).collect(),
    }
}

/// The frame of a step: the same whenever it is taken.
fn pixels(step: u32) -> Pixels {
    let key = Key::new(u64::from(step));
    Pixels::U8((0..128).map(|i| key.bits(i) as u8).collect())
}

fn create(runs: &Path, disk: Arc<dyn Disk>) -> Result<RunDir, ArchiveError> {
    let files = [(PathBuf::from("inputs/scan.toml"), b"name = \"cuts\"\n".to_vec())];
    RunDir::create_on(
        runs,
        &NewRun { run_id: "run", plan_toml: "name = \"cuts\"\n", files: &files, layout: &layout() },
        disk,
    )
}

fn event(seq: u64, kind: &str) -> EventRow {
    EventRow { seq, utc_us: seq as i64, kind: kind.to_owned(), json: format!("{{\"kind\":\"{kind}\"}}") }
}

/// Takes what is to do, as the recorder does: events, frames, and one step in ten is listed as missing first.
fn write(run: &RunDir) -> Result<(), ArchiveError> {
    let (steps, mut seq) = run.with(|j| Ok((j.steps()?, j.next_seq()?)))?;
    for step in steps.iter().filter(|s| s.state == StepState::Planned).map(|s| &s.layout) {
        if step.number % 10 == 3 {
            run.with(|j| j.event(&event(seq, "device-error")))?;
            seq += 1;
        }
        store(run, step, seq)?;
        seq += 1;
    }
    Ok(())
}

fn store(run: &RunDir, step: &StepLayout, seq: u64) -> Result<(), ArchiveError> {
    let row = FrameRow {
        step: step.number,
        digest: String::new(),
        bytes: 0,
        utc_us: i64::from(step.number),
        device_frame_id: u64::from(step.number),
        exposure_us: step.exposure_us,
        camera_serial: "S1".to_owned(),
        attempts: 1,
        rejected: 0,
    };
    let place = (step.camera.as_str(), step.array_index, step.exposure_index);
    run.store(place, &pixels(step.number), row, |_| event(seq, "frame-stored")).map(drop)
}

/// What must be the same however often the run was cut: steps, frame rows, every chunk.
fn content(run: &Path) -> String {
    let dir = RunDir::open(run).unwrap();
    let (steps, frames) = dir.with(|j| Ok((j.steps()?, j.frames()?))).unwrap();
    let mut text = format!("{steps:?}\n{frames:?}\n");
    for step in layout().steps {
        let path = dir.frames().chunk_path(&step.camera, step.array_index, step.exposure_index);
        text += &format!("{:?}\n", fs::read(path).unwrap());
    }
    text
}

fn stored(run: &Path) -> usize {
    RunDir::open(run).unwrap().with(|j| j.summary()).unwrap().stored as usize
}

/// An uninterrupted run.
fn reference(folder: &Path) -> String {
    let run = create(&folder.join("reference"), Arc::new(RealDisk)).unwrap();
    write(&run).unwrap();
    run.close().unwrap();
    content(run.path())
}

/// Goes on with a cut run to its end and compares; `committed` frames must have survived.
fn goes_on(run: &Path, expected: &str, committed: usize, what: &str) {
    if !run.join("journal.sqlite").exists() {
        assert_eq!(committed, 0, "{what}: the run was there and is gone");
        return;
    }
    let before = verify(run).unwrap();
    assert!(before.sound(), "{what}: {:?}", before.findings);
    assert!(stored(run) >= committed, "{what}: {} of {committed} committed frames are left", stored(run));
    let dir = RunDir::resume(run).unwrap_or_else(|e| panic!("{what}: {e}"));
    write(&dir).unwrap_or_else(|e| panic!("{what}: {e}"));
    dir.close().unwrap_or_else(|e| panic!("{what}: {e}"));
    let report = verify(run).unwrap();
    assert!(report.whole() && report.leftovers.is_empty(), "{what}: {report:?}");
    assert!(content(run) == expected, "{what}: other frames or rows than without the cut");
}

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
    assert!(places > 500 && again > 1000, "{places} {again}");
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

/// A finished run with products.
fn finished(folder: &Path) -> PathBuf {
    reference(folder);
    let run = folder.join("reference/run");
    let products = ["bsdf.xml", "plots/a.png", "report.html"].map(|name| run.join("products").join(name));
    for (i, path) in products.iter().enumerate() {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, vec![i as u8; 3000]).unwrap();
    }
    seal_products(&run, &products).unwrap();
    run
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

/// The real program, really killed, and gone on with by `goniod resume`.
#[test]
fn a_program_killed_at_random_times_goes_on_where_it_was() {
    let tiny = Tiny::new(&scan_text(10));
    let lab = &tiny.lab;
    let (scan, instrument) = (common::text(&lab.path("config/scans/night.toml")), common::text(&lab.instrument()));
    let draw = Key::new(11);
    let (mut kills, mut runs, mut went_on) = (0, 0, 0);
    let wanted = std::env::var("GONIOD_KILLS").ok().and_then(|n| n.parse().ok()).unwrap_or(KILLS);
    while kills < wanted {
        let folder = tiny.runs.path().join(format!("run-{runs}"));
        let at = common::text(&folder);
        let begin = ["rehearse", &scan, "--instrument", &instrument, "--runs", &at, "--no-products", "--json"];
        let mut args: Vec<String> = begin.iter().map(|s| (*s).to_owned()).collect();
        let mut before = 0;
        for attempt in 0_u32.. {
            let args_now: Vec<&str> = args.iter().map(String::as_str).collect();
            let mut child = lab
                .command(&args_now)
                .stdout(std::process::Stdio::null())
                .stderr(std::process::Stdio::piped())
                .spawn()
                .unwrap();
            // At any moment, or some moment after it got further; from the sixth attempt on it may end.
            let wait = std::time::Duration::from_secs_f64(0.3 * draw.uniform(u64::from(runs * 100 + attempt)));
            if attempt < 5 {
                if attempt % 5 != 2 {
                    wait_for_frames(&mut child, &folder, before);
                }
                std::thread::sleep(wait);
                kills += u32::from(child.try_wait().unwrap().is_none());
                let _ = child.kill();
                child.wait().unwrap();
            } else {
                let output = child.wait_with_output().unwrap();
                assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
                break;
            }
            if let Some(run) = the_run(&folder) {
                let now = stored(&run);
                assert!(now >= before, "{now} frames after {before}");
                went_on += usize::from(before > 0 && now > before);
                before = now;
                assert!(verify(&run).unwrap().sound());
                if RunDir::open(&run).unwrap().with(|j| j.summary()).unwrap().planned == 0 {
                    break;
                }
                args = ["resume", &common::text(&run), "--instrument", &instrument, "--no-products", "--json"]
                    .map(str::to_owned)
                    .to_vec();
            }
        }
        let run = the_run(&folder).unwrap();
        let verdict = goniod::front::oracle::judge(&run).unwrap();
        assert!(verdict.is_clean() && verdict.stored == verdict.planned, "{:?}", verdict.lines());
        fs::remove_dir_all(&folder).unwrap();
        runs += 1;
    }
    eprintln!("{kills} kills over {runs} runs; {went_on} times it went on from frames before");
    assert!(went_on >= wanted as usize * 3 / 10, "{went_on}");
}

/// Until the run has more than `before` frames, or the program is over.
fn wait_for_frames(child: &mut std::process::Child, folder: &Path, before: usize) {
    let further =
        || the_run(folder).filter(|run| run.join("journal.sqlite-wal").exists()).map_or(0, |run| stored(&run));
    while child.try_wait().unwrap().is_none() && further() <= before {
        std::thread::sleep(std::time::Duration::from_millis(3));
    }
}

fn the_run(folder: &Path) -> Option<PathBuf> {
    let mut entries = fs::read_dir(folder).ok()?.flatten().map(|e| e.path());
    entries.find(|p| !p.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.')))
}
