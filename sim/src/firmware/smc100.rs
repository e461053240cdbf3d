//! Twin of Newport SMC100 boxes on one line, each with a rotation stage and an address of its own.
//!
//! Source: the protocol sheet `newport-smc100`. A box is a state machine; setters and motions are silent, `TE` tells the
//! error of the last one.

use super::Firmware;
use super::outbox::{Outbox, WireFault};
use super::smc100_box::SmcBox;
use std::time::Duration;
use tokio::time::Instant;

/// Line speed.
const BAUD: u32 = 57_600;
/// Characters of a request.
const MAX_LINE: usize = 64;

/// What one box and its stage are.
#[derive(Debug, Clone, PartialEq)]
pub struct SmcStage {
    /// Address, 1 to 31.
    pub address: u8,
    /// Identifier in the stage's memory.
    pub id: String,
    /// True angle at power-up, from the home switch.
    pub start_deg: f64,
}

/// Faults of the line and of the box at an address.
#[derive(Debug, Clone, PartialEq)]
pub enum Smc100Fault {
    /// A fault of the wire, at the next reply.
    Wire(WireFault),
    /// The stage jams at this true angle: following error, reference lost.
    Jam(u8, f64),
    /// The next move ends so many degrees off.
    Overshoot(u8, f64),
    /// The next move never seems to end.
    NeverDone(u8),
    /// The home search does not find its switch within its time-out.
    HomeTimeout(u8),
    /// Somebody disables the box.
    Disabled(u8),
    /// Another hand turns the stage.
    Hand(u8, f64),
    /// The box restarts now; the line carries a NUL.
    Restart(u8),
    /// The next request makes its box restart without an answer.
    RestartOnCommand,
}

/// Boxes on one line.
#[derive(Debug)]
pub struct Smc100Twin {
    boxes: Vec<SmcBox>,
    outbox: Outbox,
    line: Vec<u8>,
    last_reply: Instant,
    replies: u64,
    restart_on_command: bool,
}

// === impl SmcStage ===

impl SmcStage {
    /// A rotation stage 37 degrees from its home switch.
    pub fn new(address: u8, serial: &str) -> SmcStage {
        SmcStage { address, id: format!("URS100CC_PN:B062031_UD:{serial}"), start_deg: 37.0 }
    }
}

// === impl Smc100Twin ===

impl Smc100Twin {
    /// Boxes powered up at `now`.
    pub fn new(stages: Vec<SmcStage>, now: Instant) -> Smc100Twin {
        Smc100Twin {
            boxes: stages.into_iter().map(|s| SmcBox::new(s.address, s.id, s.start_deg, now)).collect(),
            outbox: Outbox::default(),
            line: Vec::new(),
            last_reply: now,
            replies: 0,
            restart_on_command: false,
        }
    }

    /// True angle of the stage at an address, `None` when there is no such box.
    pub fn angle_deg(&self, address: u8, at: Instant) -> Option<f64> {
        self.boxes.iter().find(|b| b.address == address).map(|b| b.track.position(at))
    }

    /// True while a fault of the wire waits for its occasion.
    pub fn faults_wait(&self) -> bool {
        self.outbox.faults_wait()
    }

    /// Lets a fault happen, now or at the next occasion.
    pub fn inject(&mut self, fault: Smc100Fault, now: Instant) {
        match fault {
            Smc100Fault::Wire(fault) => self.outbox.inject(fault),
            Smc100Fault::Jam(n, angle) => self.with(n, now, |b| b.jam_at = Some(angle)),
            Smc100Fault::Overshoot(n, by) => self.with(n, now, |b| b.overshoot = by),
            Smc100Fault::NeverDone(n) => self.with(n, now, |b| b.never_done = true),
            Smc100Fault::HomeTimeout(n) => self.with(n, now, |b| b.home_lost = true),
            Smc100Fault::Disabled(n) => self.with(n, now, |b| b.disable(now)),
            Smc100Fault::Hand(n, by) => self.with(n, now, |b| b.turned_by_hand(by, now)),
            Smc100Fault::Restart(n) => {
                self.with(n, now, |b| b.restart(now));
                self.outbox.unasked(now, b"\0");
            }
            Smc100Fault::RestartOnCommand => self.restart_on_command = true,
        }
    }

    fn with(&mut self, address: u8, now: Instant, act: impl FnOnce(&mut SmcBox)) {
        if let Some(b) = self.boxes.iter_mut().find(|b| b.address == address) {
            b.update(now);
            act(b);
        }
    }

    /// `[address] mnemonic [value]`; without an address every box is meant and none answers.
    fn request(&mut self, line: &str, now: Instant) {
        let digits = line.bytes().take_while(u8::is_ascii_digit).count();
        let (address, words) = line.split_at(digits);
        let address: Option<u8> = address.parse().ok();
        let restart = !words.is_empty() && std::mem::take(&mut self.restart_on_command);
        for n in 0..self.boxes.len() {
            let Some(one) = self.boxes.get_mut(n) else { continue };
            if address.is_some_and(|a| a != one.address) {
                continue;
            }
            one.update(now);
            if restart {
                one.restart(now);
                continue;
            }
            let answers = one.command(words, now);
            if address.is_some() {
                answers.iter().for_each(|text| self.reply(text, now));
            }
        }
    }

    fn reply(&mut self, text: &str, now: Instant) {
        self.replies += 1;
        let bytes = format!("{text}\r\n");
        let wire = Duration::from_secs(10) * bytes.len() as u32 / BAUD;
        let at = (now + Duration::from_millis(5 + self.replies % 4)).max(self.last_reply) + wire;
        self.last_reply = at;
        self.outbox.reply(at, bytes.as_bytes());
    }
}

impl Firmware for Smc100Twin {
    fn receive(&mut self, bytes: &[u8], now: Instant) {
        for &byte in bytes {
            if byte == b'\r' || byte == b'\n' {
                let line = std::mem::take(&mut self.line);
                let text = String::from_utf8_lossy(&line).trim().to_owned();
                if !text.is_empty() {
                    self.request(&text, now);
                }
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
