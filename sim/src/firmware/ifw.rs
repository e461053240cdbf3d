//! Twin of an Optec IFW filter wheel with five to nine places.
//!
//! Source: the protocol sheet `optec-ifw`. Silent until `WSMODE`; 2 s a place the shorter way round (hosts wait 10 s for a
//! turn, nine places included), 10 s for the home search; while it turns it hears nothing.

use super::Firmware;
use super::motion::Track;
use super::outbox::{Outbox, WireFault};
use std::time::Duration;
use tokio::time::Instant;

/// Time until a request is answered: a short reply at 19200 baud.
const ANSWER: Duration = Duration::from_millis(5);
/// Seconds for one place.
const PLACE_S: f64 = 2.0;
/// Time of the home search.
const HOME: Duration = Duration::from_secs(10);
/// Characters of a request.
const MAX_LINE: usize = 96;

/// Faults of the wheel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum IfwFault {
    /// A fault of the wire, at the next reply.
    Wire(WireFault),
    /// The next reply comes without its LF.
    NoLineFeed,
    /// A stray LF comes before the next reply.
    StrayLineFeed,
    /// The wheel is stuck (true) or freed: `ER=4`.
    Stuck(bool),
    /// The next turn slips: `ER=6`, one place short.
    Slips,
    /// The next turn ends one place too far, and the box does not know.
    OffByOne,
    /// Somebody puts another wheel in.
    Wheel(char),
    /// Somebody presses the button: so many places on.
    Button(u8),
    /// The box restarts now: serial mode is left, the place is unknown.
    Restart,
    /// The next request makes it restart without an answer.
    RestartOnCommand,
}

/// A filter wheel box with a wheel in it.
#[derive(Debug)]
pub struct IfwTwin {
    places: u8,
    letter: char,
    names: Vec<String>,
    outbox: Outbox,
    line: Vec<u8>,
    track: Track,
    serial_mode: bool,
    homed: bool,
    /// True place minus believed place.
    error: i32,
    deaf_until: Option<Instant>,
    stuck: bool,
    slips: bool,
    off_by_one: bool,
    no_line_feed: bool,
    stray_line_feed: bool,
    restart_on_command: bool,
}

// === impl IfwTwin ===

impl IfwTwin {
    /// A box powered up at `now` with a wheel of so many places, standing at 3.
    pub fn new(places: u8, now: Instant) -> IfwTwin {
        IfwTwin {
            places: places.clamp(1, 9),
            letter: 'A',
            names: (1..=places.clamp(1, 9)).map(|n| format!("FILTER-{n}")).collect(),
            outbox: Outbox::default(),
            line: Vec::new(),
            track: Track::at_rest(2.0, now),
            serial_mode: false,
            homed: false,
            error: 0,
            deaf_until: None,
            stuck: false,
            slips: false,
            off_by_one: false,
            no_line_feed: false,
            stray_line_feed: false,
            restart_on_command: false,
        }
    }

    /// The place that is really in the beam at `at`; `None` while the wheel turns.
    pub fn place(&self, at: Instant) -> Option<u8> {
        (!self.track.moving(at)).then(|| self.place_of(self.track.position(at)))
    }

    /// True while a fault of the wire waits for its occasion.
    pub fn faults_wait(&self) -> bool {
        self.outbox.faults_wait()
    }

    /// Lets a fault happen, now or at the next occasion.
    pub fn inject(&mut self, fault: IfwFault, now: Instant) {
        match fault {
            IfwFault::Wire(fault) => self.outbox.inject(fault),
            IfwFault::NoLineFeed => self.no_line_feed = true,
            IfwFault::StrayLineFeed => self.stray_line_feed = true,
            IfwFault::Stuck(stuck) => self.stuck = stuck,
            IfwFault::Slips => self.slips = true,
            IfwFault::OffByOne => self.off_by_one = true,
            IfwFault::Wheel(letter) => self.letter = letter,
            IfwFault::Button(steps) => {
                self.turn(f64::from(steps), now);
            }
            IfwFault::Restart => self.restart(now),
            IfwFault::RestartOnCommand => self.restart_on_command = true,
        }
    }

    fn place_of(&self, x: f64) -> u8 {
        (x.round() as i64).rem_euclid(i64::from(self.places)) as u8 + 1
    }

    fn believed(&self, now: Instant) -> u8 {
        self.place_of(self.track.position(now) - f64::from(self.error))
    }

    /// Turns by so many places, gives the arrival.
    fn turn(&mut self, steps: f64, now: Instant) -> Instant {
        let from = self.track.position(now).round();
        self.track.go(now, from + steps, 1.0 / PLACE_S, 0.0);
        self.track.end().unwrap_or(now)
    }

