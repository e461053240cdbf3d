//! One axis of a Zaber twin: mechanics (where the stage really is) and what its firmware believes of it.

use super::motion::Track;
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::time::Instant;

/// Microsteps of a turn.
const CYCLE: f64 = 1_536_000.0;
/// Angle the counter is wrong by after a stall.
const STALL_ERROR_DEG: f64 = 3.7;
/// Warning codes, most urgent first.
const PRIORITY: [&str; 13] = ["FF", "FH", "FV", "FO", "FQ", "FS", "FE", "WL", "WM", "WR", "WH", "NC", "NI"];

/// Mechanics and firmware state of one axis.
#[derive(Debug, Clone)]
pub(super) struct AxisTwin {
    /// Where the stage really is, in degrees from the home sensor.
    pub track: Track,
    /// Counter = true angle - offset.
    offset_deg: f64,
    pub referenced: bool,
    pub latched: BTreeSet<String>,
    /// Warnings that only `warnings` tells.
    pub hidden: BTreeSet<String>,
    pub driver_on: bool,
    pub parked: bool,
    pub manual_until: Option<Instant>,
    interrupted: bool,
    pub max_speed: f64,
    pub accel: f64,
    pub approach_speed: f64,
    pub limit_min: i64,
    pub limit_max: i64,
    pub never_arrives: bool,
    stuck: bool,
    pub stall_at: Option<f64>,
    pending: Option<(Instant, Pending)>,
}

/// What happens by itself at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Pending {
    HomeFound,
    Stalled,
}

// === impl AxisTwin ===

impl AxisTwin {
    /// An axis just powered up whose stage stands at `start_deg`.
    pub fn new(start_deg: f64, now: Instant) -> AxisTwin {
        AxisTwin {
            track: Track::at_rest(start_deg, now),
            offset_deg: start_deg,
            referenced: false,
            latched: BTreeSet::new(),
            hidden: BTreeSet::new(),
            driver_on: true,
            parked: false,
            manual_until: None,
            interrupted: false,
            max_speed: 153_600.0,
            accel: 205.0,
            approach_speed: 153_600.0,
            limit_min: -(CYCLE as i64),
            limit_max: 2 * CYCLE as i64,
            never_arrives: false,
            stuck: false,
            stall_at: None,
            pending: None,
        }
    }

    /// Speed in degrees a second of a `maxspeed` value.
    fn speed_deg(&self, setting: f64) -> f64 {
        setting / 1.6384 * 360.0 / CYCLE
    }

    /// Acceleration in degrees a second squared of an `accel` value; 0 = no ramps.
    fn accel_deg(&self, setting: f64) -> f64 {
        setting * 1e4 / 1.6384 * 360.0 / CYCLE
    }

    /// Speed now in the units of `maxspeed`.
    pub fn speed(&self, now: Instant) -> f64 {
        let dt = Duration::from_millis(1);
        let degrees = (self.track.position(now + dt) - self.track.position(now)) / dt.as_secs_f64();
        if self.track.moving(now) { degrees * CYCLE / 360.0 * 1.6384 } else { 0.0 }
    }

    /// What the position counter says, in microsteps.
    pub fn counter(&self, now: Instant) -> i64 {
        ((self.track.position(now) - self.offset_deg) * CYCLE / 360.0).round() as i64
    }

    pub fn busy(&self, now: Instant) -> bool {
        self.stuck || self.track.moving(now)
    }

    /// Lets happen what was due; true when the axis has just stalled.
    pub fn update(&mut self, now: Instant) -> bool {
        if self.manual_until.is_some_and(|until| until <= now) {
            self.manual_until = None;
        }
        let Some((_, what)) = self.pending.take_if(|(at, _)| *at <= now) else { return false };
        match what {
            Pending::HomeFound => {
                self.offset_deg = self.track.position(now);
                self.referenced = true;
            }
            Pending::Stalled => {
                self.offset_deg += STALL_ERROR_DEG;
                self.latched.insert("FS".to_owned());
            }
        }
        what == Pending::Stalled
    }

    /// Codes in force, most urgent first; with `all` also the hidden ones.
    pub fn codes(&self, all: bool) -> Vec<String> {
        let mut codes: Vec<String> = self.latched.iter().cloned().collect();
        let states = [
            (!self.driver_on, "FO"),
            (!self.referenced, "WR"),
            (self.manual_until.is_some(), "NC"),
            (self.interrupted, "NI"),
        ];
        codes.extend(states.iter().filter(|(on, _)| *on).map(|(_, code)| (*code).to_owned()));
        if all {
            codes.extend(self.hidden.iter().cloned());
        }
        codes.sort_by_key(|code| PRIORITY.iter().position(|p| p == code).unwrap_or(PRIORITY.len()));
        codes.dedup();
        codes
    }

