//! How a discharge lamp behaves: out and cooling, cold, warming up, steady; and for how long it was seen burning.
//!
//! Source: the sheet `light-source-hmi`. No wire: the light readings are told to the model, which is a pure state machine
//! of time. After a start of the daemon the state is unknown until a reading tells whether it burns; a lamp found burning
//! is trusted only after the whole warm-up and a flat slope, one found out counts as hot: nobody knows when it went out.

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
    /// Largest relative slope of steady light, a minute.
    pub steady_per_minute: f64,
    /// Time over which the slope is judged.
    pub slope_over: Duration,
    /// Share of the light seen last below which the lamp is out.
    pub out_below: f64,
    /// Power on the monitor above which a lamp of unknown state burns, watts.
    pub burns_above_w: f64,
}

/// State of the lamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LampState {
    /// Nothing was seen yet.
    Unknown,
    /// Out, too hot to be struck before then. Light seen before then is not the lamp's.
    Cooling(Instant),
    /// Out, and cool enough to be struck.
    Off,
    /// Burns, not steady before then at the earliest.
    Warming(Instant),
    /// Burns steadily.
    Steady,
    /// Was steady; its light now changes faster than allowed.
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
    seen_burning: Option<Instant>,
    burnt: Duration,
    losses: u32,
}

// === impl LampConfig ===

impl Default for LampConfig {
    fn default() -> LampConfig {
        LampConfig {
            warm_up: Duration::from_secs(300),
            restrike: Duration::from_secs(900),
            steady_per_minute: 0.002,
            slope_over: Duration::from_secs(300),
            out_below: 0.1,
            burns_above_w: 1e-8,
        }
    }
}

// === impl LampModel ===

impl LampModel {
    /// A lamp of which nothing was seen yet.
    pub fn new(config: LampConfig) -> LampModel {
        LampModel {
            config,
            burning_since: None,
            out_since: None,
            steady: None,
            readings: VecDeque::new(),
            seen_burning: None,
            burnt: Duration::ZERO,
            losses: 0,
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

    /// What is known of the lamp.
    pub fn config(&self) -> &LampConfig {
        &self.config
    }

    /// True when light measured now means something.
    pub fn usable(&self, now: Instant) -> bool {
        self.state(now) == LampState::Steady
    }

    /// A reading of the light monitor. Saturated readings tell only that it burns.
    pub fn observe(&mut self, power_w: f64, saturated: bool, now: Instant) {
        let last = self.readings.back().map(|(_, power)| *power);
        let threshold = last
            .map_or(self.config.burns_above_w, |last| (self.config.out_below * last).max(self.config.burns_above_w));
        let burns = saturated || power_w > threshold;
        match (self.state(now), burns) {
            (LampState::Unknown, false) => self.out_since = Some(now),
            (LampState::Unknown | LampState::Off, true) => self.ignite(now),
            // A hot arc cannot burn.
            (LampState::Cooling(_), true) => return,
            (LampState::Off | LampState::Cooling(_), false) => {}
            (_, false) => self.extinguish(now),
            (_, true) => {}
        }
        if let (Some(since), true) = (self.burning_since, burns) {
            self.count(now);
            self.keep(power_w, saturated, now);
            self.judge(since, now);
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

    /// Time it was seen burning. Between two readings of a burning lamp it burnt all the time, unless it could have gone
    /// out, cooled and been struck again in between: such a gap is not counted.
    pub fn burnt(&self) -> Duration {
        self.burnt
    }

    /// Times it was seen going out.
    pub fn losses(&self) -> u32 {
        self.losses
    }

    fn ignite(&mut self, now: Instant) {
        (self.burning_since, self.out_since) = (Some(now), None);
        self.forget();
    }

    fn extinguish(&mut self, now: Instant) {
        (self.burning_since, self.out_since) = (None, Some(now));
        self.losses = self.losses.saturating_add(1);
        self.forget();
    }

    fn forget(&mut self) {
        (self.steady, self.seen_burning) = (None, None);
        self.readings.clear();
    }

    fn count(&mut self, now: Instant) {
        let since = self.seen_burning.replace(now).map(|seen| now.saturating_duration_since(seen));
        self.burnt += since.filter(|since| *since < self.config.restrike).unwrap_or_default();
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

    fn judge(&mut self, since: Instant, now: Instant) {
        let Some(slope) = self.slope_per_minute() else { return };
        let flat = slope.abs() <= self.config.steady_per_minute;
        match (self.steady, flat) {
            (None | Some(false), true) if now >= since + self.config.warm_up => self.steady = Some(true),
            (Some(true), false) => self.steady = Some(false),
            _ => {}
        }
    }
}

#[cfg(test)]
#[path = "lamp_tests.rs"]
mod tests;
