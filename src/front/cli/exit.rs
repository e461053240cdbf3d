//! Exit codes, named: scripts may rely on them (`docs/cli.md` has the same table).

use std::process::ExitCode;

/// How a command ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exit {
    /// Done, and everything is well.
    Done,
    /// An error that none of the other codes names.
    Failed,
    /// The command line itself is wrong (clap uses the same code).
    Usage,
    /// A scan, instrument or calibration file is wrong; nothing was started.
    BadInput,
    /// The run ended, but frames are missing; the journal lists them with reasons.
    Incomplete,
    /// A device is not there, is another one, or broke; the bench was made safe.
    Device,
    /// Run directory or products cannot be written or read.
    Storage,
    /// The operator stopped or aborted the run; it ended safely.
    Stopped,
    /// `verify` found damage.
    Damaged,
    /// The daemon does not run.
    NoDaemon,
    /// What was asked cannot be done now: the instrument is in use, the run is in another state.
    Refused,
}

// === impl Exit ===

impl Exit {
    /// All codes in order.
    pub const ALL: [Exit; 11] = [
        Exit::Done,
        Exit::Failed,
        Exit::Usage,
        Exit::BadInput,
        Exit::Incomplete,
        Exit::Device,
        Exit::Storage,
        Exit::Stopped,
        Exit::Damaged,
        Exit::NoDaemon,
        Exit::Refused,
    ];

    /// The number given to the shell.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// The name used in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Exit::Done => "done",
            Exit::Failed => "failed",
            Exit::Usage => "usage",
            Exit::BadInput => "bad-input",
            Exit::Incomplete => "incomplete",
            Exit::Device => "device",
            Exit::Storage => "storage",
            Exit::Stopped => "stopped",
            Exit::Damaged => "damaged",
            Exit::NoDaemon => "no-daemon",
            Exit::Refused => "refused",
        }
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> ExitCode {
        ExitCode::from(exit.code())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_what_the_documentation_promises() {
        let table = include_str!("../../../docs/cli.md");
        for exit in Exit::ALL {
            assert!(table.contains(&format!("| {} | `{}` |", exit.code(), exit.name())), "{exit:?} not in docs/cli.md");
        }
    }
}
