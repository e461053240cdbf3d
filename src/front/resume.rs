//! Going on with a run: finds it, compares it with the instrument as it is now, and makes it ready to be measured.

use super::cli::exit::Exit;
use super::cli::output::Failure;
use super::night::{Night, hold, storage};
use crate::archive::RunDir;
use crate::config::check::{Checked, Spectra};
use crate::config::instrument::Instrument;
use crate::config::source::read_bytes;
use crate::control::events::Event;
use crate::control::plan::document::{KeptFile, RunDocument};
use crate::digest::sha256_hex;
use goniod_drivers::clock::UtcMicros;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Largest file that is compared, bytes.
const LARGEST_FILE: u64 = 256 << 20;

/// Differences told one by one; beyond them only their number.
const DIFFERENCES_TOLD: usize = 20;

/// A run that is not finished.
pub struct Unfinished {
    /// Its folder.
    pub path: PathBuf,
    /// What it was started from.
    pub document: RunDocument,
    /// The sample in the simulated bench, proven to be the run's.
    sample: Option<PathBuf>,
    /// Folder of the instrument file.
    base: PathBuf,
}

/// The newest run in `runs` that has exposures to do; `None` where every run is finished.
///
/// # Errors
/// A folder that cannot be read.
pub fn newest_unfinished(runs: &Path) -> Result<Option<PathBuf>, Failure> {
    let entries = match std::fs::read_dir(runs) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        entries => entries.map_err(|e| Failure::new(Exit::Storage, format!("{}: {e}", runs.display())))?,
    };
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    // A run's name begins with the moment it was started.
    paths.sort();
    let unfinished = |path: &PathBuf| {
        let dir = RunDir::open(path).ok()?;
        let summary = dir.with(|journal| journal.summary()).ok()?;
        (summary.planned > 0).then_some(())
    };
    Ok(paths.into_iter().rev().find(|path| unfinished(path).is_some()))
}

// === impl Unfinished ===

impl Unfinished {
    /// Reads the run at `path` and compares it with the instrument as it is now, whose file lies in `base`. A simulated
    /// run needs its sample again: `sample`, or where the run found it.
    ///
    /// # Errors
    /// Not a run; as bad input every difference of plan, instrument, calibration and spectra.
    pub fn compare(
        path: &Path,
        instrument: &Instrument,
        base: &Path,
        sample: Option<PathBuf>,
    ) -> Result<Unfinished, Failure> {
        let dir = RunDir::open(path).map_err(storage)?;
        let text = dir.plan_toml().map_err(storage)?;
        let document: RunDocument = toml::from_str(&text).map_err(|e| {
            Failure::new(Exit::Storage, format!("{}: plan.toml cannot be read: {}", path.display(), e.message()))
        })?;
        let journal_hash = dir.with(|journal| journal.value("plan_hash")).map_err(storage)?;
        let mut found = Vec::new();
        if !document.plan.is_whole() || journal_hash != document.plan.hash {
            found.push(format!("plan.toml has plan {}, the journal {journal_hash}", document.plan.hash));
        }
        found.extend(instrument_differences(&document.instrument, instrument));
        let named = |file: &&KeptFile| !["scan", "instrument", "sample.simulated"].contains(&file.role.as_str());
        for file in document.files.iter().filter(named) {
            found.extend(file_difference(file, &place(file, instrument, base)));
        }
        let kept_sample = document.files.iter().find(|f| f.role == "sample.simulated");
        let sample = kept_sample.map(|file| sample.unwrap_or_else(|| sample_place(file, &document, base)));
        if let (Some(file), Some(at)) = (kept_sample, &sample) {
            found.extend(file_difference(file, at));
        }
        if found.is_empty() {
            return Ok(Unfinished { path: path.to_owned(), document, sample, base: base.to_owned() });
        }
        let more = found.len().saturating_sub(DIFFERENCES_TOLD);
        found.truncate(DIFFERENCES_TOLD);
        found.extend((more > 0).then(|| format!("and {more} more differences")));
        let what = format!(
            "{}: this run was started with something else than what is here now; put it back as it was, or start a new run",
            path.display()
        );
        let messages = std::iter::once(what).chain(found).collect();
        Err(Failure { exit: Exit::BadInput, messages })
    }

    /// The checked files of the run, as they were when it was started.
    pub fn checked(&self) -> Checked {
        let document = &self.document;
        let simulation = document.instrument.simulation.as_ref();
        Checked {
            instrument: document.instrument.clone(),
            scan: document.scan.clone(),
            calibrations: document.calibrations.clone(),
            spectra: Spectra::default(),
            files: Vec::new(),
            instrument_dir: self.base.clone(),
            scan_dir: self.base.clone(),
            bench: simulation.map(|s| self.base.join(&s.bench)),
            simulated_sample: self.sample.clone(),
            warnings: Vec::new(),
        }
    }

    /// When the run last told something.
    ///
    /// # Errors
    /// A journal that cannot be read.
    pub fn last_told(&self) -> Result<UtcMicros, Failure> {
        let dir = RunDir::open(&self.path).map_err(storage)?;
        let events = dir.with(|journal| journal.events()).map_err(storage)?;
        Ok(UtcMicros(events.iter().map(|e| e.utc_us).max().unwrap_or_default()))
    }

