//! Twin of the Spectral Products CM110 monochromator: a byte machine with a parameter counter that is deaf while it moves.
//!
//! Source: the protocol sheet `spectralproducts-cm110`. Assumptions of the sheet are constants here.

use super::Firmware;
use super::motion::Track;
use super::outbox::{Outbox, WireFault};
use std::collections::VecDeque;
use std::time::Duration;
use tokio::time::Instant;

/// End of command.
const END: u8 = 24;
/// Time until a request is answered.
const ANSWER: Duration = Duration::from_millis(5);
/// Slew at power-up, angstroms a second with 1200 grooves/mm (assumed: 50 to 100 nm/s).
const SLEW: f64 = 800.0;
/// Longest wavelength with 1200 grooves/mm, angstroms; others in proportion.
const REACH: f64 = 12_000.0;
/// Angstroms of a unit by units code; the scale of "micrometre" was read nowhere (assumed: centimicrons).
const ANGSTROMS: [f64; 3] = [100.0, 10.0, 1.0];
/// Time to change the grating, and to home after RESET.
const SELECT_TIME: Duration = Duration::from_secs(12);
/// Homing after RESET.
const RESET_TIME: Duration = Duration::from_secs(20);
/// SIZE of a backward step is 128 + |n| (sources conflict: others write two's complement).
const SIGN_BIT: u8 = 0x80;
/// Speeds with 1200 grooves/mm, angstroms a second.
const SPEEDS: [u16; 10] = [1000, 500, 250, 125, 62, 31, 15, 7, 3, 1];

/// Faults of the monochromator.
#[derive(Debug, Clone, PartialEq)]
pub enum MonochromatorFault {
    /// A fault of the wire, at the next reply; the status and the final 24 of a command are two replies.
    Wire(WireFault),
    /// The next command that ends gives no 24.
    NoEnd,
    /// The next rejection gives no 24.
    NoEndAfterRejection,
    /// Somebody changes the units at the keypad.
    Units(u8),
    /// It restarts now: position 0, nanometres.
    Restart,
    /// The power fails in the next move.
    RestartInMove,
    /// The next byte makes it restart without an answer.
    RestartOnCommand,
    /// The drive is slower by this factor.
    Slow(f64),
    /// The drive never ends its next move.
    NeverArrives,
    /// The next move ends this many angstroms off.
    Off(i32),
    /// Somebody turns it to this wavelength by hand.
    Turned(f64),
    /// One command sent in a move is queued instead of swallowed (true), or not.
    Queues(bool),
    /// The host left these bytes of a command behind.
    HalfCommand(Vec<u8>),
}

/// What the monochromator is.
#[derive(Debug, Clone, PartialEq)]
pub struct MonochromatorSpec {
    /// Serial number.
    pub serial: u16,
    /// Grooves a millimetre and blaze wavelength in nanometres of each grating.
    pub gratings: Vec<(u16, u16)>,
    /// Type code: 1 additive, 254 subtractive, 0 single.
    pub kind: u8,
}

/// A monochromator.
#[derive(Debug)]
pub struct Cm110Twin {
    spec: MonochromatorSpec,
    outbox: Outbox,
    /// Wavelength in angstroms.
    drive: Track,
    pending: Vec<u8>,
    queued: Vec<u8>,
    /// Deaf until then; the second leg of a scan, and where a fault moves the drive at the end.
    busy_until: Option<Instant>,
    legs: VecDeque<(f64, f64)>,
    units: u8,
    grating: usize,
    speed: u16,
    size: u8,
    order: u8,
    slow: f64,
    off: i32,
    never_arrives: bool,
    no_end: bool,
    no_end_after_rejection: bool,
    restart_in_move: bool,
    restart_on_command: bool,
    queues: bool,
    /// Commands received that change the factory calibration.
    pub destructive: u32,
}

// === impl MonochromatorSpec ===

