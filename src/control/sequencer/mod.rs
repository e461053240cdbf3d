//! Carries a plan out: states, recovery, recording, the safe end.
//!
//! - [`state`]: the states and the total transition function                       pure
//! - [`recovery`]: from a device's error to what is done about it                   pure
//! - [`layout`]: the run directory's shape for a plan                               pure
//! - [`recorder`]: frames and events on their ordered way to the disk
//! - [`verbs`]: what an operator or a signal may ask for
//! - [`run`]: the night; [`step`]: one exposure of it

pub mod layout;
pub mod recorder;
pub mod recovery;
pub mod run;
pub mod state;
mod step;
pub mod verbs;

#[cfg(test)]
mod fakes;
#[cfg(test)]
mod tests;

pub use run::{Job, Outcome, run};
