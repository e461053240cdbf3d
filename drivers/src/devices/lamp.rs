//! How a discharge lamp behaves: out, warming up, steady, cooling; what may be asked of it, and for how long it burns.
//!
//! Source: the sheet `light-source-hmi`. No wire: light readings and switching are told to the model, which is a pure
//! state machine of time. After a start of the daemon the state is unknown until a reading tells whether it burns; a lamp
//! found burning is trusted only after the whole warm-up and a flat slope. The daemon never switches a lamp off by itself.

use std::collections::VecDeque;
use std::time::Duration;
use tokio::time::Instant;

/// Readings kept for the slope: more than one a second is thinned.
const MAX_READINGS: usize = 600;
/// Shortest distance of two readings that are kept.
const THIN: Duration = Duration::from_secs(1);

/// What is known of the lamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LampConfig {
    /// Shortest time from ignition to steady light.
    pub warm_up: Duration,
    /// Cooling before it may be struck again.
    pub restrike: Duration,
    /// Shortest time from ignition to switching off.
    pub shortest_on: Duration,
    /// Largest relative slope of steady light, a minute.
    pub steady_per_minute: f64,
    /// Time over which the slope is judged.
    pub slope_over: Duration,
    /// Share of the light seen last below which the lamp is out.
    pub out_below: f64,
    /// Power on the monitor above which a lamp of unknown state burns, watts.
    pub burns_above_w: f64,
    /// Hours the maker rates it for.
    pub rated_hours: Option<f64>,
}

/// State of the lamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LampState {
    /// Nothing was seen yet.
    Unknown,
    /// Out, and cool enough to be struck.
    Off,
    /// Out, too hot to be struck before then.
    Cooling(Instant),
    /// Burns, not steady before then at the earliest.
    Warming(Instant),
    /// Burns steadily.
    Steady,
    /// Was steady; its light now changes faster than allowed.
    Drifting,
}

/// What somebody wants of the lamp.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wish {
    /// Strike it.
    On,
    /// Switch it off; only ever an operator's wish.
    Off,
}

/// Why a wish must wait, with the instant from which it is allowed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Refusal {
    /// The arc is hot.
    TooHot(Instant),
    /// It was struck too short a time ago.
    TooYoung(Instant),
    /// It is so already.
    Already,
}

/// What a reading showed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LampEvent {
    /// It burns.
    Burns,
    /// It went out: close the shutter and stop; nobody strikes it without an operator.
    Lost,
    /// Its light is steady now.
    Steady,
    /// Its light is not steady any more.
    Drifting,
}

/// The lamp as its readings tell it.
#[derive(Debug, Clone)]
pub struct LampModel {
    config: LampConfig,
    burning_since: Option<Instant>,
    out_since: Option<Instant>,
    steady: Option<bool>,
    readings: VecDeque<(Instant, f64)>,
    burnt: Duration,
    ignitions: u32,
}

// === impl LampConfig ===

impl Default for LampConfig {
    fn default() -> LampConfig {
        LampConfig {
            warm_up: Duration::from_secs(300),
            restrike: Duration::from_secs(900),
            shortest_on: Duration::from_secs(300),
            steady_per_minute: 0.002,
            slope_over: Duration::from_secs(300),
            out_below: 0.1,
            burns_above_w: 1e-8,
            rated_hours: None,
        }
    }
}

// === impl LampModel ===

impl LampModel {
    /// A lamp of which nothing is known but its past: burnt time and ignitions, as stored.
    pub fn new(config: LampConfig, burnt: Duration, ignitions: u32) -> LampModel {
        LampModel {
            config,
            burning_since: None,
            out_since: None,
            steady: None,
            readings: VecDeque::new(),
            burnt,
            ignitions,
        }
    }

    /// The state at `now`.
    pub fn state(&self, now: Instant) -> LampState {
        match (self.burning_since, self.out_since, self.steady) {
            (Some(_), _, Some(true)) => LampState::Steady,
            (Some(_), _, Some(false)) => LampState::Drifting,
            (Some(since), _, None) => LampState::Warming(since + self.config.warm_up),
            (None, Some(out), _) if now < out + self.config.restrike => LampState::Cooling(out + self.config.restrike),
            (None, Some(_), _) => LampState::Off,
            (None, None, _) => LampState::Unknown,
        }
    }

    /// True when light measured now means something.
    pub fn usable(&self, now: Instant) -> bool {
        self.state(now) == LampState::Steady
    }

