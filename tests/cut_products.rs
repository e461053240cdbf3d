//! Promise: a night that was cut and gone on with gives the same products, byte for byte: every format, plots, report, seal.
//!
//! One night is recorded on the simulated bench. Its events, rows and pixels are then written again through the archive, cut at
//! every place and gone on with from what the journal has; and the recovery is cut at each of its places, after a first cut
//! of each kind and after one place in so many (every one with `GONIOD_CUTS=1`). Times and run id are those of the recorded
//! night, so no byte of any product may differ. Products are made from the rows of the journal and the files beside it and
//! from nothing else; so these are compared everywhere, and products are made for every content that is another one, and
//! for a spread of places all the same.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;
#[path = "common/cut.rs"]
mod cut;
#[path = "common/tiny.rs"]
mod tiny;

use cut::{CutDisk, State, killed, powerless};
use goniod::archive::disk::Disk;
use goniod::archive::rows::{EventRow, FrameRow, StepState};
use goniod::archive::rundir::JOURNAL;
use goniod::archive::seal::{PRODUCTS, SEAL};
use goniod::archive::verify::verify;
use goniod::archive::{ArchiveError, NewRun, RunDir, RunLayout};
use goniod::control::events::Event;
use goniod::control::plan::document::INPUTS;
use goniod::digest::sha256_hex;
use goniod::products::make::{Product, make};
use goniod::products::reduce::Run;
use goniod_drivers::frame::Pixels;
use goniod_sim::truth::rng::Key;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use tiny::{Tiny, memory_folder};

/// Least exposures of the night.
const EXPOSURES: usize = 60;
/// After one place in so many the recovery is cut, too, besides the first place of each kind.
const EVERY: usize = 100;
/// Places for which the products are made although the content is that of the night without cut.
const CONTROLS: usize = 3;

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

/// What happened at the places of one way to cut.
#[derive(Default)]
struct Tally {
    /// Runs gone on with after one cut, by the kind of its place.
    cuts: BTreeMap<String, usize>,
    /// Runs gone on with after a cut of the recovery too, by the kinds of both places.
    again: BTreeMap<(String, String), usize>,
    /// Places before there was a run to go on with.
    too_early: usize,
    /// Digests of the contents that runs ended with.
    contents: BTreeSet<String>,
    /// Runs whose products were made.
    products: usize,
}

/// A night as it was recorded.
struct Recorded {
    run_id: String,
    plan: String,
    files: Vec<(PathBuf, Vec<u8>)>,
    layout: RunLayout,
    events: Vec<(EventRow, Did)>,
    content: String,
    products: BTreeMap<String, Vec<u8>>,
}

// === impl Tally ===

impl Tally {
    /// Prints the figures, and holds that every place was one of these and no kind of recovery place is left out.
    fn judge(&self, way: &str, places: usize) {
        let (cuts, again): (usize, usize) = (self.cuts.values().sum(), self.again.values().sum());
        let Tally { too_early, contents, products, .. } = self;
        eprintln!(
            "{way}: {places} places, {too_early} before there is a run; {cuts} cut once and {again} again in the recovery, \
             of {} kinds and {} pairs of kinds; contents: {}, products made {products} times",
            self.cuts.len(),
            self.again.len(),
            contents.len()
        );
        for (kind, n) in &self.cuts {
            let (places, cuts) = self.again_after(kind);
            eprintln!("{n:6} x {kind}; recovery: {places} kinds of places, {cuts} cuts");
            assert!(places > 0, "{way}: no recovery was cut after {kind}");
        }
        assert_eq!(cuts + too_early, places, "{way}");
        assert!(*products >= CONTROLS, "{way}: {products}");
    }