    fn restart(&mut self, now: Instant) {
        let nearest = self.track.position(now).round();
        self.track.freeze(now);
        self.track.go(now, nearest, 1.0, 0.0);
        self.outbox.clear();
        self.line.clear();
        self.serial_mode = false;
        self.homed = false;
        self.deaf_until = None;
    }

    fn reply(&mut self, text: &str, at: Instant) {
        let before = if std::mem::take(&mut self.stray_line_feed) { "\n" } else { "" };
        let end = if std::mem::take(&mut self.no_line_feed) { "\r" } else { "\n\r" };
        self.outbox.reply(at + ANSWER, format!("{before}{text}{end}").as_bytes());
    }

    fn request(&mut self, line: &str, now: Instant) {
        if std::mem::take(&mut self.restart_on_command) {
            return self.restart(now);
        }
        if line == "WSMODE" {
            self.serial_mode = true;
            return self.reply("!", now);
        }
        if !self.serial_mode {
            return;
        }
        match line {
            "WHOME" => self.home(now),
            "WIDENT" => self.reply(&self.letter.to_string(), now),
            "WFILTR" if self.homed => self.reply(&self.believed(now).to_string(), now),
            "WFILTR" => self.reply("1", now),
            "WREAD" => self.reply(&self.names.iter().map(|n| format!("{n:<8.8}")).collect::<String>(), now),
            "WVAAAA" => self.reply("V= 2.04", now),
            "WEXITS" => {
                self.reply("END", now);
                self.serial_mode = false;
            }
            _ => match (line.strip_prefix("WGOTO"), line.strip_prefix("WLOAD")) {
                (Some(place), _) => self.go(place.parse().ok(), now),
                (None, Some(names)) => self.load(names, now),
                _ => {}
            },
        }
    }

    /// Finds place 1, then stands there.
    fn home(&mut self, now: Instant) {
        let arrival = now + HOME;
        self.deaf_until = Some(arrival);
        if self.stuck {
            return self.reply("ER=4", arrival);
        }
        self.error = 0;
        self.homed = true;
        let at = self.track.position(now).round();
        let full = f64::from(self.places);
        let target = (at / full).ceil() * full;
        let speed = (target - at).abs().max(1.0) / HOME.as_secs_f64();
        self.track.go(now, target, speed, 0.0);
        self.reply(&self.letter.to_string(), arrival);
    }

    fn go(&mut self, place: Option<u8>, now: Instant) {
        let Some(place) = place.filter(|p| (1..=self.places).contains(p)) else { return self.reply("ER=5", now) };
        if self.stuck {
            self.deaf_until = Some(now + Duration::from_secs(3));
            return self.reply("ER=4", now + Duration::from_secs(3));
        }
        let all = i32::from(self.places);
        let mut steps = (i32::from(place) - i32::from(self.believed(now))).rem_euclid(all);
        if steps > all / 2 {
            steps -= all;
        }
        if std::mem::take(&mut self.slips) {
            let short = if steps < 0 { 1 } else { -1 };
            let arrival = self.turn(f64::from(steps + short), now);
            self.error += short;
            self.homed = false;
            self.deaf_until = Some(arrival);
            return self.reply("ER=6", arrival);
        }
        if std::mem::take(&mut self.off_by_one) {
            steps += 1;
            self.error += 1;
        }
        let arrival = self.turn(f64::from(steps), now);
        self.deaf_until = Some(arrival);
        self.reply("*", arrival);
    }

    /// `WLOADx*names`: eight characters a name.
    fn load(&mut self, text: &str, now: Instant) {
        let Some((letter, names)) = text.split_once('*') else { return self.reply("ER=3", now) };
        if letter == self.letter.to_string() {
            let letters: Vec<char> = names.chars().collect();
            self.names = letters.chunks(8).take(usize::from(self.places)).map(|c| c.iter().collect()).collect();
            self.names.resize(usize::from(self.places), String::new());
        }
        self.reply("!", now);
    }

    /// Requests need no end: a whole word counts once it is there; names end with the line.
    fn gathered(&self) -> bool {
        let text = String::from_utf8_lossy(&self.line);
        let plain = ["WSMODE", "WHOME", "WIDENT", "WFILTR", "WREAD", "WVAAAA", "WEXITS"].contains(&text.as_ref());
        plain || text.strip_prefix("WGOTO").is_some_and(|n| n.len() == 1)
    }
}

impl Firmware for IfwTwin {
    fn receive(&mut self, bytes: &[u8], now: Instant) {
        for &byte in bytes {
            if self.deaf_until.is_some_and(|until| now < until) {
                continue;
            }
            let end = byte == b'\n' || byte == b'\r';
            if !end && self.line.len() < MAX_LINE {
                self.line.push(byte);
            }
            if (end && !self.line.is_empty()) || self.gathered() {
                let line = std::mem::take(&mut self.line);
                self.request(&String::from_utf8_lossy(&line), now);
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
