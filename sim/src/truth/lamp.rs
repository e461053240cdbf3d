//! The lamp over time: struck, warming up, drifting slowly, jumping, flickering, out. Cameras and light monitor see the
//! same one; faults happen to it.
//!
//! Source: the sheet `light-source-hmi`: output = warm-up exponential x slow drift x jumps; a hot arc cannot be struck.

use super::config::LampFile;
use super::draw::LampDraw;
use super::spectrum::SpectrumFile;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// Instants of an exposure at which the lamp is looked at.
const LOOKS: u32 = 8;
/// Events remembered; a lamp that is switched more often is no lamp.
const MAX_EVENTS: usize = 4096;

/// What happens to the lamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LampFault {
    /// It goes out.
    Off,
    /// Somebody strikes it; nothing happens while it burns or the arc is hot.
    Strike,
    /// From now on it loses (below 0) or gains this much of its light in an hour.
    Drift(f64),
    /// The arc jumps: its light changes at once by this much (-0.03 is three percent less).
    Jump(f64),
    /// From now on it flickers from exposure to exposure with this relative standard deviation more.
    Flicker(f64),
}

/// The lamp of a bench; clones are the same lamp.
#[derive(Debug, Clone)]
pub struct SimLamp {
    steady: Arc<LampDraw>,
    file: Arc<LampFile>,
    opened: Instant,
    events: Arc<Mutex<Vec<(Instant, LampFault)>>>,
}

/// The lamp's part that events make, at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Burning {
    /// Burns since then; `None` inside: since long ago; `None` outside: out.
    since: Option<Option<Instant>>,
    /// Went out then.
    out: Option<Instant>,
    jumps: f64,
    drift_per_hour: f64,
    drifting_since: Instant,
    flicker: f64,
}

// === impl SimLamp ===

impl SimLamp {
    /// The lamp of this seed on a bench that is opened at `opened`.
    pub fn new(file: &LampFile, seed: u64, opened: Instant) -> SimLamp {
        let steady = Arc::new(LampDraw::new(file, seed));
        SimLamp { steady, file: Arc::new(file.clone()), opened, events: Arc::default() }
    }

    /// A lamp without drift, walk and flicker that puts `power_w` on the monitor, for a light monitor without a bench.
    pub fn steady(power_w: f64, opened: Instant) -> SimLamp {
        let file = LampFile {
            spectrum: SpectrumFile { constant: Some(1.0), csv: None, column: None, scale: None },
            irradiance_uw_per_cm2: 1.0,
            beam_half_angle_deg: 0.25,
            drift_per_hour: 0.0,
            drift_period_h: 6.0,
            walk_per_sqrt_hour: 0.0,
            flicker: 0.0,
            cold_start: false,
            warm_up_time_constant_s: 60.0,
            cold_output: 0.3,
            restrike_s: 600.0,
            monitor_power_w: power_w,
        };
        SimLamp::new(&file, 0, opened)
    }

    /// Lets something happen at `now`.
    pub fn inject(&self, fault: LampFault, now: Instant) {
        let mut events = self.events();
        if events.len() < MAX_EVENTS {
            events.push((now, fault));
        }
    }

    /// Slow factor of the steady lamp `seconds` after opening, without events.
    pub fn slow(&self, seconds: f64) -> f64 {
        self.steady.slow(seconds)
    }

    /// True while the arc burns at `at`.
    pub fn burns(&self, at: Instant) -> bool {
        self.burning(at).since.is_some()
    }

    /// Light at `at` relative to the steady lamp of the bench file, without flicker.
    pub fn factor(&self, at: Instant) -> f64 {
        self.slow(self.seconds(at)) * self.eventful(at)
    }

    /// Power on the light monitor's photodiode at `at`.
    pub fn monitor_w(&self, at: Instant) -> f64 {
        self.file.monitor_power_w * self.factor(at)
    }

    /// Mean factor of one exposure: slow part at its middle, flicker of this frame, events all along it.
    pub fn exposure(&self, start: Instant, length: Duration, camera: &str, frame: u64) -> f64 {
        let middle = start + length / 2;
        let drawn = self.steady.exposure(self.seconds(middle), camera, frame);
        let extra = 1.0 + self.burning(middle).flicker * self.steady.deviate(camera, frame);
        let looks = (0..LOOKS).map(|i| self.eventful(start + length * (2 * i + 1) / (2 * LOOKS)));
        drawn * extra.max(0.0) * (looks.sum::<f64>() / f64::from(LOOKS))
    }

    fn seconds(&self, at: Instant) -> f64 {
        at.checked_duration_since(self.opened).unwrap_or_default().as_secs_f64()
    }

    /// Warm-up, jumps and injected drift at `at`; exactly 1 for a warm lamp to which nothing happened.
    fn eventful(&self, at: Instant) -> f64 {
        let burning = self.burning(at);
        let Some(since) = burning.since else { return 0.0 };
        let warm = since.map_or(1.0, |since| {
            let t = at.checked_duration_since(since).unwrap_or_default().as_secs_f64();
            1.0 - (1.0 - self.file.cold_output) * (-t / self.file.warm_up_time_constant_s).exp()
        });
        let hours = at.checked_duration_since(burning.drifting_since).unwrap_or_default().as_secs_f64() / 3600.0;
        warm * burning.jumps * (1.0 + burning.drift_per_hour * hours).max(0.0)
    }

