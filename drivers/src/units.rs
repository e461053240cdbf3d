//! Units as types: no bare `f64` with a unit crosses a module border.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::time::Duration;

/// A plane angle in degrees.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Degrees(pub f64);

/// An angular speed in degrees per second.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct DegreesPerSecond(pub f64);

/// An integration time in whole microseconds: exact, ordered, hashable, so a plan can compare it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ExposureTime(pub u64);

/// A wavelength in vacuum nanometres.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Nanometres(pub f64);

/// A place of a filter wheel, counted from 1 as the wheel's own housing does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Slot(pub u8);

// === impl Degrees ===

impl Degrees {
    /// The angle in radians.
    pub fn radians(self) -> f64 {
        self.0.to_radians()
    }

    /// Size of the smallest difference to `other`, without wrapping turns.
    pub fn distance(self, other: Degrees) -> Degrees {
        Degrees((self.0 - other.0).abs())
    }
}

impl fmt::Display for Degrees {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}°", self.0)
    }
}

// === impl ExposureTime ===

impl ExposureTime {
    /// The nearest whole number of microseconds to `seconds`; negative and non-finite values give zero.
    pub fn from_seconds(seconds: f64) -> ExposureTime {
        ExposureTime((seconds * 1e6).round().max(0.0) as u64)
    }

    /// The integration time in seconds.
    pub fn seconds(self) -> f64 {
        self.0 as f64 / 1e6
    }

    /// The integration time as a duration.
    pub fn duration(self) -> Duration {
        Duration::from_micros(self.0)
    }
}

impl fmt::Display for ExposureTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            us if us < 1_000 => write!(f, "{us} µs"),
            us if us < 1_000_000 => write!(f, "{} ms", us as f64 / 1e3),
            us => write!(f, "{} s", us as f64 / 1e6),
        }
    }
}

// === impl Nanometres ===

impl fmt::Display for Nanometres {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} nm", self.0)
    }
}

// === impl Slot ===

impl fmt::Display for Slot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "slot {}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposure_times_are_whole_microseconds() {
        assert_eq!(ExposureTime::from_seconds(0.0041), ExposureTime(4100));
        assert_eq!(ExposureTime(4100).seconds(), 0.0041);
        assert_eq!(ExposureTime::from_seconds(f64::NAN), ExposureTime(0));
        assert_eq!(ExposureTime(1_500_000).to_string(), "1.5 s");
    }
}
