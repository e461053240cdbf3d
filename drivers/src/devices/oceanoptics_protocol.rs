//! What USB2000, USB2000+ and USB4000 say: commands, slots, status, spectra; and what differs between them.
//!
//! Source: USB2000, USB2000+ and USB4000 OEM data sheets. There is no encoder for what writes into the device (0x06,
//! 0x07, register writes) or powers it down (0x04).

use std::ops::Range;

/// Vendor id.
pub const VENDOR: u16 = 0x2457;
/// Byte that ends every spectrum.
pub const SYNC: u8 = 0x69;
/// Slot of the serial number.
pub const SLOT_SERIAL: u8 = 0;
/// Slots of the wavelength coefficients.
pub const SLOT_WAVELENGTH: Range<u8> = 1..5;
/// Slots of the non-linearity coefficients.
pub const SLOT_LINEARITY: Range<u8> = 6..14;
/// Slot of the order of the non-linearity polynomial.
pub const SLOT_ORDER: u8 = 14;
/// Slot of the saturation level on USB2000+ and USB4000.
pub const SLOT_SATURATION: u8 = 17;
/// Trigger mode "normal": the detector runs freely.
pub const FREE_RUNNING: u16 = 0;
/// First byte of a slot's answer.
const QUERY_SLOT: u8 = 0x05;
/// Bytes of a status answer.
const STATUS_BYTES: usize = 16;

/// How a model lays out a spectrum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// Packets of 64 low bytes and packets of 64 high bytes in turn; 12 bits count, the upper four may be anything.
    Interleaved,
    /// Words, low byte first.
    Words,
}

/// What one model is. Pixels are counted from 0, as they are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Model {
    /// Product id.
    pub product: u16,
    /// Name.
    pub name: &'static str,
    /// Endpoint for commands.
    pub command: u8,
    /// Endpoint of short answers.
    pub query: u8,
    /// Endpoint of spectra.
    pub spectrum: u8,
    /// Endpoint that carries the first 2048 bytes of a spectrum at high speed.
    pub first: Option<u8>,
    /// Unit of the integration time in microseconds.
    pub unit_us: u64,
    /// Shortest and longest integration time in that unit.
    pub times: (u64, u64),
    /// Pixels that are sent.
    pub pixels: usize,
    /// Optically black pixels.
    pub dark: Range16,
    /// Pixels that see light.
    pub active: Range16,
    /// Layout of a spectrum.
    pub layout: Layout,
    /// Largest count.
    pub full: u16,
}

/// A range of pixels, `start` to before `end`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Range16 {
    /// First pixel.
    pub start: usize,
    /// One past the last.
    pub end: usize,
}

/// The models.
pub const MODELS: [Model; 3] = [
    Model {
        product: 0x1002,
        name: "USB2000",
        command: 0x02,
        query: 0x87,
        spectrum: 0x82,
        first: None,
        unit_us: 1000,
        times: (3, 65_535),
        pixels: 2048,
        dark: Range16 { start: 2, end: 24 },
        active: Range16 { start: 26, end: 2048 },
        layout: Layout::Interleaved,
        full: 4095,
    },
    Model {
        product: 0x101E,
        name: "USB2000+",
        command: 0x01,
        query: 0x81,
        spectrum: 0x82,
        first: None,
        unit_us: 1,
        times: (1000, 65_535_000),
        pixels: 2048,
        // The data sheet says 0..17, a driver in use 6..20: what both call black.
        dark: Range16 { start: 6, end: 18 },
        active: Range16 { start: 20, end: 2048 },
        layout: Layout::Words,
        full: 65_535,
    },
    Model {
        product: 0x1022,
        name: "USB4000",
        command: 0x01,
        query: 0x81,
        spectrum: 0x82,
        first: Some(0x86),
        unit_us: 1,
        times: (10, 65_535_000),
        pixels: 3840,
        dark: Range16 { start: 5, end: 16 },
        active: Range16 { start: 21, end: 3669 },
        layout: Layout::Words,
        full: 65_535,
    },
];

/// What the device says of its state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Status {
    /// Integration time in the model's unit.
    pub time: u64,
    /// Trigger mode.
    pub trigger: u8,
    /// A spectrum was asked for and is not done.
    pub busy: bool,
    /// The bus runs at high speed.
    pub high_speed: bool,
}

/// Puts the device into its power-up state.
pub fn initialise() -> Vec<u8> {
    vec![0x01]
}

/// Lamp and strobe off.
pub fn lamp_off() -> Vec<u8> {
    vec![0x03, 0, 0]
}

/// Asks for a slot of the EEPROM.
pub fn query_slot(slot: u8) -> Vec<u8> {
    vec![QUERY_SLOT, slot]
}

/// Asks for a spectrum.
pub fn request_spectrum() -> Vec<u8> {
    vec![0x09]
}

