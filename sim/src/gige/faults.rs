//! What can be made to go wrong with the twin, and the twin's own record of what it really did.

use std::collections::VecDeque;
use std::time::Duration;

/// Faults in force. All off by default; changed while the twin runs.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Faults {
    /// Answers no request.
    pub deaf: bool,
    /// Sends no stream packet.
    pub mute: bool,
    /// Stream packets lost of 1,000, resent ones too.
    pub drop_per_1000: u32,
    /// Resend requests are answered "packet unavailable".
    pub refuse_resend: bool,
    /// The integration time reads back as this multiple of the value written.
    pub wrong_readback: Option<f64>,
    /// Every answer comes this much later.
    pub slow_answer: Option<Duration>,
    /// Writes are accepted from anybody, as cameras without access rules do after a restart.
    pub lax_access: bool,
    /// Frames of 1,000 that are replaced by the exposure before (sent or not), with its old time stamp.
    pub stale_per_1000: u32,
    /// Frames of 1,000 that carry the pixels sent last once more, under a fresh time stamp.
    pub repeated_per_1000: u32,
    /// Frames of 1,000 that end in mid-picture, for good.
    pub short_per_1000: u32,
    /// Frames after a new integration time that still use the old one.
    pub latency_frames: u32,
    /// The frame in which the integration time changes is half old, half new.
    pub half_changed: bool,
    /// Faults of the next frames, one a frame.
    pub next: VecDeque<FrameFault>,
}

/// What was wrong with a frame on purpose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FrameFault {
    /// An older picture with its older time stamp.
    Stale,
    /// The pixels sent last, once more.
    Repeated,
    /// Ends in mid-picture.
    Short,
    /// Upper half old integration time, lower half new.
    HalfChanged,
    /// Exposed, but never sent.
    NoFrame,
    /// Sent so much later.
    Late(Duration),
    /// All levels are 0.
    Black,
    /// A block id is left out before it.
    SkippedId,
}

/// What the twin really did for one block it sent.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// Count of blocks sent since power-up, from 1.
    pub sequence: u64,
    /// Block id on the wire.
    pub block_id: u16,
    /// Exposure that the picture shows.
    pub frame_number: u64,
    /// Integration time that the picture shows, in microseconds.
    pub exposure_us: f64,
    /// Integration time that was commanded when the exposure began.
    pub commanded_us: f64,
    /// What was wrong on purpose.
    pub fault: Option<FrameFault>,
}

/// Counts of what went over the wire.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Blocks sent.
    pub blocks: u64,
    /// Stream packets sent, resent ones included.
    pub packets: u64,
    /// Stream packets lost on purpose.
    pub dropped: u64,
    /// Stream packets sent again on request.
    pub resent: u64,
    /// Requests answered with an error status.
    pub refused: u64,
    /// Times a controller was dropped because its heartbeat ceased.
    pub heartbeats_missed: u64,
    /// Triggers that came while an exposure ran.
    pub triggers_ignored: u64,
}

/// A small generator of reproducible draws (64-bit linear congruence, upper bits).
#[derive(Debug, Clone)]
pub struct Draws(u64);

// === impl Draws ===

impl Draws {
    /// Draws of a seed.
    pub fn new(seed: u64) -> Draws {
        Draws(seed.wrapping_mul(2).wrapping_add(0x9e37_79b9_7f4a_7c15))
    }

    /// True `per_1000` times of 1,000.
    pub fn happens(&mut self, per_1000: u32) -> bool {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) % 1000) < u64::from(per_1000)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_keep_their_rate() {
        let mut draws = Draws::new(3);
        let hits = (0..100_000).filter(|_| draws.happens(5)).count();
        assert!((400..600).contains(&hits), "{hits} of 100,000 at 5 in 1,000");
        assert!((0..1000).all(|_| !draws.happens(0)));
    }
}
