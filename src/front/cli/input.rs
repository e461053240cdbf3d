//! What several commands need: the instrument file, the checked files, a run opened to read.

use super::exit::Exit;
use super::output::{Failure, Output};
use crate::config::check::{Checked, Options, check};
use crate::config::error::ConfigError;
use crate::config::scan::Format;
use crate::engine::bsdf::set::Quantity;
use crate::front::bench::CAMERA_DRIVERS;
use crate::front::night::stamp;
use crate::products::error::ProductError;
use crate::products::reduce::{InstrumentSpectra, Run, Setup, Standards, quantities};
use goniod_drivers::clock::{Clock, UtcMicros};
use goniod_drivers::table::DRIVERS;
use std::path::{Path, PathBuf};

/// A scan and the instrument that is to carry it out.
#[derive(Debug, Clone, clap::Args)]
pub struct ScanArgs {
    /// The scan file.
    pub scan: PathBuf,
    /// The instrument file [default: $GONIOD_INSTRUMENT, config/instrument.toml, /etc/goniod/instrument.toml].
    #[arg(long, value_name = "FILE")]
    pub instrument: Option<PathBuf>,
}

// === impl ScanArgs ===

impl ScanArgs {
    /// Reads and checks everything; warnings are told on the way.
    pub fn check(&self, output: &Output) -> Result<Checked, Failure> {
        let instrument = instrument_path(self.instrument.as_deref())?;
        let checked = check(&self.scan, &instrument, &check_options(Clock::system())).map_err(bad_input)?;
        for warning in &checked.warnings {
            output.warn(&warning.to_string());
        }
        if let Some(warning) = klems_without_reach(&checked).map_err(|e| Failure::new(Exit::BadInput, e.to_string()))? {
            output.warn(&format!("{}: {warning}", self.scan.display()));
        }
        Ok(checked)
    }
}

/// What to know before the night, when the scan asks for a Klems file that its bands will not give.
fn klems_without_reach(checked: &Checked) -> Result<Option<String>, ProductError> {
    if !checked.scan.products.formats.contains(&Format::KlemsXml) {
        return Ok(None);
    }
    let of_role = |role: &str| checked.files.iter().find(|f| f.role == role);
    let text = |role: &str| Ok(of_role(role).map(|f| String::from_utf8_lossy(&f.bytes).into_owned()));
    let spectra = InstrumentSpectra::of(&checked.instrument_dir, checked.calibrations.keys(), &text)?;
    let standards = Standards::load()?;
    let bands = &checked.scan.bands.names;
    let given = quantities(Setup { instrument: &checked.instrument, bands, spectra: &spectra, standards: &standards })?;
    let lacks = |there: bool, name: &'static str| (!there).then_some(name);
    let visible = lacks(given.contains(&Quantity::Visible), "Visible");
    let solar = lacks(given.iter().any(|q| matches!(q, Quantity::Solar { .. })), "Solar");
    let lacking: Vec<&str> = visible.into_iter().chain(solar).collect();
    Ok((!lacking.is_empty()).then(|| {
        format!(
            "`products.formats` asks for klems-xml, but the bands do not reach far enough for {}; that file will not be \
             made unless `bands.use` names more bands",
            lacking.join(" and ")
        )
    }))
}

/// What the checks are to know: the drivers of this build, and the day by this clock.
pub fn check_options(clock: Clock) -> Options {
    let drivers = DRIVERS.iter().map(|d| d.name).chain(CAMERA_DRIVERS.iter().copied()).map(str::to_owned).collect();
    Options { drivers, today: stamp(clock.utc()).to_zoned(jiff::tz::TimeZone::UTC).date() }
}

/// The instrument file: as given, else the first of the usual places.
pub fn instrument_path(given: Option<&Path>) -> Result<PathBuf, Failure> {
    if let Some(path) = given {
        return Ok(path.to_owned());
    }
    if let Some(path) = std::env::var_os("GONIOD_INSTRUMENT") {
        return Ok(path.into());
    }
    let usual = ["config/instrument.toml", "/etc/goniod/instrument.toml"];
    usual.iter().map(PathBuf::from).find(|p| p.is_file()).ok_or_else(|| {
        Failure::new(
            Exit::BadInput,
            format!(
                "no instrument file: give --instrument FILE, set $GONIOD_INSTRUMENT, or put it at {}",
                usual.join(" or ")
            ),
        )
    })
}

/// A moment given as RFC 3339.
pub fn moment(text: &str) -> Result<UtcMicros, Failure> {
    text.parse::<jiff::Timestamp>()
        .map(|t| UtcMicros(t.as_microsecond()))
        .map_err(|_| Failure::new(Exit::Usage, format!("`{text}` is not a moment; write it as 2026-01-01T18:00:00Z")))
}

/// A run opened to be reduced.
pub fn open_run(path: &Path) -> Result<Run, Failure> {
    Run::open(path).map_err(|e| Failure::new(Exit::Storage, e.to_string()))
}

/// All faults of the files, one sentence each.
pub fn bad_input(error: ConfigError) -> Failure {
    let issues = error.issues();
    let messages =
        if issues.is_empty() { vec![error.to_string()] } else { issues.iter().map(ToString::to_string).collect() };
    Failure { exit: Exit::BadInput, messages }
}
