//! The lamp's level through the night, from the light monitor's readings in the journal: what a view is scaled by.

use crate::archive::rows::EventRow;
use crate::control::events::{Event, LampNow};

/// One level of the lamp.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Level {
    utc_us: i64,
    power_w: f64,
    u_w: f64,
}

/// The levels of a run in order of time.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LightCurve {
    levels: Vec<Level>,
}

/// What a view is scaled by, so that it is as under the level of the first reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriftFactor {
    /// Level of the first reading over that in the middle of the view.
    pub factor: f64,
    /// Relative standard uncertainty of the factor.
    pub relative_u: f64,
}

// === impl LightCurve ===

impl LightCurve {
    /// The readings of a journal; empty where it has none. What was read of a lamp that was out or warming up is no
    /// level: nothing is exposed then, and the first level is what everything is scaled to.
    pub fn of(events: &[EventRow]) -> LightCurve {
        let mut warm = true;
        let level = |row: &EventRow| match serde_json::from_str(&row.json) {
            Ok(Event::LightRead { power_w, u_w, .. }) if warm && power_w > 0.0 && u_w.is_finite() => {
                Some(Level { utc_us: row.utc_us, power_w, u_w })
            }
            Ok(Event::Lamp { lamp }) => {
                warm = matches!(lamp, LampNow::Steady | LampNow::Drifting);
                None
            }
            Ok(Event::RunStarted { .. }) => {
                warm = true;
                None
            }
            _ => None,
        };
        let telling = |row: &&EventRow| ["light-read", "lamp", "run-started"].contains(&row.kind.as_str());
        let mut levels: Vec<Level> = events.iter().filter(telling).filter_map(level).collect();
        levels.sort_by_key(|level| level.utc_us);
        LightCurve { levels }
    }

    /// The factor for a view that lasts from `begin_us` to `end_us`; `None` without readings.
    ///
    /// The level in its middle lies on the straight line between the readings around it. Its uncertainty has the scatter
    /// of the readings and, as a rectangular distribution, the change of the level from beginning to end.
    pub fn factor(&self, begin_us: i64, end_us: i64) -> Option<DriftFactor> {
        let reference = self.levels.first()?;
        let middle = self.at(begin_us + (end_us - begin_us) / 2)?;
        let change = (self.at(end_us)?.power_w - self.at(begin_us)?.power_w) / middle.power_w;
        let scatter = (middle.u_w / middle.power_w).hypot(reference.u_w / reference.power_w);
        Some(DriftFactor {
            factor: reference.power_w / middle.power_w,
            relative_u: scatter.hypot(change / 12.0_f64.sqrt()),
        })
    }

    fn at(&self, utc_us: i64) -> Option<Level> {
        let after = self.levels.partition_point(|level| level.utc_us <= utc_us);
        let (before, after) = (after.checked_sub(1).and_then(|i| self.levels.get(i)), self.levels.get(after));
        match (before, after) {
            (Some(a), Some(b)) => {
                let w = (utc_us - a.utc_us) as f64 / (b.utc_us - a.utc_us) as f64;
                let power_w = (1.0 - w) * a.power_w + w * b.power_w;
                Some(Level { utc_us, power_w, u_w: ((1.0 - w) * a.u_w).hypot(w * b.u_w) })
            }
            (one, other) => one.or(other).copied(),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    fn row(utc_us: i64, power_w: f64, u_w: f64) -> EventRow {
        let event = Event::LightRead { view: None, power_w, u_w };
        EventRow { seq: 0, utc_us, kind: event.kind().to_owned(), json: serde_json::to_string(&event).unwrap() }
    }

    #[test]
    fn a_view_is_scaled_to_the_level_of_the_first_reading() {
        let curve = LightCurve::of(&[row(0, 2.0, 0.0), row(1000, 1.0, 0.0)]);
        let at_end = curve.factor(1000, 1000).unwrap();
        assert_eq!((at_end.factor, at_end.relative_u), (2.0, 0.0));
        let between = curve.factor(250, 750).unwrap();
        assert!((between.factor - 2.0 / 1.5).abs() < 1e-12);
        assert!((between.relative_u - (0.5 / 1.5) / 12.0_f64.sqrt()).abs() < 1e-12, "the change within the view");
        assert_eq!(curve.factor(5000, 6000).unwrap().factor, 2.0, "beyond the last reading it holds");
    }

    #[test]
    fn a_lamp_that_is_out_or_warms_up_gives_no_level() {
        let lamp = |utc_us, lamp| {
            let event = Event::Lamp { lamp };
            EventRow { seq: 0, utc_us, kind: event.kind().to_owned(), json: serde_json::to_string(&event).unwrap() }
        };
        let warming = || LampNow::Warming { steady_from: goniod_drivers::clock::UtcMicros(2000) };
        let rows = [
            lamp(0, warming()),
            row(0, 0.3, 0.0),
            lamp(2000, LampNow::Steady),
            row(2000, 1.0, 0.0),
            lamp(3000, LampNow::Off { warm_up_s: 1.0 }),
            row(3000, 1e-9, 0.0),
            lamp(4000, warming()),
            row(4000, 0.3, 0.0),
            lamp(6000, LampNow::Steady),
            row(6000, 0.5, 0.0),
        ];
        let curve = LightCurve::of(&rows);
        assert_eq!(curve.factor(2000, 2000).unwrap().factor, 1.0);
        assert_eq!(curve.factor(6000, 7000).unwrap().factor, 2.0);
    }

    #[test]
    fn scatter_of_both_readings_is_in_the_uncertainty_and_no_reading_is_no_factor() {
        let curve = LightCurve::of(&[row(0, 1.0, 0.003), row(1000, 1.0, 0.004)]);
        assert!((curve.factor(2000, 2000).unwrap().relative_u - 0.005).abs() < 1e-12);
        assert_eq!(LightCurve::of(&[]).factor(0, 1), None);
    }
}