    /// Kinds of places at which the recovery after a first cut of this kind was cut, and how often it was.
    fn again_after(&self, kind: &str) -> (usize, usize) {
        let after = self.again.iter().filter(|((first, _), _)| first == kind);
        after.fold((0, 0), |(places, cuts), (_, n)| (places + 1, cuts + n))
    }
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
        Recorded { run_id, plan, files, layout, events, content: content(&path), products: products(&path) }
    }

    fn create(&self, runs: &Path, disk: Arc<dyn Disk>) -> Result<RunDir, ArchiveError> {
        let Recorded { run_id, plan, files, layout, .. } = self;
        RunDir::create_on(runs, &NewRun { run_id, plan_toml: plan, files, layout }, disk)
    }

    /// Writes what the journal does not have yet, as the recorder does, `most` events of it.
    fn write(&self, run: &RunDir, most: usize) -> Result<(), ArchiveError> {
        let from = run.with(|j| j.next_seq())?;
        for (event, did) in self.events.iter().filter(|(event, _)| event.seq >= from).take(most) {
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

    /// Goes on with a cut run to its end and compares what it has with the night without cut; its products, too, where they
    /// are wanted or the content is one that was not met before.
    fn goes_on(&self, run: &Path, wanted: bool, tally: &Mutex<Tally>, what: &str) {
        let dir = RunDir::resume(run).unwrap_or_else(|e| panic!("{what}: {e}"));
        self.write(&dir, usize::MAX).unwrap_or_else(|e| panic!("{what}: {e}"));
        dir.close().unwrap_or_else(|e| panic!("{what}: {e}"));
        let content = content(run);
        let known = content == self.content;
        if tally.lock().unwrap().contents.insert(content) && !known || wanted {
            self.same_products(run, what);
            tally.lock().unwrap().products += 1;
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

/// Digest of what the products of a closed run are made from: every row that the journal gives, every file beside it. The
/// bytes of the journal's own file are not in it, nor those of its seal, which repeats their digest: nothing but SQLite
/// and the seal's check reads them.
fn content(run: &Path) -> String {
    let dir = RunDir::open(run).unwrap();
    let mut text = dir.with(|j| j.row_digest()).unwrap();
    for (name, bytes) in files(run, run) {
        if name != JOURNAL && name != SEAL {
            write!(text, "\n{name} {}", sha256_hex(&bytes)).unwrap();
        }
    }
    sha256_hex(text.as_bytes())
}

/// The files below `folder`, by their paths below `root`.
fn files(root: &Path, folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        if path.is_dir() {
            found.append(&mut files(root, &path));
        } else {
            found.insert(common::text(path.strip_prefix(root).unwrap()), fs::read(path).unwrap());
        }
    }
    found
}

/// Makes every product of a run; gives the files by name.
fn products(path: &Path) -> BTreeMap<String, Vec<u8>> {
    let run = Run::open(path).unwrap();
    let every = [Product::KlemsXml, Product::KlemsXmlBands, Product::Hdf5, Product::Plots, Product::Report];
    make(&run, &every).unwrap();
    files(path, &path.join(PRODUCTS))
}

/// After one place in so many the recovery is cut.
fn every() -> usize {
    std::env::var("GONIOD_CUTS").ok().and_then(|n| n.parse().ok()).unwrap_or(EVERY)
}

/// Places of the night.
fn places(night: &Recorded) -> usize {
    let folder = memory_folder();
    let disk = CutDisk::new(|_, _, _| {});
    let run = night.create(&folder.path().join("live"), disk.clone()).unwrap();
    night.write(&run, usize::MAX).unwrap();
    run.close().unwrap();
    disk.points()
}

/// Cuts the night at each of its places; each copy is gone on with at once, while the night waits.
fn cut_everywhere(night: &Arc<Recorded>, places: usize, (leave, offset): (Way, usize)) -> Arc<Mutex<Tally>> {
    let folder = memory_folder();
    let (runs, copy) = (folder.path().join("live"), folder.path().join("cut"));
    let live = runs.join(&night.run_id);
    let tally = Arc::new(Mutex::new(Tally::default()));
    let (told, counted) = (Arc::clone(night), Arc::clone(&tally));
    let disk = CutDisk::new(move |n, what, state| {
        if live.is_dir() {
            leave(&live, &copy, state, Key::new(n as u64));
        }
        if !copy.join(JOURNAL).exists() {
            counted.lock().unwrap().too_early += 1;
        } else {
            let first = !counted.lock().unwrap().cuts.contains_key(what);
            if first || n % every() == offset % every() {
                cut_the_recovery(&told, &copy, (leave, n, what), &counted);
            }
            let control = n % (places / CONTROLS) == places / CONTROLS - 1;
            told.goes_on(&copy, control, &counted, &format!("place {n} ({what})"));
            *counted.lock().unwrap().cuts.entry(what.to_owned()).or_default() += 1;
        }
        let _ = fs::remove_dir_all(&copy);
    });
    let run = night.create(&runs, disk.clone()).unwrap();
    night.write(&run, usize::MAX).unwrap();
    run.close().unwrap();
    assert_eq!(disk.points(), places);
    assert_eq!(content(run.path()), night.content, "not cut");
    tally
}

/// Cuts the recovery of a copy of `cut` at each of its places, to the first record after it.
fn cut_the_recovery(
    night: &Arc<Recorded>,
    cut: &Path,
    (leave, n, what): (Way, usize, &str),
    tally: &Arc<Mutex<Tally>>,
) {
    let (live, again) = (cut.with_extension("live"), cut.with_extension("again"));
    cut::copy(cut, &live);
    let recovers = Arc::new(AtomicBool::new(true));
    let (told, source, counted) = (Arc::clone(night), live.clone(), Arc::clone(tally));
    let (first, still) = (what.to_owned(), Arc::clone(&recovers));
    let disk = CutDisk::new(move |m, what, state| {
        if still.load(Ordering::SeqCst) {
            leave(&source, &again, state, Key::new((n * 1000 + m) as u64));
            let place = format!("place {n} ({first}), then place {m} of its recovery ({what})");
            told.goes_on(&again, false, &counted, &place);
            let _ = fs::remove_dir_all(&again);
            *counted.lock().unwrap().again.entry((first.clone(), what.to_owned())).or_default() += 1;
        }
    });
    let run = RunDir::resume_on(&live, disk).unwrap();
    night.write(&run, 1).unwrap();
    recovers.store(false, Ordering::SeqCst);
    drop(run);
    fs::remove_dir_all(&live).unwrap();
}

#[test]
fn a_night_cut_by_a_kill_or_by_the_power_gives_the_same_products() {
    let night = Arc::new(Recorded::measure());
    for wanted in ["products/bsdf.xml", "products/bsdf.h5", "products/report.html", "products/products.seal"] {
        assert!(night.products.contains_key(wanted), "{wanted}: {:?}", night.products.keys());
    }
    assert!(night.products.keys().any(|name| name.starts_with("products/plots/")));
    let places = places(&night);
    let ways: [(&str, Way); 2] = [("kill", killed), ("power", powerless)];
    std::thread::scope(|scope| {
        for (offset, (name, leave)) in ways.into_iter().enumerate() {
            let night = &night;
            scope.spawn(move || {
                let tally = cut_everywhere(night, places, (leave, offset * every() / 2));
                tally.lock().unwrap().judge(name, places);
            });
        }
    });
}