    fn burning(&self, at: Instant) -> Burning {
        let mut b = Burning {
            since: Some(self.file.cold_start.then_some(self.opened)),
            out: None,
            jumps: 1.0,
            drift_per_hour: 0.0,
            drifting_since: self.opened,
            flicker: 0.0,
        };
        let restrike = Duration::from_secs_f64(self.file.restrike_s);
        for (when, event) in self.events().iter().filter(|(when, _)| *when <= at) {
            match *event {
                LampFault::Off => {
                    b.out = b.since.map_or(b.out, |_| Some(*when));
                    b.since = None;
                }
                LampFault::Strike if b.since.is_none() && b.out.is_none_or(|out| *when >= out + restrike) => {
                    b.since = Some(Some(*when));
                }
                LampFault::Strike => {}
                LampFault::Jump(by) => b.jumps *= 1.0 + by,
                LampFault::Drift(per_hour) => {
                    let hours = (*when - b.drifting_since).as_secs_f64() / 3600.0;
                    b.jumps *= (1.0 + b.drift_per_hour * hours).max(0.0);
                    (b.drift_per_hour, b.drifting_since) = (per_hour, *when);
                }
                LampFault::Flicker(relative) => b.flicker = relative,
            }
        }
        b
    }

    fn events(&self) -> MutexGuard<'_, Vec<(Instant, LampFault)>> {
        self.events.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::test_bench;

    fn lamp(cold: bool) -> (SimLamp, Instant) {
        let mut file = test_bench::file(true).lamp;
        file.cold_start = cold;
        let now = Instant::now();
        (SimLamp::new(&file, 3, now), now)
    }

    const MINUTE: Duration = Duration::from_secs(60);
    const HOUR: Duration = Duration::from_secs(3600);

    #[tokio::test(start_paused = true)]
    async fn a_lamp_to_which_nothing_happens_is_the_steady_one_to_the_bit() {
        let file = test_bench::file(false).lamp;
        let now = Instant::now();
        let (lamp, draw) = (SimLamp::new(&file, 20_090_107, now), LampDraw::new(&file, 20_090_107));
        for minute in 0..600_u32 {
            let start = now + MINUTE * minute;
            let seconds = (start + MINUTE / 2 - now).as_secs_f64();
            let id = u64::from(minute);
            assert_eq!(lamp.exposure(start, MINUTE, "ccd", id).to_bits(), draw.exposure(seconds, "ccd", id).to_bits());
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_cold_lamp_warms_up_with_its_time_constant() {
        let (lamp, now) = lamp(true);
        assert!((lamp.factor(now) - 0.3).abs() < 1e-12);
        assert!((lamp.factor(now + MINUTE) - (1.0 - 0.7 / std::f64::consts::E)).abs() < 1e-12);
        assert!((lamp.factor(now + 15 * MINUTE) - 1.0).abs() < 1e-6);
    }

    #[tokio::test(start_paused = true)]
    async fn a_hot_arc_cannot_be_struck_and_a_cooled_one_warms_up_anew() {
        let (lamp, now) = lamp(false);
        lamp.inject(LampFault::Off, now + MINUTE);
        lamp.inject(LampFault::Strike, now + 2 * MINUTE);
        assert_eq!((lamp.factor(now), lamp.factor(now + 3 * MINUTE)), (1.0, 0.0));
        lamp.inject(LampFault::Strike, now + 12 * MINUTE);
        assert!(!lamp.burns(now + 11 * MINUTE) && lamp.burns(now + 12 * MINUTE));
        assert!((lamp.factor(now + 12 * MINUTE) - 0.3).abs() < 1e-12);
    }

    #[tokio::test(start_paused = true)]
    async fn jumps_and_drifts_change_the_light_from_then_on() {
        let (lamp, now) = lamp(false);
        lamp.inject(LampFault::Jump(-0.03), now + HOUR);
        lamp.inject(LampFault::Drift(-0.05), now + 2 * HOUR);
        lamp.inject(LampFault::Drift(0.0), now + 4 * HOUR);
        assert_eq!(lamp.factor(now + HOUR / 2), 1.0);
        for (hours, factor) in [(1, 0.97), (2, 0.97), (3, 0.97 * 0.95), (4, 0.97 * 0.9), (9, 0.97 * 0.9)] {
            assert!((lamp.factor(now + HOUR * hours) - factor).abs() < 1e-12, "{hours}");
        }
    }

    /// A lamp that goes out in the middle of an exposure leaves half its light.
    #[tokio::test(start_paused = true)]
    async fn an_exposure_has_the_light_that_there_was() {
        let (lamp, now) = lamp(false);
        lamp.inject(LampFault::Off, now + MINUTE);
        assert!((lamp.exposure(now, 2 * MINUTE, "ccd", 1) - 0.5).abs() < 1e-12);
        assert_eq!(lamp.exposure(now + 2 * MINUTE, MINUTE, "ccd", 2), 0.0);
    }
}
