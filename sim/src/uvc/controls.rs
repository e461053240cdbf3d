//! The camera's controls and the requests that read and write them. Pure.
//!
//! Source: UVC 1.0, chapter 4.2; the exposure time counts in 100 us.

use super::descriptors::{CAMERA, PROCESSING};
use crate::front::usb::{Answer, SetupPacket};

/// SET_CUR.
pub const SET_CUR: u8 = 0x01;
/// GET_CUR.
pub const GET_CUR: u8 = 0x81;
/// GET_MIN.
pub const GET_MIN: u8 = 0x82;
/// GET_MAX.
pub const GET_MAX: u8 = 0x83;
/// GET_RES.
pub const GET_RES: u8 = 0x84;
/// GET_LEN.
pub const GET_LEN: u8 = 0x85;
/// GET_INFO.
pub const GET_INFO: u8 = 0x86;
/// GET_DEF.
pub const GET_DEF: u8 = 0x87;

/// GET_INFO: readable, writable, may change by itself (so that a host reads it back and does not trust its memory).
const INFO: u8 = 0x01 | 0x02 | 0x08;
/// Automatic exposure modes: manual, and aperture priority (the camera chooses the time).
const MANUAL: i32 = 1;
const APERTURE_PRIORITY: i32 = 8;
/// Exposure that the automatic mode arrives at, in 100 us.
const AUTOMATIC_EXPOSURE: u32 = 333;

/// Why the camera refused a request, as its error code control says.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Refusal {
    /// Nothing was refused.
    #[default]
    None = 0,
    /// The control cannot be written in this mode.
    WrongState = 2,
    /// Outside the range.
    OutOfRange = 4,
    /// No such control.
    InvalidControl = 6,
    /// No such request.
    InvalidRequest = 7,
}

/// One control.
#[derive(Debug, Clone, Copy)]
struct Control {
    entity: u8,
    selector: u8,
    bytes: usize,
    min: i32,
    max: i32,
    step: i32,
    default: i32,
}

/// Settings that bear on a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// Integration time in 100 us.
    pub exposure: u32,
    /// Gain in 0.1 dB.
    pub gain: i32,
    /// Added to every level.
    pub brightness: i32,
    /// Gamma in hundredths.
    pub gamma: i32,
}

/// All controls with their values.
#[derive(Debug, Clone)]
pub struct Controls {
    now: [i32; 6],
    refusal: Refusal,
}

const MODE: usize = 0;
const PRIORITY: usize = 1;
const EXPOSURE: usize = 2;
const BRIGHTNESS: usize = 3;
const GAIN: usize = 4;
const GAMMA: usize = 5;

#[rustfmt::skip]
const CONTROLS: [Control; 6] = [
    Control { entity: CAMERA, selector: 0x02, bytes: 1, min: 0, max: 0, step: MANUAL | APERTURE_PRIORITY, default: APERTURE_PRIORITY },
    Control { entity: CAMERA, selector: 0x03, bytes: 1, min: 0, max: 1, step: 1, default: 1 },
    Control { entity: CAMERA, selector: 0x04, bytes: 4, min: 1, max: 100_000, step: 1, default: 333 },
    Control { entity: PROCESSING, selector: 0x02, bytes: 2, min: -64, max: 64, step: 1, default: 0 },
    Control { entity: PROCESSING, selector: 0x04, bytes: 2, min: 0, max: 240, step: 1, default: 60 },
    Control { entity: PROCESSING, selector: 0x09, bytes: 2, min: 50, max: 300, step: 1, default: 200 },
];

// === impl Controls ===

impl Controls {
    /// After power-up: automatic exposure, gain 6 dB, gamma 2, as cameras made for people are.
    pub fn power_up() -> Controls {
        Controls { now: CONTROLS.map(|c| c.default), refusal: Refusal::None }
    }

    /// What a picture that begins now is taken with.
    pub fn settings(&self) -> Settings {
        let manual = self.now[MODE] == MANUAL;
        let exposure = if manual { self.now[EXPOSURE].unsigned_abs() } else { AUTOMATIC_EXPOSURE };
        Settings { exposure, gain: self.now[GAIN], brightness: self.now[BRIGHTNESS], gamma: self.now[GAMMA] }
    }

    /// The camera may lengthen its frame interval by itself.
    pub fn may_slow_down(&self) -> bool {
        self.now[PRIORITY] == 1
    }

