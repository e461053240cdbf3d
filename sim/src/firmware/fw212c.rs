//! Twin of the Thorlabs FW212C and FW102C filter wheels.
//!
//! Source: the protocol sheet `thorlabs-fw212c`. The position is a continuous angle, counted in places; half a turn of
//! twelve places takes 2.9 s fast and 6.8 s slow, one place 0.9 s and 1.8 s.

use super::Firmware;
use super::motion::Track;
use super::outbox::WireFault;
use super::prompt::PromptPort;
use std::collections::VecDeque;
use std::time::Duration;
use tokio::time::Instant;

/// Time until a query is answered.
const ANSWER: Duration = Duration::from_millis(3);
/// How long a jammed wheel tries before it listens again.
const JAM_TIME: Duration = Duration::from_secs(12);
/// Bytes kept while the wheel turns, where it queues them.
const MAX_QUEUE: usize = 256;

/// What the wheel is and how it was left.
#[derive(Debug, Clone, PartialEq)]
pub struct WheelSpec {
    /// Number of places it is set to.
    pub places: u8,
    /// Place at power-up.
    pub place: u8,
    /// Stored `speed`.
    pub speed: u8,
    /// Stored `sensors`.
    pub sensors: u8,
    /// Requests that come while the wheel turns are queued (else dropped).
    pub queues_input: bool,
}

/// Faults of the wheel.
#[derive(Debug, Clone, PartialEq)]
pub enum WheelFault {
    /// A fault of the wire, at the next reply.
    Wire(WireFault),
    /// The next turn's prompt comes before it has arrived, and questions are answered while it turns.
    PromptEarly,
    /// `pos?` gives nothing while the wheel turns.
    PositionEmpty,
    /// The next turn ends one place too far, and the wheel does not know.
    LostEdge,
    /// Somebody presses the button: so many places on.
    Button(i8),
    /// The wheel is set to another number of places.
    PlaceCount(u8),
    /// The wheel restarts now: NUL bytes and a prompt come, settings are the stored ones.
    Restart,
    /// The next request makes it restart without an answer.
    RestartOnCommand,
    /// The wheel jams (true) or is freed.
    Jam(bool),
}

/// A filter wheel.
#[derive(Debug)]
pub struct Fw212cTwin {
    spec: WheelSpec,
    port: PromptPort,
    track: Track,
    speed: u8,
    sensors: u8,
    trig: u8,
    baud: u8,
    /// True place minus believed place.
    error: i32,
    deaf_until: Option<Instant>,
    queued: VecDeque<u8>,
    jammed: bool,
    prompt_early: bool,
    position_empty: bool,
    lost_edge: bool,
    restart_on_command: bool,
}

// === impl WheelSpec ===

impl Default for WheelSpec {
    /// Twelve places, standing at 3, fast, sensors always on.
    fn default() -> WheelSpec {
        WheelSpec { places: 12, place: 3, speed: 1, sensors: 1, queues_input: false }
    }
}

// === impl Fw212cTwin ===

impl Fw212cTwin {
    /// A wheel powered up at `now`.
    pub fn new(spec: WheelSpec, now: Instant) -> Fw212cTwin {
        Fw212cTwin {
            port: PromptPort::new(ANSWER),
            track: Track::at_rest(f64::from(spec.place) - 1.0, now),
            speed: spec.speed,
            sensors: spec.sensors,
            trig: 0,
            baud: 1,
            error: 0,
            deaf_until: None,
            queued: VecDeque::new(),
            jammed: false,
            prompt_early: false,
            position_empty: false,
            lost_edge: false,
            restart_on_command: false,
            spec,
        }
    }

    /// The place that is really in the beam at `at`; `None` while the wheel turns.
    pub fn place(&self, at: Instant) -> Option<u8> {
        let x = self.track.position(at);
        (!self.track.moving(at) && (x - x.round()).abs() < 0.02).then(|| self.place_of(x))
    }

    /// True while the position sensors shine at rest.
    pub fn sensors_on(&self) -> bool {
        self.sensors == 1
    }

    /// Lets a fault happen, now or at the next occasion.
    pub fn inject(&mut self, fault: WheelFault, now: Instant) {
        match fault {
            WheelFault::Wire(fault) => self.port.inject(fault),
            WheelFault::PromptEarly => self.prompt_early = true,
            WheelFault::PositionEmpty => self.position_empty = true,
            WheelFault::LostEdge => self.lost_edge = true,
            WheelFault::Button(steps) => {
                // As with any turn, requests wait until it has arrived.
                self.deaf_until = Some(self.turn(f64::from(steps), now));
            }
            WheelFault::PlaceCount(places) => self.spec.places = places,
            WheelFault::Restart => self.restart(now),
            WheelFault::RestartOnCommand => self.restart_on_command = true,
            WheelFault::Jam(jammed) => self.jammed = jammed,
        }
    }

    /// True while an injected fault waits for its occasion.
    pub fn faults_wait(&self) -> bool {
        // That no place is told while the wheel turns is a habit, not an event.
        let flags = [self.prompt_early, self.lost_edge, self.restart_on_command];
        self.port.faults_wait() || flags.contains(&true)
    }

    /// Place number of a track position.
    fn place_of(&self, x: f64) -> u8 {
        (x.round() as i64).rem_euclid(i64::from(self.spec.places.max(1))) as u8 + 1
    }

