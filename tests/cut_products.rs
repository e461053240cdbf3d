//! Promise: a night that was cut and gone on with gives the same products, byte for byte: every format, plots, report, seal.
//!
//! One night is recorded on the simulated bench. Its events, rows and pixels are then written again through the archive, cut at
//! a spread of places (each kind of place at least once; every place with `GONIOD_CUTS=1`), gone on with from what the
//! journal has, and reduced. Times and run id are those of the recorded night, so no byte of any product may differ.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;
#[path = "common/cut.rs"]
mod cut;
#[path = "common/tiny.rs"]
mod tiny;

use cut::{CutDisk, State, killed, powerless};
use goniod::archive::disk::Disk;
use goniod::archive::rows::{EventRow, FrameRow, StepState};
use goniod::archive::verify::verify;
use goniod::archive::{ArchiveError, NewRun, RunDir, RunLayout};
use goniod::control::events::Event;
use goniod::control::plan::document::INPUTS;
use goniod::products::make::{Product, make, make_all};
use goniod::products::reduce::Run;
use goniod_drivers::frame::Pixels;
use goniod_sim::truth::rng::Key;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use tiny::{Tiny, memory_folder};

/// Least exposures of the night.
const EXPOSURES: usize = 60;
/// One place in so many is cut, besides the first of each kind.
const EVERY: usize = 240;
/// Of those, one in so many is cut again in its recovery, at one place in so many.
const AGAIN: (usize, usize) = (8, 15);

const SCAN: &str = r#"
name = "cut night"
[sample]
thickness_mm = 4.0
symmetry = "isotropic"
simulated = "../sim/samples/rough_glass.toml"
[incidence]
directions = [[0, 180]]
sides = ["transmission-front"]
[bands]
use = ["f1", "f2", "f3", "f4", "f5", "f6", "f7", "f8", "nir1", "nir2", "nir3"]
[exposure]
policy = "ladder"
ratio = 4.0
shortest_s = 0.004
longest_s = 2.5
[dark]
frames = 1
[reference]
mode = "irradiance"
[products]
formats = ["klems-xml", "hdf5"]
"#;

/// What one event did to the journal.
enum Did {
    Told,
    Stored { place: (String, u32, u32), row: FrameRow, pixels: Pixels },
    Missing { step: u32, reason: String },
}

/// How a run's folder is left by a cut: the folder recorded, the one to leave, what was on the disk then, a draw.
type Way = fn(&Path, &Path, &State, Key);

/// A night as it was recorded.
struct Recorded {
    run_id: String,
    plan: String,
    files: Vec<(PathBuf, Vec<u8>)>,
    layout: RunLayout,
    events: Vec<(EventRow, Did)>,
    products: BTreeMap<String, Vec<u8>>,
}

// === impl Recorded ===

impl Recorded {
    /// Measures the night and reads everything that was recorded.
    fn measure() -> Recorded {
        let tiny = Tiny::new(SCAN);
        let scan = tiny.lab.path("config/scans/night.toml");
        let path = tiny.lab.rehearse(&scan, "runs", &["--no-products"]);
        let dir = RunDir::open(&path).unwrap();
        let (files, plan_hash, arrays, steps, frames, events) = dir
            .with(|j| Ok((j.files()?, j.value("plan_hash")?, j.arrays()?, j.steps()?, j.frames()?, j.events()?)))
            .unwrap();
        assert!(frames.len() >= EXPOSURES, "{} exposures", frames.len());
        assert!(steps.iter().all(|s| s.state == StepState::Stored));
        let inputs = files.iter().filter(|f| Path::new(&f.path).starts_with(INPUTS));
        let copied =
            |f: &goniod::archive::rows::FileRow| (PathBuf::from(&f.path), fs::read(path.join(&f.path)).unwrap());
        let rows: BTreeMap<u32, FrameRow> = frames.into_iter().map(|f| (f.step, f)).collect();
        let did = |event: &EventRow| match serde_json::from_str(&event.json).unwrap() {
            Event::FrameStored { step, .. } => {
                let at = &steps[step as usize].layout;
                let pixels = dir.frames().read_frame(&at.camera, at.array_index, at.exposure_index).unwrap().unwrap();
                let place = (at.camera.clone(), at.array_index, at.exposure_index);
                Did::Stored { place, row: rows[&step].clone(), pixels }
            }
            Event::StepMissing { step, reason, .. } => Did::Missing { step, reason },
            _ => Did::Told,
        };
        let events = events.into_iter().map(|event| (event.clone(), did(&event))).collect();
        let layout = RunLayout { plan_hash, arrays, steps: steps.iter().map(|s| s.layout.clone()).collect() };
        let run_id = dir.with(|j| j.value("run_id")).unwrap();
        let (plan, files) = (dir.plan_toml().unwrap(), inputs.map(copied).collect());
        Recorded { run_id, plan, files, layout, events, products: products(&path) }
    }

    fn create(&self, runs: &Path, disk: Arc<dyn Disk>) -> Result<RunDir, ArchiveError> {
        let Recorded { run_id, plan, files, layout, .. } = self;
        RunDir::create_on(runs, &NewRun { run_id, plan_toml: plan, files, layout }, disk)
    }

    /// Writes what the journal does not have yet, as the recorder does.
    fn write(&self, run: &RunDir) -> Result<(), ArchiveError> {
        let from = run.with(|j| j.next_seq())?;
        for (event, did) in self.events.iter().filter(|(event, _)| event.seq >= from) {
            match did {
                Did::Told => run.with(|j| j.event(event))?,
                Did::Missing { step, reason } => run.with(|j| j.step_missing(*step, reason, event))?,
                Did::Stored { place, row, pixels } => {
                    run.store((&place.0, place.1, place.2), pixels, row.clone(), |_| event.clone())?;
                }
            }
        }
        Ok(())
    }