    /// Opens the run to go on with it. With `missing`, exposures listed as missing are tried again too.
    ///
    /// # Errors
    /// A run that another process works on, a journal that cannot be written.
    pub fn night(self, missing: bool) -> Result<Night, Failure> {
        let lock = hold(&self.path)?;
        let run = RunDir::resume(&self.path).map_err(storage)?;
        if missing {
            run.with(|journal| journal.plan_missing_again()).map_err(storage)?;
        }
        let events = run.with(|journal| journal.events()).map_err(storage)?;
        let mut serials = BTreeMap::new();
        for row in events.iter().filter(|row| row.kind == "device-opened") {
            if let Ok(Event::DeviceOpened { device, identity }) = serde_json::from_str(&row.json) {
                serials.entry(device).or_insert(identity.serial);
            }
        }
        Ok(Night { plan: self.document.plan, run: Arc::new(run), path: self.path, serials, lock })
    }
}

/// Where a kept file lies now: beside the instrument file, or where the instrument file says.
fn place(file: &KeptFile, i: &Instrument, base: &Path) -> PathBuf {
    if !file.name.starts_with("outside/") {
        return base.join(&file.name);
    }
    let named = match file.role.as_str() {
        "simulation.bench" => i.simulation.as_ref().map(|s| &s.bench),
        "lamp.spectrum" => Some(&i.lamp.spectrum),
        "optics.mirror_reflectance" => Some(&i.optics.mirror_reflectance),
        "filter_wheel.glasses" => Some(&i.filter_wheel.glasses),
        "filter_wheel.glass_parameters" => Some(&i.filter_wheel.glass_parameters),
        "reference.reflection.spectrum" => i.reference.reflection.as_ref().map(|r| &r.spectrum),
        "reference.transmission.spectrum" => i.reference.transmission.as_ref().map(|r| &r.spectrum),
        role => role.strip_prefix("calibration.").and_then(|name| i.camera.get(name)).map(|c| &c.calibration),
    };
    base.join(named.map_or(Path::new(&file.name), PathBuf::as_path))
}

/// Where the sample of a simulated bench lies: beside the instrument file, or where the scan says.
fn sample_place(file: &KeptFile, document: &RunDocument, base: &Path) -> PathBuf {
    let named = document.scan.sample.simulated.as_ref().filter(|_| file.name.starts_with("outside/"));
    base.join(named.map_or(Path::new(&file.name), PathBuf::as_path))
}

/// One sentence where the file is not what the run was started with.
fn file_difference(kept: &KeptFile, now: &Path) -> Option<String> {
    let digest = |text: &str| text.get(..12).unwrap_or(text).to_owned();
    match read_bytes(now, "kept", LARGEST_FILE) {
        Ok(bytes) => {
            let found = sha256_hex(&bytes);
            let words = || format!("{} ({}): SHA-256 was {}…", kept.role, now.display(), digest(&kept.sha256));
            (found != kept.sha256).then(|| format!("{}, is {}…", words(), digest(&found)))
        }
        Err(e) => Some(format!("{}: {e}", kept.role)),
    }
}

/// One sentence for each key of the instrument file that has another value. What a run may be gone on with by is no
/// difference.
fn instrument_differences(was: &Instrument, is: &Instrument) -> Vec<String> {
    let flat = |instrument: &Instrument| {
        let mut flat = BTreeMap::new();
        let mut instrument = instrument.clone();
        instrument.auto_resume = false;
        instrument.daemon = Default::default();
        if let Ok(value) = toml::Value::try_from(instrument) {
            flatten(&value, "", &mut flat);
        }
        flat
    };
    let (was, is) = (flat(was), flat(is));
    let keys: std::collections::BTreeSet<&String> = was.keys().chain(is.keys()).collect();
    let shown = |value: Option<&String>| value.map_or("absent".to_owned(), Clone::clone);
    let differs = keys.into_iter().filter(|key| was.get(*key) != is.get(*key));
    differs.map(|key| format!("instrument: `{key}` was {}, is {}", shown(was.get(key)), shown(is.get(key)))).collect()
}

fn flatten(value: &toml::Value, name: &str, into: &mut BTreeMap<String, String>) {
    match value {
        toml::Value::Table(table) => {
            for (key, value) in table {
                let full = if name.is_empty() { key.clone() } else { format!("{name}.{key}") };
                flatten(value, &full, into);
            }
        }
        value => {
            into.insert(name.to_owned(), value.to_string());
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::config::testing;

    #[test]
    fn differences_are_told_key_by_key_and_only_they() {
        let was = testing::instrument();
        assert!(instrument_differences(&was, &was).is_empty());
        let mut is = was.clone();
        is.auto_resume = true;
        assert!(instrument_differences(&was, &is).is_empty(), "going on may be switched on meanwhile");
        is.holder.tilt.serial = "60001".to_owned();
        is.lamp.irradiance_uw_per_cm2 = None;
        let found = instrument_differences(&was, &is);
        let told = [
            "instrument: `holder.tilt.serial` was \"50001\", is \"60001\"",
            "instrument: `lamp.irradiance_uw_per_cm2` was 75.0, is absent",
        ];
        assert_eq!(found, told);
    }

    #[test]
    fn a_changed_or_missing_file_is_a_difference() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path().join("lamp.csv");
        let kept = KeptFile { role: "lamp.spectrum".into(), name: "lamp.csv".into(), sha256: sha256_hex(b"one") };
        assert!(file_difference(&kept, &at).is_some_and(|words| words.contains("lamp.spectrum")));
        std::fs::write(&at, b"one").unwrap();
        assert_eq!(file_difference(&kept, &at), None);
        std::fs::write(&at, b"two").unwrap();
        assert!(file_difference(&kept, &at).is_some_and(|words| words.contains("SHA-256 was")));
    }
}
