//! From digital levels to relative exposure rates: response, level tables, dark, bracket merge.

pub mod dark;
pub mod levels;
pub mod merge;
pub mod response;
