//! What can go wrong between a run and its products.

use crate::archive::ArchiveError;
use crate::engine::error::EngineError;
use std::path::PathBuf;
use thiserror::Error;

/// An error of making products.
#[derive(Debug, Error)]
pub enum ProductError {
    /// The run directory.
    #[error(transparent)]
    Archive(#[from] ArchiveError),
    /// The mathematics refuse the input.
    #[error("{what}: {source}")]
    Engine {
        /// What was being computed.
        what: String,
        /// What the engine says.
        source: EngineError,
    },
    /// `plan.toml` of a run is not what this version writes.
    #[error("{path}: the run's plan cannot be read ({message}); `goniod verify` tells whether it is damaged")]
    Plan {
        /// The file.
        path: PathBuf,
        /// What the reader said.
        message: String,
    },
    /// A file that the run should have kept.
    #[error("{run}: its copy of `{role}` {message}; `goniod verify` tells whether the run is damaged")]
    Input {
        /// The run directory.
        run: PathBuf,
        /// Role of the file.
        role: String,
        /// What is wrong.
        message: String,
    },
    /// There is nothing to make the product from.
    #[error("{0}")]
    Nothing(String),
}

/// Result of making products.
pub type Result<T> = std::result::Result<T, ProductError>;

/// Puts words to an engine error.
pub(crate) fn engine(what: impl Into<String>) -> impl FnOnce(EngineError) -> ProductError {
    let what = what.into();
    move |source| ProductError::Engine { what, source }
}
