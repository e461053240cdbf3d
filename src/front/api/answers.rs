//! The documents of the API. Adding a field is allowed, changing or removing one is another version of the API.

use crate::front::daemon::entry::{Ended, Entry, EntryState, Products, Work};
use crate::front::daemon::hub::Told;
use crate::front::runs::RunStatus;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// `GET /v1/status`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Version of the program.
    pub version: String,
    /// Process of the daemon.
    pub pid: u32,
    /// Name of the instrument.
    pub instrument: String,
    /// Folder of the run directories.
    pub runs_dir: PathBuf,
    /// Now, by the daemon's clock, RFC 3339.
    pub now: String,
    /// Why no entry of the queue is begun, where something holds it.
    pub held: Option<String>,
    /// True when the daemon was asked to end.
    pub stopping: bool,
    /// The run under way.
    pub run: Option<RunNow>,
    /// Entries that wait.
    pub waiting: usize,
    /// Folders of the queue that cannot be read.
    pub bad_entries: usize,
    /// The latest result.
    pub headline: Option<Headline>,
    /// The last events that journals keep, frames left out; the newest last.
    pub last_events: Vec<Told>,
    /// Clients that listen to events.
    pub listeners: usize,
    /// Events that slow listeners lost.
    pub lost_events: u64,
}

/// The run under way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunNow {
    /// Entry of the queue.
    pub entry: u32,
    /// The run.
    pub run: String,
    /// Name of the scan.
    pub scan: String,
    /// What the sequencer is doing, one word.
    pub state: String,
    /// The same with its particulars.
    pub detail: serde_json::Value,
    /// Exposures of the plan.
    pub exposures: u32,
    /// Stored.
    pub stored: u32,
    /// Listed as missing.
    pub missing: u32,
    /// When it began or went on, RFC 3339.
    pub begun: String,
    /// Forecast of what is left, seconds.
    pub left_s: f64,
    /// What the lamp does, and when it may be struck, while the run waits for it.
    #[serde(default)]
    pub lamp: Option<String>,
    /// Forecast of the end, RFC 3339.
    pub done_at: String,
}

/// T and R of the latest run with products.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Headline {
    /// The run.
    pub run: String,
    /// A few lines.
    pub lines: Vec<String>,
}

/// `GET /v1/queue`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct QueueList {
    /// Why no entry is begun, where something holds the queue.
    pub held: Option<String>,
    /// All entries in their order, those that are over too.
    pub entries: Vec<EntryNow>,
    /// Folders of the queue that cannot be read.
    pub bad: Vec<Bad>,
}

/// A folder of the queue that cannot be read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bad {
    /// The folder.
    pub path: PathBuf,
    /// What is wrong.
    pub reason: String,
}

/// One entry of the queue.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EntryNow {
    /// Its number.
    pub id: u32,
    /// `waiting`, `running`, `done`, `failed`, `cancelled`.
    pub state: String,
    /// Name of the scan, or the run that is gone on with.
    pub name: String,
    /// When it was put into the queue, RFC 3339.
    pub added: String,
    /// The scan file it was made from; absent for a run that is gone on with.
    pub scan: Option<PathBuf>,
    /// Exposures of the plan.
    pub exposures: Option<u32>,
    /// Forecast, seconds.
    pub forecast_s: Option<f64>,
    /// Its run, once it has one.
    pub run: Option<String>,
    /// How the run ended.
    pub outcome: Option<Ended>,
    /// Why it failed.
    pub reason: Option<String>,
    /// What became of the products.
    pub products: Products,
}

/// `POST /v1/queue`: a scan, or a run to go on with.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewEntry {
    /// Absolute path of a scan file that the daemon can read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scan: Option<PathBuf>,
    /// Name of a run that was cut short.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resume: Option<String>,
}

/// `POST /v1/queue`: what was put into the queue.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Added {
    /// The entry.
    pub entry: EntryNow,
    /// Entries before it.
    pub before: usize,
    /// Why no entry is begun, where something holds the queue.
    pub held: Option<String>,
    /// What somebody should know, none of it an error.
    pub warnings: Vec<String>,
}

/// `POST /v1/verbs/{verb}`: the request is with the run, or was carried out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Accepted {
    /// The verb.
    pub verb: String,
    /// The run it was given to; absent when the queue itself was meant.
    pub run: Option<String>,
    /// What happens now.
    pub message: String,
}

/// `GET /v1/runs`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunList {
    /// Folder of the run directories.
    pub runs_dir: PathBuf,
    /// The latest runs by name, the newest last.
    pub runs: Vec<RunStatus>,
}

/// `GET /v1/runs/{id}`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunTold {
    /// How it stands.
    pub status: RunStatus,
    /// Name of the scan.
    pub scan: String,
    /// When it was made, RFC 3339.
    pub started: String,
    /// Digest of the plan.
    pub plan_hash: String,
    /// Exposures that are listed as missing, at most 1000.
    pub missing: Vec<Missing>,
    /// Files of its products, inside the run directory.
    pub products: Vec<PathBuf>,
}

/// An exposure that could not be had.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Missing {
    /// Step of the plan.
    pub step: u32,
    /// View of the plan.
    pub view: u32,
    /// Why.
    pub reason: String,
}

// === impl EntryNow ===

impl EntryNow {
    /// What the API tells of an entry.
    pub fn of(entry: &Entry) -> EntryNow {
        let scan = match &entry.work {
            Work::Scan(scan) => Some(scan),
            Work::Resume { .. } => None,
        };
        let (outcome, reason) = match &entry.state {
            EntryState::Done { outcome, .. } => (Some(outcome.clone()), None),
            EntryState::Failed { reason, .. } => (None, Some(reason.clone())),
            _ => (None, None),
        };
        EntryNow {
            id: entry.id,
            state: entry.state.name().to_owned(),
            name: entry.name().to_owned(),
            added: entry.added.clone(),
            scan: scan.map(|s| s.scan.clone()),
            exposures: scan.map(|s| s.exposures),
            forecast_s: scan.map(|s| s.forecast_s),
            run: entry.run().map(str::to_owned),
            outcome,
            reason,
            products: entry.products.clone(),
        }
    }
}
