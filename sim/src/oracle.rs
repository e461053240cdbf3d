//! Reads painted truth back out of a picture, or says why it cannot.

use crate::paint::{BYTES, CELL, MAGIC, PaintedTruth, ROWS, crc32};
use goniod_drivers::frame::Pixels;
use goniod_drivers::units::ExposureTime;
use thiserror::Error;

/// Why a picture tells nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum OracleError {
    /// The picture has no room for the painting.
    #[error("the picture is too small for painted truth: {width} columns, {pixels} pixels")]
    TooSmall {
        /// Columns.
        width: usize,
        /// Pixels.
        pixels: usize,
    },
    /// The first bits are not the mark.
    #[error("no painted truth: the first 16 bits are {found:#06x}, not the mark (a black or foreign picture)")]
    NoMark {
        /// Bits found.
        found: u16,
    },
    /// The checksum does not fit.
    #[error("painted truth is damaged: checksum {found:#010x}, computed {computed:#010x}")]
    Checksum {
        /// As painted.
        found: u32,
        /// Of the painted bytes.
        computed: u32,
    },
}

/// Reads a frame's pixels; `levels` is the number of levels of its format.
pub fn read_pixels(pixels: &Pixels, width: usize, levels: u32) -> Result<PaintedTruth, OracleError> {
    match pixels {
        Pixels::U8(v) => read(|i| v.get(i).copied().map(u32::from), v.len(), width, levels),
        Pixels::U16(v) => read(|i| v.get(i).copied().map(u32::from), v.len(), width, levels),
    }
}

/// Reads levels given by index; a cell is white where its mean lies above half of the full scale.
pub fn read(
    level: impl Fn(usize) -> Option<u32>,
    pixels: usize,
    width: usize,
    levels: u32,
) -> Result<PaintedTruth, OracleError> {
    let along = width / CELL;
    let rows = (BYTES * 8).div_ceil(along.max(1)) * CELL;
    if along == 0 || rows > ROWS || rows * width > pixels {
        return Err(OracleError::TooSmall { width, pixels });
    }
    let white = |bit: usize| {
        let (top, left) = (bit / along * CELL, bit % along * CELL);
        let cell = (0..CELL * CELL).filter_map(|i| level((top + i / CELL) * width + left + i % CELL));
        2 * cell.sum::<u32>() > (levels - 1) * (CELL * CELL) as u32
    };
    let mut bytes = [0u8; BYTES];
    for (i, byte) in bytes.iter_mut().enumerate() {
        *byte = (0..8).fold(0, |b, k| b << 1 | u8::from(white(8 * i + k)));
    }
    decode(&bytes)
}

fn decode(bytes: &[u8; BYTES]) -> Result<PaintedTruth, OracleError> {
    let word = |at: usize| u32::from_be_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
    let mark = u16::from_be_bytes([bytes[0], bytes[1]]);
    if mark != MAGIC {
        return Err(OracleError::NoMark { found: mark });
    }
    let (found, computed) = (word(24), crc32(&bytes[..24]));
    if found != computed {
        return Err(OracleError::Checksum { found, computed });
    }
    Ok(PaintedTruth {
        tilt_udeg: word(2) as i32,
        spin_udeg: word(6) as i32,
        changer_udeg: word(10) as i32,
        slot: Some(bytes[14]).filter(|s| *s != 0),
        shutter_open: bytes[15] & 1 == 1,
        moved: bytes[15] & 2 == 2,
        exposure: ExposureTime(u64::from(word(16))),
        frame: word(20),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::truth::rng::Key;

    fn truth() -> PaintedTruth {
        PaintedTruth {
            tilt_udeg: -12_345_678,
            spin_udeg: 359_999_999,
            changer_udeg: 180_000_000,
            slot: Some(11),
            shutter_open: true,
            moved: false,
            exposure: ExposureTime(60_000_000),
            frame: 4_000_000_000,
        }
    }

    #[test]
    fn painted_truth_survives_noise_on_both_cameras() {
        for (width, levels) in [(1392usize, 256u32), (320, 4096)] {
            let mut pixels =
                if levels == 256 { Pixels::U8(vec![0; width * 20]) } else { Pixels::U16(vec![0; width * 20]) };
            truth().paint(&mut pixels, width, 16, levels);
            let key = Key::new(3);
            let noisy = |i: usize| {
                let shift = 0.25 * f64::from(levels) * key.normal(i as u64);
                Some((f64::from(pixels.level(i)) + shift).clamp(0.0, f64::from(levels - 1)) as u32)
            };
            assert_eq!(read(noisy, pixels.len(), width, levels), Ok(truth()));
            assert_eq!(read_pixels(&pixels, width, levels), Ok(truth()));
        }
    }

    #[test]
    fn a_black_a_small_and_a_damaged_picture_are_told_apart() {
        let black = Pixels::U8(vec![0; 320 * 20]);
        assert_eq!(read_pixels(&black, 320, 256), Err(OracleError::NoMark { found: 0 }));
        assert!(matches!(read_pixels(&black, 16, 256), Err(OracleError::TooSmall { .. })));
        let mut damaged = Pixels::U8(vec![0; 320 * 20]);
        truth().paint(&mut damaged, 320, 16, 256);
        if let Pixels::U8(v) = &mut damaged {
            (0..4).for_each(|row| (0..4).for_each(|k| v[row * 320 + 30 * 4 + k] ^= 255));
        }
        assert!(matches!(read_pixels(&damaged, 320, 256), Err(OracleError::Checksum { .. })));
    }

    /// The check value of CRC-32.
    #[test]
    fn the_checksum_is_crc32() {
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
    }
}
