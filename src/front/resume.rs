//! Going on with a run: finds it, compares it with the instrument as it is now, and makes it ready to be measured.

use super::cli::exit::Exit;
use super::cli::output::Failure;
use super::night::{Night, hold, storage};
use crate::archive::RunDir;
use crate::archive::disk::RealDisk;
use crate::archive::mend::resume_mended;
use crate::archive::rundir::JOURNAL;
use crate::archive::verify::{accept_loss, records_must_be_sound};
use crate::config::check::{Checked, Spectra};
use crate::config::instrument::Instrument;
use crate::config::source::read_bytes;
use crate::control::events::Event;
use crate::control::frames::guard::Rejection;
use crate::control::plan::document::{KeptFile, RunDocument};
use crate::control::sequencer::recorder;
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
/// A folder that cannot be read; a journal that cannot be read, in a run that is newer than what is found.
pub fn newest_unfinished(runs: &Path) -> Result<Option<PathBuf>, Failure> {
    let entries = match std::fs::read_dir(runs) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        entries => entries.map_err(|e| Failure::new(Exit::Storage, format!("{}: {e}", runs.display())))?,
    };
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    // A run's name begins with the moment it was started.
    paths.sort();
    for path in paths.into_iter().rev().filter(|path| path.join(JOURNAL).is_file()) {
        let dir = RunDir::open(&path).map_err(storage)?;
        if dir.with(|journal| journal.summary()).map_err(storage)?.planned > 0 {
            return Ok(Some(path));
        }
    }
    Ok(None)
}

/// Lets a run whose log is damaged be gone on with from what of it is whole; of any other run nothing is changed.
///
/// # Errors
/// A run that another process works on, a file that cannot be read or removed.
pub fn accept_lost_end(run: &Path) -> Result<(), Failure> {
    let _lock = hold(run)?;
    accept_loss(run, &RealDisk).map_err(storage)
}

// === impl Unfinished ===

impl Unfinished {
    /// Reads the run at `path` and compares it with the instrument as it is now, whose file lies in `base`. A simulated
    /// run needs its sample again: `sample`, or where the run found it.
    ///
    /// # Errors
    /// Not a run; a journal, plan or kept file that is not as it was written; as bad input every difference of plan,
    /// instrument, calibration and spectra.
    pub fn compare(
        path: &Path,
        instrument: &Instrument,
        base: &Path,
        sample: Option<PathBuf>,
    ) -> Result<Unfinished, Failure> {
        records_must_be_sound(path).map_err(storage)?;
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
            found.extend(file_difference(file, &place(file, &document, instrument, base)));
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

    /// Opens the run to go on with it, proven against its digests: damaged frames are taken again, other damage ends it.
    /// With `missing`, exposures listed as missing are tried again too.
    ///
    /// # Errors
    /// A run that another process works on, one that is damaged, a journal that cannot be written.
    pub fn night(self, missing: bool) -> Result<Night, Failure> {
        let lock = hold(&self.path)?;
        let last = self.last_told()?;
        let again =
            |step, seq| recorder::row(seq, last, &Event::FrameRejected { step, reason: Rejection::FileDamaged });
        let (run, mended) = resume_mended(&self.path, again).map_err(storage)?;
        if !mended.steps.is_empty() {
            tracing::warn!(run = %self.path.display(), frames = mended.steps.len(), "damaged frames are taken again");
        }
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

/// Where a kept file lies now: beside the instrument file, or where the instrument file or a calibration says.
fn place(file: &KeptFile, document: &RunDocument, i: &Instrument, base: &Path) -> PathBuf {
    if !file.name.starts_with("outside/") {
        return base.join(&file.name);
    }
    if let Some(name) = file.role.strip_prefix("responsivity.") {
        // The digest of the calibration, which is compared too, proves that it still names this file.
        let named = document.calibrations.get(name).map(|c| &c.responsivity.file);
        let folder = i.camera.get(name).and_then(|c| c.calibration.parent()).unwrap_or(Path::new(""));
        return base.join(folder).join(named.map_or(Path::new(&file.name), PathBuf::as_path));
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

/// Where the sample of a simulated bench lies: beside the instrument file, or where the scan says, whose own folder is
/// known where the scan lies beside the instrument file.
fn sample_place(file: &KeptFile, document: &RunDocument, base: &Path) -> PathBuf {
    let Some(named) = document.scan.sample.simulated.as_ref().filter(|_| file.name.starts_with("outside/")) else {
        return base.join(&file.name);
    };
    let scan = document.files.iter().find(|f| f.role == "scan" && !f.name.starts_with("outside/"));
    base.join(scan.and_then(|f| Path::new(&f.name).parent()).unwrap_or(Path::new(""))).join(named)
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

/// One sentence for each key of the instrument file that has another value. What changes nothing that is measured is no
/// difference: where runs lie, whom the daemon serves, and the port a device is found at, which its identity proves.
fn instrument_differences(was: &Instrument, is: &Instrument) -> Vec<String> {
    let flat = |instrument: &Instrument| {
        let mut flat = BTreeMap::new();
        let mut instrument = instrument.clone();
        instrument.auto_resume = false;
        instrument.daemon = Default::default();
        instrument.runs_dir = PathBuf::new();
        if let Ok(value) = toml::Value::try_from(instrument) {
            flatten(&value, "", &mut flat);
        }
        flat.retain(|key, _| key != "port" && !key.ends_with(".port"));
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
        is.runs_dir = "/elsewhere".into();
        is.holder.port = "/dev/ttyUSB7".into();
        assert!(instrument_differences(&was, &is).is_empty(), "nothing that is measured depends on these");
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
