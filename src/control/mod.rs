//! What happens in the night: plan, sequencer, devices, frames.

pub mod devices;
pub mod events;
pub mod frames;
pub mod plan;
pub mod sequencer;
