//! What can go wrong with queue, locks and sockets, in the words of the person who must act.

use crate::archive::ArchiveError;
use crate::config::error::ConfigError;
use std::path::PathBuf;
use thiserror::Error;

/// Why the daemon cannot do what was asked.
#[derive(Debug, Error)]
pub enum DaemonError {
    /// The scan or its instrument is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The scan cannot be planned.
    #[error("{0}")]
    Plan(String),
    /// The state folder cannot be written.
    #[error(transparent)]
    Archive(#[from] ArchiveError),
    /// The state folder cannot be read.
    #[error("{path}: {source}; check the rights of the state folder", path = .path.display())]
    Io {
        /// What was touched.
        path: PathBuf,
        /// The operating system's words.
        source: std::io::Error,
    },
    /// No such entry.
    #[error("the queue has no entry {0}; `goniod queue list` tells which there are")]
    NoEntry(u32),
    /// The entry is not one that can be taken out.
    #[error("entry {id} is {state}; only a waiting entry can be taken out{hint}")]
    NotWaiting {
        /// The entry.
        id: u32,
        /// What it is.
        state: &'static str,
        /// What to do instead; may be empty.
        hint: &'static str,
    },
    /// Too many entries wait.
    #[error("{0} entries wait already, more are not taken; remove some, or wait until one is done")]
    Full(usize),
    /// The largest number is taken, by a folder that somebody else made.
    #[error(
        "the queue has no number after {0}; move the folder of that entry out of the queue and start the daemon again"
    )]
    NumbersEnd(u32),
    /// The copies of a scan are not what was queued.
    #[error("the copy of the scan cannot be used: {why}; put the scan into the queue again")]
    Snapshot {
        /// What is wrong.
        why: String,
    },
    /// Somebody else has the instrument or the state folder.
    #[error("{what} is in use by {holder}; {hint}")]
    InUse {
        /// Instrument, port or state folder.
        what: String,
        /// Process and run.
        holder: String,
        /// What to do.
        hint: &'static str,
    },
    /// A lock cannot be had for another reason.
    #[error("{path}: the lock cannot be taken: {source}; check the rights of the file and its folder", path = .path.display())]
    Lock {
        /// The lock file.
        path: PathBuf,
        /// The operating system's words.
        source: std::io::Error,
    },
    /// The socket cannot be made.
    #[error("{path}: the socket cannot be made: {why}", path = .path.display())]
    Socket {
        /// The socket.
        path: PathBuf,
        /// Why, and what to do.
        why: String,
    },
}
