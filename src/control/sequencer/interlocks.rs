//! Interlocks: from a set of readings with their ages to the set of warnings and alarms they mean. Pure, level-triggered.
//!
//! A warning suspends the run until it is gone; an alarm makes the bench safe and ends the run. Nothing is remembered:
//! each evaluation sees the levels as they are, and two conditions at once are two members of a set.

use crate::config::night::Interlocks;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::time::Instant;

/// A reading that was asked for and did not come for more than so many periods is an alarm.
pub const SILENT_PERIODS: u32 = 3;

/// Why exposures must wait, or the run must end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reason {
    /// The lamp's warm-up is not over.
    LampWarming,
    /// The lamp is out: somebody must strike it, once it has cooled.
    LampOut,
    /// The light monitor reads another level than at the start.
    LampUnsteady,
    /// A device is too warm.
    Temperature,
    /// The door contact is open.
    Door,
    /// The run's disk has too little room, or none.
    Disk,
    /// A reading does not come any more, or never came.
    Silent,
    /// A device is lost and waited for.
    DeviceLost,
}

/// What is read.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Gauge {
    /// Seconds since the run began.
    LampOn,
    /// Power of the light monitor over that at the start, or since the lamp was struck again, less one.
    Light,
    /// State of the lamp by its light, one of [`Gauge::LAMP_STEADY`] and its like.
    Lamp,
    /// 1 while the light monitor reads a power that cannot be the lamp's, else 0.
    LightRange,
    /// Temperature of this device, degrees Celsius.
    Temperature(String),
    /// 1 while the door contact is open, else 0.
    Door,
    /// Free room of the run's disk, megabytes.
    FreeDisk,
}

/// One gauge at the moment of evaluation.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// What was read.
    pub gauge: Gauge,
    /// Its last value; `None` when there was none yet.
    pub value: Option<f64>,
    /// For how long it was asked and did not answer; zero after an answer.
    pub silent: Duration,
}

/// One condition that holds.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Trip {
    /// What it means for the run.
    pub reason: Reason,
    /// Whose reading it is.
    pub gauge: Gauge,
}

/// All conditions that hold at once.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Trips {
    /// They suspend.
    pub warnings: BTreeSet<Trip>,
    /// They end the run.
    pub alarms: BTreeSet<Trip>,
}

/// The last value of each gauge, and since when it is silent.
#[derive(Debug, Clone, Default)]
pub struct Gauges {
    known: BTreeMap<Gauge, (Option<f64>, Option<Instant>)>,
}

// === impl Reason ===

impl Reason {
    /// All reasons.
    pub const ALL: [Reason; 8] = [
        Reason::LampWarming,
        Reason::LampOut,
        Reason::LampUnsteady,
        Reason::Temperature,
        Reason::Door,
        Reason::Disk,
        Reason::Silent,
        Reason::DeviceLost,
    ];

    /// The reason's name, as in the journal.
    pub fn name(self) -> &'static str {
        match self {
            Reason::LampWarming => "lamp-warming",
            Reason::LampOut => "lamp-out",
            Reason::LampUnsteady => "lamp-unsteady",
            Reason::Temperature => "temperature",
            Reason::Door => "door",
            Reason::Disk => "disk",
            Reason::Silent => "silent",
            Reason::DeviceLost => "device-lost",
        }
    }
}

// === impl Gauge ===

impl Gauge {
    /// The lamp burns steadily.
    pub const LAMP_STEADY: f64 = 0.0;
    /// The lamp warms up, or nothing is known of it yet.
    pub const LAMP_WARMING: f64 = 1.0;
    /// The lamp was steady and its light changes now.
    pub const LAMP_DRIFTING: f64 = 2.0;
    /// The lamp is out.
    pub const LAMP_OUT: f64 = 3.0;
}

// === impl Trips ===

impl Trips {
    /// The reasons to suspend.
    pub fn reasons(&self) -> BTreeSet<Reason> {
        self.warnings.iter().map(|trip| trip.reason).collect()
    }

    /// The alarms in words.
    pub fn alarm(&self) -> Option<String> {
        let words: Vec<String> = self.alarms.iter().map(|t| format!("{} ({:?})", t.reason.name(), t.gauge)).collect();
        (!words.is_empty()).then(|| format!("interlock alarm: {}", words.join(", ")))
    }
}

// === impl Gauges ===

impl Gauges {
    /// A gauge that must answer; silent from `now` on until it does.
    pub fn expect(&mut self, gauge: Gauge, now: Instant) {
        self.known.entry(gauge).or_insert((None, Some(now)));
    }

    /// An answer; a value that is no number is none.
    pub fn answered(&mut self, gauge: Gauge, value: f64, now: Instant) {
        if value.is_finite() {
            self.known.insert(gauge, (Some(value), None));
        } else {
            self.missed(gauge, now);
        }
    }

