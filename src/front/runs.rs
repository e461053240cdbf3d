//! What the runs of a folder are doing or how they ended, read from their journals.

use super::night::stamp;
use crate::archive::rundir::{JOURNAL, PLAN};
use crate::archive::{ArchiveError, RunDir};
use crate::control::devices::safe::SafeResult;
use crate::control::events::Event;
use goniod_drivers::clock::UtcMicros;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// State of a run whose end no journal tells: under way or cut short.
const OPEN: &str = "open";
/// State of a run whose journal cannot be read: nothing of it is known.
const UNREADABLE: &str = "unreadable";

/// How a run stands.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunStatus {
    /// The run directory.
    pub run: PathBuf,
    /// `open` (under way or cut short), `unreadable` (its numbers are then not known), or how it ended.
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
    /// Why it cannot be read; absent where it can.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

// === impl RunStatus ===

impl RunStatus {
    /// Every exposure is stored or listed as missing, and the run was ended.
    pub fn is_finished(&self) -> bool {
        self.planned == 0 && self.state != OPEN && self.state != UNREADABLE
    }
}

/// The latest runs of a folder by name, the newest last; those that cannot be read are told with the reason.
///
/// # Errors
/// Those of listing the folder.
pub fn latest(runs_dir: &Path, last: usize) -> std::io::Result<Vec<RunStatus>> {
    let mut paths: Vec<PathBuf> = std::fs::read_dir(runs_dir)?.flatten().map(|e| e.path()).collect();
    paths.sort();
    let mut runs: Vec<RunStatus> = paths.iter().rev().filter_map(|p| told(p)).take(last).collect();
    runs.reverse();
    Ok(runs)
}

/// How one run stands; `None` for a folder that is no run, or a run that cannot be read.
pub fn status_of(path: &Path) -> Option<RunStatus> {
    read(path).ok()
}

/// The same, where a run that cannot be read is told as such; `None` for a folder that is no run.
fn told(path: &Path) -> Option<RunStatus> {
    // A run that is being made is hidden.
    let hidden = path.file_name().is_none_or(|name| name.to_string_lossy().starts_with('.'));
    let is_run = !hidden && [JOURNAL, PLAN].iter().any(|name| path.join(name).is_file());
    let unreadable = |e: ArchiveError| RunStatus {
        run: path.to_owned(),
        state: UNREADABLE.to_owned(),
        stored: 0,
        missing: 0,
        planned: 0,
        rejected: 0,
        bytes: 0,
        safe: false,
        last_event: None,
        reason: Some(e.to_string()),
    };
    read(path).map_or_else(|e| is_run.then(|| unreadable(e)), Some)
}

fn read(path: &Path) -> Result<RunStatus, ArchiveError> {
    let (summary, events) = RunDir::open(path)?.with(|j| Ok((j.summary()?, j.events()?)))?;
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
    Ok(RunStatus {
        run: path.to_owned(),
        safe: ending.is_some() && !safe.is_empty() && safe.values().all(|s| *s),
        state: ending.unwrap_or_else(|| OPEN.to_owned()),
        stored: summary.stored,
        missing: summary.missing,
        planned: summary.planned,
        rejected: summary.rejected,
        bytes: summary.bytes,
        last_event: events.last().map(|e| format!("{} {}", stamp(UtcMicros(e.utc_us)), e.kind)),
        reason: None,
    })
}
