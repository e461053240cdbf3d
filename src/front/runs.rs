//! What the runs of a folder are doing or how they ended, read from their journals.

use super::night::stamp;
use crate::archive::RunDir;
use crate::control::devices::safe::SafeResult;
use crate::control::events::Event;
use goniod_drivers::clock::UtcMicros;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// State of a run whose end no journal tells: under way or cut short.
const OPEN: &str = "open";

/// How a run stands.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunStatus {
    /// The run directory.
    pub run: PathBuf,
    /// `open` (under way or cut short), or how it ended.
    pub state: String,
    /// Exposures stored.
    pub stored: u32,
    /// Exposures listed as missing.
    pub missing: u32,
    /// Exposures not done.
    pub planned: u32,
    /// Frames rejected and retaken.
    pub rejected: u32,
    /// Size of the stored frames.
    pub bytes: u64,
    /// True when every device proved its safe state at the run's end.
    pub safe: bool,
    /// When the last event came, and its kind.
    pub last_event: Option<String>,
}

// === impl RunStatus ===

impl RunStatus {
    /// Every exposure is stored or listed as missing, and the run was ended.
    pub fn is_finished(&self) -> bool {
        self.planned == 0 && self.state != OPEN
    }
}

/// The latest runs of a folder by name, the newest last.
///
/// # Errors
/// Those of listing the folder.
pub fn latest(runs_dir: &Path, last: usize) -> std::io::Result<Vec<RunStatus>> {
    let mut paths: Vec<PathBuf> = std::fs::read_dir(runs_dir)?.flatten().map(|e| e.path()).collect();
    paths.sort();
    let mut runs: Vec<RunStatus> = paths.iter().rev().filter_map(|p| status_of(p)).take(last).collect();
    runs.reverse();
    Ok(runs)
}

/// How one run stands; `None` for a folder that is no run.
pub fn status_of(path: &Path) -> Option<RunStatus> {
    let dir = RunDir::open(path).ok()?;
    let (summary, events) = dir.with(|j| Ok((j.summary()?, j.events()?))).ok()?;
    let mut safe: BTreeMap<String, bool> = BTreeMap::new();
    let mut ending = None;
    // A run that was gone on with has more than one end: the last begin counts.
    for event in events.iter().filter_map(|e| serde_json::from_str::<Event>(&e.json).ok()) {
        match event {
            Event::RunStarted { .. } => {
                safe.clear();
                ending = None;
            }
            Event::SafeState { device, outcome, .. } => {
                safe.insert(device, outcome == SafeResult::Confirmed);
            }
            Event::RunEnded { ending: how, .. } => ending = Some(format!("{how:?}").to_lowercase()),
            _ => {}
        }
    }
    Some(RunStatus {
        run: path.to_owned(),
        safe: ending.is_some() && !safe.is_empty() && safe.values().all(|s| *s),
        state: ending.unwrap_or_else(|| OPEN.to_owned()),
        stored: summary.stored,
        missing: summary.missing,
        planned: summary.planned,
        rejected: summary.rejected,
        bytes: summary.bytes,
        last_event: events.last().map(|e| format!("{} {}", stamp(UtcMicros(e.utc_us)), e.kind)),
    })
}