    /// No answer, or an error; silence counts from the first of them.
    pub fn missed(&mut self, gauge: Gauge, now: Instant) {
        self.known.entry(gauge).or_insert((None, Some(now))).1.get_or_insert(now);
    }

    /// The gauge's last value.
    pub fn value(&self, gauge: &Gauge) -> Option<f64> {
        self.known.get(gauge)?.0
    }

    /// All gauges as they stand at `now`.
    pub fn readings(&self, now: Instant) -> Vec<Reading> {
        let silent = |since: &Option<Instant>| since.map_or(Duration::ZERO, |s| now.saturating_duration_since(s));
        let reading = |(gauge, (value, since)): (&Gauge, &(Option<f64>, Option<Instant>))| Reading {
            gauge: gauge.clone(),
            value: *value,
            silent: silent(since),
        };
        self.known.iter().map(reading).collect()
    }
}

/// What the readings mean together.
pub fn evaluate(readings: &[Reading], limits: &Interlocks) -> Trips {
    let mut trips = Trips::default();
    for reading in readings {
        let trip = |reason| Trip { reason, gauge: reading.gauge.clone() };
        if reading.silent >= limits.period() * SILENT_PERIODS {
            trips.alarms.insert(trip(Reason::Silent));
        }
        let Some(value) = reading.value else {
            trips.warnings.insert(trip(Reason::Silent));
            continue;
        };
        let (reason, warning, alarm) = judge(&reading.gauge, value, limits);
        if alarm {
            trips.alarms.insert(trip(reason));
        } else if warning {
            trips.warnings.insert(trip(reason));
        }
    }
    trips
}

