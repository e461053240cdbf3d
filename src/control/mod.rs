//! What happens in the night: plan, sequencer, devices, frames.

pub mod devices;
pub mod events;
pub mod frames;
pub mod lamp_hours;
pub mod plan;
pub mod sequencer;
