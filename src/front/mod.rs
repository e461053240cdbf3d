//! What people touch: the command line.

pub mod cli;