impl Default for MonochromatorSpec {
    fn default() -> MonochromatorSpec {
        MonochromatorSpec { serial: 11_042, gratings: vec![(1200, 500), (600, 1000)], kind: 0 }
    }
}

// === impl Cm110Twin ===

impl Cm110Twin {
    /// Powered up at `now`: position 0, nanometres, first grating.
    pub fn new(spec: MonochromatorSpec, now: Instant) -> Cm110Twin {
        Cm110Twin {
            spec,
            outbox: Outbox::default(),
            drive: Track::at_rest(0.0, now),
            pending: Vec::new(),
            queued: Vec::new(),
            busy_until: None,
            legs: VecDeque::new(),
            units: 1,
            grating: 0,
            speed: SPEEDS[0],
            size: 1,
            order: 1,
            slow: 1.0,
            off: 0,
            never_arrives: false,
            no_end: false,
            no_end_after_rejection: false,
            restart_in_move: false,
            restart_on_command: false,
            queues: false,
            destructive: 0,
        }
    }

    /// True wavelength at `at`.
    pub fn wavelength_nm(&self, at: Instant) -> f64 {
        self.drive.position(at) / 10.0
    }

    /// True while the drive moves at `at`.
    pub fn moving(&self, at: Instant) -> bool {
        self.drive.moving(at)
    }

    /// True while a fault waits for its occasion.
    pub fn faults_wait(&self) -> bool {
        self.outbox.faults_wait()
    }

    /// Lets a fault happen, now or at the next occasion.
    pub fn inject(&mut self, fault: MonochromatorFault, now: Instant) {
        match fault {
            MonochromatorFault::Wire(fault) => self.outbox.inject(fault),
            MonochromatorFault::NoEnd => self.no_end = true,
            MonochromatorFault::NoEndAfterRejection => self.no_end_after_rejection = true,
            MonochromatorFault::Units(units) => self.units = units.min(2),
            MonochromatorFault::Restart => self.restart(now),
            MonochromatorFault::RestartInMove => self.restart_in_move = true,
            MonochromatorFault::RestartOnCommand => self.restart_on_command = true,
            MonochromatorFault::Slow(factor) => self.slow = factor.max(1e-3),
            MonochromatorFault::NeverArrives => self.never_arrives = true,
            MonochromatorFault::Off(angstroms) => self.off = angstroms,
            MonochromatorFault::Turned(nm) => self.drive.jump(now, nm * 10.0),
            MonochromatorFault::Queues(queues) => self.queues = queues,
            MonochromatorFault::HalfCommand(bytes) => self.pending = bytes,
        }
    }

    fn restart(&mut self, now: Instant) {
        let spec = self.spec.clone();
        let (destructive, queues) = (self.destructive, self.queues);
        *self = Cm110Twin { destructive, queues, ..Cm110Twin::new(spec, now) };
    }

    fn grooves(&self) -> u16 {
        self.spec.gratings.get(self.grating).map_or(1200, |g| g.0)
    }

    /// Longest wavelength of the grating, angstroms.
    fn reach(&self) -> f64 {
        REACH * 1200.0 / f64::from(self.grooves().max(1))
    }

    fn scale(&self) -> f64 {
        ANGSTROMS.get(usize::from(self.units)).copied().unwrap_or(1.0)
    }

    fn byte(&mut self, byte: u8, now: Instant) {
        if std::mem::take(&mut self.restart_on_command) {
            return self.restart(now);
        }
        if self.busy_until.is_some_and(|until| now < until) {
            if self.queues && self.queued.len() < 5 {
                self.queued.push(byte);
            }
            return;
        }
        self.busy_until = None;
        self.pending.push(byte);
        let Some(&command) = self.pending.first() else { return };
        if self.pending.len() <= parameters(command) {
            return;
        }
        let request = std::mem::take(&mut self.pending);
        self.request(&request, now);
    }

