//! Newport SMC100, the words on the wire: orders and queries out, states and errors in.
//!
//! Source: SMC100CC/PP user's manual (commands, state diagram, appendix of errors) as collected in the protocol sheet
//! `newport-smc100`. What enters the configuration state, restarts or re-addresses cannot be spelt.

use crate::error::ErrorKind;
use std::fmt;

/// What a box is told; none of these is answered, `TE` tells how it went.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Order {
    /// Search for the reference.
    Home,
    /// Go to a position in the stage's units (degrees).
    MoveAbs(f64),
    /// Stop with the ramp.
    Stop,
    /// From DISABLE to READY.
    Enable,
    /// Speed.
    Velocity(f64),
    /// Acceleration.
    Acceleration(f64),
}

/// What a box is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Query {
    /// Errors and state.
    State,
    /// Error of the last command.
    Error,
    /// Position of the encoder.
    Position,
    /// Stage identifier.
    StageId,
    /// Firmware.
    Version,
    /// Speed.
    Velocity,
    /// Acceleration.
    Acceleration,
    /// Lower soft limit.
    LeftLimit,
    /// Upper soft limit.
    RightLimit,
    /// Time-out of the home search in seconds.
    HomeLimit,
}

/// What a box does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// No reference: after power-up, a failed search, a fault.
    NotReferenced,
    /// Its configuration is being written.
    Configuration,
    /// It searches its reference.
    Homing,
    /// It moves.
    Moving,
    /// It stands and may be commanded.
    Ready,
    /// The motor is off; the reference holds.
    Disabled,
    /// It is moved from the keypad.
    Jogging,
}

/// Answer to `TS`: motor errors and state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Status {
    /// Bits of the motor's errors.
    pub errors: u16,
    /// State number.
    pub state: State,
}

/// Motor errors by bit.
const MOTOR_ERRORS: [&str; 10] = [
    "negative end of run",
    "positive end of run",
    "peak current limit",
    "RMS current limit",
    "short circuit",
    "following error",
    "homing time-out",
    "wrong stage",
    "supply voltage too low",
    "80 W output exceeded",
];

// === impl Order ===

impl fmt::Display for Order {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let plain = |x: f64| (x * 1e5).round() / 1e5 + 0.0;
        match self {
            Order::Home => f.write_str("OR"),
            Order::MoveAbs(x) => write!(f, "PA{}", plain(*x)),
            Order::Stop => f.write_str("ST"),
            Order::Enable => f.write_str("MM1"),
            Order::Velocity(v) => write!(f, "VA{}", plain(*v)),
            Order::Acceleration(a) => write!(f, "AC{}", plain(*a)),
        }
    }
}

// === impl Query ===

impl Query {
    /// The request's words.
    pub fn words(self) -> &'static str {
        match self {
            Query::State => "TS",
            Query::Error => "TE",
            Query::Position => "TP",
            Query::StageId => "ID?",
            Query::Version => "VE",
            Query::Velocity => "VA?",
            Query::Acceleration => "AC?",
            Query::LeftLimit => "SL?",
            Query::RightLimit => "SR?",
            Query::HomeLimit => "OT?",
        }
    }

    /// What follows address and mnemonic in a reply; `None` when the line answers another question.
    pub fn value(self, address: u8, line: &str) -> Option<String> {
        let rest = line.strip_prefix(&address.to_string())?.strip_prefix(self.words().trim_end_matches('?'))?;
        Some(rest.trim().to_owned())
    }
}

// === impl Status ===

impl Status {
    /// Reads `00000A`: four digits of errors, two of state.
    pub fn parse(text: &str) -> Option<Status> {
        if text.len() != 6 || !text.bytes().all(|b| b.is_ascii_hexdigit()) {
            return None;
        }
        let errors = u16::from_str_radix(text.get(..4)?, 16).ok()?;
        let state = match u8::from_str_radix(text.get(4..)?, 16).ok()? {
            0x0A..=0x11 => State::NotReferenced,
            0x14 => State::Configuration,
            0x1E | 0x1F => State::Homing,
            0x28 => State::Moving,
            0x32..=0x35 => State::Ready,
            0x3C..=0x3E => State::Disabled,
            0x46 | 0x47 => State::Jogging,
            _ => return None,
        };
        Some(Status { errors, state })
    }

    /// The motor's errors in words; end-of-run switches are among them.
    pub fn words(self) -> Vec<String> {
        let on = |bit: usize| self.errors >> bit & 1 == 1;
        MOTOR_ERRORS.iter().enumerate().filter(|(bit, _)| on(*bit)).map(|(_, w)| (*w).to_owned()).collect()
    }
}

/// Kind and words of an error letter; `None` for `@`.
pub fn meaning(letter: char) -> Option<(ErrorKind, &'static str)> {
    use ErrorKind::{Broken, Busy, Refused};
    Some(match letter {
        '@' => return None,
        'G' | 'N' => (Refused, "beyond the controller's soft limits"),
        'H' => (Broken, "no reference (restart or fault); open and home the axis again"),
        'I' => (Busy, "it is in its configuration state; leave it with the vendor's program"),
        'J' => (Broken, "it is disabled; open the axis again"),
        'E' | 'L' => (Busy, "it searches its reference"),
        'M' => (Busy, "it moves"),
        'K' => (Refused, "not allowed while it is ready"),
        'F' => (ErrorKind::WrongDevice, "the stage is not one it knows"),
        'S' => (ErrorKind::Garbled, "its own link timed out"),
        'A' | 'B' | 'C' | 'D' | 'W' | 'X' => (Refused, "the controller does not take the command; check its firmware"),
        _ => (Broken, "see the controller's manual, appendix of errors"),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn the_worked_exchange_is_read() {
        let state = |line: &str| Status::parse(&Query::State.value(1, line).unwrap()).unwrap();
        assert_eq!(state("1TS00000A"), Status { errors: 0, state: State::NotReferenced });
        assert_eq!(state("1TS00001E").state, State::Homing);
        assert_eq!(state("1TS000032").state, State::Ready);
        assert_eq!(state("1TS000028").state, State::Moving);
        assert_eq!(state("1TS001328"), Status { errors: 0x13, state: State::Moving });
        assert_eq!(state("1TS001328").words(), ["negative end of run", "positive end of run", "short circuit"]);
        assert_eq!(Query::Position.value(1, "1TP29.99988").unwrap(), "29.99988");
        assert_eq!(Query::Position.value(2, "1TP29.99988"), None, "another box");
        assert_eq!(Query::Position.value(1, "1TS000032"), None, "another question");
        assert_eq!(Status::parse("000099"), None);
        assert_eq!(format!("1{}", Order::MoveAbs(30.0)), "1PA30");
        assert_eq!(format!("1{}", Order::Home), "1OR");
    }
}