    /// Why a motion may not begin, in the firmware's word.
    pub fn refuses(&self) -> Option<&'static str> {
        if !self.driver_on {
            Some("DRIVERDISABLED")
        } else if self.parked {
            Some("PARKED")
        } else if self.latched.contains("FS") {
            Some("STATUSBUSY")
        } else {
            None
        }
    }

    /// Begins a move to a counter value with this speed and acceleration, in the units of `maxspeed` and `accel`; the
    /// caller has checked limits and state.
    pub fn move_to(&mut self, steps: i64, (speed, accel): (f64, f64), now: Instant) {
        let target = steps as f64 * 360.0 / CYCLE + self.offset_deg;
        self.begin(target, self.speed_deg(speed), accel, now);
        if std::mem::take(&mut self.never_arrives) {
            let half = self.track.end().map_or(Duration::ZERO, |end| end.saturating_duration_since(now) / 2);
            self.track.freeze(now + half);
            self.stuck = true;
        }
    }

    /// Begins the search for the home sensor, which sits at true angle 0.
    pub fn home(&mut self, now: Instant) {
        self.begin(0.0, self.speed_deg(self.approach_speed.min(self.max_speed)), self.accel, now);
        if self.pending.is_none() {
            self.pending = self.track.end().map(|end| (end, Pending::HomeFound));
        }
    }

    fn begin(&mut self, target: f64, speed: f64, accel: f64, now: Instant) {
        self.interrupted = false;
        self.stuck = false;
        self.pending = None;
        self.track.go(now, target, speed, self.accel_deg(accel));
        if let Some(angle) = self.stall_at
            && let Some(at) = self.track.passes(now, angle)
        {
            self.track.freeze(at);
            self.stall_at = None;
            self.pending = Some((at, Pending::Stalled));
        }
    }

    /// Stops with the ramp.
    pub fn stop(&mut self, now: Instant) {
        if self.busy(now) {
            self.interrupted = true;
            self.stuck = false;
            self.pending = None;
            self.track.brake(now, self.accel_deg(self.accel));
        }
    }

    /// Stops dead.
    pub fn estop(&mut self, now: Instant) {
        if self.busy(now) {
            self.interrupted = true;
            self.stuck = false;
            self.pending = None;
            self.track.freeze(now);
        }
    }

    /// Moves at a speed in the units of `maxspeed`, until a limit.
    pub fn run(&mut self, speed: f64, accel: f64, now: Instant) {
        let limit = if speed > 0.0 { self.limit_max } else { self.limit_min };
        self.begin(limit as f64 * 360.0 / CYCLE + self.offset_deg, self.speed_deg(speed.abs()), accel, now);
    }

    /// When the motion under way ends by itself.
    pub fn end_of_motion(&self) -> Option<Instant> {
        self.track.end().filter(|end| !self.stuck && self.track.moving(*end - Duration::from_millis(1)))
    }

    /// The present position gets this counter value.
    pub fn set_counter(&mut self, steps: i64, now: Instant) {
        self.offset_deg = self.track.position(now) - steps as f64 * 360.0 / CYCLE;
    }

    /// Power goes and comes back: the stage stays where it is, the firmware knows nothing.
    pub fn restart(&mut self, now: Instant) {
        self.track.freeze(now);
        self.offset_deg = self.track.position(now);
        self.referenced = false;
        self.latched.clear();
        self.driver_on = true;
        self.interrupted = false;
        self.stuck = false;
        self.manual_until = None;
        self.pending = None;
    }

    /// Somebody pushes the stage while it stands: the counter does not follow.
    pub fn displace(&mut self, by_deg: f64, now: Instant) {
        self.track.jump(now, self.track.position(now) + by_deg);
        self.offset_deg += by_deg;
        self.latched.insert("WM".to_owned());
    }

    /// Somebody turns the knob for a while: the counter follows.
    pub fn turn_knob(&mut self, by_deg: f64, until: Instant, now: Instant) {
        self.pending = None;
        self.track.jump(now, self.track.position(now) + by_deg);
        self.manual_until = Some(until);
    }
}
