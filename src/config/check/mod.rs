//! Instrument, scan and calibrations together: everything is compared with everything, and all faults are told at once.

mod calibration;
mod cameras;
mod devices;
mod inputs;
mod light;
mod night;
mod optics;
mod scan;
#[cfg(test)]
mod tests;

pub use inputs::{InputFile, Spectra};

use super::calibration::CameraCalibration;
use super::curves::LARGEST_FILE;
use super::error::{ConfigError, Issue, Severity};
use super::instrument::Instrument;
use super::load::{Loaded, load};
use super::scan::Scan;
use super::source::{Source, read_bytes};
use inputs::Inputs;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What the check is to know besides the files.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Driver names of the driver table; empty = names are not checked.
    pub drivers: Vec<String>,
    /// The day calibrations are judged by.
    pub today: jiff::civil::Date,
}

/// Files that fit together.
#[derive(Debug, Clone, PartialEq)]
pub struct Checked {
    /// The instrument.
    pub instrument: Instrument,
    /// The scan.
    pub scan: Scan,
    /// Calibration by camera name.
    pub calibrations: BTreeMap<String, CameraCalibration>,
    /// The spectral data that the files name.
    pub spectra: Spectra,
    /// Every file that was read, with digest and content, ordered by name.
    pub files: Vec<InputFile>,
    /// Folder of the instrument file: base of the paths in it.
    pub instrument_dir: PathBuf,
    /// Folder of the scan file: base of the paths in it.
    pub scan_dir: PathBuf,
    /// The simulated bench's description, where the instrument has one.
    pub bench: Option<PathBuf>,
    /// The sample in the simulated bench, where the scan names one.
    pub simulated_sample: Option<PathBuf>,
    /// What somebody should know, none of it an error.
    pub warnings: Vec<Issue>,
}

/// Role of the sample in the simulated bench.
const SAMPLE: &str = "sample.simulated";

/// Collects what is found in one file.
struct Report<'a> {
    source: &'a Source,
    issues: &'a mut Vec<Issue>,
}

/// Reads and checks a scan with the instrument that is to carry it out, its calibrations and spectral data.
///
/// # Errors
/// `NotFound` or `Unreadable` for the two files themselves; `Faulty` with all faults (and the warnings) of all files.
pub fn check(scan_path: &Path, instrument_path: &Path, options: &Options) -> Result<Checked, ConfigError> {
    let (instrument, scan) = both(load(instrument_path, "instrument"), load(scan_path, "scan"))?;
    let mut issues = Vec::new();
    let mut inputs = Inputs::new(folder(instrument_path));
    inputs.add("instrument", instrument_path, instrument.source.text.as_bytes());
    inputs.add("scan", scan_path, scan.source.text.as_bytes());

    devices::check(&instrument, options, &mut issues);
    optics::check(&instrument, &mut issues);
    instrument.value.daemon.check(&instrument.source, &mut issues);
    let spectra = inputs.spectra(&instrument, &mut issues);
    let bench = inputs.bench(&instrument, &mut issues);
    let calibrations = calibration::read(&instrument, options, &mut inputs, &mut issues);
    scan::check(&scan, &instrument, &mut issues);
    let simulated_sample = inputs.sample(&scan, &instrument, folder(scan_path), &mut issues);

    issues.sort_by(|a, b| (&a.path, a.line, a.column).cmp(&(&b.path, b.line, b.column)));
    if issues.iter().any(|i| i.severity == Severity::Error) {
        return Err(ConfigError::Faulty { issues });
    }
    let (spectra, files) = inputs.finish(spectra);
    Ok(Checked {
        instrument: instrument.value,
        scan: scan.value,
        calibrations,
        spectra,
        files,
        instrument_dir: folder(instrument_path),
        scan_dir: folder(scan_path),
        bench,
        simulated_sample,
        warnings: issues,
    })
}

// === impl Checked ===

impl Checked {
    /// Lays another sample into the simulated bench: its file takes the place of the one that the scan names, in what a
    /// run keeps too.
    ///
    /// # Errors
    /// `NotFound` or `Unreadable`.
    pub fn lay_sample(&mut self, path: &Path) -> Result<(), ConfigError> {
        let bytes = read_bytes(path, "sample", LARGEST_FILE)?;
        let mut inputs = Inputs::new(self.instrument_dir.clone());
        inputs.keep(std::mem::take(&mut self.files).into_iter().filter(|file| file.role != SAMPLE));
        inputs.add(SAMPLE, path, &bytes);
        (_, self.files) = inputs.finish(Spectra::default());
        // A path that is none of the instrument's folder is found again by its full name.
        self.scan.sample.simulated = Some(std::path::absolute(path).unwrap_or_else(|_| path.to_owned()));
        self.simulated_sample = Some(path.to_owned());
        Ok(())
    }
}

/// Reads an instrument file and checks its devices by themselves, for work that needs no scan. Names of drivers are left
/// to the driver table, so that one that this build lacks stops nobody from using the others.
///
/// # Errors
/// As [`check`].
pub fn check_devices(path: &Path, today: jiff::civil::Date) -> Result<Instrument, ConfigError> {
    let instrument = load(path, "instrument")?;
    let mut issues = Vec::new();
    devices::check(&instrument, &Options { drivers: Vec::new(), today }, &mut issues);
    issues.retain(|i| i.severity == Severity::Error);
    if issues.is_empty() { Ok(instrument.value) } else { Err(ConfigError::Faulty { issues }) }
}

/// Both files, or the faults of both together.
fn both<A, B>(
    a: Result<Loaded<A>, ConfigError>,
    b: Result<Loaded<B>, ConfigError>,
) -> Result<(Loaded<A>, Loaded<B>), ConfigError> {
    match (a, b) {
        (Ok(a), Ok(b)) => Ok((a, b)),
        (Err(ConfigError::Faulty { mut issues }), Err(ConfigError::Faulty { issues: more })) => {
            issues.extend(more);
            Err(ConfigError::Faulty { issues })
        }
        (Err(ConfigError::Faulty { .. }), Err(e)) | (Err(e), _) | (_, Err(e)) => Err(e),
    }
}

fn folder(path: &Path) -> PathBuf {
    match path.parent() {
        Some(dir) if !dir.as_os_str().is_empty() => dir.to_owned(),
        _ => PathBuf::from("."),
    }
}

// === impl Report ===

impl Report<'_> {
    fn error(&mut self, key: &str, message: impl Into<String>) {
        self.issues.push(self.source.issue(Severity::Error, key, message));
    }

    fn warn(&mut self, key: &str, message: impl Into<String>) {
        self.issues.push(self.source.issue(Severity::Warning, key, message));
    }

    /// Refuses a number that is not from `min` to `max`, both allowed.
    fn range(&mut self, key: &str, value: f64, min: f64, max: f64) -> bool {
        let fits = value >= min && value <= max;
        if !fits {
            self.error(key, format!("`{key}` is {value}, but must be from {min} to {max}; correct the number"));
        }
        fits
    }

    /// Refuses a number that is not above 0 and at most `max`.
    fn positive(&mut self, key: &str, value: f64, max: f64) -> bool {
        let fits = value > 0.0 && value <= max;
        if !fits {
            self.error(key, format!("`{key}` is {value}, but must be above 0 and at most {max}; correct the number"));
        }
        fits
    }

    /// Refuses an empty text.
    fn text(&mut self, key: &str, value: &str) {
        if value.trim().is_empty() {
            self.error(key, format!("`{key}` is empty; write a name"));
        }
    }
}
