//! The settings of an ESP301 axis: mnemonic, value at power-up, range, how it is written.
//!
//! Source: the protocol sheet `newport-esp301`, section 3, and the commands that public drivers of the controller send.
//! Values are those of a model rotation stage with a direct-current motor.

use std::collections::BTreeMap;

/// Values by mnemonic.
pub(super) type Settings = BTreeMap<&'static str, f64>;

/// How a value is written in a reply.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Style {
    /// Plain decimal.
    Number,
    /// Hexadecimal with H.
    Hex,
}

/// One setting.
pub(super) struct Setting {
    /// Mnemonic.
    pub name: &'static str,
    /// At power-up.
    pub value: f64,
    /// Smallest and largest value.
    pub range: (f64, f64),
    /// In replies.
    pub style: Style,
    /// The setting that this one may not exceed, and the error if it does.
    pub below: Option<(&'static str, u16)>,
}

const fn plain(name: &'static str, value: f64, low: f64, high: f64) -> Setting {
    Setting { name, value, range: (low, high), style: Style::Number, below: None }
}

const fn capped(name: &'static str, value: f64, by: &'static str, error: u16) -> Setting {
    Setting { name, value, range: (0.0, 1e9), style: Style::Number, below: Some((by, error)) }
}

const fn hex(name: &'static str, value: f64) -> Setting {
    Setting { name, value, range: (0.0, 65_535.0), style: Style::Hex, below: None }
}

/// All settings of an axis.
#[rustfmt::skip]
pub(super) const SETTINGS: &[Setting] = &[
    capped("VA", 10.0, "VU", 10), plain("VU", 40.0, 0.0, 1e9), capped("VB", 0.0, "VU", 10),
    capped("AC", 40.0, "AU", 11), capped("AG", 40.0, "AU", 11), capped("AE", 160.0, "AU", 11), plain("AU", 160.0, 0.0, 1e9),
    capped("OH", 10.0, "VU", 10), capped("OL", 1.0, "VU", 10), capped("JH", 10.0, "VU", 10), capped("JW", 2.0, "VU", 10),
    plain("JK", 400.0, 0.0, 1e9), plain("OM", 1.0, 0.0, 6.0), plain("SH", 0.0, -1e9, 1e9),
    plain("SN", 7.0, 0.0, 11.0), plain("SU", 0.0005, 1e-12, 1e6), plain("FR", 0.01, 1e-12, 1e6), plain("QS", 100.0, 1.0, 2000.0),
    plain("SL", -360.0, -1e9, 0.0), plain("SR", 720.0, 0.0, 1e9), plain("FE", 1.0, 0.0, 1e9), plain("FP", 4.0, 0.0, 7.0),
    plain("QM", 1.0, 0.0, 4.0), plain("QI", 1.0, 0.0, 100.0), plain("QV", 24.0, 0.0, 100.0), plain("QT", 5.0, 0.0, 100.0),
    plain("QR", 50.0, 0.0, 100.0), plain("QG", 1.0, 0.0, 1e6), plain("TJ", 1.0, 1.0, 6.0), plain("GR", 1.0, -1e6, 1e6),
    plain("KP", 450.0, 0.0, 1e9), plain("KI", 100.0, 0.0, 1e9), plain("KD", 600.0, 0.0, 1e9), plain("KS", 500.0, 0.0, 1e9),
    plain("AF", 0.0, 0.0, 2e9), plain("VF", 0.0, 0.0, 2e9), plain("DB", 0.0, 0.0, 1e9), plain("DO", 0.0, -10.0, 10.0),
    plain("CL", 0.0, 0.0, 60_000.0), plain("BA", 0.0, 0.0, 1e6), plain("CO", 0.0, -1e6, 1e6), plain("SI", 10.0, 1.0, 1000.0),
    plain("SS", 1.0, 1.0, 3.0), plain("SK", 0.0, -1e9, 1e9), plain("BP", 0.0, 0.0, 15.0), plain("BQ", 0.0, 0.0, 1.0),
    hex("ZA", 291.0), hex("ZB", 768.0), hex("ZE", 3.0), hex("ZF", 3.0), hex("ZH", 36.0), hex("ZS", 4.0),
];

/// All values at power-up.
pub(super) fn defaults() -> Settings {
    SETTINGS.iter().map(|s| (s.name, s.value)).collect()
}

/// The setting of this mnemonic.
pub(super) fn setting(name: &str) -> Option<&'static Setting> {
    SETTINGS.iter().find(|s| s.name == name)
}

// === impl Setting ===

