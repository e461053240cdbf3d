//! The drivers, one file (or one folder) each.

#[cfg(feature = "aravis")]
pub mod aravis;
