//! From digital levels to relative exposure rates: response, level tables, dark, bracket merge.

pub mod agreement;
pub mod dark;
#[cfg(test)]
mod format_tests;
pub mod levels;
pub mod merge;
pub mod response;
pub mod sums;
