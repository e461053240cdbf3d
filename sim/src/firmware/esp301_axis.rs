//! One axis of an ESP301 twin: the stage's mechanics, and what the controller knows of it.

use super::esp301_settings::{Settings, defaults};
use super::motion::Track;
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::Instant;

/// How far past the home switch a search runs before it turns round, degrees.
const HOME_PAST: f64 = 1.0;
/// How long the axis rests between the phases of a search when `MD?` gives way.
const PHASE_REST: Duration = Duration::from_millis(150);

/// Mechanics and controller state of one axis.
#[derive(Debug)]
pub(super) struct EspAxis {
    /// Model text of the stage.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// Where the stage really is, degrees from its home switch.
    pub track: Track,
    /// Counter = true angle - offset.
    pub offset: f64,
    /// Motor on.
    pub motor: bool,
    /// All settings by mnemonic.
    pub settings: Settings,
    /// Commanded position, counter.
    pub target: f64,
    /// Rests between home phases as `MD?` 1.
    pub home_glitch: bool,
    /// The stage jams at this true angle.
    pub jam_at: Option<f64>,
    /// The next move ends so much off.
    pub overshoot: f64,
    /// The next move never seems to end.
    pub never_done: bool,
    stuck: bool,
    pending: Option<(Instant, Pending)>,
}

/// What happens by itself at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Pending {
    SwitchPassed,
    SwitchBack,
    HomeFound,
    Jammed,
    SoftLimit(u8),
    HardLimit(u8),
}

// === impl EspAxis ===

impl EspAxis {
    /// An axis powered up at `now`, its stage standing at `start_deg`.
    pub fn new(model: &str, serial: &str, start_deg: f64, now: Instant) -> EspAxis {
        EspAxis {
            model: model.to_owned(),
            serial: serial.to_owned(),
            track: Track::at_rest(start_deg, now),
            offset: start_deg,
            motor: false,
            settings: defaults(),
            target: 0.0,
            home_glitch: false,
            jam_at: None,
            overshoot: 0.0,
            never_done: false,
            stuck: false,
            pending: None,
        }
    }

    /// A setting's value.
    pub fn get(&self, name: &str) -> f64 {
        self.settings.get(name).copied().unwrap_or(0.0)
    }

    /// What the encoder says.
    pub fn counter(&self, now: Instant) -> f64 {
        self.track.position(now) - self.offset
    }

    /// Speed now, from a short difference of position.
    pub fn velocity(&self, now: Instant) -> f64 {
        let dt = Duration::from_millis(1);
        if self.track.moving(now) { (self.track.position(now + dt) - self.track.position(now)) / 1e-3 } else { 0.0 }
    }

    /// A home search runs.
    pub fn homing(&self) -> bool {
        use Pending::{HomeFound, SwitchBack, SwitchPassed};
        matches!(self.pending, Some((_, SwitchPassed | SwitchBack | HomeFound)))
    }

    /// What `MD?` says.
    pub fn done(&self, now: Instant) -> bool {
        let resting = matches!(self.pending, Some((_, Pending::SwitchBack)));
        !self.stuck && !self.track.moving(now) && (!self.homing() || resting)
    }

    /// When something is to happen by itself.
    pub fn due(&self) -> Option<Instant> {
        self.pending.map(|(at, _)| at)
    }

    /// Lets happen what was due, one thing at a time, each at its own instant; gives error numbers.
    pub fn update(&mut self, now: Instant) -> Vec<u16> {
        let mut errors = Vec::new();
        while let Some((at, what)) = self.pending.take_if(|(at, _)| *at <= now) {
            match what {
                Pending::SwitchPassed if self.home_glitch => {
                    self.pending = Some((at + PHASE_REST, Pending::SwitchBack))
                }
                Pending::SwitchPassed | Pending::SwitchBack => self.second_phase(at),
                Pending::HomeFound => {
                    self.offset = self.track.position(at) - self.get("SH");
                    self.target = self.get("SH");
                }
                Pending::Jammed => {
                    self.motor = false;
                    errors.push(3);
                }
                Pending::SoftLimit(code) | Pending::HardLimit(code) => errors.push(u16::from(code)),
            }
        }
        errors
    }

