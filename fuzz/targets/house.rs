//! Targets: what people, clients and a damaged disk hand to the daemon: configuration, plan, journal, queue, requests,
//! spectra, BSDF files.

use super::harness::Target;
use goniod::archive::disk::RealDisk;
use goniod::archive::journal::Journal;
use goniod::config::calibration::CameraCalibration;
use goniod::config::check::{Options, check};
use goniod::config::curves::{Curves, reflection_factors};
use goniod::config::error::ConfigError;
use goniod::config::instrument::Instrument;
use goniod::config::load::parse;
use goniod::config::scan::Scan;
use goniod::config::source::Source;
use goniod::control::plan::document::RunDocument;
use goniod::front::daemon::queue::Queue;
use goniod::products::export::klems_read::read_klems;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

/// All of them, without the requests ([`super::requests`]).
pub const TARGETS: &[Target] = &[
    Target { name: "scan-file", run: |bytes| file::<Scan>("scan", bytes), mutations: 1500 },
    Target { name: "instrument-file", run: |bytes| file::<Instrument>("instrument", bytes), mutations: 300 },
    Target { name: "calibration-file", run: |bytes| file::<CameraCalibration>("calibration", bytes), mutations: 300 },
    Target { name: "scan-checked", run: |bytes| checked("scans/demo.toml", bytes), mutations: 40 },
    Target { name: "instrument-checked", run: |bytes| checked("instrument.sim.toml", bytes), mutations: 40 },
    Target { name: "calibration-checked", run: |bytes| checked("calibration/ccd.sim.toml", bytes), mutations: 30 },
    Target { name: "plan-file", run: plan, mutations: 60 },
    Target { name: "journal", run: journal, mutations: 100 },
    Target { name: "queue-entry", run: queue_entry, mutations: 600 },
    Target { name: "queue-folder", run: queue_folder, mutations: 1000 },
    Target { name: "spectrum-csv", run: spectrum, mutations: 4000 },
    Target { name: "glasses-csv", run: glasses, mutations: 3000 },
    Target { name: "klems-xml", run: klems, mutations: 60 },
];

fn same(what: &str, read: &str, written: &str) -> Result<(), String> {
    if read == written { Ok(()) } else { Err(format!("{what} does not come back as it was written")) }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A folder for this process.
fn folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = std::env::temp_dir().join(format!("goniod-fuzz-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a temporary folder");
        folder
    })
}

/// Removes the folder of this process.
pub fn tidy_up() {
    let _ = std::fs::remove_dir_all(folder());
}

/// An error of the configuration must have words, and its places must lie in the file.
fn told(error: &ConfigError, text: &str) -> Result<(), String> {
    let lines = text.lines().count().max(1) + 1;
    for issue in error.issues() {
        if issue.message.is_empty() || issue.line == 0 || issue.line > lines || issue.column == 0 {
            return Err(format!("an issue without words or place: {issue:?}"));
        }
    }
    if error.to_string().is_empty() { Err("an error without words".to_owned()) } else { Ok(()) }
}

/// What is read as a file of ours can be written, and is then read as the same.
fn file<T: DeserializeOwned + Serialize>(role: &str, bytes: &[u8]) -> Result<(), String> {
    let read = |text: String| parse::<T>(Source::parse(Path::new("input.toml"), text)?);
    let text = text(bytes);
    let loaded = match read(text.clone()) {
        Ok(loaded) => loaded,
        Err(error) => return told(&error, &text),
    };
    let written =
        toml::to_string(&loaded.value).map_err(|e| format!("the {role} that was read cannot be written: {e}"))?;
    let again = read(written.clone()).map_err(|e| format!("the {role} that was written cannot be read: {e}"))?;
    same(role, &toml::to_string(&again.value).map_err(|e| e.to_string())?, &written)
}

/// A copy of the shipped configuration with one file changed, checked as a whole.
fn checked(name: &str, bytes: &[u8]) -> Result<(), String> {
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
    let shipped = if shipped.is_dir() { shipped } else { Path::new(env!("CARGO_MANIFEST_DIR")).join("../config") };
    let copy = folder().join(name.replace('/', "-"));
    if !copy.is_dir() {
        copy_folder(&shipped, &copy);
    }
    let (path, whole) = (copy.join(name), text(bytes));
    std::fs::write(&path, &whole).map_err(|e| e.to_string())?;
    let today = "2026-01-01".parse().map_err(|_| "no day")?;
    let options = Options { drivers: Vec::new(), today };
    match check(&copy.join("scans/demo.toml"), &copy.join("instrument.sim.toml"), &options) {
        Ok(_) => Ok(()),
        Err(error) if error.issues().iter().any(|i| i.path == path) => told(&error, &whole),
        Err(error) if error.to_string().is_empty() => Err("an error without words".to_owned()),
        Err(_) => Ok(()),
    }
}

fn copy_folder(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("a folder");
    for entry in std::fs::read_dir(from).expect("the shipped configuration").flatten() {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy_folder(&entry.path(), &target);
        } else {
            std::fs::copy(entry.path(), target).expect("a copy");
        }
    }
}

fn plan(bytes: &[u8]) -> Result<(), String> {
    let Ok(document) = toml::from_str::<RunDocument>(&text(bytes)) else { return Ok(()) };
    let written = toml::to_string(&document).map_err(|e| format!("the plan that was read cannot be written: {e}"))?;
    let again: RunDocument = toml::from_str(&written).map_err(|e| format!("the written plan cannot be read: {e}"))?;
    same("plan", &toml::to_string(&again).map_err(|e| e.to_string())?, &written)
}

