//! What people write: instrument, scan and calibration files become checked values; errors point at file, line and column.

pub mod calibration;
pub mod instrument;
pub mod scan;