    /// Answers a class request to an entity of the control interface.
    pub fn request(&mut self, setup: SetupPacket, bytes: &[u8]) -> Answer {
        let (entity, selector) = ((setup.index >> 8) as u8, (setup.value >> 8) as u8);
        if (entity, selector) == (0, 2) {
            return match setup.request {
                GET_CUR => Answer::Data(vec![self.refusal as u8]),
                GET_INFO => Answer::Data(vec![1]),
                _ => Answer::Stall,
            };
        }
        let Some(at) = CONTROLS.iter().position(|c| (c.entity, c.selector) == (entity, selector)) else {
            return self.refuse(Refusal::InvalidControl);
        };
        let control = CONTROLS[at];
        let value = match setup.request {
            SET_CUR => return self.write(at, bytes),
            GET_CUR if at == EXPOSURE => self.settings().exposure as i32,
            GET_CUR => self.now[at],
            GET_MIN => control.min,
            GET_MAX => control.max,
            GET_RES => control.step,
            GET_DEF => control.default,
            GET_LEN => return Answer::Data((control.bytes as u16).to_le_bytes().to_vec()),
            GET_INFO => return Answer::Data(vec![INFO]),
            _ => return self.refuse(Refusal::InvalidRequest),
        };
        self.refusal = Refusal::None;
        Answer::Data(value.to_le_bytes().into_iter().take(control.bytes).collect())
    }

    fn refuse(&mut self, why: Refusal) -> Answer {
        self.refusal = why;
        Answer::Stall
    }

    fn write(&mut self, at: usize, bytes: &[u8]) -> Answer {
        let control = CONTROLS[at];
        let value = match (control.bytes, bytes) {
            (1, [a]) => i32::from(*a),
            (2, [a, b]) => i32::from(i16::from_le_bytes([*a, *b])),
            (4, [a, b, c, d]) => i32::from_le_bytes([*a, *b, *c, *d]),
            _ => return self.refuse(Refusal::InvalidRequest),
        };
        let right = match at {
            MODE => value == MANUAL || value == APERTURE_PRIORITY,
            _ => (control.min..=control.max).contains(&value),
        };
        if !right {
            return self.refuse(Refusal::OutOfRange);
        }
        if at == EXPOSURE && self.now[MODE] != MANUAL {
            return self.refuse(Refusal::WrongState);
        }
        self.refusal = Refusal::None;
        self.now[at] = value;
        Answer::Data(Vec::new())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ask(controls: &mut Controls, request: u8, entity: u8, selector: u8, bytes: &[u8]) -> Answer {
        let (value, index) = (u16::from(selector) << 8, u16::from(entity) << 8);
        let request_type = if request == SET_CUR { 0x21 } else { 0xa1 };
        controls.request(SetupPacket { request_type, request, value, index, length: bytes.len() as u16 }, bytes)
    }

    #[test]
    fn the_exposure_obeys_only_in_manual_mode_and_within_its_range() {
        let mut c = Controls::power_up();
        assert_eq!(c.settings().exposure, AUTOMATIC_EXPOSURE);
        let five_seconds = 50_000_u32.to_le_bytes();
        assert_eq!(ask(&mut c, SET_CUR, CAMERA, 4, &five_seconds), Answer::Stall, "automatic");
        assert_eq!(ask(&mut c, GET_CUR, 0, 2, &[]), Answer::Data(vec![Refusal::WrongState as u8]));
        assert_eq!(ask(&mut c, SET_CUR, CAMERA, 2, &[1]), Answer::Data(vec![]));
        assert_eq!(ask(&mut c, SET_CUR, CAMERA, 4, &five_seconds), Answer::Data(vec![]));
        assert_eq!(ask(&mut c, GET_CUR, CAMERA, 4, &[]), Answer::Data(five_seconds.to_vec()));
        assert_eq!(c.settings().exposure, 50_000);
        assert_eq!(ask(&mut c, SET_CUR, CAMERA, 4, &[0; 4]), Answer::Stall, "below the range");
        assert_eq!(ask(&mut c, GET_CUR, 0, 2, &[]), Answer::Data(vec![Refusal::OutOfRange as u8]));
    }

    #[test]
    fn signed_controls_keep_their_sign_and_what_is_not_there_is_refused() {
        let mut c = Controls::power_up();
        assert_eq!(ask(&mut c, SET_CUR, PROCESSING, 2, &(-5_i16).to_le_bytes()), Answer::Data(vec![]));
        assert_eq!(c.settings().brightness, -5);
        assert_eq!(ask(&mut c, GET_LEN, PROCESSING, 2, &[]), Answer::Data(vec![2, 0]));
        assert_eq!(ask(&mut c, GET_CUR, PROCESSING, 0x33, &[]), Answer::Stall);
        assert_eq!(ask(&mut c, SET_CUR, PROCESSING, 2, &[1, 2, 3]), Answer::Stall);
    }
}
