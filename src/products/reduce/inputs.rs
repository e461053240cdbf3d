//! What a run kept, read back: plan document, spectra, journal.

use super::light::{DriftFactor, LightCurve};
use super::readings::Setup;
use crate::archive::rows::FrameRow;
use crate::archive::rundir::PLAN;
use crate::archive::verify::records_must_be_sound;
use crate::archive::{ArchiveError, RunDir};
use crate::config::curves::{Curves, reflection_factors};
use crate::control::plan::document::RunDocument;
use crate::engine::spectra::curve::Curve;
use crate::products::error::{ProductError, Result, engine};
use std::collections::BTreeMap;
use std::path::Path;

const D65: &str = include_str!("../../../config/spectra/source/cie_d65.csv");
const PHOTOPIC: &str = include_str!("../../../config/spectra/observer/cie1924_v_1nm.csv");
const G173_DIRECT: &str = include_str!("../../../config/spectra/solar/astm_g173_direct.csv");

/// A run opened to be reduced.
pub struct Run {
    /// The directory.
    pub dir: RunDir,
    /// Everything resolved.
    pub document: RunDocument,
    /// Stored frames by step number.
    pub frames: BTreeMap<u32, FrameRow>,
    /// The lamp's level through the night; empty without a light monitor.
    pub light: LightCurve,
    /// Begin of the first and end of the last stored frame of each view, microseconds since 1970.
    times: BTreeMap<u32, (i64, i64)>,
    /// Spectra of the instrument.
    pub spectra: InstrumentSpectra,
    /// Standard spectra.
    pub standards: Standards,
}

/// Spectra that the instrument file names.
#[derive(Debug, Clone)]
pub struct InstrumentSpectra {
    /// Relative spectral power of the lamp.
    pub lamp: Curve,
    /// Reflectance of the mirror.
    pub mirror: Curve,
    /// Internal transmittance at 1 mm by glass.
    pub glasses: BTreeMap<String, Curve>,
    /// Reflection factor P by glass.
    pub reflection_factors: BTreeMap<String, f64>,
    /// Responsivity by camera, one curve a channel.
    pub responsivity: BTreeMap<String, Vec<Curve>>,
    /// Value of the reflecting diffuser.
    pub reflection_reference: Option<Curve>,
    /// Value of the transmitting diffuser.
    pub transmission_reference: Option<Curve>,
}

/// Standard spectra that the totals are weighted with.
#[derive(Debug, Clone)]
pub struct Standards {
    /// CIE D65.
    pub d65: Curve,
    /// V(lambda), CIE 1924.
    pub v: Curve,
    /// ASTM G173 direct.
    pub g173_direct: Curve,
}

// === impl Run ===

impl Run {
    /// Opens the run directory at `path`.
    ///
    /// # Errors
    /// Not a run, a plan of another version, a journal, plan or kept file that is not as it was written.
    pub fn open(path: &Path) -> Result<Run> {
        records_must_be_sound(path)?;
        let dir = RunDir::open(path)?;
        let text = dir.plan_toml()?;
        let document: RunDocument = toml::from_str(&text)
            .map_err(|e| ProductError::Plan { path: path.join(PLAN), message: e.message().to_owned() })?;
        let (frames, events) = dir.with(|journal| Ok((journal.frames()?, journal.events()?)))?;
        let frames: BTreeMap<u32, FrameRow> = frames.into_iter().map(|f| (f.step, f)).collect();
        let (light, times) = (LightCurve::of(&events), times(&document, &frames));
        let text = |role: &str| document.input(role).map(|name| std::fs::read_to_string(path.join(name))).transpose();
        let spectra = InstrumentSpectra::of(path, document.calibrations.keys(), &text)?;
        Ok(Run { dir, document, frames, light, times, spectra, standards: Standards::load()? })
    }

    /// What a view is scaled by because the lamp drifted; `None` without light monitor or frames.
    pub fn drift_factor(&self, view: u32) -> Option<DriftFactor> {
        let (begin, end) = self.times.get(&view)?;
        self.light.factor(*begin, *end)
    }

    /// What the run measured with.
    pub fn setup(&self) -> Setup<'_> {
        Setup {
            instrument: &self.document.instrument,
            bands: &self.document.scan.bands.names,
            spectra: &self.spectra,
            standards: &self.standards,
        }
    }

    /// Microseconds since 1970 of the first stored frame of a view; `None` if it has none.
    pub fn view_time(&self, view: u32) -> Option<i64> {
        self.times.get(&view).map(|(begin, _)| *begin)
    }
}

