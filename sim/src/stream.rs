//! The clock of a free-running sensor: frames follow each other, settings reach the sensor some frames late, a short
//! queue keeps old frames.

use goniod_drivers::contract::CameraSettings;
use std::collections::VecDeque;
use std::time::Duration;
use tokio::time::Instant;

/// Buffers between sensor and reader: when all are full, newer frames are lost (their ids are not).
pub const QUEUE: usize = 4;

/// Times of a sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// Read-out and transfer.
    pub readout: Duration,
    /// Shortest time from start to start.
    pub interval: Duration,
    /// Frames that start after a write and still carry the old settings.
    pub latency: u64,
    /// Time to stop and start the stream, where that is possible.
    pub restart: Option<Duration>,
}

/// One frame of the sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shot {
    /// Device frame id.
    pub id: u64,
    /// Start of exposure.
    pub start: Instant,
    /// Settings that the sensor really used.
    pub settings: CameraSettings,
}

/// A running stream.
#[derive(Debug)]
pub struct Stream {
    timing: Timing,
    current: Shot,
    pending: VecDeque<(u64, CameraSettings)>,
    queue: VecDeque<Shot>,
}

/// What arming gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Armament {
    /// Frames from there on may count.
    pub not_before: Instant,
    /// Frames after it that still carry old settings.
    pub discard: u32,
    /// When the first good frame is complete.
    pub due: Instant,
}

// === impl Stream ===

impl Stream {
    /// A stream whose first frame, number `id`, starts at `start`.
    pub fn new(timing: Timing, id: u64, start: Instant, settings: CameraSettings) -> Stream {
        Stream { timing, current: Shot { id, start, settings }, pending: VecDeque::new(), queue: VecDeque::new() }
    }

    /// Id of the frame under way.
    pub fn id(&self) -> u64 {
        self.current.id
    }

    /// When a frame is complete.
    pub fn done(&self, shot: &Shot) -> Instant {
        shot.start + shot.settings.exposure.duration() + self.timing.readout
    }

    fn period(&self, settings: &CameraSettings) -> Duration {
        (settings.exposure.duration() + self.timing.readout).max(self.timing.interval)
    }

    /// When the next frame will be in the queue.
    pub fn next_done(&self) -> Instant {
        self.done(&self.current)
    }

    /// Lets the sensor run until `now`.
    pub fn advance(&mut self, now: Instant) {
        while self.done(&self.current) <= now {
            if self.queue.len() < QUEUE {
                self.queue.push_back(self.current);
            } else if self.pending.is_empty() {
                // Nothing will change until somebody reads: skip the lost frames at once.
                let period = self.period(&self.current.settings);
                let lost = (now - self.done(&self.current)).as_nanos() / period.as_nanos().max(1);
                let lost = lost.min(u128::from(u32::MAX)) as u32;
                self.current.id += u64::from(lost);
                self.current.start += period * lost;
            }
            self.step();
        }
    }

    fn step(&mut self) {
        self.current.start += self.period(&self.current.settings);
        self.current.id += 1;
        while self.pending.front().is_some_and(|(id, _)| *id <= self.current.id) {
            if let Some((_, settings)) = self.pending.pop_front() {
                self.current.settings = settings;
            }
        }
    }

    /// Id of the first frame that starts at or after `now`.
    fn first_after(&self, now: Instant) -> u64 {
        if self.current.start >= now { self.current.id } else { self.current.id + 1 }
    }

    /// Writes settings at `now`.
    pub fn write(&mut self, settings: CameraSettings, now: Instant) {
        self.advance(now);
        self.pending.push_back((self.first_after(now) + self.timing.latency.max(1), settings));
    }

    /// Empties the queue and says which frames count; restarts the stream where that is the shorter way.
    pub fn arm(&mut self, now: Instant) -> Armament {
        self.advance(now);
        self.queue.clear();
        let first = self.first_after(now);
        let good = self.pending.back().map_or(first, |(id, _)| (*id).max(first));
        let mut probe = Stream::new(self.timing, self.current.id, self.current.start, self.current.settings);
        probe.pending = self.pending.clone();
        while probe.current.id < good {
            probe.step();
        }
        if let Some(restart) = self.timing.restart
            && now + restart < probe.current.start
        {
            let settings = probe.current.settings;
            *self = Stream::new(self.timing, self.current.id + 1, now + restart, settings);
            return Armament { not_before: now, discard: 0, due: self.next_done() };
        }
        Armament { not_before: now, discard: (good - first) as u32, due: probe.next_done() }
    }

