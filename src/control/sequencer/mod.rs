//! Carries a plan out: states, recovery, recording, the safe end.
//!
//! - [`state`]: the states and the total transition function                       pure
//! - [`recovery`]: from a device's error to what is done about it                   pure
//! - [`interlocks`]: from readings with their ages to warnings and alarms           pure
//! - [`light`]: what the light monitor's readings say of the lamp                  pure
//! - [`layout`]: the run directory's shape for a plan                               pure
//! - [`recorder`]: frames and events on their ordered way to the disk
//! - [`verbs`]: what an operator or a signal may ask for, and what each state answers
//! - [`stage`]: the state, told to whoever watches
//! - [`run`]: the night; [`step`]: one exposure of it, [`memory`]: what outlives it; [`watch`]: reads the gauges

mod hours;
pub mod interlocks;
pub mod layout;
pub mod light;
mod memory;
pub mod recorder;
pub mod recovery;
pub mod run;
pub mod stage;
pub mod state;
mod step;
pub mod verbs;
mod watch;

#[cfg(test)]
mod disk_tests;
#[cfg(test)]
mod edge_tests;
#[cfg(test)]
mod fakes;
#[cfg(test)]
mod lamp_tests;
#[cfg(test)]
mod operator_tests;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod trouble_tests;

pub use run::{Job, Outcome, run};
