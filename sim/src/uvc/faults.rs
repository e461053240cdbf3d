//! What can be made to go wrong with the camera, and its own record of what it really did.

use super::controls::Settings;
use tokio::time::Instant;

/// Faults in force. All off by default; changed while the camera runs.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Faults {
    /// Frames after a change of a control that are still taken with the old value.
    pub latency_frames: u32,
    /// The frame in which the integration time changes is half old, half new.
    pub half_changed: bool,
    /// Frames of 1,000 in whose place the exposure before comes (again).
    pub stale_per_1000: u32,
    /// Frames of 1,000 in whose place the picture sent last comes once more.
    pub repeated_per_1000: u32,
    /// Frames of 1,000 that end in mid-picture.
    pub short_per_1000: u32,
    /// Frames of 1,000 in one of whose payloads the error bit is set.
    pub error_per_1000: u32,
    /// Frames of 1,000 of which only the header comes.
    pub dropped_per_1000: u32,
    /// Hangs: neither pictures nor answers.
    pub frozen: bool,
    /// Sends no pictures, but answers.
    pub mute: bool,
}

/// What was wrong with a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum FrameFault {
    /// The exposure before.
    Stale,
    /// The picture sent last.
    Repeated,
    /// Ends in mid-picture.
    Short,
    /// Error bit in a payload.
    ErrorBit,
    /// Only its header was sent.
    Dropped,
    /// The host had not taken an earlier picture, so only its header was sent.
    Overrun,
    /// Upper half old integration time, lower half new.
    HalfChanged,
}

/// What the camera really did for one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// Count of frames sent since power-up, from 1.
    pub sequence: u64,
    /// Exposure that the picture shows.
    pub frame_number: u64,
    /// When the exposure that the picture shows began.
    pub started: Instant,
    /// What the picture was taken with.
    pub settings: Settings,
    /// What was commanded when the exposure began.
    pub commanded: Settings,
    /// What was wrong.
    pub fault: Option<FrameFault>,
}
