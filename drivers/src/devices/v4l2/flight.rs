//! Frames in flight: which dequeued frame is fresh, which settings it can have, whether it may be used. Pure.
//!
//! A change of a control reaches the sensor some frames later, and frames already exposed or queued come first.
//! Source: `../shared/protocols/ccd-v4l2-kappa-dx20.md`, chapters 3 and 4.

use super::sys::BufferMeta;
use std::collections::VecDeque;
use std::time::Duration;

/// V4L2_BUF_FLAG_ERROR: data corrupt.
const FLAG_ERROR: u32 = 0x0040;
/// Clock of the stamp; only MONOTONIC can be compared with ours.
const STAMP_CLOCK: u32 = 0xE000;
const STAMP_MONOTONIC: u32 = 0x2000;
/// Moment of the stamp; anything but start of exposure is taken as end of frame.
const STAMP_MOMENT: u32 = 0x7_0000;
const STAMP_START: u32 = 0x1_0000;
/// Pictures remembered to notice one that comes again.
const REMEMBERED: usize = 4;

/// What was odd about frames since the device was opened, and what happened to the good ones.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct Counters {
    /// Buffers taken from the device.
    pub dequeued: u64,
    /// Sequence numbers that never came.
    pub lost: u64,
    /// Older than a frame that came before.
    pub stale: u64,
    /// Came twice: the same buffer, or the same picture under a new number.
    pub repeated: u64,
    /// Flagged as corrupt by the device.
    pub damaged: u64,
    /// Shorter than a picture.
    pub short: u64,
    /// Came while the input reported no signal.
    pub no_signal: u64,
    /// Good, but not to be used: exposed or started too early for the settings or the bench.
    pub settling: u64,
    /// Good, but no reader had left a place for it.
    pub unread: u64,
    /// Restarts of the stream after an input/output error.
    pub restarts: u64,
}

/// One dequeued buffer.
#[derive(Debug, Clone, Copy)]
pub struct Seen {
    /// What the kernel says.
    pub meta: BufferMeta,
    /// CLOCK_MONOTONIC when it was dequeued.
    pub dequeued: Duration,
    /// Bytes a whole picture needs.
    pub picture_bytes: usize,
    /// Digest of the picture; `None` for a flat one, which may rightly come again.
    pub digest: Option<u64>,
    /// The input has a signal.
    pub signal: bool,
}

/// What a frame is good for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Placed {
    /// The device's counter, continued over restarts of the stream.
    pub id: u64,
    /// CLOCK_MONOTONIC at the start of its exposure, at the latest estimate that is safe.
    pub start: Duration,
    /// To be handed to the reader.
    pub deliver: bool,
    /// Must not be used: corrupt, short, stale, repeated or without signal.
    pub odd: bool,
    /// Frames were lost just before it.
    pub after_loss: bool,
}

/// The rules with their memory.
#[derive(Debug)]
pub struct Flight {
    settle_frames: u32,
    readout: Duration,
    buffers: u32,
    exposure: Duration,
    slowest: Duration,
    settings_at: Option<Duration>,
    armed_at: Option<Duration>,
    started_since: u32,
    delivering: bool,
    last: Option<BufferMeta>,
    id: u64,
    sequence_moves: bool,
    stamps_usable: bool,
    start_stamps: bool,
    recent: VecDeque<u64>,
    /// Sums since opening.
    pub counters: Counters,
}

/// A 64-bit digest of a picture, `None` when all its bytes are alike.
pub fn digest(bytes: &[u8]) -> Option<u64> {
    let (words, tail) = bytes.as_chunks::<8>();
    let first = u64::from_le_bytes(*words.first()?);
    let mut hash = bytes.len() as u64;
    let mut differ = 0;
    for word in words {
        let word = u64::from_le_bytes(*word);
        differ |= word ^ first;
        hash = (hash ^ word).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29);
    }
    for byte in tail {
        hash = (hash ^ u64::from(*byte)).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29);
        differ |= u64::from(*byte) ^ (first & 0xFF);
    }
    (differ != 0 || first != first.rotate_left(8)).then_some(hash)
}

// === impl Flight ===

