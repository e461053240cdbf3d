//! What people touch: the command line, the daemon with its API, the bench they open for a run, and the oracle that
//! judges a simulated one.

pub mod api;
pub mod bands;
pub mod bench;
pub mod cli;
pub mod daemon;
pub mod lamp;
pub mod night;
#[cfg(feature = "sim")]
pub mod oracle;
pub mod remaining;
pub mod resume;
pub mod runs;
