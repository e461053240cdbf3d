//! The shipped instrument as a value, for tests of this wing and of those that build on it.

#![allow(clippy::unwrap_used)]

use super::instrument::{Instrument, LightMonitor};
use super::load::load;
use super::scan::Scan;
use std::path::{Path, PathBuf};

/// The shipped configuration folder.
pub fn config_dir() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("config")
}

/// `config/instrument.sim.toml`.
pub fn instrument() -> Instrument {
    load(&config_dir().join("instrument.sim.toml"), "instrument").unwrap().value
}

/// The light monitor of `config/instrument.example.toml`; the simulated bench has none.
pub fn light_monitor() -> LightMonitor {
    let example: Instrument = load(&config_dir().join("instrument.example.toml"), "instrument").unwrap().value;
    example.light_monitor.unwrap()
}

/// A scan of `config/scans/`, by name.
pub fn scan(name: &str) -> Scan {
    load(&config_dir().join(format!("scans/{name}.toml")), "scan").unwrap().value
}
