//! The drivers, one file or folder each.

#[cfg(feature = "v4l2")]
pub mod v4l2;
