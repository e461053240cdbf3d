//! Fronts: what carries a twin's bytes to a driver.

pub mod pipe;

pub use pipe::{PipeConnector, PipePort};
