//! The free-running detector of a spectrometer: periods, light gathered in them, dark level, noise, non-linearity.

use crate::truth::rng::Key;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// Counts per second that light of a wavelength (in nm) makes at an instant.
pub type Light = Arc<dyn Fn(f64, Instant) -> f64 + Send + Sync>;

/// Looks at the light within one period, so that a shutter that moves in it counts in part.
const LOOKS: u32 = 4;
/// Steps of the fixed point that inverts the non-linearity.
const STEPS: u32 = 12;

/// One period of the detector, as it truly was.
#[derive(Debug, Clone, PartialEq)]
pub struct Exposure {
    /// When it began.
    pub began: Instant,
    /// When it ended.
    pub ended: Instant,
    /// Raw counts of all pixels, as the device had them.
    pub raw: Vec<u16>,
}

/// Mercury and rare-earth lines of a metal halide lamp over a continuum, in counts per second: about 2000 counts of 4095
/// in the strongest line at 100 ms.
pub fn hmi() -> Light {
    const LINES: [(f64, f64, f64); 8] = [
        (404.7, 0.35, 2.0),
        (435.8, 0.70, 2.0),
        (546.1, 1.00, 2.0),
        (578.0, 0.80, 2.5),
        (589.3, 0.45, 4.0),
        (625.0, 0.25, 6.0),
        (671.0, 0.30, 3.0),
        (819.5, 0.20, 4.0),
    ];
    Arc::new(|nm, _| {
        let lines: f64 = LINES.iter().map(|&(at, height, width)| height * (-((nm - at) / width).powi(2)).exp()).sum();
        let continuum = 0.25 * (-((nm - 560.0) / 180.0).powi(2)).exp();
        20_000.0 * (lines + continuum)
    })
}

/// Light gathered over a period, in linear counts of a 12-bit detector.
pub fn gather(light: &Light, nm: f64, began: Instant, period: Duration) -> f64 {
    let seconds = period.as_secs_f64();
    let looks = (0..LOOKS).map(|i| began + period.mul_f64((f64::from(i) + 0.5) / f64::from(LOOKS)));
    looks.map(|at| light(nm, at)).sum::<f64>() / f64::from(LOOKS) * seconds
}

/// The count whose correction `count / p(count)` is `linear`.
pub fn bend(linear: f64, polynomial: &[f64]) -> f64 {
    (0..STEPS).fold(linear, |count, _| linear * power_series(polynomial, count))
}

/// c0 + c1 x + c2 x^2 + ...
pub fn power_series(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().enumerate().map(|(n, c)| c * x.powi(n as i32)).sum()
}

/// Readout and shot noise of a pixel that holds `counts`, for pixel `pixel` of period `number`.
pub fn noise(key: Key, number: u64, pixel: u64, counts: f64) -> f64 {
    // About 15 electrons a count: a standard deviation of 1.5 in the dark, 16 at 4000 counts.
    (2.25 + counts.max(0.0) / 15.0).sqrt() * key.with(number).normal(pixel)
}

/// A clock of periods that follow one another; a new length counts from the end of the running one.
#[derive(Debug, Clone)]
pub struct Periods {
    began: Instant,
    length: Duration,
    next: Option<Duration>,
}

// === impl Periods ===

impl Periods {
    /// Periods of `length` from `now` on.
    pub fn new(length: Duration, now: Instant) -> Periods {
        Periods { began: now, length, next: None }
    }

    /// The running period at `now`: its begin and its length.
    pub fn running(&mut self, now: Instant) -> (Instant, Duration) {
        if let Some(next) = self.next
            && self.began + self.length <= now
        {
            self.began += self.length;
            self.length = next;
            self.next = None;
        }
        let since = now.saturating_duration_since(self.began).as_nanos();
        let length = self.length.as_nanos().max(1);
        let whole = u64::try_from(since / length * length).unwrap_or(u64::MAX);
        self.began += Duration::from_nanos(whole);
        (self.began, self.length)
    }

    /// Sets the length of the periods after the running one.
    pub fn set(&mut self, length: Duration, now: Instant) {
        self.running(now);
        self.next = Some(length);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_new_length_counts_from_the_end_of_the_running_period() {
        let ms = Duration::from_millis;
        let zero = Instant::now();
        let mut periods = Periods::new(ms(100), zero);
        assert_eq!(periods.running(zero + ms(250)), (zero + ms(200), ms(100)));
        periods.set(ms(30), zero + ms(250));
        assert_eq!(periods.running(zero + ms(299)), (zero + ms(200), ms(100)));
        assert_eq!(periods.running(zero + ms(300)), (zero + ms(300), ms(30)));
        assert_eq!(periods.running(zero + ms(395)), (zero + ms(390), ms(30)));
    }

    #[test]
    fn bending_is_undone_by_the_correction() {
        let polynomial = [0.98, 2e-5, -3e-9];
        let count = bend(2000.0, &polynomial);
        assert!((count / power_series(&polynomial, count) - 2000.0).abs() < 1e-6);
    }
}
