//! Truth painted into the reserved rows of a photograph: black and white cells of 4 x 4 pixels, one a bit, row by row
//! from the top left, so a test that reads stored files can judge their labels.

use crate::pose::Pose;
use goniod_drivers::frame::Pixels;
use goniod_drivers::units::ExposureTime;

/// Pixels along a cell.
pub const CELL: usize = 4;
/// Rows the painting needs at most.
pub const ROWS: usize = 16;
/// First 16 bits.
pub const MAGIC: u16 = 0x6A5C;
/// Bytes painted, with magic and checksum.
pub const BYTES: usize = 28;

/// What a photograph really saw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PaintedTruth {
    /// Tilt axis angle in the middle of the exposure, millionths of a degree.
    pub tilt_udeg: i32,
    /// Spin axis angle.
    pub spin_udeg: i32,
    /// Changer axis angle.
    pub changer_udeg: i32,
    /// Wheel place; `None` while it turned.
    pub slot: Option<u8>,
    /// Light passed the shutter in the middle of the exposure.
    pub shutter_open: bool,
    /// Something moved or switched during the exposure.
    pub moved: bool,
    /// Integration time that the sensor really used.
    pub exposure: ExposureTime,
    /// Device frame id, lower 32 bits.
    pub frame: u32,
}

// === impl PaintedTruth ===

impl PaintedTruth {
    /// The truth of a pose, an exposure and a frame number.
    pub fn new(pose: &Pose, moved: bool, exposure: ExposureTime, frame: u64) -> PaintedTruth {
        let udeg = |deg: f64| (deg * 1e6).round() as i32;
        PaintedTruth {
            tilt_udeg: udeg(pose.tilt_deg),
            spin_udeg: udeg(pose.spin_deg),
            changer_udeg: udeg(pose.changer_deg),
            slot: pose.slot,
            shutter_open: pose.shutter_open,
            moved,
            exposure,
            frame: frame as u32,
        }
    }

    /// The painted bytes: magic, angles, slot (0 = turning), flags, exposure in us, frame, CRC-32 (big-endian).
    pub fn bytes(&self) -> [u8; BYTES] {
        let mut out = [0; BYTES];
        let flags = u8::from(self.shutter_open) | u8::from(self.moved) << 1;
        let exposure = u32::try_from(self.exposure.0).unwrap_or(u32::MAX);
        out[0..2].copy_from_slice(&MAGIC.to_be_bytes());
        out[2..6].copy_from_slice(&self.tilt_udeg.to_be_bytes());
        out[6..10].copy_from_slice(&self.spin_udeg.to_be_bytes());
        out[10..14].copy_from_slice(&self.changer_udeg.to_be_bytes());
        out[14] = self.slot.unwrap_or(0);
        out[15] = flags;
        out[16..20].copy_from_slice(&exposure.to_be_bytes());
        out[20..24].copy_from_slice(&self.frame.to_be_bytes());
        let crc = crc32(&out[..24]);
        out[24..28].copy_from_slice(&crc.to_be_bytes());
        out
    }

    /// Paints itself into the top `rows` rows of a picture `width` wide with `levels` levels.
    pub fn paint(&self, pixels: &mut Pixels, width: usize, rows: usize, levels: u32) {
        let bytes = self.bytes();
        let along = width / CELL;
        let n = (rows.min(ROWS) * width).min(pixels.len());
        let white = |i: usize| {
            let (row, column) = (i / width / CELL, i % width / CELL);
            let bit = row * along + column;
            column < along && bytes.get(bit / 8).is_some_and(|byte| byte >> (7 - bit % 8) & 1 == 1)
        };
        let full = (levels - 1) as u16;
        match pixels {
            Pixels::U8(v) => {
                v[..n].iter_mut().enumerate().for_each(|(i, p)| *p = if white(i) { full as u8 } else { 0 })
            }
            Pixels::U16(v) => v[..n].iter_mut().enumerate().for_each(|(i, p)| *p = if white(i) { full } else { 0 }),
        }
    }
}

/// CRC-32 (reflected polynomial 0xEDB88320, start and end complemented).
pub fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |c, _| if c & 1 == 1 { c >> 1 ^ 0xEDB8_8320 } else { c >> 1 })
    })
}
