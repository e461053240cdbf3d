//! Twin of a Halden CW6 filter wheel.
//!
//! Source: the sheet in `docs/adding-a-device.md`. It turns one way only, 0.8 s a place.

use super::Firmware;
use super::motion::Track;
use super::outbox::{Outbox, WireFault};
use std::time::Duration;
use tokio::time::Instant;

/// Time until a request is answered.
const ANSWER: Duration = Duration::from_millis(8);
/// Places.
const PLACES: u8 = 6;
/// Places a second.
const SPEED: f64 = 1.25;
/// Characters of a request.
const MAX_LINE: usize = 16;

/// Faults of the wheel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Cw6Fault {
    /// A fault of the wire, at the next reply.
    Wire(WireFault),
    /// The wheel is stuck (true) or freed: `E2`.
    Stuck(bool),
    /// The next order is acknowledged and not carried out.
    Ignores,
    /// Somebody turns it by hand, so many places on.
    ByHand(u8),
}

/// A filter wheel.
#[derive(Debug)]
pub struct HaldenCw6Twin {
    outbox: Outbox,
    line: Vec<u8>,
    track: Track,
    stuck: bool,
    ignores: bool,
}

// === impl HaldenCw6Twin ===

impl HaldenCw6Twin {
    /// A wheel powered up at `now`, standing at 3.
    pub fn new(now: Instant) -> HaldenCw6Twin {
        HaldenCw6Twin {
            outbox: Outbox::default(),
            line: Vec::new(),
            track: Track::at_rest(2.0, now),
            stuck: false,
            ignores: false,
        }
    }

    /// The place that is really in the beam at `at`; `None` while the wheel turns.
    pub fn place(&self, at: Instant) -> Option<u8> {
        let nearest = self.track.position(at).round() as i64;
        (!self.track.moving(at)).then(|| nearest.rem_euclid(i64::from(PLACES)) as u8 + 1)
    }

    /// True while a fault of the wire waits for its occasion.
    pub fn faults_wait(&self) -> bool {
        self.outbox.faults_wait()
    }

    /// Lets a fault happen, now or at the next occasion.
    pub fn inject(&mut self, fault: Cw6Fault, now: Instant) {
        match fault {
            Cw6Fault::Wire(fault) => self.outbox.inject(fault),
            Cw6Fault::Stuck(stuck) => self.stuck = stuck,
            Cw6Fault::Ignores => self.ignores = true,
            Cw6Fault::ByHand(steps) => self.turn(steps, now),
        }
    }

    fn turn(&mut self, steps: u8, now: Instant) {
        let from = self.track.position(now).round();
        self.track.go(now, from + f64::from(steps), SPEED, 0.0);
    }

    fn request(&mut self, line: &str, now: Instant) {
        let answer = match line {
            "I?" => "CW6,1.3,40213".to_owned(),
            "P?" => format!("P{}", self.place(now).unwrap_or(0)),
            _ => match line.strip_prefix('G').map(|n| n.parse()) {
                Some(Ok(place)) if (1..=PLACES).contains(&place) => self.go(place, now).to_owned(),
                Some(_) => "E1".to_owned(),
                None => "E9".to_owned(),
            },
        };
        self.outbox.reply(now + ANSWER, format!("{answer}\r").as_bytes());
    }

    fn go(&mut self, place: u8, now: Instant) -> &'static str {
        if self.stuck {
            return "E2";
        }
        if !std::mem::take(&mut self.ignores) {
            let nearest = self.track.position(now).round() as i64;
            let ahead = (i64::from(place) - 1 - nearest).rem_euclid(i64::from(PLACES));
            self.turn(ahead as u8, now);
        }
        "K"
    }
}

impl Firmware for HaldenCw6Twin {
    fn receive(&mut self, bytes: &[u8], now: Instant) {
        for &byte in bytes {
            if byte == b'\r' {
                let line = std::mem::take(&mut self.line);
                self.request(&String::from_utf8_lossy(&line), now);
            } else if self.line.len() < MAX_LINE {
                self.line.push(byte);
            }
        }
    }

    fn due(&self) -> Option<Instant> {
        self.outbox.due()
    }

    fn take(&mut self, now: Instant) -> Vec<u8> {
        self.outbox.take(now)
    }

    fn connected(&mut self, _now: Instant) {
        self.outbox.clear();
        self.line.clear();
    }
}