    /// Whether a wish may be granted at `now`.
    ///
    /// # Errors
    /// Why not, and from when on.
    pub fn may(&self, wish: Wish, now: Instant) -> Result<(), Refusal> {
        match (wish, self.state(now)) {
            (Wish::On, LampState::Off) => Ok(()),
            // It may have been switched off just before the daemon began: the whole cooling time is waited for.
            (Wish::On, LampState::Unknown) => Err(Refusal::TooHot(now + self.config.restrike)),
            (Wish::On, LampState::Cooling(until)) => Err(Refusal::TooHot(until)),
            (Wish::On, _) | (Wish::Off, LampState::Off | LampState::Cooling(_)) => Err(Refusal::Already),
            (Wish::Off, _) => match self.burning_since.map(|since| since + self.config.shortest_on) {
                Some(until) if now < until => Err(Refusal::TooYoung(until)),
                _ => Ok(()),
            },
        }
    }

    /// Somebody switched the lamp at `now`. What it does, the readings tell.
    pub fn switched(&mut self, wish: Wish, now: Instant) {
        match wish {
            Wish::On => self.ignite(now),
            Wish::Off => self.extinguish(now),
        }
    }

    /// A reading of the light monitor. Saturated readings tell only that it burns.
    pub fn observe(&mut self, power_w: f64, saturated: bool, now: Instant) -> Option<LampEvent> {
        let last = self.readings.back().map(|(_, power)| *power);
        let threshold = last
            .map_or(self.config.burns_above_w, |last| (self.config.out_below * last).max(self.config.burns_above_w));
        let burns = saturated || power_w > threshold;
        match (self.burning_since, burns) {
            (None, false) => {
                self.out_since = self.out_since.or(Some(now));
                None
            }
            (None, true) => {
                self.ignite(now);
                self.keep(power_w, saturated, now);
                Some(LampEvent::Burns)
            }
            (Some(_), false) => {
                self.extinguish(now);
                Some(LampEvent::Lost)
            }
            (Some(since), true) => {
                self.keep(power_w, saturated, now);
                self.judge(since, now)
            }
        }
    }

    /// Relative change a minute over the last readings, by least squares; `None` before they span the whole time.
    pub fn slope_per_minute(&self) -> Option<f64> {
        let (first, last) = (self.readings.front()?.0, self.readings.back()?.0);
        if last - first < self.config.slope_over.mul_f64(0.95) {
            return None;
        }
        let minutes = |at: Instant| (at - first).as_secs_f64() / 60.0;
        let n = self.readings.len() as f64;
        let mean_t = self.readings.iter().map(|(at, _)| minutes(*at)).sum::<f64>() / n;
        let mean_p = self.readings.iter().map(|(_, power)| power).sum::<f64>() / n;
        let over = self.readings.iter().map(|(at, power)| (minutes(*at) - mean_t) * (power - mean_p)).sum::<f64>();
        let under = self.readings.iter().map(|(at, _)| (minutes(*at) - mean_t).powi(2)).sum::<f64>();
        Some(over / under / mean_p).filter(|slope| slope.is_finite())
    }

    /// Time it has burnt in its life.
    pub fn burnt(&self, now: Instant) -> Duration {
        let running = self.burning_since.and_then(|since| now.checked_duration_since(since));
        self.burnt + running.unwrap_or_default()
    }

    /// Times it was struck, as far as was seen.
    pub fn ignitions(&self) -> u32 {
        self.ignitions
    }

    /// True when it has burnt longer than its maker rates it for.
    pub fn worn(&self, now: Instant) -> bool {
        self.config.rated_hours.is_some_and(|hours| self.burnt(now).as_secs_f64() / 3600.0 > hours)
    }

    fn ignite(&mut self, now: Instant) {
        if self.burning_since.is_none() {
            self.ignitions = self.ignitions.saturating_add(1);
            self.burning_since = Some(now);
        }
        self.out_since = None;
        self.steady = None;
        self.readings.clear();
    }

    fn extinguish(&mut self, now: Instant) {
        self.burnt = self.burnt(now);
        self.burning_since = None;
        self.out_since = Some(now);
        self.steady = None;
        self.readings.clear();
    }

    fn keep(&mut self, power_w: f64, saturated: bool, now: Instant) {
        if saturated || self.readings.back().is_some_and(|(at, _)| now < *at + THIN) {
            return;
        }
        self.readings.push_back((now, power_w));
        while self.readings.len() > MAX_READINGS
            || self.readings.front().is_some_and(|(at, _)| *at + self.config.slope_over < now)
        {
            self.readings.pop_front();
        }
    }

    fn judge(&mut self, since: Instant, now: Instant) -> Option<LampEvent> {
        let flat = self.slope_per_minute()?.abs() <= self.config.steady_per_minute;
        match (self.steady, flat) {
            (None | Some(false), true) if now >= since + self.config.warm_up => {
                self.steady = Some(true);
                Some(LampEvent::Steady)
            }
            (Some(true), false) => {
                self.steady = Some(false);
                Some(LampEvent::Drifting)
            }
            _ => None,
        }
    }
}

#[cfg(test)]
#[path = "lamp_tests.rs"]
mod tests;
