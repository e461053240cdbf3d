//! Newport ESP300/ESP301, the words on the wire: orders and queries out, error reports in.
//!
//! Source: ESP300 user's manual (commands, appendix of error messages) as collected in the protocol sheet
//! `newport-esp301`. What saves, restarts, configures motors or stores programs cannot be spelt.

use crate::error::ErrorKind;
use std::fmt;

/// Home search: 1 = home switch and index pulse.
const HOME_MODE: u8 = 1;
/// What `SN?` must say: degrees.
pub const DEGREES: u8 = 7;
/// Text of report 0.
const NO_ERROR: &str = "NO ERROR DETECTED";

/// What an axis is told; none of these is answered, the error queue tells how it went.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Order {
    /// Motor on.
    MotorOn,
    /// Search for the reference.
    Home,
    /// Go to a position in degrees.
    MoveAbs(f64),
    /// Stop with the ramp.
    Stop,
    /// Speed, degrees a second.
    Velocity(f64),
    /// Acceleration, degrees a second squared.
    Acceleration(f64),
    /// Deceleration.
    Deceleration(f64),
}

/// What an axis is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Query {
    /// Model and serial number of the stage.
    StageId,
    /// Code of the units.
    Units,
    /// 1: motor on.
    Motor,
    /// 1: at rest.
    Done,
    /// Position of the encoder.
    Position,
    /// Lower soft limit.
    LeftLimit,
    /// Upper soft limit.
    RightLimit,
    /// Largest speed.
    VelocityMax,
    /// Speed.
    Velocity,
    /// Acceleration.
    Acceleration,
    /// Deceleration.
    Deceleration,
    /// Speed of the home search.
    HomeSpeed,
    /// Position after the home search.
    HomePreset,
}

/// A number from the error queue: 1 to 99 of the controller, 100 times the axis and more of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Report(pub u16);

// === impl Order ===

impl fmt::Display for Order {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Order::MotorOn => f.write_str("MO"),
            Order::Home => write!(f, "OR{HOME_MODE}"),
            Order::MoveAbs(x) => write!(f, "PA{}", plain(*x)),
            Order::Stop => f.write_str("ST"),
            Order::Velocity(v) => write!(f, "VA{}", plain(*v)),
            Order::Acceleration(a) => write!(f, "AC{}", plain(*a)),
            Order::Deceleration(a) => write!(f, "AG{}", plain(*a)),
        }
    }
}

/// A number with at most four decimals and never a negative zero.
fn plain(x: f64) -> f64 {
    (x * 1e4).round() / 1e4 + 0.0
}

// === impl Query ===

impl Query {
    /// The mnemonic with its question mark.
    pub fn words(self) -> &'static str {
        match self {
            Query::StageId => "ID?",
            Query::Units => "SN?",
            Query::Motor => "MO?",
            Query::Done => "MD?",
            Query::Position => "TP?",
            Query::LeftLimit => "SL?",
            Query::RightLimit => "SR?",
            Query::VelocityMax => "VU?",
            Query::Velocity => "VA?",
            Query::Acceleration => "AC?",
            Query::Deceleration => "AG?",
            Query::HomeSpeed => "OH?",
            Query::HomePreset => "SH?",
        }
    }
}

// === impl Report ===

impl Report {
    /// Reads `code, time stamp, text`. The text of code 0 is known, so a disturbed 0 is no report.
    pub fn parse(line: &str) -> Option<Report> {
        let (code, rest) = line.split_once(',')?;
        let (stamp, text) = rest.split_once(',')?;
        let code: u16 = Some(code.trim()).filter(|c| !c.starts_with('+'))?.parse().ok()?;
        stamp.trim().parse::<u64>().ok()?;
        ((code == 0) == (text.trim() == NO_ERROR)).then_some(Report(code))
    }

    /// Axis that the report is about; `None` for the controller.
    pub fn axis(self) -> Option<u8> {
        (self.0 >= 100).then_some((self.0 / 100) as u8)
    }

    /// True for what stops every axis: emergency stop, cable interlock, digital interlock.
    pub fn concerns_all(self) -> bool {
        matches!(self.0, 4 | 8)
    }

