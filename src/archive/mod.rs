//! The run directory: the only code that writes run files.
//!
//! ```text
//! <runs>/<run-id>/
//!   plan.toml         everything resolved                       written once, digest in the journal
//!   calibration/ ...  files copied in, so that a run stands alone   (the same)
//!   frames.zarr/      Zarr v3: a group, one array a camera; one chunk = one frame = one immutable file
//!   journal.sqlite    steps, frames, events; the row of a frame is committed after its file is in place
//!   journal.seal      digests over the closed journal
//!   journal.base      digest of journal.sqlite while the run is open; journal.head: how far its log is committed
//!   journal.ballast   room for the last records of a full disk; only while the run is open
//!   products/         can always be made again
//! ```
//!
//! - [`rundir`]: makes, opens and closes a run directory
//! - [`frames`]: the frame store
//! - [`journal`]: steps, frames and events in SQLite; [`rows`]: what its rows mean
//! - [`layout`]: the shape of a run: arrays and steps
//! - `marks`: what covers the bits of a journal that is open, `wal`: how far its log is whole
//! - [`seal`]: digests over the closed journal and the products
//! - [`verify`]: proves a run whole; [`mend`]: makes good what can be before a run is gone on with
//! - [`disk`]: the one door to the file system; the atomic write
//! - [`space`]: room proven before the start, ballast for the end
//! - [`error`]: what can go wrong, in the words of the person who must act

pub mod disk;
pub mod error;
pub mod frames;
pub mod journal;
pub mod layout;
mod marks;
pub mod mend;
pub mod rows;
pub mod rundir;
pub mod seal;
pub mod space;
pub mod verify;
mod wal;

pub use disk::write_atomic;
pub use error::{ArchiveError, Result};
pub use layout::{ArrayLayout, RunLayout, StepLayout};
pub use rundir::{NewRun, RunDir};
