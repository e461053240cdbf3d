//! Time: the only module of drivers and daemon that reads a clock or waits.
//!
//! All waiting goes through tokio's clock, so a paused runtime turns a night into seconds and the same seed
//! gives the same night. Durations are monotonic; wall stamps are UTC microseconds since 1970.

use std::future::Future;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::time::Instant;

/// A UTC stamp in microseconds since 1970-01-01T00:00:00Z.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
#[serde(transparent)]
pub struct UtcMicros(pub i64);

/// A handle to the daemon's time: monotonic instants of tokio's clock and the wall time that belongs to them.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    origin: Instant,
    origin_utc: UtcMicros,
    rehearsed: bool,
}

/// The deadline passed before the future was ready.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Elapsed;

// === impl Clock ===

impl Clock {
    /// The clock of a real night: wall time from the operating system, now.
    pub fn system() -> Clock {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Clock { rehearsed: false, ..Clock::starting_at(UtcMicros(since.as_micros() as i64)) }
    }

    /// A clock whose wall time is `utc` at this moment of tokio's clock (rehearsals and tests).
    pub fn starting_at(utc: UtcMicros) -> Clock {
        Clock { origin: Instant::now(), origin_utc: utc, rehearsed: true }
    }

    /// True when the wall time is not that of the operating system.
    pub fn is_virtual(&self) -> bool {
        self.rehearsed
    }

    /// The monotonic instant now.
    pub fn now(&self) -> Instant {
        Instant::now()
    }

    /// Time since the clock was made.
    pub fn elapsed(&self) -> Duration {
        self.now() - self.origin
    }

    /// Wall time now.
    pub fn utc(&self) -> UtcMicros {
        self.utc_at(self.now())
    }

    /// Wall time of a monotonic instant.
    pub fn utc_at(&self, at: Instant) -> UtcMicros {
        let since = at.checked_duration_since(self.origin).unwrap_or_default();
        UtcMicros(self.origin_utc.0 + since.as_micros() as i64)
    }

    /// Waits for `duration`.
    pub async fn sleep(&self, duration: Duration) {
        tokio::time::sleep(duration).await;
    }

    /// Waits until `at`; returns at once when it has passed.
    pub async fn sleep_until(&self, at: Instant) {
        tokio::time::sleep_until(at).await;
    }

    /// The future's value, or [`Elapsed`] when `limit` passes first.
    pub async fn timeout<F: Future>(&self, limit: Duration, future: F) -> Result<F::Output, Elapsed> {
        tokio::time::timeout(limit, future).await.map_err(|_| Elapsed)
    }
}
