//! One entry of the queue: what is to be measured, and what became of it. Kept as `entry.json`.

use crate::control::plan::document::KeptFile;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// One entry. Its number is its place in the queue and its name in the API.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// Number, rising; never used twice.
    pub id: u32,
    /// When it was put into the queue, RFC 3339 in UTC.
    pub added: String,
    /// What is to be done.
    pub work: Work,
    /// What became of it.
    pub state: EntryState,
    /// Its run directory was made.
    #[serde(default)]
    pub begun: bool,
    /// What became of the products of its run.
    pub products: Products,
}

/// What an entry asks for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Work {
    /// A scan, as it was when it was put into the queue.
    Scan(Box<QueuedScan>),
    /// Going on with a run that was cut short.
    Resume {
        /// The run.
        run: String,
    },
}

/// A checked scan with the digests of everything it was checked with; the files themselves lie beside the entry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QueuedScan {
    /// Name of the scan.
    pub name: String,
    /// The scan file, absolute, as it was named.
    pub scan: PathBuf,
    /// The instrument file, absolute.
    pub instrument: PathBuf,
    /// Digest of the plan.
    pub plan_hash: String,
    /// Exposures of the plan.
    pub exposures: u32,
    /// Forecast of the run, seconds.
    pub forecast_s: f64,
    /// Every file that was read.
    pub files: Vec<KeptFile>,
    /// What a simulated bench is made of. It is the bench itself, not configuration, and is read where it lies.
    pub simulated: Option<SimulatedBench>,
}

/// The simulated bench and what lies in it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatedBench {
    /// Description of the bench, absolute.
    pub bench: PathBuf,
    /// Its sample, absolute.
    pub sample: Option<PathBuf>,
}

/// What became of an entry.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "state", rename_all = "kebab-case")]
pub enum EntryState {
    /// Its turn will come.
    Waiting,
    /// Under way, or cut short and not yet gone on with.
    Running {
        /// The run; its directory may not be there yet.
        run: String,
    },
    /// Its run ended.
    Done {
        /// The run.
        run: String,
        /// How it ended, and how many exposures are missing.
        outcome: Ended,
    },
    /// It could not be carried out.
    Failed {
        /// The run, where there is one.
        run: Option<String>,
        /// Why, and what to do.
        reason: String,
    },
    /// Taken out of the queue before its turn.
    Cancelled,
}

/// How the run of an entry ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ended {
    /// `completed`, `stopped`, `aborted`, ….
    pub ending: String,
    /// Exposures stored.
    pub stored: u32,
    /// Exposures listed as missing.
    pub missing: u32,
    /// Exposures left as planned.
    pub planned: u32,
    /// True when every device proved its safe state.
    pub safe: bool,
    /// What the operator must know, where there is something.
    pub message: Option<String>,
}

/// What became of the products of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "state", rename_all = "kebab-case")]
pub enum Products {
    /// None are due.
    None,
    /// To be made, or being made.
    Pending,
    /// Made.
    Made {
        /// T and R in a few lines.
        headline: Vec<String>,
        /// The files.
        files: Vec<PathBuf>,
        /// What the frames could not give, each with the reason.
        not_made: Vec<String>,
    },
    /// They could not be made.
    Failed {
        /// Why, and what to do.
        reason: String,
    },
}

// === impl Entry ===

impl Entry {
    /// Name of the scan, or the run that is gone on with.
    pub fn name(&self) -> &str {
        match &self.work {
            Work::Scan(scan) => &scan.name,
            Work::Resume { run } => run,
        }
    }

    /// The entry's run, where it has one.
    pub fn run(&self) -> Option<&str> {
        match &self.state {
            EntryState::Running { run } | EntryState::Done { run, .. } => Some(run),
            EntryState::Failed { run, .. } => run.as_deref(),
            EntryState::Waiting | EntryState::Cancelled => None,
        }
    }

    /// True when nothing more happens to it but products.
    pub fn is_over(&self) -> bool {
        !matches!(self.state, EntryState::Waiting | EntryState::Running { .. })
    }
}

// === impl EntryState ===

impl EntryState {
    /// One word.
    pub fn name(&self) -> &'static str {
        match self {
            EntryState::Waiting => "waiting",
            EntryState::Running { .. } => "running",
            EntryState::Done { .. } => "done",
            EntryState::Failed { .. } => "failed",
            EntryState::Cancelled => "cancelled",
        }
    }
}
