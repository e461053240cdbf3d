//! Pixel formats on the wire and how their bytes become levels. Pure.

use crate::devices::camera::Packing;
use crate::frame::{BayerOrder, PixelFormat, Pixels};

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
    /// Colour mosaic of 8, 10, 12 or 16 bits, in 16-bit little-endian words beyond 8.
    Bayer(BayerOrder, u8),
}

/// Colour mosaics: format of the frames, PFNC name and code.
const BAYER: [(PixelFormat, &str, u32); 16] = [
    (PixelFormat::BayerGrbg8, "BayerGR8", 0x0108_0008),
    (PixelFormat::BayerRggb8, "BayerRG8", 0x0108_0009),
    (PixelFormat::BayerGbrg8, "BayerGB8", 0x0108_000a),
    (PixelFormat::BayerBggr8, "BayerBG8", 0x0108_000b),
    (PixelFormat::BayerGrbg10, "BayerGR10", 0x0110_000c),
    (PixelFormat::BayerRggb10, "BayerRG10", 0x0110_000d),
    (PixelFormat::BayerGbrg10, "BayerGB10", 0x0110_000e),
    (PixelFormat::BayerBggr10, "BayerBG10", 0x0110_000f),
    (PixelFormat::BayerGrbg12, "BayerGR12", 0x0110_0010),
    (PixelFormat::BayerRggb12, "BayerRG12", 0x0110_0011),
    (PixelFormat::BayerGbrg12, "BayerGB12", 0x0110_0012),
    (PixelFormat::BayerBggr12, "BayerBG12", 0x0110_0013),
    (PixelFormat::BayerGrbg16, "BayerGR16", 0x0110_002e),
    (PixelFormat::BayerRggb16, "BayerRG16", 0x0110_002f),
    (PixelFormat::BayerGbrg16, "BayerGB16", 0x0110_0030),
    (PixelFormat::BayerBggr16, "BayerBG16", 0x0110_0031),
];

// === impl WireFormat ===

impl WireFormat {
    /// All formats.
    pub const ALL: [WireFormat; 10] = [
        WireFormat::Mono8,
        WireFormat::Mono10,
        WireFormat::Mono12,
        WireFormat::Mono12p,
        WireFormat::Mono12Packed,
        WireFormat::Mono14,
        WireFormat::Mono16,
        WireFormat::Bayer(BayerOrder::Rggb, 8),
        WireFormat::Bayer(BayerOrder::Gbrg, 8),
        WireFormat::Bayer(BayerOrder::Bggr, 12),
    ];

    /// The form on the wire that gives frames of `format`; `None` where the driver reads none.
    pub fn of(format: PixelFormat, packing: Packing) -> Option<WireFormat> {
        let bayer = || format.mosaic().map(|order| WireFormat::Bayer(order, format.bits()));
        match (packing, format) {
            (Packing::Mono12p, PixelFormat::Mono12) => Some(WireFormat::Mono12p),
            (Packing::Mono12Packed, PixelFormat::Mono12) => Some(WireFormat::Mono12Packed),
            (Packing::Mono12p | Packing::Mono12Packed, _) => None,
            (Packing::Words, PixelFormat::Mono8) => Some(WireFormat::Mono8),
            (Packing::Words, PixelFormat::Mono10) => Some(WireFormat::Mono10),
            (Packing::Words, PixelFormat::Mono12) => Some(WireFormat::Mono12),
            (Packing::Words, PixelFormat::Mono14) => Some(WireFormat::Mono14),
            (Packing::Words, PixelFormat::Mono16) => Some(WireFormat::Mono16),
            (Packing::Words, PixelFormat::Summed { .. }) => None,
            (Packing::Words, _) => bayer(),
        }
    }

    /// Row of the table of mosaics; the first for what is none.
    fn bayer(self) -> (PixelFormat, &'static str, u32) {
        let same = |f: &PixelFormat| WireFormat::of(*f, Packing::Words) == Some(self);
        BAYER.into_iter().find(|(format, ..)| same(format)).unwrap_or(BAYER[0])
    }

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
            WireFormat::Bayer(..) => self.bayer().1,
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
            WireFormat::Bayer(..) => self.bayer().2,
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
            WireFormat::Bayer(..) => self.bayer().0,
        }
    }

    /// Bytes of `pixels` pixels.
    pub fn bytes(self, pixels: usize) -> usize {
        match self {
            WireFormat::Mono8 | WireFormat::Bayer(_, 8) => pixels,
            WireFormat::Mono12p | WireFormat::Mono12Packed => (pixels * 3).div_ceil(2),
            _ => pixels * 2,
        }
    }

    /// No pixels, in the variant of this format.
    pub fn empty(self) -> Pixels {
        match self {
            WireFormat::Mono8 | WireFormat::Bayer(_, 8) => Pixels::U8(Vec::new()),
            _ => Pixels::U16(Vec::new()),
        }
    }

    /// The levels of `pixels` pixels from `bytes`, in `buffer` if its variant fits. `None` where bytes are missing.
    pub fn unpack(self, bytes: &[u8], pixels: usize, buffer: Option<Pixels>) -> Option<Pixels> {
        let bytes = bytes.get(..self.bytes(pixels))?;
        match (self, buffer) {
            (WireFormat::Mono8 | WireFormat::Bayer(_, 8), buffer) => {
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
    fn every_format_of_frames_has_its_form_on_the_wire() {
        for (format, name, code) in BAYER {
            let wire = WireFormat::of(format, Packing::Words);
            assert_eq!(wire.map(|w| (w.frame_format(), w.name(), w.code())), Some((format, name, code)));
            let width = if format.bits() == 8 { 1 } else { 2 };
            assert_eq!(wire.map(|w| w.bytes(6)), Some(6 * width), "{name}");
        }
        for mono in WireFormat::ALL {
            let packing = match mono {
                WireFormat::Mono12p => Packing::Mono12p,
                WireFormat::Mono12Packed => Packing::Mono12Packed,
                _ => Packing::Words,
            };
            assert_eq!(WireFormat::of(mono.frame_format(), packing), Some(mono));
        }
        assert_eq!(WireFormat::of(PixelFormat::Rgb8, Packing::Words), None);
        assert_eq!(WireFormat::of(PixelFormat::Mono14, Packing::Mono12p), None);
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
