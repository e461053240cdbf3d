//! What people touch: the command line, the bench it opens for a run, and the oracle that judges a simulated one.

pub mod bench;
pub mod cli;
pub mod night;
#[cfg(feature = "sim")]
pub mod oracle;
pub mod resume;
