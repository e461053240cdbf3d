//! The files that instrument, scan and calibrations name: read once, kept with their digests, spectra parsed.

use super::Report;
use crate::config::curves::{self, Curves};
use crate::config::error::{ConfigError, Issue};
use crate::config::instrument::Instrument;
use crate::config::load::Loaded;
use crate::config::scan::Scan;
use crate::config::source::read_bytes;
use crate::digest::sha256_hex;
use std::collections::BTreeMap;
use std::fmt;
use std::path::{Component, Path, PathBuf};

/// A file that was read.
#[derive(Clone, PartialEq, Eq)]
pub struct InputFile {
    /// What it is for: `scan`, `instrument`, `calibration.ccd`, `lamp.spectrum`, ….
    pub role: String,
    /// Path relative to the instrument file's folder, with `/`; files outside of it are named `outside/N/NAME`.
    pub name: String,
    /// Where it was read.
    pub path: PathBuf,
    /// SHA-256 of the content, hexadecimal.
    pub sha256: String,
    /// The content, so that a run can keep it.
    pub bytes: Vec<u8>,
}

/// The spectral data that the files name.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Spectra {
    /// Lamp, relative spectral power; first column counts.
    pub lamp: Curves,
    /// Mirror reflectance; first column counts.
    pub mirror: Curves,
    /// Internal transmittance at 1 mm, one column a glass.
    pub glasses: Curves,
    /// Reflection factor P by glass.
    pub reflection_factors: BTreeMap<String, f64>,
    /// Responsivity by camera: columns r, g, b or one column.
    pub responsivity: BTreeMap<String, Curves>,
    /// Reflecting diffuser; first column counts.
    pub reflection_reference: Option<Curves>,
    /// Transmitting diffuser; first column counts.
    pub transmission_reference: Option<Curves>,
}

/// Files read so far.
pub(super) struct Inputs {
    base: PathBuf,
    files: BTreeMap<String, InputFile>,
    pub(super) responsivity: BTreeMap<String, Curves>,
}

// === impl InputFile ===

impl fmt::Debug for InputFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The content is long and has its digest.
        f.debug_struct("InputFile").field("name", &self.name).field("sha256", &self.sha256).finish_non_exhaustive()
    }
}

// === impl Inputs ===

impl Inputs {
    pub(super) fn new(base: PathBuf) -> Inputs {
        Inputs { base, files: BTreeMap::new(), responsivity: BTreeMap::new() }
    }

    /// Keeps a file; the same path twice is one file.
    pub(super) fn add(&mut self, role: &str, path: &Path, bytes: &[u8]) {
        let plain = plain_path(path);
        if self.files.values().any(|f| plain_path(&f.path) == plain) {
            return;
        }
        let inside = plain.strip_prefix(plain_path(&self.base)).ok().map(|p| {
            p.components().map(|c| c.as_os_str().to_string_lossy().into_owned()).collect::<Vec<_>>().join("/")
        });
        let name = inside.unwrap_or_else(|| {
            let last = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            format!("outside/{}/{last}", self.files.len())
        });
        let file = InputFile {
            role: role.to_owned(),
            name: name.clone(),
            path: path.to_owned(),
            sha256: sha256_hex(bytes),
            bytes: bytes.to_owned(),
        };
        self.files.insert(name, file);
    }

    /// Keeps files that were read before.
    pub(super) fn keep(&mut self, files: impl Iterator<Item = InputFile>) {
        self.files.extend(files.map(|file| (file.name.clone(), file)));
    }

    /// Reads and keeps a file named by `key`; a fault is told at the key.
    pub(super) fn read(&mut self, report: &mut Report<'_>, key: &str, role: &str, path: &Path) -> Option<String> {
        let outcome = read_bytes(path, "named", curves::LARGEST_FILE);
        let shown = path.display();
        match outcome.map(|bytes| (String::from_utf8(bytes.clone()), bytes)) {
            Ok((Ok(text), bytes)) => {
                self.add(role, path, &bytes);
                Some(text)
            }
            Ok((Err(_), _)) => {
                report.error(key, format!("`{key}` names {shown}, which is not UTF-8 text; is it the right file?"));
                None
            }
            Err(ConfigError::Unreadable { reason, .. }) => {
                report.error(key, format!("`{key}` names {shown}, which cannot be read: {reason}"));
                None
            }
            Err(_) => {
                report.error(
                    key,
                    format!(
                        "`{key}` names {shown}, which is not there; paths are relative to the file that names them"
                    ),
                );
                None
            }
        }
    }

    /// Reads a table of values over wavelength.
    pub(super) fn curves(&mut self, report: &mut Report<'_>, key: &str, role: &str, path: &Path) -> Option<Curves> {
        let text = self.read(report, key, role, path)?;
        match Curves::parse(&text) {
            Ok(curves) => Some(curves),
            Err(why) => {
                report.error(key, format!("`{key}` names {}, which is no spectral table: {why}", path.display()));
                None
            }
        }
    }