impl Flight {
    /// Rules for a camera that needs `settle_frames` (N) after a change, with this read-out time.
    pub fn new(settle_frames: u32, readout: Duration) -> Flight {
        Flight {
            settle_frames: settle_frames.max(1),
            readout,
            buffers: 0,
            exposure: Duration::ZERO,
            slowest: Duration::ZERO,
            settings_at: None,
            armed_at: None,
            started_since: 0,
            delivering: false,
            last: None,
            id: 0,
            sequence_moves: false,
            stamps_usable: true,
            start_stamps: true,
            recent: VecDeque::new(),
            counters: Counters::default(),
        }
    }

    /// Stamps flagged as those of the start of exposure are those of its end. `uvcvideo` sets that flag, but stamps
    /// the moment at which the first bytes of the picture came (Linux 6.1, `uvc_video_decode_start`). A picture may have
    /// waited inside the camera until then, so the N frames are counted anew after every arming.
    pub fn distrust_start_stamps(&mut self) {
        self.start_stamps = false;
    }

    /// The stream (re)starts with `buffers` kernel buffers: sequence numbers may begin anew.
    pub fn restarted(&mut self, buffers: usize) {
        self.buffers = buffers as u32;
        self.last = None;
        self.sequence_moves = false;
        self.delivering = false;
        self.recent.clear();
    }

    /// Settings were written and read back at `at`; frames before it may have had the old exposure. Disarms.
    pub fn changed(&mut self, at: Duration, exposure: Duration) {
        self.slowest = self.slowest.max(self.exposure).max(exposure);
        self.exposure = exposure;
        self.settings_at = Some(at);
        self.started_since = 0;
        self.delivering = false;
        self.armed_at = None;
    }

    /// The same settings were written again at `at` after a restart of the stream: they settle anew, what was armed
    /// stays armed.
    pub fn resettle(&mut self, at: Duration) {
        self.settings_at = Some(at);
        self.started_since = 0;
    }

    /// No frame may be used until [`Flight::armed`].
    pub fn disarm(&mut self) {
        self.armed_at = None;
        self.delivering = false;
    }

    /// The bench stands since `at`: only frames that start later count. Without usable stamps every frame that may
    /// wait in the queue is counted out as well.
    pub fn armed(&mut self, at: Duration) {
        self.armed_at = Some(at);
        self.delivering = false;
        if !self.stamps_usable || !self.start_stamps {
            self.started_since = 0;
        }
    }

    /// Frames that must start before the first usable one can, for deadlines.
    pub fn frames_to_settle(&self) -> u32 {
        self.needed().saturating_sub(self.started_since)
    }

    /// The device stamps its frames with the monotonic clock.
    pub fn stamps_usable(&self) -> bool {
        self.stamps_usable
    }

    /// Exposure that a frame under way may have had, at most.
    pub fn slowest(&self) -> Duration {
        self.slowest
    }

    fn needed(&self) -> u32 {
        if self.stamps_usable { self.settle_frames } else { self.settle_frames + self.buffers + 1 }
    }

    /// Judges one frame.
    pub fn place(&mut self, seen: &Seen) -> Placed {
        let meta = &seen.meta;
        self.counters.dequeued += 1;
        self.stamps_usable = meta.flags & STAMP_CLOCK == STAMP_MONOTONIC;
        let (fresh, lost) = self.number(meta);
        let repeated = seen.digest.is_some_and(|d| self.recent.contains(&d));
        self.remember(seen.digest);
        let damaged = meta.flags & FLAG_ERROR != 0;
        let short = meta.bytesused < seen.picture_bytes;
        self.counters.lost += u64::from(lost);
        self.counters.stale += u64::from(fresh == Fresh::Older);
        self.counters.repeated += u64::from(fresh == Fresh::Same || fresh == Fresh::Newer && repeated);
        self.counters.damaged += u64::from(damaged);
        self.counters.short += u64::from(short && !damaged);
        self.counters.no_signal += u64::from(!seen.signal);
        let odd = fresh != Fresh::Newer || repeated || damaged || short || !seen.signal;

        let settled_before = self.started_since >= self.needed();
        let exposure = if settled_before { self.exposure } else { self.slowest.max(self.exposure) };
        let early = self.start_of(seen, exposure);
        let since = if self.start_stamps { self.settings_at } else { self.settings_at.max(self.armed_at) };
        if !odd && since.is_some_and(|t| early >= t) {
            self.started_since = self.started_since.saturating_add(1);
        }
        let settled = self.started_since >= self.needed();
        if settled && !settled_before {
            self.slowest = self.exposure;
        }
        let start = self.start_of(seen, self.exposure);
        let usable = settled && self.armed_at.is_some_and(|t| start >= t);
        self.delivering |= usable && !odd;
        if !self.delivering && !odd {
            self.counters.settling += 1;
        }
        Placed { id: self.id, start, deliver: self.delivering, odd, after_loss: lost > 0 }
    }