/// What a value means: reason, warning, alarm.
fn judge(gauge: &Gauge, value: f64, limits: &Interlocks) -> (Reason, bool, bool) {
    let above = |limit: Option<f64>| limit.is_some_and(|l| value >= l);
    let below = |limit: Option<f64>| limit.is_some_and(|l| value <= l);
    let beyond = |limit: Option<f64>| limit.is_some_and(|l| value.abs() >= l);
    match gauge {
        Gauge::LampOn => (Reason::LampWarming, value < limits.warm_up_s, false),
        Gauge::Light => (Reason::LampUnsteady, beyond(limits.lamp_drift_warning), beyond(limits.lamp_drift_alarm)),
        Gauge::Lamp if value >= Gauge::LAMP_OUT => (Reason::LampOut, true, false),
        Gauge::Lamp if value >= Gauge::LAMP_DRIFTING => (Reason::LampUnsteady, true, false),
        Gauge::Lamp => (Reason::LampWarming, value >= Gauge::LAMP_WARMING, false),
        Gauge::LightRange => (Reason::LampUnsteady, false, value >= 0.5),
        Gauge::Temperature(_) => {
            (Reason::Temperature, above(limits.temperature_warning_c), above(limits.temperature_alarm_c))
        }
        Gauge::Door => (Reason::Door, false, value >= 0.5),
        Gauge::FreeDisk => (Reason::Disk, below(limits.free_disk_warning_mb), below(limits.free_disk_alarm_mb)),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    fn limits() -> Interlocks {
        Interlocks {
            period_s: 10.0,
            warm_up_s: 60.0,
            lamp_drift_warning: Some(0.02),
            lamp_drift_alarm: Some(0.2),
            temperature_warning_c: Some(40.0),
            temperature_alarm_c: Some(55.0),
            door: true,
            free_disk_warning_mb: Some(500.0),
            free_disk_alarm_mb: Some(50.0),
            ..Interlocks::default()
        }
    }

    /// A small generator, so that the seed in a failure's text is all that is needed to see it again.
    struct Dice(u64);

    impl Dice {
        fn roll(&mut self, sides: u64) -> u64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 33) % sides
        }
    }

    fn gauges() -> [Gauge; 8] {
        let t = |name: &str| Gauge::Temperature(name.to_owned());
        let lamp = [Gauge::LampOn, Gauge::Light, Gauge::Lamp, Gauge::LightRange];
        let [on, light, state, range] = lamp;
        [on, light, state, range, t("ccd"), t("ingaas"), Gauge::Door, Gauge::FreeDisk]
    }

    /// Values at these levels: 0 well, 1 warning, 2 alarm (where the gauge has one).
    fn value(gauge: &Gauge, level: u64, dice: &mut Dice) -> f64 {
        let part = dice.roll(1000) as f64 / 1000.0;
        match (gauge, level) {
            (Gauge::LampOn, 0) => 60.0 + 1e5 * part,
            (Gauge::LampOn, _) => 59.9 * part,
            (Gauge::Light, 0) => 0.039 * (part - 0.5),
            (Gauge::Light, 1) => (0.02 + 0.17 * part) * if dice.roll(2) == 0 { 1.0 } else { -1.0 },
            (Gauge::Light, _) => (0.2 + part) * if dice.roll(2) == 0 { 1.0 } else { -1.0 },
            (Gauge::Lamp, 0) => Gauge::LAMP_STEADY,
            (Gauge::Lamp, 1) => Gauge::LAMP_DRIFTING,
            (Gauge::Lamp, _) => Gauge::LAMP_OUT,
            (Gauge::Temperature(_), 0) => 39.9 * part,
            (Gauge::Temperature(_), 1) => 40.0 + 14.9 * part,
            (Gauge::Temperature(_), _) => 55.0 + 50.0 * part,
            (Gauge::Door | Gauge::LightRange, 0 | 1) => 0.0,
            (Gauge::Door | Gauge::LightRange, _) => 1.0,
            (Gauge::FreeDisk, 0) => 501.0 + 1e6 * part,
            (Gauge::FreeDisk, 1) => 51.0 + 449.0 * part,
            (Gauge::FreeDisk, _) => 50.0 * part,
        }
    }

    /// Scenes of 20 periods: tripped at the start, several at once, flapping each period, going silent. Every trip that
    /// holds at an evaluation must be seen at that evaluation, and nothing else.
    #[test]
    fn of_ten_thousand_scenes_no_trip_is_missed_and_none_is_invented() {
        let limits = limits();
        let start = Instant::now();
        let (mut trips_seen, mut silences, mut at_once) = (0_u32, 0_u32, 0_u32);
        for seed in 0..10_000 {
            let mut dice = Dice(seed);
            let mut known = Gauges::default();
            let mut levels: BTreeMap<Gauge, (u64, Option<u32>)> = BTreeMap::new();
            gauges().into_iter().for_each(|g| known.expect(g, start));
            for period in 0..20_u32 {
                let now = start + limits.period() * period;
                for gauge in gauges() {
                    let (mut level, mut since) = levels.get(&gauge).copied().unwrap_or((9, Some(0)));
                    if dice.roll(5) == 0 {
                        known.missed(gauge.clone(), now);
                        since = since.or(Some(period));
                    } else if since.is_none() || level == 9 || dice.roll(4) > 0 {
                        level = dice.roll(3);
                        known.answered(gauge.clone(), value(&gauge, level, &mut dice), now);
                        since = None;
                    } else {
                        known.missed(gauge.clone(), now);
                    }
                    levels.insert(gauge, (level, since));
                }
                let trips = evaluate(&known.readings(now), &limits);
                let mut expected = Trips::default();
                for (gauge, (level, since)) in &levels {
                    let (warning, alarm) = expected_of(gauge, *level);
                    let trip = |reason| Trip { reason, gauge: gauge.clone() };
                    expected.warnings.extend(warning.map(trip));
                    expected.alarms.extend(alarm.map(trip));
                    if since.is_some_and(|s| period - s >= SILENT_PERIODS) {
                        expected.alarms.insert(trip(Reason::Silent));
                        silences += 1;
                    }
                }
                assert_eq!(trips, expected, "seed {seed}, period {period}");
                trips_seen += (trips.warnings.len() + trips.alarms.len()) as u32;
                at_once += u32::from(trips.warnings.len() + trips.alarms.len() > 1);
            }
        }
        assert!(trips_seen > 100_000 && silences > 1000 && at_once > 10_000, "{trips_seen} {silences} {at_once}");
    }

    fn expected_of(gauge: &Gauge, level: u64) -> (Option<Reason>, Option<Reason>) {
        let reason = match gauge {
            Gauge::LampOn => Reason::LampWarming,
            Gauge::Light | Gauge::Lamp | Gauge::LightRange => Reason::LampUnsteady,
            Gauge::Temperature(_) => Reason::Temperature,
            Gauge::Door => Reason::Door,
            Gauge::FreeDisk => Reason::Disk,
        };
        match (gauge, level) {
            (_, 9) => (Some(Reason::Silent), None),
            (_, 0) | (Gauge::Door | Gauge::LightRange, 1) => (None, None),
            (Gauge::Lamp, 2) => (Some(Reason::LampOut), None),
            (Gauge::LampOn, _) | (_, 1) => (Some(reason), None),
            _ => (None, Some(reason)),
        }
    }

    #[test]
    fn a_lamp_that_warms_up_is_waited_for() {
        let (mut known, now) = (Gauges::default(), Instant::now());
        known.answered(Gauge::Lamp, Gauge::LAMP_WARMING, now);
        let trips = evaluate(&known.readings(now), &limits());
        assert_eq!((trips.reasons(), trips.alarm()), ([Reason::LampWarming].into(), None));
    }

    #[test]
    fn a_value_that_is_no_number_is_no_answer() {
        let (mut known, now) = (Gauges::default(), Instant::now());
        known.answered(Gauge::Light, 0.0, now);
        known.answered(Gauge::Light, f64::NAN, now);
        let trips = evaluate(&known.readings(now + Duration::from_secs(30)), &limits());
        assert_eq!(trips.alarms.first().map(|t| t.reason), Some(Reason::Silent));
        assert!(trips.alarm().is_some_and(|words| words.contains("silent")));
    }
}
