//! Zaber warning codes: what each means and what it asks of the driver.
//!
//! Source: vendor library flag names and two public drivers, as collected in the protocol sheet `zaber-ascii`.

use crate::error::ErrorKind;

/// What a warning asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Class {
    /// A fault that a person must look at.
    Fault,
    /// The drive stage is off; opening the axis enables it.
    DriveOff,
    /// The position is lost or suspect; homing is the way back.
    PositionLost,
    /// No reference since power-up, or not homed.
    Unreferenced,
    /// Somebody turns the knob.
    Manual,
    /// The last movement was interrupted or recovered from a stall: fails a move, is normal after a stop.
    Interrupted,
    /// Worth telling, no more.
    Note,
}

/// One warning of an axis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Warning {
    /// Two characters.
    pub code: String,
    /// What it asks for; an unknown code is a fault.
    pub class: Class,
    /// Meaning for a person.
    pub meaning: &'static str,
}

/// All codes: code, class, meaning.
const CODES: &[(&str, Class, &str)] = &[
    ("FF", Class::Fault, "critical system error; switch the device off and on, then call service"),
    ("FN", Class::Fault, "peripheral not supported; check the stage that is connected"),
    ("FZ", Class::Fault, "peripheral inactive; activate it with the vendor's program"),
    ("FH", Class::Fault, "hardware emergency stop; release it"),
    ("FV", Class::Fault, "supply voltage out of range, drive off; check the power supply"),
    ("FO", Class::DriveOff, "drive stage off; open the axis again"),
    ("FC", Class::Fault, "inrush current error; check the power supply"),
    ("FM", Class::Fault, "motor too hot; let it cool down"),
    ("FD", Class::Fault, "drive stage off from heat; let it cool down"),
    ("FQ", Class::Fault, "encoder error; call service"),
    ("FI", Class::Fault, "index error; call service"),
    ("FA", Class::Fault, "analogue encoder error; call service"),
    ("FR", Class::Fault, "overdrive limit exceeded; check the load"),
    ("FS", Class::PositionLost, "stalled and stopped; clear the way, then home"),
    ("FB", Class::Fault, "stream bounds exceeded, though streams are not used here"),
    ("FP", Class::Fault, "path deviation, though streams are not used here"),
    ("FE", Class::PositionLost, "limit error; home again"),
    ("FT", Class::Fault, "excessive twist; untwist cable and stage"),
    ("WL", Class::PositionLost, "unexpected limit trigger; home again"),
    ("WV", Class::Note, "supply voltage out of range"),
    ("WT", Class::Note, "controller hot"),
    ("WS", Class::Interrupted, "stalled and recovered"),
    ("WM", Class::PositionLost, "displaced while it stood; home again"),
    ("WP", Class::Fault, "calibration of the peripheral invalid; check the stage that is connected"),
    ("WR", Class::Unreferenced, "no reference position since power-up; home it"),
    ("WH", Class::Unreferenced, "not homed; home it"),
    ("NC", Class::Manual, "moved by its knob; leave it alone"),
    ("NI", Class::Interrupted, "movement interrupted"),
    ("ND", Class::Note, "stream discontinuity"),
    ("NR", Class::Note, "value rounded"),
    ("NT", Class::Note, "value truncated"),
    ("NU", Class::Note, "setting update pending"),
    ("NJ", Class::Note, "joystick calibrating"),
    ("NB", Class::Fault, "in update mode; switch it off and on"),
];

// === impl Warning ===

impl Warning {
    /// The warning of a two-character code.
    pub fn of(code: &str) -> Warning {
        let known = CODES.iter().find(|(c, _, _)| *c == code);
        let (class, meaning) =
            known.map_or((Class::Fault, "unknown to this driver; see the device's manual"), |k| (k.1, k.2));
        Warning { code: code.to_owned(), class, meaning }
    }

    /// Reads the data of `warnings`: a count, then so many codes. `None` when that does not hold.
    pub fn list(data: &str) -> Option<Vec<Warning>> {
        let mut words = data.split_ascii_whitespace();
        let count: usize = words.next().filter(|w| w.bytes().all(|b| b.is_ascii_digit()))?.parse().ok()?;
        let codes: Vec<Warning> = words.map(Warning::of).collect();
        (codes.len() == count && codes.iter().all(|w| w.code.len() == 2)).then_some(codes)
    }

    /// Code and meaning.
    pub fn words(&self) -> String {
        format!("{} ({})", self.code, self.meaning)
    }

    /// What an absolute move that has not begun makes of it.
    pub fn forbids_move(&self) -> Option<ErrorKind> {
        match self.class {
            // Without a reference the axis was restarted since it was homed: homing it mends that.
            Class::Fault | Class::DriveOff | Class::PositionLost | Class::Unreferenced => Some(ErrorKind::Broken),
            Class::Manual => Some(ErrorKind::Busy),
            Class::Interrupted | Class::Note => None,
        }
    }

    /// What a move that has ended makes of it.
    pub fn fails_move(&self) -> bool {
        self.class != Class::Note
    }

    /// True when the position cannot be trusted.
    pub fn voids_position(&self) -> bool {
        matches!(self.class, Class::PositionLost | Class::Unreferenced)
    }

    /// True when `home` may begin in spite of it (after the latched ones were cleared).
    pub fn allows_home(&self) -> bool {
        matches!(self.class, Class::PositionLost | Class::Unreferenced | Class::Interrupted | Class::Note)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn lists_are_read_with_their_count() {
        let list = Warning::list("02 WR NI").unwrap();
        assert_eq!(list.iter().map(|w| w.class).collect::<Vec<_>>(), [Class::Unreferenced, Class::Interrupted]);
        assert_eq!(Warning::list("00").unwrap(), []);
        assert_eq!(Warning::list("02 WR"), None);
        assert_eq!(Warning::list("WR"), None);
        assert_eq!(Warning::list("01 WRX"), None);
    }

    #[test]
    fn every_code_of_the_sheet_is_classed() {
        let sheet =
            "FF FN FZ FH FV FO FC FM FD FQ FI FA FR FS FB FP FE FT WL WV WT WS WM WP WR WH NC NI ND NR NT NU NJ NB";
        for code in sheet.split(' ') {
            let warning = Warning::of(code);
            assert!(!warning.meaning.starts_with("unknown"), "{code}");
            if code.starts_with('F') {
                assert_eq!(warning.forbids_move(), Some(ErrorKind::Broken), "{code}");
                assert!(warning.fails_move(), "{code}");
            }
        }
        assert_eq!(Warning::of("ZZ").class, Class::Fault);
        for code in ["WL", "WS", "NI", "NC"] {
            assert!(Warning::of(code).fails_move(), "{code}");
        }
    }
}
