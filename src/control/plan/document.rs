//! `plan.toml` of a run: everything resolved, so that the run directory stands alone.

use super::Plan;
use crate::config::calibration::CameraCalibration;
use crate::config::instrument::Instrument;
use crate::config::scan::Scan;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Folder of the run directory that keeps the files a run was started from.
pub const INPUTS: &str = "inputs";

/// What a run was started from and what it is to do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunDocument {
    /// Name of the run.
    pub run_id: String,
    /// Version of the program that made the run.
    pub goniod_version: String,
    /// Seed of the simulated bench; absent on hardware.
    pub simulated_seed: Option<u64>,
    /// The run was rehearsed: its time is not that of the wall.
    #[serde(default)]
    pub virtual_time: bool,
    /// Start of the run, RFC 3339 in UTC.
    pub started: String,
    /// Files that were read, in `inputs/`.
    pub files: Vec<KeptFile>,
    /// The scan.
    pub scan: Scan,
    /// The instrument.
    pub instrument: Instrument,
    /// Calibrations by camera.
    pub calibrations: BTreeMap<String, CameraCalibration>,
    /// The plan.
    pub plan: Plan,
}

/// A file that the run keeps.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeptFile {
    /// What it is for: `scan`, `instrument`, `calibration.ccd`, `lamp.spectrum`, ….
    pub role: String,
    /// Path inside `inputs/`.
    pub name: String,
    /// SHA-256 of the content, hexadecimal.
    pub sha256: String,
}

// === impl RunDocument ===

impl RunDocument {
    /// Path inside the run directory of the file with this role.
    pub fn input(&self, role: &str) -> Option<String> {
        self.files.iter().find(|f| f.role == role).map(|f| format!("{INPUTS}/{}", f.name))
    }
}
