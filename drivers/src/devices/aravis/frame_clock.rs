//! Device time to host time, and 16-bit block ids to a counter that never turns back. Pure.

use std::time::Duration;
use tokio::time::Instant;

/// One moment known on both clocks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    /// Device time in nanoseconds.
    pub device_ns: u64,
    /// Host instant, not earlier than the device's.
    pub host: Instant,
}

/// Turns the block ids of a stream (1 to 65535, then 1 again, 1 after each start) into one growing counter.
#[derive(Debug, Clone, Default)]
pub struct FrameCounter {
    last: u64,
    last_raw: u64,
}

// === impl Mark ===

impl Mark {
    /// The host instant of a device time. Device times before the mark give instants before its host instant, later
    /// ones later: the order on the device is kept exactly, however long the latch took.
    pub fn host(&self, device_ns: u64) -> Instant {
        match device_ns.checked_sub(self.device_ns) {
            Some(after) => self.host + Duration::from_nanos(after),
            None => {
                let before = Duration::from_nanos(self.device_ns - device_ns);
                self.host.checked_sub(before).unwrap_or(self.host)
            }
        }
    }
}

// === impl FrameCounter ===

impl FrameCounter {
    /// The stream begins again with block 1.
    pub fn restarted(&mut self) {
        self.last_raw = 0;
    }

    /// The counter of the next block. A step of more than one means lost blocks; a step back never happens.
    pub fn count(&mut self, raw: u64) -> u64 {
        let step = if raw > self.last_raw {
            raw - self.last_raw
        } else {
            (0xffff_u64 + raw).saturating_sub(self.last_raw).max(1)
        };
        self.last += step;
        self.last_raw = raw;
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn block_ids_wrap_past_zero_and_a_restart_continues_the_count() {
        let mut c = FrameCounter::default();
        assert_eq!(c.count(1), 1);
        assert_eq!(c.count(3), 3, "one lost");
        c.count(65_535);
        assert_eq!(c.count(1), 65_536, "65535 is followed by 1");
        c.restarted();
        assert_eq!(c.count(1), 65_537);
        c.restarted();
        assert_eq!(c.count(2), 65_539, "the first block of the new stream was lost");
    }

    #[test]
    fn device_times_keep_their_order_around_the_mark() {
        let mark = Mark { device_ns: 5_000, host: Instant::now() + Duration::from_secs(10) };
        assert_eq!(mark.host(5_000), mark.host);
        assert!(mark.host(4_999) < mark.host);
        assert_eq!(mark.host(7_000) - mark.host, Duration::from_nanos(2_000));
    }
}