impl Setting {
    /// The value as a reply writes it.
    pub fn text(&self, value: f64) -> String {
        match self.style {
            Style::Number => number(value),
            Style::Hex => format!("{:X}H", value as u32),
        }
    }

    /// Reads a value: decimal, or hexadecimal ending in H.
    pub fn read(&self, text: &str) -> Option<f64> {
        match text.strip_suffix(['H', 'h']) {
            Some(hex) => u32::from_str_radix(hex, 16).ok().map(f64::from),
            None => text.parse().ok().filter(|v: &f64| v.is_finite()),
        }
    }
}

/// A plain decimal with at most six places.
pub(super) fn number(value: f64) -> String {
    let text = format!("{value:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Text of an error number of an axis (`nn` of `100 axis + nn`) or, below 100, of the controller.
pub(super) fn error_text(code: u16) -> String {
    let text = match code % 100 {
        _ if code < 100 => return controller_text(code).to_owned(),
        0 => "MOTOR TYPE NOT DEFINED",
        1 => "PARAMETER OUT OF RANGE",
        2 => "AMPLIFIER FAULT DETECTED",
        3 => "FOLLOWING ERROR THRESHOLD EXCEEDED",
        4 => "POSITIVE HARDWARE LIMIT DETECTED",
        5 => "NEGATIVE HARDWARE LIMIT DETECTED",
        6 => "POSITIVE SOFTWARE LIMIT DETECTED",
        7 => "NEGATIVE SOFTWARE LIMIT DETECTED",
        8 => "MOTOR / STAGE NOT CONNECTED",
        9 => "FEEDBACK SIGNAL FAULT DETECTED",
        10 => "MAXIMUM VELOCITY EXCEEDED",
        11 => "MAXIMUM ACCELERATION EXCEEDED",
        13 => "MOTOR NOT ENABLED",
        15 => "MAXIMUM JERK EXCEEDED",
        16 => "MAXIMUM DAC OFFSET EXCEEDED",
        17 => "ESP CRITICAL SETTINGS ARE PROTECTED",
        18 => "ESP STAGE DEVICE ERROR",
        19 => "ESP STAGE DATA INVALID",
        20 => "HOMING ABORTED",
        21 => "MOTOR CURRENT NOT DEFINED",
        22 => "UNIDRIVE COMMUNICATIONS ERROR",
        23 => "UNIDRIVE NOT DETECTED",
        24 => "SPEED OUT OF RANGE",
        25 => "INVALID TRAJECTORY MASTER AXIS",
        26 => "PARAMETER CHANGE NOT ALLOWED",
        27 => "INVALID TRAJECTORY MODE FOR HOMING",
        28 => "INVALID ENCODER STEP RATIO",
        29 => "DIGITAL I/O INTERLOCK DETECTED",
        30 => "COMMAND NOT ALLOWED DURING HOMING",
        31 => "COMMAND NOT ALLOWED DUE TO GROUP ASSIGNMENT",
        32 => "INVALID TRAJECTORY MODE FOR MOVING",
        _ => "ERROR",
    };
    format!("AXIS-{} {text}", code / 100)
}

fn controller_text(code: u16) -> &'static str {
    match code {
        0 => "NO ERROR DETECTED",
        1 => "PCI COMMUNICATION TIME-OUT",
        4 => "EMERGENCY STOP ACTIVATED",
        6 => "COMMAND DOES NOT EXIST",
        7 => "PARAMETER OUT OF RANGE",
        8 => "CABLE INTERLOCK ERROR",
        9 => "AXIS NUMBER OUT OF RANGE",
        13 => "GROUP NUMBER MISSING",
        14 => "GROUP NUMBER OUT OF RANGE",
        15 => "GROUP NUMBER NOT ASSIGNED",
        20 => "DATA ACQUISITION IS BUSY",
        21 => "DATA ACQUISITION SETUP ERROR",
        22 => "DATA ACQUISITION NOT ENABLED",
        23 => "SERVO CYCLE TICK FAILURE",
        25 => "DOWNLOAD IN PROGRESS",
        26 => "STORED PROGRAM NOT STARTED",
        27 => "COMMAND NOT ALLOWED",
        28 => "STORED PROGRAM FLASH AREA FULL",
        35 => "PROGRAM NOT FOUND",
        37 => "AXIS NUMBER MISSING",
        38 => "COMMAND PARAMETER MISSING",
        39 => "PROGRAM LABEL NOT FOUND",
        40 => "LAST COMMAND CANNOT BE REPEATED",
        41 => "MAX NUMBER OF LABELS PER PROGRAM EXCEEDED",
        _ => "ERROR",
    }
}