/// Begin and end of each view that has frames.
fn times(document: &RunDocument, frames: &BTreeMap<u32, FrameRow>) -> BTreeMap<u32, (i64, i64)> {
    let mut times: BTreeMap<u32, (i64, i64)> = BTreeMap::new();
    for step in &document.plan.steps {
        let Some(frame) = frames.get(&step.number) else { continue };
        let end_us = frame.utc_us + frame.exposure_us as i64;
        let (begin, end) = times.entry(step.view).or_insert((frame.utc_us, end_us));
        (*begin, *end) = ((*begin).min(frame.utc_us), (*end).max(end_us));
    }
    times
}

// === impl Standards ===

impl Standards {
    /// The shipped tables.
    ///
    /// # Errors
    /// None on a sound build; the tables are part of the program.
    pub fn load() -> Result<Standards> {
        let curve = |name: &str, text: &str| {
            let curves = Curves::parse(text).map_err(|e| ProductError::Nothing(format!("the table {name}: {e}")))?;
            first(name, &curves)
        };
        Ok(Standards {
            d65: curve("CIE D65", D65)?,
            v: curve("V(lambda)", PHOTOPIC)?,
            g173_direct: curve("ASTM G173", G173_DIRECT)?,
        })
    }
}

// === impl InstrumentSpectra ===

impl InstrumentSpectra {
    /// The tables that `text` gives by their roles; `place` is named in errors.
    ///
    /// # Errors
    /// A table that is not there, cannot be read or is none.
    pub fn of<'a>(
        place: &Path,
        cameras: impl Iterator<Item = &'a String>,
        text: &dyn Fn(&str) -> std::io::Result<Option<String>>,
    ) -> Result<InstrumentSpectra> {
        let input =
            |role: &str, message: String| ProductError::Input { run: place.to_owned(), role: role.into(), message };
        let known = |role: &str| text(role).map_err(|e| input(role, format!("cannot be read ({e})")));
        let text = |role: &str| known(role)?.ok_or_else(|| input(role, "is not there".into()));
        let curves =
            |role: &str| -> Result<Curves> { Curves::parse(&text(role)?).map_err(|message| input(role, message)) };
        let one = |role: &str| first(role, &curves(role)?);
        let reference = |role: &str| known(role)?.map(|_| one(role)).transpose();
        let mut responsivity = BTreeMap::new();
        for name in cameras {
            let role = format!("responsivity.{name}");
            let table = curves(&role)?;
            let channels = table.columns.iter().map(|c| curve(&role, &table.wavelength_nm, c));
            responsivity.insert(name.clone(), channels.collect::<Result<Vec<Curve>>>()?);
        }
        let glass_table = curves("filter_wheel.glasses")?;
        let glasses = glass_table.names.iter().zip(&glass_table.columns);
        const PARAMETERS: &str = "filter_wheel.glass_parameters";
        let factors = reflection_factors(&text(PARAMETERS)?).map_err(|message| input(PARAMETERS, message))?;
        Ok(InstrumentSpectra {
            lamp: one("lamp.spectrum")?,
            mirror: one("optics.mirror_reflectance")?,
            glasses: glasses
                .map(|(name, c)| Ok((name.clone(), curve(name, &glass_table.wavelength_nm, c)?)))
                .collect::<Result<_>>()?,
            reflection_factors: factors,
            responsivity,
            reflection_reference: reference("reference.reflection.spectrum")?,
            transmission_reference: reference("reference.transmission.spectrum")?,
        })
    }
}

fn first(name: &str, curves: &Curves) -> Result<Curve> {
    let column = curves.columns.first().map_or(&[][..], Vec::as_slice);
    curve(name, &curves.wavelength_nm, column)
}

fn curve(name: &str, wavelength_nm: &[f64], values: &[f64]) -> Result<Curve> {
    Curve::new(wavelength_nm.to_vec(), values.to_vec()).map_err(engine(format!("the spectrum {name}")))
}

impl From<std::io::Error> for ProductError {
    fn from(e: std::io::Error) -> ProductError {
        ProductError::Archive(ArchiveError::io("read or write", Path::new("products"), &e))
    }
}
