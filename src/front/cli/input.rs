//! What several commands need: the instrument file, the checked files, a run opened to read.

use super::exit::Exit;
use super::output::{Failure, Output};
use crate::config::check::{Checked, Options, check};
use crate::config::error::ConfigError;
use crate::front::bands::what_bands_give;
use crate::front::bench::CAMERA_DRIVERS;
use crate::front::night::stamp;
use crate::products::reduce::Run;
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
        let told = what_bands_give(&checked);
        if let Some(warning) =
            told.map_err(|e| Failure::new(Exit::BadInput, format!("{}: {e}", self.scan.display())))?
        {
            output.warn(&format!("{}: {warning}", self.scan.display()));
        }
        Ok(checked)
    }
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