    /// Where the firmware thinks the wheel is.
    fn believed(&self, now: Instant) -> u8 {
        self.place_of(self.track.position(now) - f64::from(self.error))
    }

    /// Turns by so many places; gives the arrival.
    fn turn(&mut self, steps: f64, now: Instant) -> Instant {
        if steps == 0.0 {
            return now;
        }
        let n = steps.abs();
        let seconds = if self.speed == 1 { 0.5 + 0.4 * n } else { 0.8 + n };
        let from = self.track.position(now).round();
        self.track.go(now, from + steps, n / seconds, 0.0);
        self.track.end().unwrap_or(now)
    }

    fn restart(&mut self, now: Instant) {
        self.track.freeze(now);
        let nearest = self.track.position(now).round();
        self.track.go(now, nearest, 1.0, 0.0);
        self.port.reset();
        self.queued.clear();
        self.speed = self.spec.speed;
        self.sensors = self.spec.sensors;
        self.error = 0;
        self.deaf_until = None;
        self.port.unasked(b"\0\0> ", now);
    }

    fn request(&mut self, line: &str, now: Instant) {
        if std::mem::take(&mut self.restart_on_command) {
            return self.restart(now);
        }
        if let Some(name) = line.strip_suffix('?') {
            return match name {
                "*idn" => self.port.value("THORLABS FW102C/FW212C Filter Wheel version 1.07", now),
                "pos" if self.position_empty && self.track.moving(now) => self.port.value("", now),
                "pos" => self.port.value(self.believed(now), now),
                "pcount" => self.port.value(self.spec.places, now),
                "speed" => self.port.value(self.speed, now),
                "sensors" => self.port.value(self.sensors, now),
                "trig" => self.port.value(self.trig, now),
                "baud" => self.port.value(self.baud, now),
                _ => self.port.error("CMD_NOT_DEFINED", now),
            };
        }
        let Some((name, value)) = line.split_once('=') else {
            return match line {
                "save" => {
                    (self.spec.speed, self.spec.sensors) = (self.speed, self.sensors);
                    self.port.done(now);
                }
                _ => self.port.error("CMD_NOT_DEFINED", now),
            };
        };
        match (name, value.parse::<u8>()) {
            ("pos", Ok(place)) if (1..=self.spec.places).contains(&place) => self.go(place, now),
            ("speed", Ok(v @ (0 | 1))) => self.set(now, |w| w.speed = v),
            ("sensors", Ok(v @ (0 | 1))) => self.set(now, |w| w.sensors = v),
            // A pseudo-terminal or a pipe goes on at any speed.
            ("baud", Ok(v @ (0 | 1))) => self.set(now, |w| w.baud = v),
            ("trig", Ok(v @ (0 | 1))) => self.set(now, |w| w.trig = v),
            ("pcount", Ok(v @ (6 | 12))) => self.set(now, |w| w.spec.places = v),
            ("pos" | "speed" | "sensors" | "trig" | "pcount" | "baud", _) => self.port.error("CMD_ARG_INVALID", now),
            _ => self.port.error("CMD_NOT_DEFINED", now),
        }
    }

    fn set(&mut self, now: Instant, change: impl FnOnce(&mut Fw212cTwin)) {
        change(self);
        self.port.done(now);
    }

    /// Turns to a place the shorter way; the prompt comes on arrival.
    fn go(&mut self, place: u8, now: Instant) {
        if self.jammed {
            self.deaf_until = Some(now + JAM_TIME);
            return self.port.silence();
        }
        let all = i32::from(self.spec.places);
        let mut steps = (i32::from(place) - i32::from(self.believed(now))).rem_euclid(all);
        if steps > all / 2 {
            steps -= all;
        }
        if std::mem::take(&mut self.lost_edge) {
            steps += 1;
            self.error += 1;
        }
        let arrival = self.turn(f64::from(steps), now);
        if std::mem::take(&mut self.prompt_early) {
            self.port.done(now);
        } else {
            // What was queued is taken up after the prompt.
            self.deaf_until = Some(arrival + ANSWER);
            self.port.done(arrival);
        }
    }

    /// Takes up what was queued while the wheel turned.
    fn catch_up(&mut self, now: Instant) {
        while self.deaf_until.is_none_or(|until| until <= now) {
            self.deaf_until = None;
            let Some(byte) = self.queued.pop_front() else { return };
            if let Some(line) = self.port.byte(byte, now) {
                self.request(&line, now);
            }
        }
    }
}

impl Firmware for Fw212cTwin {
    fn receive(&mut self, bytes: &[u8], now: Instant) {
        self.catch_up(now);
        for &byte in bytes {
            if self.deaf_until.is_some_and(|until| now < until) {
                if self.spec.queues_input && self.queued.len() < MAX_QUEUE {
                    self.queued.push_back(byte);
                }
            } else if let Some(line) = self.port.byte(byte, now) {
                self.request(&line, now);
            } else if let Some(up) = self.port.arrow() {
                self.turn(if up { 1.0 } else { -1.0 }, now);
            }
        }
    }

    fn due(&self) -> Option<Instant> {
        let queued = self.deaf_until.filter(|_| !self.queued.is_empty());
        [self.port.due(), queued].into_iter().flatten().min()
    }

    fn take(&mut self, now: Instant) -> Vec<u8> {
        self.catch_up(now);
        self.port.take(now)
    }

    fn connected(&mut self, _now: Instant) {
        self.port.reset();
        self.queued.clear();
    }
}