/// Sets the trigger mode.
pub fn trigger(mode: u16) -> Vec<u8> {
    let [low, high] = mode.to_le_bytes();
    vec![0x0A, low, high]
}

/// Asks for the status.
pub fn query_status() -> Vec<u8> {
    vec![0xFE]
}

/// The bytes of a slot: 15 to 16 after the two that repeat the question; `None` when it is no answer to that question.
pub fn slot_bytes(answer: &[u8], slot: u8) -> Option<&[u8]> {
    let body = answer.strip_prefix(&[QUERY_SLOT, slot])?;
    (15..=16).contains(&body.len()).then_some(body)
}

/// The text of a slot: what stands before the first NUL, without blanks around it; `None` when it is empty or not text.
pub fn slot_text(body: &[u8]) -> Option<&str> {
    let text = body.split(|&b| b == 0).next()?;
    let text = std::str::from_utf8(text).ok()?.trim();
    (!text.is_empty() && text.bytes().all(|b| (0x20..0x7F).contains(&b))).then_some(text)
}

/// The number in a slot; `None` when it is empty or no finite decimal number.
pub fn slot_number(body: &[u8]) -> Option<f64> {
    let text = slot_text(body)?;
    let plain = text.bytes().all(|b| b.is_ascii_digit() || b"+-.eE".contains(&b));
    plain.then(|| text.parse().ok()).flatten().filter(|n: &f64| n.is_finite())
}

/// The saturation level in slot 17 of USB2000+ and USB4000; `full` where it was never programmed.
pub fn saturation_level(body: &[u8], full: u16) -> Option<u16> {
    let level = u16::from_le_bytes([*body.get(4)?, *body.get(5)?]);
    Some(if level == 0 { full } else { level })
}

// === impl Model ===

impl Model {
    /// The model with this product id.
    pub fn of(product: u16) -> Option<&'static Model> {
        MODELS.iter().find(|m| m.product == product)
    }

    /// Sets the integration time, in the model's unit.
    pub fn set_time(&self, time: u64) -> Vec<u8> {
        let [a, b, c, d, ..] = time.to_le_bytes();
        match self.layout {
            Layout::Interleaved => vec![0x02, a, b],
            Layout::Words => vec![0x02, a, b, c, d],
        }
    }

    /// Bytes of a whole spectrum.
    pub fn spectrum_bytes(&self) -> usize {
        2 * self.pixels + 1
    }

    /// The status; `None` when the bytes are no status of this model.
    pub fn status(&self, answer: &[u8]) -> Option<Status> {
        let bytes: [u8; STATUS_BYTES] = answer.try_into().ok()?;
        let [p0, p1, t0, t1, t2, t3, b6, b7, b8, ..] = bytes;
        let little = u16::from_le_bytes([p0, p1]) as usize == self.pixels;
        match self.layout {
            Layout::Interleaved => {
                // Data sheet and devices disagree on the order; the number of pixels shows which one this is.
                let big = u16::from_be_bytes([p0, p1]) as usize == self.pixels;
                let time = match (big, little) {
                    (true, _) => u16::from_be_bytes([t0, t1]),
                    (false, true) => u16::from_le_bytes([t0, t1]),
                    _ => return None,
                };
                Some(Status { time: time.into(), trigger: t3, busy: b6 != 0, high_speed: false })
            }
            Layout::Words => {
                let time = u32::from_le_bytes([t0, t1, t2, t3]).into();
                let speed = bytes[14];
                (little && (speed == 0 || speed == 0x80)).then_some(Status {
                    time,
                    trigger: b7,
                    busy: b8 != 0,
                    high_speed: speed == 0x80,
                })
            }
        }
    }

    /// The raw counts of a whole spectrum; `None` when its length or its last byte is wrong.
    pub fn counts(&self, bytes: &[u8]) -> Option<Vec<u16>> {
        let (&last, data) = bytes.split_last()?;
        if last != SYNC || bytes.len() != self.spectrum_bytes() {
            return None;
        }
        Some(match self.layout {
            Layout::Interleaved => {
                let pairs = data.chunks_exact(128).map(|pair| pair.split_at(64));
                pairs
                    .flat_map(|(low, high)| low.iter().zip(high).map(|(&l, &h)| u16::from_le_bytes([l, h & 0x0F])))
                    .collect()
            }
            Layout::Words => data
                .chunks_exact(2)
                .map(|word| word.iter().rev().fold(0_u16, |value, &byte| value << 8 | u16::from(byte)))
                .collect(),
        })
    }
}

// === impl Range16 ===

impl Range16 {
    /// The part of `values` in this range.
    pub fn of<T>(self, values: &[T]) -> &[T] {
        values.get(self.start..self.end).unwrap_or_default()
    }
}

#[cfg(test)]
#[path = "oceanoptics_protocol_tests.rs"]
mod tests;