    /// The oldest frame in the queue.
    pub fn front(&self) -> Option<Shot> {
        self.queue.front().copied()
    }

    /// Takes the oldest frame out of the queue.
    pub fn pop(&mut self) -> Option<Shot> {
        self.queue.pop_front()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use goniod_drivers::units::ExposureTime;

    fn settings(ms: u64) -> CameraSettings {
        CameraSettings { exposure: ExposureTime(ms * 1000), gain: 0.0 }
    }

    fn timing(restart: Option<u64>) -> Timing {
        let ms = Duration::from_millis;
        Timing { readout: ms(10), interval: ms(50), latency: 2, restart: restart.map(ms) }
    }

    fn at(start: Instant, ms: u64) -> Instant {
        start + Duration::from_millis(ms)
    }

    #[tokio::test(start_paused = true)]
    async fn frames_follow_at_the_longer_of_exposure_and_interval() {
        let t0 = Instant::now();
        let mut stream = Stream::new(timing(None), 1, t0, settings(20));
        stream.advance(at(t0, 149));
        assert_eq!(stream.queue.iter().map(|s| s.id).collect::<Vec<_>>(), [1, 2, 3]);
        assert_eq!(stream.queue[2].start, at(t0, 100));
        let mut slow = Stream::new(timing(None), 1, t0, settings(100));
        slow.advance(at(t0, 220));
        assert_eq!(slow.queue.len(), 2);
        assert_eq!(slow.queue[1].start, at(t0, 110));
    }

    /// Two frames that start after the write still carry the old exposure; `arm` says so.
    #[tokio::test(start_paused = true)]
    async fn a_setting_arrives_after_the_latency() {
        let t0 = Instant::now();
        let mut stream = Stream::new(timing(None), 1, t0, settings(20));
        stream.write(settings(5), at(t0, 60));
        let armed = stream.arm(at(t0, 60));
        assert_eq!(armed.discard, 2);
        stream.advance(at(t0, 230));
        let seen: Vec<(u64, u64)> = stream.queue.iter().map(|s| (s.id, s.settings.exposure.0)).collect();
        assert_eq!(seen, [(2, 20_000), (3, 20_000), (4, 20_000), (5, 5_000)]);
        let good = stream.queue.iter().filter(|s| s.start >= armed.not_before).nth(armed.discard as usize).unwrap();
        assert_eq!(good.settings.exposure.0, 5_000);
        assert_eq!(armed.due, at(t0, 215));
    }

    #[tokio::test(start_paused = true)]
    async fn an_unread_queue_keeps_old_frames_and_counts_lost_ones() {
        let t0 = Instant::now();
        let mut stream = Stream::new(timing(None), 1, t0, settings(20));
        stream.advance(at(t0, 3_600_000));
        assert_eq!(stream.queue.iter().map(|s| s.id).collect::<Vec<_>>(), [1, 2, 3, 4]);
        assert_eq!(stream.pop().unwrap().id, 1);
        stream.advance(at(t0, 3_600_100));
        assert_eq!(stream.queue.back().unwrap().id, 72_001);
    }

    #[tokio::test(start_paused = true)]
    async fn a_long_exposure_under_way_is_cut_short_by_a_restart() {
        let t0 = Instant::now();
        let mut stream = Stream::new(timing(Some(100)), 1, t0, settings(60_000));
        stream.write(settings(5), at(t0, 1_000));
        let armed = stream.arm(at(t0, 1_000));
        assert_eq!((armed.discard, armed.due), (0, at(t0, 1_115)));
        stream.advance(armed.due);
        let shot = stream.front().unwrap();
        assert_eq!((shot.id, shot.settings.exposure.0), (2, 5_000));
    }
}