    /// When its exposure started, if it lasted `exposure`.
    fn start_of(&self, seen: &Seen, exposure: Duration) -> Duration {
        if !self.stamps_usable {
            return seen.dequeued.saturating_sub(self.readout + exposure);
        }
        match seen.meta.flags & STAMP_MOMENT {
            STAMP_START if self.start_stamps => seen.meta.stamp,
            _ => seen.meta.stamp.saturating_sub(self.readout + exposure),
        }
    }

    /// Compares with the newest frame so far and continues the counter.
    fn number(&mut self, meta: &BufferMeta) -> (Fresh, u32) {
        let Some(last) = self.last else {
            self.last = Some(*meta);
            self.id += 1;
            return (Fresh::Newer, 0);
        };
        let step = meta.sequence.wrapping_sub(last.sequence) as i32;
        let later = meta.stamp > last.stamp;
        let fresh = match step {
            // Some drivers never fill the number: then a later stamp is the only sign of a new frame.
            0 if later && !self.sequence_moves => Fresh::Newer,
            0 => Fresh::Same,
            1.. if later || !self.stamps_usable => Fresh::Newer,
            _ => Fresh::Older,
        };
        if fresh != Fresh::Newer {
            return (fresh, 0);
        }
        self.sequence_moves |= step != 0;
        self.last = Some(*meta);
        let lost = step.max(1).unsigned_abs() - 1;
        self.id += 1 + u64::from(lost);
        (fresh, lost)
    }

    fn remember(&mut self, digest: Option<u64>) {
        if let Some(digest) = digest
            && !self.recent.contains(&digest)
        {
            self.recent.truncate(REMEMBERED - 1);
            self.recent.push_front(digest);
        }
    }
}

