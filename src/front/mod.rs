//! What people touch: the command line, the daemon with its API, and the bench they open for a run.

pub mod api;
pub mod bench;
pub mod cli;
pub mod daemon;
pub mod night;
pub mod remaining;
pub mod resume;
pub mod runs;
