//! The rows of the journal as values.

use super::layout::StepLayout;
use serde::{Deserialize, Serialize};

/// What became of a planned exposure.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StepState {
    /// Not done yet.
    Planned,
    /// Its frame is in the store and was journalled.
    Stored,
    /// It could not be had, for this reason.
    Missing(String),
}

/// One planned exposure with its state.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StepRow {
    /// Where its frame goes.
    pub layout: StepLayout,
    /// What became of it.
    pub state: StepState,
}

/// A stored frame.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameRow {
    /// Step it was taken for.
    pub step: u32,
    /// SHA-256 of the chunk file, hexadecimal.
    pub digest: String,
    /// Size of the chunk file.
    pub bytes: u64,
    /// Start of the exposure, UTC microseconds since 1970.
    pub utc_us: i64,
    /// The camera's own frame counter.
    pub device_frame_id: u64,
    /// Integration time as read back, microseconds.
    pub exposure_us: u64,
    /// Serial number of the camera.
    pub camera_serial: String,
    /// Attempts it took, at least 1.
    pub attempts: u32,
    /// Frames rejected on the way.
    pub rejected: u32,
}

/// One event, as the journal keeps it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EventRow {
    /// Sequence number, rising through the run and its continuations.
    pub seq: u64,
    /// When, UTC microseconds since 1970.
    pub utc_us: i64,
    /// Its kind, in the words of the event type.
    pub kind: String,
    /// The whole event.
    pub json: String,
}

/// A file that was copied into the run when it was made.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileRow {
    /// Path relative to the run directory, with `/`.
    pub path: String,
    /// SHA-256, hexadecimal.
    pub digest: String,
}

/// How far a run is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Summary {
    /// Planned exposures not done yet.
    pub planned: u32,
    /// Exposures stored.
    pub stored: u32,
    /// Exposures listed as missing.
    pub missing: u32,
    /// Frames rejected on the way to the stored ones.
    pub rejected: u32,
    /// Bytes of the stored chunks.
    pub bytes: u64,
}
