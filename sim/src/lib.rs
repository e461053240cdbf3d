//! goniod-sim: the bench in software. Optics of its own (never the engine's), firmware twins that answer the devices'
//! bytes, cameras that photograph the true state and paint it into reserved rows, an oracle that reads it back.

pub mod gige;
pub mod pose;
