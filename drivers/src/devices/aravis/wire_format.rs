//! Pixel formats on the wire and how their bytes become levels. Pure.

use crate::frame::{PixelFormat, Pixels};

/// Formats the driver reads. Names are those of the camera's `PixelFormat` feature.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum WireFormat {
    /// 8 bit.
    Mono8,
    /// 10 bit in 16-bit little-endian words.
    Mono10,
    /// 12 bit in 16-bit words.
    Mono12,
    /// 12 bit, two pixels in three bytes, little-endian bit stream (PFNC).
    Mono12p,
    /// 12 bit, two pixels in three bytes, high bytes outside (GigE Vision 1).
    Mono12Packed,
    /// 14 bit in 16-bit words.
    Mono14,
    /// 16 bit.
    Mono16,
    /// Red-green / green-blue mosaic, 8 bit.
    BayerRg8,
}

// === impl WireFormat ===

impl WireFormat {
    /// All formats.
    pub const ALL: [WireFormat; 8] = [
        WireFormat::Mono8,
        WireFormat::Mono10,
        WireFormat::Mono12,
        WireFormat::Mono12p,
        WireFormat::Mono12Packed,
        WireFormat::Mono14,
        WireFormat::Mono16,
        WireFormat::BayerRg8,
    ];

    /// The entry of the camera's `PixelFormat` feature.
    pub fn name(self) -> &'static str {
        match self {
            WireFormat::Mono8 => "Mono8",
            WireFormat::Mono10 => "Mono10",
            WireFormat::Mono12 => "Mono12",
            WireFormat::Mono12p => "Mono12p",
            WireFormat::Mono12Packed => "Mono12Packed",
            WireFormat::Mono14 => "Mono14",
            WireFormat::Mono16 => "Mono16",
            WireFormat::BayerRg8 => "BayerRG8",
        }
    }

    /// The 32-bit code in the stream (PFNC and GigE Vision lists).
    pub fn code(self) -> u32 {
        match self {
            WireFormat::Mono8 => 0x0108_0001,
            WireFormat::Mono10 => 0x0110_0003,
            WireFormat::Mono12 => 0x0110_0005,
            WireFormat::Mono12p => 0x010c_0047,
            WireFormat::Mono12Packed => 0x010c_0006,
            WireFormat::Mono14 => 0x0110_0025,
            WireFormat::Mono16 => 0x0110_0007,
            WireFormat::BayerRg8 => 0x0108_0009,
        }
    }

    /// How the levels lie in a frame once unpacked.
    pub fn frame_format(self) -> PixelFormat {
        match self {
            WireFormat::Mono8 => PixelFormat::Mono8,
            WireFormat::Mono10 => PixelFormat::Mono10,
            WireFormat::Mono12 | WireFormat::Mono12p | WireFormat::Mono12Packed => PixelFormat::Mono12,
            WireFormat::Mono14 => PixelFormat::Mono14,
            WireFormat::Mono16 => PixelFormat::Mono16,
            WireFormat::BayerRg8 => PixelFormat::BayerRggb8,
        }
    }

    /// Bytes of `pixels` pixels.
    pub fn bytes(self, pixels: usize) -> usize {
        match self {
            WireFormat::Mono8 | WireFormat::BayerRg8 => pixels,
            WireFormat::Mono12p | WireFormat::Mono12Packed => (pixels * 3).div_ceil(2),
            _ => pixels * 2,
        }
    }

    /// No pixels, in the variant of this format.
    pub fn empty(self) -> Pixels {
        match self {
            WireFormat::Mono8 | WireFormat::BayerRg8 => Pixels::U8(Vec::new()),
            _ => Pixels::U16(Vec::new()),
        }
    }

    /// The levels of `pixels` pixels from `bytes`, in `buffer` if its variant fits. `None` where bytes are missing.
    pub fn unpack(self, bytes: &[u8], pixels: usize, buffer: Option<Pixels>) -> Option<Pixels> {
        let bytes = bytes.get(..self.bytes(pixels))?;
        match (self, buffer) {
            (WireFormat::Mono8 | WireFormat::BayerRg8, buffer) => {
                let mut out = match buffer {
                    Some(Pixels::U8(v)) => v,
                    _ => Vec::new(),
                };
                out.clear();
                out.extend_from_slice(bytes);
                Some(Pixels::U8(out))
            }
            (_, buffer) => {
                let mut out = match buffer {
                    Some(Pixels::U16(v)) => v,
                    _ => Vec::new(),
                };
                out.clear();
                out.reserve(pixels);
                self.unpack_words(bytes, &mut out);
                out.truncate(pixels);
                Some(Pixels::U16(out))
            }
        }
    }

    fn unpack_words(self, bytes: &[u8], out: &mut Vec<u16>) {
        match self {
            WireFormat::Mono12p => {
                for c in bytes.chunks(3) {
                    let [a, b] = [c.first(), c.get(1)].map(|v| u16::from(v.copied().unwrap_or(0)));
                    out.push(a | ((b & 0x0f) << 8));
                    out.push((b >> 4) | (u16::from(c.get(2).copied().unwrap_or(0)) << 4));
                }
            }
            WireFormat::Mono12Packed => {
                for c in bytes.chunks(3) {
                    let [a, b] = [c.first(), c.get(1)].map(|v| u16::from(v.copied().unwrap_or(0)));
                    out.push((a << 4) | (b & 0x0f));
                    out.push((b >> 4) | (u16::from(c.get(2).copied().unwrap_or(0)) << 4));
                }
            }
            _ => out.extend(bytes.chunks_exact(2).map(|c| u16::from_le_bytes([c[0], c[1]]))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packed_pixels_come_apart_as_the_two_standards_say() {
        let p = WireFormat::Mono12p.unpack(&[0xbc, 0x3a, 0x12, 0xff, 0x0f], 3, None);
        assert_eq!(p, Some(Pixels::U16(vec![0xabc, 0x123, 0xfff])));
        let packed = WireFormat::Mono12Packed.unpack(&[0xab, 0x3c, 0x12], 2, None);
        assert_eq!(packed, Some(Pixels::U16(vec![0xabc, 0x123])));
    }

    #[test]
    fn a_used_buffer_is_overwritten_and_a_short_picture_is_none() {
        let used = Some(Pixels::U16(vec![9; 100]));
        assert_eq!(WireFormat::Mono16.unpack(&[1, 2, 3, 4], 2, used), Some(Pixels::U16(vec![0x0201, 0x0403])));
        assert_eq!(WireFormat::Mono16.unpack(&[1, 2, 3], 2, None), None);
        let wrong_kind = Some(Pixels::U16(vec![1]));
        assert_eq!(WireFormat::Mono8.unpack(&[5, 6], 2, wrong_kind), Some(Pixels::U8(vec![5, 6])));
    }
}