/// Order against the newest frame so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fresh {
    Newer,
    Same,
    Older,
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn seen(sequence: u32, stamp_ms: u32) -> Seen {
        let meta = BufferMeta { bytesused: 8, flags: STAMP_MONOTONIC, field: 1, stamp: MS * stamp_ms, sequence };
        let digest = Some(u64::from(stamp_ms) | 1 << 40);
        Seen { meta, dequeued: MS * stamp_ms, picture_bytes: 8, digest, signal: true }
    }

    /// The worked exchange of the sheet: 0.5 s exposure, 30 ms read-out, t0 = 812.4 s, N = 4.
    #[test]
    fn the_sheets_worked_exchange_keeps_frame_21() {
        let mut flight = Flight::new(4, MS * 30);
        flight.restarted(4);
        flight.changed(MS * 812_400, MS * 500);
        flight.armed(MS * 812_400);
        let kept: Vec<bool> = [(17, 812_100), (18, 813_000), (19, 814_000), (20, 815_000), (21, 816_000)]
            .map(|(sequence, stamp)| flight.place(&seen(sequence, stamp)).deliver)
            .to_vec();
        assert_eq!(kept, [false, false, false, false, true]);
        assert_eq!(flight.counters.settling, 4);
    }

    #[test]
    fn a_frame_exposed_longer_under_old_settings_does_not_pass_as_a_short_one() {
        let mut flight = Flight::new(1, MS);
        flight.restarted(4);
        flight.changed(MS, MS * 1000);
        flight.changed(MS * 5000, MS * 10);
        flight.armed(MS * 5000);
        // Ended 500 ms after the change: with the new 10 ms it would have started after it, with the old it did not.
        assert!(!flight.place(&seen(1, 5500)).deliver);
        assert!(flight.place(&seen(2, 6002)).deliver);
        assert!(flight.place(&seen(3, 6020)).deliver, "once settled the new exposure is certain");
    }

    #[test]
    fn a_bench_that_moved_needs_only_frames_started_later() {
        let mut flight = Flight::new(3, MS);
        flight.restarted(4);
        flight.changed(MS, MS * 10);
        flight.armed(MS);
        let _ = [20, 40, 60].map(|t| flight.place(&seen(t, t)));
        flight.armed(MS * 75);
        assert!(!flight.place(&seen(61, 80)).deliver, "started before the bench stood");
        assert!(flight.place(&seen(62, 100)).deliver);
    }

    #[test]
    fn odd_frames_are_told_apart_counted_and_do_not_settle_anything() {
        let mut flight = Flight::new(2, MS);
        flight.restarted(4);
        flight.changed(MS, MS * 10);
        flight.armed(MS);
        assert!(!flight.place(&seen(1, 20)).deliver);
        let again = flight.place(&seen(1, 20));
        assert!(again.odd && !again.deliver, "the same buffer twice is one frame");
        let first = flight.place(&seen(2, 40));
        assert!(first.deliver && !first.odd);
        let gap = flight.place(&seen(5, 100));
        assert!(gap.after_loss && !gap.odd);
        assert_eq!(gap.id, first.id + 3);
        assert!(flight.place(&seen(3, 60)).odd, "older than the newest");
        let copy = Seen { digest: Some(100 | 1 << 40), ..seen(6, 120) };
        assert!(flight.place(&copy).odd, "an old picture under a new number");
        let mut bad = seen(7, 140);
        bad.meta.flags |= FLAG_ERROR;
        assert!(flight.place(&bad).odd);
        let mut short = seen(8, 160);
        short.meta.bytesused = 7;
        assert!(flight.place(&short).odd);
        let c = flight.counters;
        assert_eq!((c.lost, c.stale, c.repeated, c.damaged, c.short), (2, 1, 2, 1, 1));
    }

    #[test]
    fn a_stamp_that_only_claims_to_be_of_the_start_is_taken_as_of_the_end() {
        let mut flight = Flight::new(1, MS);
        flight.distrust_start_stamps();
        flight.restarted(4);
        flight.changed(MS, MS * 100);
        flight.armed(MS * 1000);
        let start_flagged = |n: u32, at: u32| {
            let mut s = seen(n, at);
            s.meta.flags |= STAMP_START;
            s
        };
        assert!(!flight.place(&start_flagged(1, 1050)).deliver, "began at 949");
        assert!(flight.place(&start_flagged(2, 1150)).deliver);
    }

    #[test]
    fn pictures_that_may_have_waited_inside_the_camera_are_counted_out_after_every_arming() {
        let mut flight = Flight::new(3, MS);
        flight.distrust_start_stamps();
        flight.restarted(4);
        flight.changed(MS, MS);
        flight.armed(MS);
        assert_eq!([20, 40, 60].map(|t| flight.place(&seen(t, t)).deliver), [false, false, true]);
        flight.armed(MS * 70);
        assert_eq!([80, 100, 120].map(|t| flight.place(&seen(t, t)).deliver), [false, false, true]);
    }

    #[test]
    fn without_usable_stamps_every_queued_frame_is_counted_out() {
        let mut flight = Flight::new(2, MS);
        flight.restarted(3);
        flight.changed(MS, MS * 10);
        let unstamped = |n: u32| {
            let mut s = seen(n, n * 20);
            s.meta.flags = 0;
            s
        };
        flight.place(&unstamped(1));
        flight.armed(MS * 21);
        let first = (2..20).find(|n| flight.place(&unstamped(*n)).deliver);
        assert_eq!(first, Some(7), "3 buffers and the one being exposed may be old, then N = 2");
        assert!(!flight.stamps_usable());
    }

    #[test]
    fn numbers_that_are_never_filled_and_numbers_that_wrap_are_followed() {
        let mut flight = Flight::new(1, MS);
        flight.restarted(4);
        flight.changed(MS, MS);
        flight.armed(MS);
        let ids = [20, 40, 60].map(|t| flight.place(&seen(0, t)).id);
        assert_eq!(ids, [1, 2, 3]);
        flight.restarted(4);
        let ids = [(u32::MAX, 80), (0, 100), (1, 120)].map(|(s, t)| flight.place(&seen(s, t)).id);
        assert_eq!(ids, [4, 5, 6]);
        assert_eq!(flight.counters.lost, 0);
    }

    #[test]
    fn only_flat_pictures_may_come_again() {
        assert_eq!(digest(&[7; 100]), None);
        assert!(digest(&[0, 1, 0, 1, 0, 1, 0, 1]).is_some());
        let mut picture = [7; 100];
        picture[99] = 8;
        assert!(digest(&picture).is_some());
        assert_ne!(digest(&picture), digest(&[&picture[..99], &[9]].concat()));
    }
}