/// A damaged journal is an error or rows; it can be asked everything.
fn journal(bytes: &[u8]) -> Result<(), String> {
    let path = folder().join("journal.sqlite");
    std::fs::write(&path, bytes).map_err(|e| e.to_string())?;
    for writing in [false, true] {
        let opened = if writing { Journal::open(&path, Arc::new(RealDisk)) } else { Journal::open_read_only(&path) };
        let Ok(journal) = opened else { continue };
        let (steps, summary) = (journal.steps(), journal.summary());
        let _ = (journal.value("run_id"), journal.files(), journal.arrays(), journal.frames(), journal.events());
        let _ = (journal.next_seq(), journal.row_digest());
        let sound = journal.integrity().is_ok_and(|found| found.is_empty());
        if let (Ok(steps), Ok(s), true) = (steps, summary, sound)
            && steps.len() != (s.planned + s.stored + s.missing) as usize
        {
            return Err(format!("{} steps, but {s:?}", steps.len()));
        }
    }
    Ok(())
}

/// `entry.json` of entry 7: it is entry 7 of the queue, or it is named as bad.
fn queue_entry(bytes: &[u8]) -> Result<(), String> {
    let state = folder().join("state");
    let entry = state.join("queue/000007");
    std::fs::create_dir_all(&entry).map_err(|e| e.to_string())?;
    std::fs::write(entry.join("entry.json"), bytes).map_err(|e| e.to_string())?;
    let queue = Queue::open(&state).map_err(|e| format!("one bad entry closes the queue: {e}"))?;
    match (queue.get(7), queue.bad()) {
        (Some(read), []) => {
            let written = serde_json::to_string(read).map_err(|e| e.to_string())?;
            let again: goniod::front::daemon::entry::Entry =
                serde_json::from_str(&written).map_err(|e| e.to_string())?;
            same("entry", &serde_json::to_string(&again).map_err(|e| e.to_string())?, &written)
        }
        (None, [bad]) if !bad.reason.is_empty() => Ok(()),
        _ => Err("the entry is neither in the queue nor named as bad".to_owned()),
    }
}

/// The name of a folder in the queue: whatever it is, the next entry gets a number, or a reason why not.
fn queue_folder(bytes: &[u8]) -> Result<(), String> {
    let name = text(bytes).replace(['/', '\0'], "_");
    if name.is_empty() || name == "." || name == ".." || name.len() > 200 {
        return Ok(());
    }
    let state = folder().join("names");
    let entry = state.join("queue").join(&name);
    std::fs::create_dir_all(&entry).map_err(|e| e.to_string())?;
    let mut queue = Queue::open(&state).map_err(|e| format!("{name:?} closes the queue: {e}"))?;
    let known = queue.bad().len() + queue.entries().count();
    if known != usize::from(entry.exists()) {
        return Err(format!("{name:?} is in the folder {known} times"));
    }
    match queue.stage() {
        Err(error) if error.to_string().is_empty() => return Err("an error without words".to_owned()),
        _ => {}
    }
    std::fs::remove_dir_all(&state).map_err(|e| e.to_string())
}

fn spectrum(bytes: &[u8]) -> Result<(), String> {
    let curves = match Curves::parse(&text(bytes)) {
        Ok(curves) => curves,
        Err(why) if why.is_empty() => return Err("an error without words".to_owned()),
        Err(_) => return Ok(()),
    };
    let nm = &curves.wavelength_nm;
    let whole = nm.len() > 1 && curves.columns.len() == curves.names.len();
    let rising = nm.windows(2).all(|w| w[0] < w[1]);
    let filled = curves.columns.iter().all(|c| c.len() == nm.len() && c.iter().all(|v| v.is_finite()));
    if !(whole && rising && filled && !curves.names.is_empty()) {
        return Err(format!("it is read as {curves:?}"));
    }
    let mut written = format!("wavelength_nm,{}\n", curves.names.join(","));
    for (i, nm) in nm.iter().enumerate() {
        let row: Vec<String> = curves.columns.iter().map(|c| c[i].to_string()).collect();
        written.push_str(&format!("{nm},{}\n", row.join(",")));
    }
    if Curves::parse(&written) == Ok(curves) { Ok(()) } else { Err(format!("it does not come back from {written:?}")) }
}

fn glasses(bytes: &[u8]) -> Result<(), String> {
    match reflection_factors(&text(bytes)) {
        Ok(factors) if factors.values().all(|p| (0.0..=1.0).contains(p)) => Ok(()),
        Ok(factors) => Err(format!("it is read as {factors:?}")),
        Err(why) if why.is_empty() => Err("an error without words".to_owned()),
        Err(_) => Ok(()),
    }
}

fn klems(bytes: &[u8]) -> Result<(), String> {
    let Ok(file) = read_klems(&text(bytes)) else { return Ok(()) };
    let patches = file.basis.len();
    for block in &file.blocks {
        if block.values.len() != patches * patches || block.values.iter().any(|v| !v.is_finite()) {
            return Err(format!("{} {:?} has {} values", block.wavelength, block.side, block.values.len()));
        }
        if let Some(sums) = file.hemispherical(&block.wavelength, block.side)
            && sums.len() != patches
        {
            return Err(format!("{} sums for {patches} patches", sums.len()));
        }
    }
    Ok(())
}
