//! Fault plans: what may go wrong on a bench, drawn from a seed, carried out in simulated time, counted when it really
//! happens.
//!
//! - [`catalogue`]: every kind of fault, and which of them pass by themselves
//! - [`schedule`]: which faults a night gets, and when
//! - [`inject`]: lets them happen on the twins and cameras, and asks for those around the bench

pub mod catalogue;
pub mod inject;
pub mod schedule;

pub use catalogue::Kind;
pub use inject::{Around, Counts, Targets, Wish, carry_out};
pub use schedule::{Mix, Schedule};
