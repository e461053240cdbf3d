//! What the readings of the light monitor say of the lamp: whether it burns and is steady, and whether the power can be
//! its own at all.

use super::interlocks::Gauge;
use crate::config::instrument::Instrument;
use crate::config::night::{Interlocks, seconds};
use crate::control::events::LampNow;
use crate::control::lamp_hours::LampLog;
use goniod_drivers::clock::{Clock, UtcMicros};
use goniod_drivers::contract::LightReading;
use goniod_drivers::devices::lamp::{LampConfig, LampModel, LampState};
use std::time::Duration;
use tokio::time::Instant;

/// Time over which the slope of the light is judged, where the warm-up is not shorter.
const SLOPE_OVER: Duration = Duration::from_secs(300);
/// Readings that a slope needs at least, by the period of the interlocks.
const SLOPE_PERIODS: u32 = 3;

/// What the instrument file says of lamp and light.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LightRules {
    /// The lamp, where its warm-up is known.
    pub lamp: Option<LampConfig>,
    /// Power below which the light is too weak to be the lamp's, watts.
    pub min_w: Option<f64>,
    /// Power above which something is wrong, watts.
    pub max_w: Option<f64>,
    /// Where the hours of the lamp are kept.
    pub hours: Option<LampLog>,
}

/// The light of a run under way.
pub(super) struct Light {
    rules: LightRules,
    lamp: LampModel,
    last_w: Option<f64>,
}

// === impl LightRules ===

impl LightRules {
    /// The rules of an instrument; none without a light monitor.
    pub fn of(instrument: &Instrument) -> LightRules {
        let Some(monitor) = &instrument.light_monitor else { return LightRules::default() };
        let period = instrument.interlocks.as_ref().map_or(Interlocks::default().period(), Interlocks::period);
        let lamp = instrument.lamp.warm_up_s.map(|warm_up_s| {
            let warm_up = seconds(warm_up_s);
            LampConfig {
                warm_up,
                slope_over: warm_up.min(SLOPE_OVER).max(period * SLOPE_PERIODS),
                restrike: instrument.lamp.restrike_s.map_or(LampConfig::default().restrike, seconds),
                ..LampConfig::default()
            }
        });
        LightRules { lamp, min_w: monitor.min_w, max_w: monitor.max_w, hours: None }
    }
}

// === impl Light ===

impl Light {
    /// Nothing was read yet.
    pub(super) fn new(rules: LightRules) -> Light {
        let lamp = LampModel::new(rules.lamp.unwrap_or_default());
        Light { rules, lamp, last_w: None }
    }

    /// True when the lamp must be watched before its first level counts.
    pub(super) fn has_lamp(&self) -> bool {
        self.rules.lamp.is_some()
    }

    /// Time it was seen burning.
    pub(super) fn burnt(&self) -> Duration {
        self.lamp.burnt()
    }

    /// The lamp, where its warm-up is known.
    fn judged(&self) -> Option<&LampModel> {
        self.rules.lamp.map(|_| &self.lamp)
    }

    /// A reading came.
    pub(super) fn read(&mut self, reading: &LightReading, now: Instant) {
        self.last_w = Some(reading.power_w).filter(|_| !reading.saturated);
        self.lamp.observe(reading.power_w, reading.saturated, now);
    }

    /// True while levels mean something: the lamp is steady, or nothing is known of lamps here.
    pub(super) fn settled(&self, now: Instant) -> bool {
        self.judged().is_none_or(|lamp| lamp.usable(now))
    }

    /// True while a level may be compared with another: the lamp burns and is warm, or nothing is known of lamps here.
    pub(super) fn warm(&self, now: Instant) -> bool {
        let state = self.judged().map(|lamp| lamp.state(now));
        matches!(state, None | Some(LampState::Steady | LampState::Drifting))
    }

    /// Times the lamp was seen going out.
    pub(super) fn losses(&self) -> u32 {
        self.judged().map_or(0, LampModel::losses)
    }

    /// How long a lamp that is not steady may take at most to be so, besides the time until somebody strikes it.
    pub(super) fn lock_out(&self, now: Instant) -> Duration {
        let lamp = self.judged().filter(|lamp| !lamp.usable(now));
        lamp.map_or(Duration::ZERO, |lamp| lamp.config().restrike + lamp.config().warm_up)
    }

    /// The lamp in words for events, where it is judged and something was seen of it.
    pub(super) fn now(&self, clock: Clock) -> Option<LampNow> {
        let lamp = self.judged()?;
        let now = clock.now();
        let stamp = |at: Instant| UtcMicros(clock.utc().0 + at.saturating_duration_since(now).as_micros() as i64);
        let warm_up_s = lamp.config().warm_up.as_secs_f64();
        Some(match lamp.state(now) {
            LampState::Unknown => return None,
            LampState::Cooling(until) => LampNow::Cooling { strike_from: stamp(until), warm_up_s },
            LampState::Off => LampNow::Off { warm_up_s },
            LampState::Warming(until) => LampNow::Warming { steady_from: stamp(until) },
            LampState::Steady => LampNow::Steady,
            LampState::Drifting => LampNow::Drifting,
        })
    }