    fn second_phase(&mut self, at: Instant) {
        self.go_true(0.0, (self.get("OH") / 2.0).max(0.01), self.get("AC"), at);
        let end = self.track.end().unwrap_or(at);
        self.pending = self.pending.or(Some((end, Pending::HomeFound)));
    }

    /// Begins a move to a counter value; the caller has checked state and limits.
    pub fn move_to(&mut self, target: f64, now: Instant) {
        self.target = target;
        self.pending = None;
        let end = target + self.offset + std::mem::take(&mut self.overshoot);
        self.go_true(end, self.get("VA"), self.get("AC"), now);
        self.stuck = std::mem::take(&mut self.never_done);
    }

    /// Moves until it is stopped or meets the soft limit (`hard`: the limit switch two degrees behind it).
    pub fn run(&mut self, positive: bool, hard: bool, now: Instant) {
        let past = if hard { 2.0 } else { 0.0 };
        let (limit, code) = if positive { (self.get("SR") + past, 6) } else { (self.get("SL") - past, 7) };
        self.move_to(limit, now);
        let at = self.track.end().unwrap_or(now);
        let what = if hard { Pending::HardLimit(code - 2) } else { Pending::SoftLimit(code) };
        self.pending = self.pending.or(Some((at, what)));
    }

    /// Begins the search for the home switch, which sits at true angle 0; `mode` 0 goes to the counter's zero.
    pub fn home(&mut self, mode: u8, now: Instant) {
        if mode == 0 {
            return self.move_to(0.0, now);
        }
        self.pending = None;
        self.stuck = false;
        let past = if self.track.position(now) > 0.0 { -HOME_PAST } else { HOME_PAST };
        self.go_true(past, self.get("OH"), self.get("AC"), now);
        let end = self.track.end().unwrap_or(now);
        self.pending = self.pending.or(Some((end, Pending::SwitchPassed)));
    }

    fn go_true(&mut self, target: f64, speed: f64, acceleration: f64, now: Instant) {
        self.track.go(now, target, speed, acceleration);
        if let Some(angle) = self.jam_at
            && let Some(at) = self.track.passes(now, angle)
        {
            self.track.freeze(at);
            self.jam_at = None;
            self.pending = Some((at, Pending::Jammed));
        }
    }

    /// Stops with the ramp of `setting` (`AG` or `AE`); true when a home search was broken off.
    pub fn stop(&mut self, setting: &str, now: Instant) -> bool {
        let homing = self.homing();
        self.pending = None;
        self.stuck = false;
        self.track.brake(now, self.get(setting));
        self.target = self.track.end().map_or(0.0, |end| self.counter(end));
        homing
    }

    /// The motor goes off: the stage stands where it is.
    pub fn motor_off(&mut self, now: Instant) {
        self.motor = false;
        self.pending = None;
        self.stuck = false;
        self.track.freeze(now);
        self.target = self.counter(now);
    }

    /// The present position becomes `value`.
    pub fn define(&mut self, value: f64, now: Instant) {
        self.offset = self.track.position(now) - value;
        self.target = value;
    }

    /// Power goes and comes back: the stage stays, the controller knows nothing and has its saved settings.
    pub fn restart(&mut self, saved: &BTreeMap<&'static str, f64>, now: Instant) {
        self.motor_off(now);
        self.offset = self.track.position(now);
        self.target = 0.0;
        self.settings.clone_from(saved);
    }

    /// Another hand turns the stage; the encoder follows.
    pub fn turned_by_hand(&mut self, by_deg: f64, now: Instant) {
        self.pending = None;
        self.track.jump(now, self.track.position(now) + by_deg);
    }
}