    fn request(&mut self, request: &[u8], now: Instant) {
        match *request {
            [27] => self.outbox.reply(now + ANSWER, &[27]),
            [56, what] => self.query(what, now),
            [16, high, low] => self.goto(f64::from(u16::from_be_bytes([high, low])) * self.scale(), now),
            [12, a, b, c, d] => {
                let [start, end] = [[a, b], [c, d]].map(|p| f64::from(u16::from_be_bytes(p)) * self.scale());
                self.scan(start, end, now);
            }
            [54] => {
                let step = f64::from(self.size & !SIGN_BIT) * if self.size & SIGN_BIT == 0 { 1.0 } else { -1.0 };
                self.goto(self.drive.position(now).round() + step * self.scale(), now);
            }
            [55, size] => {
                let same = std::mem::replace(&mut self.size, size) == size;
                self.settled(same, now);
            }
            [13, high, low] => self.set_speed(u16::from_be_bytes([high, low]), now),
            [50, units @ 0..=2] => {
                let same = std::mem::replace(&mut self.units, units) == units;
                self.settled(same, now);
            }
            [51, order @ (1 | 254)] => {
                let same = std::mem::replace(&mut self.order, order) == order;
                self.settled(same, now);
            }
            [50 | 51, _] => self.reject(false, now),
            [26, grating] => self.select(grating, now),
            [255, 255, 255] => {
                self.status(false, now);
                self.drive.go(now, 0.0, self.reach() / RESET_TIME.as_secs_f64(), 0.0);
                self.end(now + RESET_TIME);
            }
            [52 | 7 | 1, ..] | [18, ..] => {
                self.destructive += 1;
                self.settled(false, now);
            }
            // An unknown byte is no command: nothing is said (assumed).
            _ => {}
        }
    }

    fn query(&mut self, what: u8, now: Instant) {
        let grating = self.spec.gratings.get(self.grating).copied().unwrap_or((1200, 500));
        let value = match what {
            0 => (self.drive.position(now) / self.scale()).round() as u16,
            1 => u16::from(self.spec.kind),
            2 => grating.0,
            3 => grating.1,
            4 => self.grating as u16 + 1,
            5 => self.speed,
            6 => u16::from(self.size),
            13 => self.spec.gratings.len() as u16,
            14 => u16::from(self.units),
            19 => self.spec.serial,
            _ => return self.reject(false, now),
        };
        let [high, low] = value.to_be_bytes();
        self.outbox.reply(now + ANSWER, &[high, low, self.flags(), END]);
    }

    /// Order and units bits of a status.
    fn flags(&self) -> u8 {
        self.units | if self.order == 254 { 0x08 } else { 0 }
    }

    fn status(&mut self, nothing_to_do: bool, now: Instant) {
        let status = self.flags() | if nothing_to_do { 0x40 } else { 0 };
        self.outbox.reply(now + ANSWER, &[status]);
    }

    /// Status and end of a setting.
    fn settled(&mut self, nothing_to_do: bool, now: Instant) {
        self.status(nothing_to_do, now);
        self.end(now);
    }

    fn reject(&mut self, too_small: bool, now: Instant) {
        let status = self.flags() | 0x80 | if too_small { 0x20 } else { 0 };
        self.outbox.reply(now + ANSWER, &[status]);
        if !std::mem::take(&mut self.no_end_after_rejection) {
            self.outbox.reply(now + 2 * ANSWER, &[END]);
        }
    }

    /// The command under way ends at `at`; until then the box is deaf.
    fn end(&mut self, at: Instant) {
        self.busy_until = Some(at);
        if !std::mem::take(&mut self.no_end) {
            self.outbox.reply(at + 2 * ANSWER, &[END]);
        }
    }

