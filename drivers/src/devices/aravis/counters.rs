//! What a camera's link has counted since the driver was made.

use std::sync::atomic::{AtomicU64, Ordering};

/// Counts, kept by the owner thread and read from anywhere.
#[derive(Debug, Default)]
pub struct Counters {
    /// Frames that came whole.
    pub complete: AtomicU64,
    /// Frames that came incomplete; their pixels were thrown away.
    pub incomplete: AtomicU64,
    /// Frames thrown away because they were taken before an `arm`.
    pub drained: AtomicU64,
    /// Packets asked for again.
    pub resent_packets: AtomicU64,
    /// Packets that never came.
    pub missing_packets: AtomicU64,
    /// Frames the library had no buffer for.
    pub underruns: AtomicU64,
    /// Times the camera was opened.
    pub opened: AtomicU64,
}

/// The counts at one moment.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Frames that came whole.
    pub complete: u64,
    /// Frames that came incomplete and were not used.
    pub incomplete: u64,
    /// Frames thrown away because they were taken before an `arm`.
    pub drained: u64,
    /// Packets asked for again.
    pub resent_packets: u64,
    /// Packets that never came.
    pub missing_packets: u64,
    /// Frames the library had no buffer for.
    pub underruns: u64,
    /// Times the camera was opened.
    pub opened: u64,
}

/// Adds one.
pub fn tick(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}

// === impl Counters ===

impl Counters {
    /// The counts now.
    pub fn now(&self) -> Counts {
        let get = |c: &AtomicU64| c.load(Ordering::Relaxed);
        Counts {
            complete: get(&self.complete),
            incomplete: get(&self.incomplete),
            drained: get(&self.drained),
            resent_packets: get(&self.resent_packets),
            missing_packets: get(&self.missing_packets),
            underruns: get(&self.underruns),
            opened: get(&self.opened),
        }
    }
}
