//! What the lamp takes from a run besides its forecast, and the lamp in words.

use super::night::stamp;
use crate::control::events::{Event, LampNow, Stamped};
use goniod_drivers::clock::UtcMicros;

/// How long a lamp that went out holds a run up. The first warm-up is no part of it: the forecast has that.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LampWait {
    /// Time it has taken, over and done with, microseconds.
    taken_us: i64,
    /// Since when it takes more, and what it did last.
    holds: Option<(UtcMicros, LampNow)>,
}

/// The lamp in one sentence.
pub fn words(lamp: &LampNow) -> String {
    let clock = |utc: &UtcMicros| stamp(*utc).strftime("%H:%M:%S UTC").to_string();
    match lamp {
        LampNow::Cooling { strike_from, .. } => {
            format!(
                "the lamp is out and hot: strike it from {} on, not before; the run then goes on",
                clock(strike_from)
            )
        }
        LampNow::Off { .. } => "the lamp is out and cool: strike it; the run then goes on".to_owned(),
        LampNow::Warming { steady_from } => {
            format!("the lamp warms up: steady at {} at the earliest", clock(steady_from))
        }
        LampNow::Steady => "the lamp is steady".to_owned(),
        LampNow::Drifting => "the lamp is not steady any more".to_owned(),
    }
}

// === impl LampWait ===

impl LampWait {
    /// Takes note of an event of the run.
    pub fn note(&mut self, stamped: &Stamped) {
        match &stamped.event {
            Event::Lamp { lamp: lamp @ (LampNow::Cooling { .. } | LampNow::Off { .. }) } => {
                let since = self.holds.as_ref().map_or(stamped.utc, |(since, _)| *since);
                self.holds = Some((since, lamp.clone()));
            }
            Event::Lamp { lamp: lamp @ LampNow::Warming { .. } } => {
                self.holds.iter_mut().for_each(|(_, now)| now.clone_from(lamp));
            }
            Event::Lamp { lamp: LampNow::Steady | LampNow::Drifting } => {
                self.taken_us += self.holds.take().map_or(0, |(since, _)| stamped.utc.0 - since.0);
            }
            _ => {}
        }
    }

    /// Seconds that it has taken until `now`.
    pub fn taken_s(&self, now: UtcMicros) -> f64 {
        let holds_us = self.holds.as_ref().map_or(0, |(since, _)| now.0 - since.0);
        (self.taken_us + holds_us) as f64 / 1e6
    }

    /// Seconds that it will still take, if it is struck as soon as it may be.
    pub fn ahead_s(&self, now: UtcMicros) -> f64 {
        let until_s = |utc: &UtcMicros| ((utc.0 - now.0) as f64 / 1e6).max(0.0);
        match self.holds.as_ref().map(|(_, lamp)| lamp) {
            Some(LampNow::Cooling { strike_from, warm_up_s }) => until_s(strike_from) + warm_up_s,
            Some(LampNow::Off { warm_up_s }) => *warm_up_s,
            Some(LampNow::Warming { steady_from }) => until_s(steady_from),
            _ => 0.0,
        }
    }

    /// What the lamp does, while the run waits for it.
    pub fn told(&self) -> Option<String> {
        self.holds.as_ref().map(|(_, lamp)| words(lamp))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(wait: &mut LampWait, at_s: i64, lamp: LampNow) {
        let event = Event::Lamp { lamp };
        wait.note(&Stamped { seq: 0, utc: UtcMicros(at_s * 1_000_000), event });
    }

    #[test]
    fn a_lamp_that_is_out_takes_its_cooling_the_operators_time_and_its_warm_up() {
        let at = |s: i64| UtcMicros(s * 1_000_000);
        let mut wait = LampWait::default();
        told(&mut wait, 0, LampNow::Warming { steady_from: at(300) });
        told(&mut wait, 300, LampNow::Steady);
        assert_eq!((wait.taken_s(at(400)), wait.ahead_s(at(400))), (0.0, 0.0), "the forecast has the first warm-up");
        told(&mut wait, 1000, LampNow::Cooling { strike_from: at(1900), warm_up_s: 300.0 });
        assert_eq!((wait.taken_s(at(1100)), wait.ahead_s(at(1100))), (100.0, 800.0 + 300.0));
        assert!(wait.told().is_some_and(|words| words.contains("from 00:31:40 UTC on")), "{:?}", wait.told());
        told(&mut wait, 1900, LampNow::Off { warm_up_s: 300.0 });
        assert_eq!((wait.taken_s(at(2500)), wait.ahead_s(at(2500))), (1500.0, 300.0), "nobody has struck it yet");
        told(&mut wait, 2600, LampNow::Warming { steady_from: at(2900) });
        assert_eq!(wait.ahead_s(at(2700)), 200.0);
        told(&mut wait, 2900, LampNow::Steady);
        assert_eq!((wait.taken_s(at(9000)), wait.ahead_s(at(9000)), wait.told()), (1900.0, 0.0, None));
    }
}