    /// Goes on with a cut run to its end and compares its products.
    fn goes_on(&self, run: &Path, what: &str) {
        if run.join("journal.sqlite").exists() {
            let before = verify(run).unwrap();
            assert!(before.sound(), "{what}: {:?}", before.findings);
            let dir = RunDir::resume(run).unwrap_or_else(|e| panic!("{what}: {e}"));
            self.write(&dir).unwrap_or_else(|e| panic!("{what}: {e}"));
            dir.close().unwrap();
            self.same_products(run, what);
        }
    }

    fn same_products(&self, run: &Path, what: &str) {
        let found = products(run);
        assert_eq!(found.keys().collect::<Vec<_>>(), self.products.keys().collect::<Vec<_>>(), "{what}");
        for (name, bytes) in &found {
            assert!(*bytes == self.products[name], "{what}: {name} has other bytes than without the cut");
        }
        assert!(verify(run).unwrap().whole(), "{what}");
    }
}

/// Makes every product of a run; gives the files by name.
fn products(path: &Path) -> BTreeMap<String, Vec<u8>> {
    let run = Run::open(path).unwrap();
    make_all(&run).unwrap();
    make(&run, &[Product::KlemsXmlBands]).unwrap();
    let mut files = BTreeMap::new();
    let mut folders = vec![path.join("products")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap().flatten() {
            let file = entry.path();
            if file.is_dir() {
                folders.push(file);
            } else {
                let name = file.strip_prefix(path).unwrap().to_string_lossy().into_owned();
                files.insert(name, fs::read(file).unwrap());
            }
        }
    }
    files
}

/// One place in so many.
fn every() -> usize {
    std::env::var("GONIOD_CUTS").ok().and_then(|n| n.parse().ok()).unwrap_or(EVERY)
}

/// Cuts the night at its places; each copy is gone on with at once, while the night waits.
fn cut_everywhere(night: &Arc<Recorded>, leave: fn(&Path, &Path, &State, Key), offset: usize) -> (usize, usize, usize) {
    let folder = memory_folder();
    let (runs, copy) = (folder.path().join("live"), folder.path().join("cut"));
    let live = runs.join(&night.run_id);
    let (again, cuts) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
    let kinds = Mutex::new(BTreeSet::new());
    let (told, counted, second) = (Arc::clone(night), Arc::clone(&cuts), Arc::clone(&again));
    let disk = CutDisk::new(move |n, what, state| {
        // Before the run has its name there is nothing to go on with.
        if !live.is_dir() || !(kinds.lock().unwrap().insert(what.to_owned()) || n % every() == offset % every()) {
            return;
        }
        leave(&live, &copy, state, Key::new(n as u64));
        if counted.fetch_add(1, Ordering::SeqCst) % AGAIN.0 == AGAIN.0 - 1 {
            second.fetch_add(cut_the_recovery(&told, &copy, leave), Ordering::SeqCst);
        }
        told.goes_on(&copy, &format!("place {n} ({what})"));
        let _ = fs::remove_dir_all(&copy);
    });
    let run = night.create(&runs, disk.clone()).unwrap();
    night.write(&run).unwrap();
    run.close().unwrap();
    night.same_products(run.path(), "not cut");
    (disk.points(), cuts.load(Ordering::SeqCst), again.load(Ordering::SeqCst))
}

/// Cuts the recovery of a copy of `cut` and what follows; gives the number of cuts.
fn cut_the_recovery(night: &Arc<Recorded>, cut: &Path, leave: fn(&Path, &Path, &State, Key)) -> usize {
    if !cut.join("journal.sqlite").exists() {
        return 0;
    }
    let (live, again) = (cut.with_extension("live"), cut.with_extension("again"));
    cut::copy(cut, &live);
    let cuts = Arc::new(AtomicUsize::new(0));
    let (told, source, counted) = (Arc::clone(night), live.clone(), Arc::clone(&cuts));
    let disk = CutDisk::new(move |m, what, state| {
        if m % AGAIN.1 == 0 && m < 4 * AGAIN.1 {
            leave(&source, &again, state, Key::new(m as u64));
            told.goes_on(&again, &format!("in the recovery, place {m} ({what})"));
            let _ = fs::remove_dir_all(&again);
            counted.fetch_add(1, Ordering::SeqCst);
        }
    });
    let run = RunDir::resume_on(&live, disk).unwrap();
    night.write(&run).unwrap();
    run.close().unwrap();
    fs::remove_dir_all(&live).unwrap();
    cuts.load(Ordering::SeqCst)
}

#[test]
fn a_night_cut_by_a_kill_or_by_the_power_gives_the_same_products() {
    let night = Arc::new(Recorded::measure());
    for wanted in ["products/bsdf.xml", "products/bsdf.h5", "products/report.html", "products/products.seal"] {
        assert!(night.products.contains_key(wanted), "{wanted}: {:?}", night.products.keys());
    }
    assert!(night.products.keys().any(|name| name.starts_with("products/plots/")));
    let ways: [(&str, Way); 2] = [("kill", killed), ("power", powerless)];
    std::thread::scope(|scope| {
        for (offset, (name, leave)) in ways.into_iter().enumerate() {
            let night = &night;
            scope.spawn(move || {
                let (places, cuts, again) = cut_everywhere(night, leave, offset * every() / 2);
                eprintln!("{name}: {cuts} of {places} places cut, {again} times cut again in the recovery");
                assert!(cuts >= 15 && again >= 4, "{name}: {cuts} {again}");
            });
        }
    });
}
