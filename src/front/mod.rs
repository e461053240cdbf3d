//! What people touch: the command line, and the bench it opens for a run.

pub mod bench;
pub mod cli;
pub mod night;
pub mod resume;
