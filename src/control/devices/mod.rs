//! The bench as the sequencer uses it: devices by name, poses proven, the safe state reached whatever fails.

pub mod bench;
pub mod pose;
pub mod safe;
