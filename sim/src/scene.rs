//! What a camera twin photographs: the [`Scene`] a bench plugs in, and a painted one whose pixels tell the truth about themselves.

use std::ops::Range;
use tokio::time::Instant;

/// What the sensor really does while a picture is taken.
#[derive(Debug, Clone, PartialEq)]
pub struct ExposureRequest {
    /// Count of exposures since power-up.
    pub frame_number: u64,
    /// Count of frames that its host has been given since it opened the camera, this one included.
    pub host_count: u64,
    /// Integration time the sensor really used, in microseconds.
    pub exposure_us: f64,
    /// Gain in dB.
    pub gain_db: f64,
    /// When the exposure began.
    pub started: Instant,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Highest level of the pixel format in force.
    pub max_level: u16,
}

/// Anything that can be photographed.
pub trait Scene: Send + Sync {
    /// Fills `out` (width * height levels, row by row) with the picture of `request`; levels above `max_level` are cut.
    fn render(&self, request: &ExposureRequest, out: &mut [u16]);
}

/// A picture that says in its first and last row which exposure it is, and whose every other pixel follows from it.
#[derive(Debug, Clone, Copy, Default)]
pub struct Painted;

/// What a painted row says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tag {
    /// Count of exposures since power-up.
    pub frame_number: u64,
    /// Integration time in whole microseconds.
    pub exposure_us: u64,
}

/// What a painted picture turned out to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reading {
    /// One exposure, every pixel as it must be.
    Whole(Tag),
    /// Upper and lower part belong to different integration times.
    Mixed(Tag, Tag),
    /// Not a painted picture, or a pixel is wrong.
    Damaged,
}

/// Bytes of a tag: mark, frame number, exposure, checksum.
const TAG: usize = 2 + 8 + 8 + 2;
const MARK: [u8; 2] = [0x47, 0xd5];

// === impl Tag ===

impl Tag {
    fn bytes(self) -> [u8; TAG] {
        let mut bytes = [0; TAG];
        bytes[..2].copy_from_slice(&MARK);
        bytes[2..10].copy_from_slice(&self.frame_number.to_be_bytes());
        bytes[10..18].copy_from_slice(&self.exposure_us.to_be_bytes());
        let sum = checksum(&bytes[..18]);
        bytes[18..].copy_from_slice(&sum.to_be_bytes());
        bytes
    }

    fn read(row: impl Iterator<Item = u16>) -> Option<Tag> {
        let bytes: Vec<u8> = row.take(TAG).map(|v| v as u8).collect();
        let number = |r: Range<usize>| Some(u64::from_be_bytes(bytes.get(r)?.try_into().ok()?));
        let sum = u16::from_be_bytes(bytes.get(18..TAG)?.try_into().ok()?);
        (bytes.get(..2)? == MARK && sum == checksum(bytes.get(..18)?))
            .then_some(Tag { frame_number: number(2..10)?, exposure_us: number(10..18)? })
    }

    /// Level of the pattern at a pixel.
    fn level(self, row: usize, column: usize, max_level: u16) -> u16 {
        let seed = (self.frame_number as u32).wrapping_mul(0x9e37) ^ (self.exposure_us as u32).wrapping_mul(0x85eb);
        (seed.wrapping_add(row as u32 * 31).wrapping_add(column as u32 * 7) as u16) & max_level
    }
}

fn checksum(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xffff_u16, |sum, b| sum.rotate_left(5) ^ u16::from(*b).wrapping_mul(0x0101))
}

// === impl Painted ===

impl Painted {
    /// Fewest columns a tag needs.
    pub const MIN_WIDTH: usize = TAG;

    /// Reads a picture back: who it is, and whether every pixel is as painted.
    pub fn read(width: usize, height: usize, max_level: u16, level: impl Fn(usize) -> u16) -> Reading {
        let row = |r: usize| (0..width).map(|c| level(r * width + c)).collect::<Vec<u16>>();
        if width < TAG || height < 2 {
            return Reading::Damaged;
        }
        let (Some(top), Some(bottom)) = (Tag::read(row(0).into_iter()), Tag::read(row(height - 1).into_iter())) else {
            return Reading::Damaged;
        };
        if top != bottom {
            return Reading::Mixed(top, bottom);
        }
        let right = (1..height - 1).all(|r| (0..width).all(|c| level(r * width + c) == top.level(r, c, max_level)));
        if right { Reading::Whole(top) } else { Reading::Damaged }
    }
}

impl Scene for Painted {
    fn render(&self, request: &ExposureRequest, out: &mut [u16]) {
        let tag = Tag { frame_number: request.frame_number, exposure_us: request.exposure_us.round() as u64 };
        let last = request.height.saturating_sub(1);
        for (r, row) in out.chunks_mut(request.width.max(1)).enumerate() {
            if r == 0 || r == last {
                row.fill(0);
                row.iter_mut().zip(tag.bytes()).for_each(|(pixel, byte)| *pixel = u16::from(byte));
            } else {
                row.iter_mut().enumerate().for_each(|(c, pixel)| *pixel = tag.level(r, c, request.max_level));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    fn picture(frame_number: u64, exposure_us: f64) -> Vec<u16> {
        let request = ExposureRequest {
            frame_number,
            host_count: frame_number,
            exposure_us,
            gain_db: 0.0,
            started: Instant::now(),
            width: 32,
            height: 6,
            max_level: 0xff,
        };
        let mut out = vec![0; 32 * 6];
        Painted.render(&request, &mut out);
        out
    }

    fn read(levels: &[u16]) -> Reading {
        Painted::read(32, 6, 0xff, |i| levels[i])
    }

    #[test]
    fn a_painted_picture_says_what_it_is_and_shows_a_single_wrong_pixel() {
        let mut a = picture(7, 4100.0);
        assert_eq!(read(&a), Reading::Whole(Tag { frame_number: 7, exposure_us: 4100 }));
        let b = picture(8, 16400.0);
        let mut half = a.clone();
        half[96..].copy_from_slice(&b[96..]);
        assert!(
            matches!(read(&half), Reading::Mixed(top, bottom) if top.frame_number == 7 && bottom.frame_number == 8)
        );
        a[70] ^= 1;
        assert_eq!(read(&a), Reading::Damaged);
    }
}