    fn goto(&mut self, angstroms: f64, now: Instant) {
        if angstroms > self.reach() || angstroms < 0.0 {
            return self.reject(angstroms < 0.0, now);
        }
        let here = (self.drive.position(now) - angstroms).abs() < 0.5;
        self.status(here, now);
        if here {
            return self.end(now);
        }
        let speed = SLEW * 1200.0 / f64::from(self.grooves()) / self.slow;
        self.drive.go(now, angstroms + f64::from(std::mem::take(&mut self.off)), speed, 0.0);
        let end = self.drive.end().unwrap_or(now);
        if std::mem::take(&mut self.restart_in_move) {
            self.restart(now + (end - now) / 2);
        } else if std::mem::take(&mut self.never_arrives) {
            self.drive.freeze(now + (end - now) / 2);
            self.busy_until = Some(now + Duration::from_secs(3600));
        } else {
            self.end(end);
        }
    }

    fn scan(&mut self, start: f64, end: f64, now: Instant) {
        if start.max(end) > self.reach() {
            return self.reject(false, now);
        }
        let direction = if end < start { 0x10 } else { 0 };
        self.outbox.reply(now + ANSWER, &[self.flags() | direction]);
        let speed = f64::from(self.speed);
        let there = (self.drive.position(now) - start).abs() / SLEW;
        self.drive.go(now, start, SLEW, 0.0);
        self.legs.push_back((end, speed));
        self.end(now + Duration::from_secs_f64(there + (end - start).abs() / speed));
    }

    fn set_speed(&mut self, speed: u16, now: Instant) {
        let factor = 1200.0 / f64::from(self.grooves().max(1));
        let allowed = |s: &&u16| (f64::from(**s) * factor).floor() as u16 == speed;
        if SPEEDS.iter().find(allowed).is_none() {
            return self.reject(speed == 0, now);
        }
        let same = std::mem::replace(&mut self.speed, speed) == speed;
        self.settled(same, now);
    }

    fn select(&mut self, grating: u8, now: Instant) {
        let index = usize::from(grating).wrapping_sub(1);
        if index >= self.spec.gratings.len() {
            return self.reject(grating == 0, now);
        }
        if index == self.grating {
            return self.settled(true, now);
        }
        self.status(false, now);
        // The same angle of the drive is another wavelength.
        let ratio = f64::from(self.grooves());
        self.grating = index;
        let position = self.drive.position(now) * ratio / f64::from(self.grooves());
        self.drive.jump(now, position.min(self.reach()).round());
        self.end(now + SELECT_TIME);
    }

    /// Second legs begin, and a queued command is heard, when their time has come.
    fn advance(&mut self, now: Instant) {
        if let Some((target, speed)) = self.legs.front().copied()
            && let Some(end) = self.drive.end().filter(|end| *end <= now)
        {
            self.legs.pop_front();
            self.drive.go(end, target, speed, 0.0);
        }
        if self.busy_until.is_some_and(|until| until <= now) && !self.queued.is_empty() {
            for byte in std::mem::take(&mut self.queued) {
                self.byte(byte, now);
            }
        }
    }
}

/// Parameters that a command swallows, whatever they are.
fn parameters(command: u8) -> usize {
    match command {
        16 | 13 | 18 | 255 => 2,
        12 => 4,
        55 | 50 | 51 | 26 | 56 => 1,
        _ => 0,
    }
}

impl Firmware for Cm110Twin {
    fn receive(&mut self, bytes: &[u8], now: Instant) {
        self.advance(now);
        bytes.iter().for_each(|byte| self.byte(*byte, now));
    }

    fn due(&self) -> Option<Instant> {
        let leg = self.legs.front().and_then(|_| self.drive.end());
        let queued = self.busy_until.filter(|_| !self.queued.is_empty());
        [self.outbox.due(), leg, queued].into_iter().flatten().min()
    }

    fn take(&mut self, now: Instant) -> Vec<u8> {
        self.advance(now);
        self.outbox.take(now)
    }

    /// The box does not notice who listens: half a command stays half a command.
    fn connected(&mut self, _now: Instant) {
        self.outbox.clear();
    }
}
