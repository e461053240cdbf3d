//! What can be wrong with the files that describe the bench and its samples.

use std::path::{Path, PathBuf};
use thiserror::Error;

/// An error of the simulated bench's description.
#[derive(Debug, Error)]
pub enum SimError {
    /// The file cannot be opened or read.
    #[error("{path}: cannot be read ({source}); check the path, it is taken relative to the file that names it")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is read but is not what it should be.
    #[error("{path}: {message}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong, where, and what is allowed.
        message: String,
    },
    /// A caller asks for something the bench does not have.
    #[error("the simulated bench has no {what} `{name}`; it has {known}")]
    Unknown {
        /// Kind of thing.
        what: &'static str,
        /// Its name as asked.
        name: String,
        /// What there is.
        known: String,
    },
}

/// Result of reading the bench.
pub type Result<T> = std::result::Result<T, SimError>;

// === impl SimError ===

impl SimError {
    /// A format error of `path`.
    pub fn format(path: &Path, message: impl Into<String>) -> SimError {
        SimError::Format { path: path.to_owned(), message: message.into() }
    }
}

/// The text of `path`.
pub fn read_text(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).map_err(|source| SimError::Read { path: path.to_owned(), source })
}

/// `path` taken relative to the folder of `file`.
pub fn beside(file: &Path, path: &Path) -> PathBuf {
    file.parent().map_or_else(|| path.to_owned(), |folder| folder.join(path))
}
