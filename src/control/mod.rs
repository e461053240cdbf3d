//! What happens in the night: plan, sequencer, devices, frames.

pub mod plan;
