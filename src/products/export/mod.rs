//! Exports, one file a format; each checks what it is given before it writes a byte.
//!
//! measured columns -> [`matrix`] (145 x 145 with the origin of each column) -> [`klems_blocks`] (four directions, none
//! empty) -> [`klems_xml`]; [`klems_read`] reads it back. [`hdf5_nexus`] holds everything, uncertainty included.

pub mod hdf5_nexus;
pub mod klems_blocks;
pub mod klems_read;
pub mod klems_xml;
pub mod matrix;

use thiserror::Error;

/// Why an export was not written, or a file not read.
#[derive(Debug, Error)]
pub enum ExportError {
    /// The values cannot be told in the format.
    #[error("{format}: {what}; {advice}")]
    Unfit {
        /// The format.
        format: &'static str,
        /// What is wrong and where.
        what: String,
        /// What to do.
        advice: &'static str,
    },
    /// A file that is read is not what it should be.
    #[error("BSDF file: {0}")]
    Malformed(String),
    /// The file system refused.
    #[error("cannot write {path}: {source}; check that the folder exists, is writable and has room")]
    Io {
        /// The file.
        path: std::path::PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The archive's atomic write refused.
    #[error(transparent)]
    Archive(#[from] crate::archive::ArchiveError),
    /// The HDF5 library refused.
    #[error("cannot write HDF5 file {path}: {source}")]
    Hdf5 {
        /// The file.
        path: std::path::PathBuf,
        /// What the library said.
        source: hdf5::Error,
    },
}
