//! What every driver must do, whatever it drives: checks that speak only to the contract's traits.
//!
//! The safe part ([`check`]) is for a twin and for the real device alike: it opens, asks, refuses, moves a little, comes
//! back and makes safe. What needs a hand on the wire stands beside the twins, which have one. A check that does not
//! apply is [`Verdict::NotApplicable`] with its reason, never a silent pass.

pub mod facts;
mod safe;
mod subject;

pub use safe::{PATIENCE, check};
pub use subject::{Subject, Value};

use serde::Serialize;

/// A check by name, with what it promises.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Check {
    /// Its name in reports, stable.
    pub name: &'static str,
    /// What holds when it passes.
    pub promise: &'static str,
}

/// How a check ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "verdict", content = "note", rename_all = "kebab-case")]
pub enum Verdict {
    /// It holds; what was seen.
    Passed(String),
    /// It does not apply, and why.
    NotApplicable(String),
    /// It does not hold, and where.
    Failed(String),
}

/// One check's end.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// The check.
    #[serde(flatten)]
    pub check: Check,
    /// How it ended.
    #[serde(flatten)]
    pub verdict: Verdict,
}

/// The safe checks, in their order.
pub const SAFE: [Check; 8] = [IDENTITY, HEALTH, LIMITS, REFUSALS, STATE, COMMANDS, DROPPED, SAFE_STATE];

/// It says who it is.
pub const IDENTITY: Check =
    Check { name: "identity", promise: "opens, names itself, and is the same when opened again" };
/// It says how it is.
pub const HEALTH: Check = Check { name: "health", promise: "answers a harmless question, twice" };
/// Its limits make sense.
pub const LIMITS: Check = Check { name: "limits", promise: "tells limits that are ordered and finite" };
/// It refuses what is outside.
pub const REFUSALS: Check =
    Check { name: "refusals", promise: "refuses every order outside its limits and stays as it was" };
/// It says where it stands.
pub const STATE: Check = Check { name: "state", promise: "says where it stands, or that it does not know" };
/// It does what it is told.
pub const COMMANDS: Check = Check {
    name: "commands",
    promise: "carries every order of its contract out, says the same when asked, and comes back",
};
/// A call that is dropped leaves nothing behind.
pub const DROPPED: Check =
    Check { name: "dropped calls", promise: "a call given up on its way leaves nothing behind for the next" };
/// It can be made safe.
pub const SAFE_STATE: Check =
    Check { name: "safe state", promise: "is brought into its safe state, and answers afterwards" };

// === impl Verdict ===

impl Verdict {
    /// The verdict of a check that gives what it saw, or where it failed.
    pub fn of(result: Result<String, String>) -> Verdict {
        result.map_or_else(Verdict::Failed, Verdict::Passed)
    }

    /// True for a failure.
    pub fn failed(&self) -> bool {
        matches!(self, Verdict::Failed(_))
    }

    /// What was seen, why not, or where it failed.
    pub fn note(&self) -> &str {
        match self {
            Verdict::Passed(note) | Verdict::NotApplicable(note) | Verdict::Failed(note) => note,
        }
    }
}