    /// The spectra of the instrument file, and the glasses of the slots against them.
    pub(super) fn spectra(&mut self, instrument: &Loaded<Instrument>, issues: &mut Vec<Issue>) -> Spectra {
        let mut report = Report { source: &instrument.source, issues };
        let i = &instrument.value;
        let base = self.base.clone();
        let mut get = |report: &mut Report<'_>, key: &str, path: &Path, max: f64| {
            let curves = self.curves(report, key, key, &base.join(path))?;
            let (low, high) = curves.value_range();
            if low < 0.0 || high > max {
                let allowed = if max.is_finite() { format!("from 0 to {max}") } else { "not negative".into() };
                report.error(
                    key,
                    format!(
                        "`{key}` names {}, whose values go from {low} to {high}, but must be {allowed}",
                        path.display()
                    ),
                );
            }
            Some(curves)
        };
        let lamp = get(&mut report, "lamp.spectrum", &i.lamp.spectrum, f64::INFINITY);
        let mirror = get(&mut report, "optics.mirror_reflectance", &i.optics.mirror_reflectance, 1.0);
        let glasses = get(&mut report, "filter_wheel.glasses", &i.filter_wheel.glasses, 1.0);
        let reflection = i.reference.reflection.as_ref();
        let transmission = i.reference.transmission.as_ref();
        let reflection = reflection.and_then(|r| get(&mut report, "reference.reflection.spectrum", &r.spectrum, 1.1));
        let transmission =
            transmission.and_then(|r| get(&mut report, "reference.transmission.spectrum", &r.spectrum, 1.0));
        let key = "filter_wheel.glass_parameters";
        let path = base.join(&i.filter_wheel.glass_parameters);
        let factors = self.read(&mut report, key, key, &path).and_then(|text| {
            let read = curves::reflection_factors(&text);
            read.map_err(|why| report.error(key, format!("`{key}` names {}: {why}", path.display()))).ok()
        });
        known_glasses(i, glasses.as_ref(), factors.as_ref(), &mut report);
        Spectra {
            lamp: lamp.unwrap_or_default(),
            mirror: mirror.unwrap_or_default(),
            glasses: glasses.unwrap_or_default(),
            reflection_factors: factors.unwrap_or_default(),
            responsivity: BTreeMap::new(),
            reflection_reference: reflection,
            transmission_reference: transmission,
        }
    }

    /// The simulated bench's file.
    pub(super) fn bench(&mut self, instrument: &Loaded<Instrument>, issues: &mut Vec<Issue>) -> Option<PathBuf> {
        let mut report = Report { source: &instrument.source, issues };
        let path = self.base.join(&instrument.value.simulation.as_ref()?.bench);
        self.read(&mut report, "simulation.bench", "simulation.bench", &path)?;
        Some(path)
    }

    /// The sample in the simulated bench.
    pub(super) fn sample(
        &mut self,
        scan: &Loaded<Scan>,
        instrument: &Loaded<Instrument>,
        dir: PathBuf,
        issues: &mut Vec<Issue>,
    ) -> Option<PathBuf> {
        let mut report = Report { source: &scan.source, issues };
        let key = super::SAMPLE;
        match (&scan.value.sample.simulated, &instrument.value.simulation) {
            (Some(path), Some(_)) => {
                let path = dir.join(path);
                self.read(&mut report, key, key, &path).map(|_| path)
            }
            (Some(_), None) => {
                report.warn(
                    key,
                    format!(
                        "`{key}` is not used: the instrument is not simulated; the sample in the holder is measured"
                    ),
                );
                None
            }
            (None, Some(_)) => {
                report.error(key, format!("`{key}` is missing, and the instrument is simulated; name the sample that lies in it, such as \"../sim/samples/rough_glass.toml\""));
                None
            }
            (None, None) => None,
        }
    }

    /// Spectra complete with the responsivities, and all files.
    pub(super) fn finish(self, spectra: Spectra) -> (Spectra, Vec<InputFile>) {
        (Spectra { responsivity: self.responsivity, ..spectra }, self.files.into_values().collect())
    }
}

fn known_glasses(
    instrument: &Instrument,
    glasses: Option<&Curves>,
    factors: Option<&BTreeMap<String, f64>>,
    report: &mut Report<'_>,
) {
    for (number, slot) in &instrument.filter_wheel.slot {
        for (n, glass) in slot.glasses.iter().enumerate() {
            let key = format!("filter_wheel.slot.{number}.glasses[{n}].glass");
            let name = &glass.glass;
            if let Some(table) = glasses.filter(|t| t.column(name).is_none()) {
                let known = table.names.iter().map(String::as_str);
                let near = crate::config::hint::nearest(name, known).map(|n| format!("; did you mean \"{n}\"?"));
                let file = instrument.filter_wheel.glasses.display();
                report.error(
                    &key,
                    format!("`{key}` is \"{name}\", a glass that {file} does not have{}", near.unwrap_or_default()),
                );
            } else if factors.is_some_and(|f| f.get(name).is_none_or(|p| *p == 0.0)) {
                let file = instrument.filter_wheel.glass_parameters.display();
                report.error(
                    &key,
                    format!("`{key}` is \"{name}\", whose reflection factor is not in {file}; add it there"),
                );
            }
        }
    }
}

/// The path without `.` and with each `..` taken back where it can be.
fn plain_path(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir if matches!(plain.components().next_back(), Some(Component::Normal(_))) => {
                plain.pop();
            }
            other => plain.push(other),
        }
    }
    plain
}
