//! What people write: instrument, scan and calibration files become checked values; errors point at file, line and column.
//!
//! [`load`] reads one file and compares its keys with the structs; [`check`] reads a scan with its instrument,
//! calibrations and spectra and compares everything with everything. [`incidence`] and [`pose`] say what the numbers
//! mean: which directions, which integration times, which axis angles.

pub mod calibration;
pub mod check;
pub mod curves;
pub mod daemon;
#[cfg(test)]
mod docs;
pub mod error;
mod hint;
pub mod incidence;
pub mod instrument;
pub mod load;
pub mod night;
pub mod pose;
pub mod scan;
pub mod schema;
pub mod source;
#[cfg(test)]
pub mod testing;