    /// What happened, and the kind that recovery decides on.
    pub fn meaning(self) -> (ErrorKind, &'static str) {
        use ErrorKind::{Broken, Busy, Refused, WrongDevice};
        if self.axis().is_none() {
            return match self.0 {
                4 => (Broken, "emergency stop; release the button, then open and home the axes again"),
                8 => (Broken, "cable interlock; plug the stage cables in"),
                9 => (WrongDevice, "there is no such axis; check `axis` in the instrument file"),
                6 | 7 | 37 | 38 => (Refused, "the controller does not understand the command; check its firmware"),
                23 => (Broken, "servo tick failure; switch the controller off and on"),
                25 | 27 => (Busy, "the controller is occupied by a stored program or a download"),
                13..=19 | 29..=34 => (Refused, "the axis belongs to a group; undo it with the vendor's program"),
                _ => (Broken, "see the controller's manual, appendix of errors"),
            };
        }
        match self.0 % 100 {
            2 => (Broken, "amplifier fault, the motor is off"),
            3 => (Broken, "following error: the stage is blocked, the motor is off"),
            4 | 5 => (Broken, "a hardware limit switch was reached"),
            6 | 7 => (Refused, "beyond the controller's soft limits"),
            8 => (WrongDevice, "motor or stage not connected"),
            9 => (Broken, "feedback fault; check the stage cable"),
            10 => (Refused, "faster than the stage allows; lower `speed_deg_per_s`"),
            11 => (Refused, "more than the stage's acceleration; lower `acceleration_deg_per_s2`"),
            13 => (Broken, "the motor is off; open and home the axis again"),
            20 => (Broken, "homing was aborted"),
            29 => (Broken, "digital interlock; close its contact"),
            30 => (Busy, "it searches its reference"),
            31 => (Refused, "the axis belongs to a group; undo it with the vendor's program"),
            _ => (Broken, "see the controller's manual, appendix of errors"),
        }
    }
}

/// Model and serial number from `TS50DC.5, SN1263`; `None` for a stage the controller does not know.
pub fn stage_id(line: &str) -> Option<(String, String)> {
    let (model, serial) = line.split_once(',')?;
    let serial = serial.trim().strip_prefix("SN").unwrap_or(serial.trim());
    Some((model.trim().to_owned(), serial.trim().to_owned()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn orders_and_queries_are_the_worked_exchange() {
        let said = |order: Order| format!("1{order}");
        assert_eq!(said(Order::MotorOn), "1MO");
        assert_eq!(said(Order::Home), "1OR1", "home switch and index pulse");
        assert_eq!(said(Order::MoveAbs(200.0)), "1PA200");
        assert_eq!(said(Order::MoveAbs(30.0)), "1PA30");
        assert_eq!(said(Order::MoveAbs(-0.000_01)), "1PA0");
        assert_eq!(said(Order::MoveAbs(29.999_84)), "1PA29.9998");
        assert_eq!(said(Order::Stop), "1ST");
        assert_eq!(format!("1{}", Query::Position.words()), "1TP?");
    }

    #[test]
    fn reports_are_read_and_disturbed_ones_are_not() {
        assert_eq!(Report::parse("0, 451322, NO ERROR DETECTED"), Some(Report(0)));
        let limit = Report::parse("106, 460021, AXIS-1 POSITIVE SOFTWARE LIMIT DETECTED").unwrap();
        assert_eq!((limit.axis(), limit.meaning().0), (Some(1), ErrorKind::Refused));
        for bad in ["0, 451322, NO ERRO", "0", "1, 451322, NO ERROR DETECTED", "0, x, NO ERROR DETECTED", ""] {
            assert_eq!(Report::parse(bad), None, "{bad}");
        }
    }

    #[test]
    fn a_stage_tells_model_and_serial_number() {
        assert_eq!(stage_id("TS50DC.5, SN1263"), Some(("TS50DC.5".to_owned(), "1263".to_owned())));
        assert_eq!(stage_id("Unknown"), None);
    }
}