    /// The gauges that follow from the readings so far.
    pub(super) fn gauges(&self, now: Instant) -> Vec<(Gauge, f64)> {
        let mut all = Vec::new();
        if let Some(lamp) = self.judged() {
            let value = match lamp.state(now) {
                LampState::Steady => Gauge::LAMP_STEADY,
                LampState::Unknown | LampState::Warming(_) => Gauge::LAMP_WARMING,
                LampState::Drifting => Gauge::LAMP_DRIFTING,
                LampState::Off | LampState::Cooling(_) => Gauge::LAMP_OUT,
            };
            all.push((Gauge::Lamp, value));
        }
        let LightRules { min_w, max_w, .. } = self.rules;
        if let Some(power_w) = self.last_w.filter(|_| self.warm(now) && (min_w.is_some() || max_w.is_some())) {
            let beyond = min_w.is_some_and(|min| power_w < min) || max_w.is_some_and(|max| power_w > max);
            all.push((Gauge::LightRange, f64::from(u8::from(beyond))));
        }
        all
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::config::instrument::LightMonitor;
    use crate::config::testing::{instrument, light_monitor};
    use goniod_drivers::units::Nanometres;

    fn reading(power_w: f64, saturated: bool, at: Instant) -> LightReading {
        LightReading { power_w, wavelength: Nanometres(550.0), saturated, at }
    }

    fn rules() -> LightRules {
        let lamp = LampConfig {
            warm_up: Duration::from_secs(120),
            slope_over: Duration::from_secs(120),
            ..LampConfig::default()
        };
        LightRules { lamp: Some(lamp), min_w: Some(1e-4), max_w: Some(1e-2), hours: None }
    }

    /// Readings of `power_w` every 10 s from second `from` to `to`; the gauges after the last.
    fn after(light: &mut Light, begun: Instant, from: u64, to: u64, power_w: f64) -> Vec<(Gauge, f64)> {
        let at = |s: u64| begun + Duration::from_secs(s);
        (from..=to).step_by(10).for_each(|s| light.read(&reading(power_w, false, at(s)), at(s)));
        light.gauges(at(to))
    }

    #[test]
    fn a_lamp_warms_up_is_steady_drifts_and_goes_out() {
        let (mut light, t) = (Light::new(rules()), Instant::now());
        assert_eq!(light.gauges(t), [(Gauge::Lamp, Gauge::LAMP_WARMING)], "nothing is known before the first reading");
        assert_eq!(after(&mut light, t, 0, 110, 1e-3), [(Gauge::Lamp, Gauge::LAMP_WARMING)]);
        assert!(!light.settled(t + Duration::from_secs(110)));
        let steady = [(Gauge::Lamp, Gauge::LAMP_STEADY), (Gauge::LightRange, 0.0)];
        assert_eq!(after(&mut light, t, 120, 200, 1e-3), steady);
        assert_eq!(after(&mut light, t, 210, 230, 1.1e-3)[0], (Gauge::Lamp, Gauge::LAMP_DRIFTING));
        assert_eq!(after(&mut light, t, 240, 240, 1e-9)[0], (Gauge::Lamp, Gauge::LAMP_OUT));
    }

    #[test]
    fn a_power_that_cannot_be_the_lamps_is_beyond_its_range() {
        let t = Instant::now();
        for (power_w, beyond) in [(9e-5, 1.0), (1e-4, 0.0), (1e-2, 0.0), (1.1e-2, 1.0)] {
            let mut light = Light::new(LightRules { lamp: None, ..rules() });
            assert!(light.settled(t) && light.gauges(t).is_empty());
            light.read(&reading(power_w, false, t), t);
            assert_eq!(light.gauges(t), [(Gauge::LightRange, beyond)], "{power_w}");
            light.read(&reading(power_w, true, t), t);
            assert!(light.gauges(t).is_empty(), "a saturated reading is no power");
        }
    }

    #[test]
    fn the_rules_are_those_of_the_instrument_file() {
        let mut i = instrument();
        i.lamp.warm_up_s = Some(600.0);
        i.light_monitor = Some(LightMonitor { min_w: Some(1e-6), ..light_monitor() });
        let rules = LightRules::of(&i);
        assert_eq!(rules.lamp.unwrap().warm_up, Duration::from_secs(600));
        assert_eq!((rules.lamp.unwrap().slope_over, rules.min_w), (SLOPE_OVER, Some(1e-6)));
        i.lamp.warm_up_s = None;
        assert_eq!(LightRules::of(&i).lamp, None, "a lamp of unknown warm-up is not judged");
        i.light_monitor = None;
        assert_eq!(LightRules::of(&i), LightRules::default());
    }
}
