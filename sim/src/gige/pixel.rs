//! Pixel formats of the twin: their codes and how levels become bytes on the wire.

use goniod_drivers::frame::PixelFormat;

/// What a pixel looks like on the wire (codes of the GigE Vision / PFNC lists).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PixelCode {
    /// 8 bit.
    Mono8,
    /// 10 bit in 16-bit little-endian words.
    Mono10,
    /// 12 bit in 16-bit words.
    Mono12,
    /// 12 bit, two pixels in three bytes, little-endian bit stream (PFNC).
    Mono12p,
    /// 12 bit, two pixels in three bytes, high bytes outside (GigE Vision).
    Mono12Packed,
    /// 14 bit in 16-bit words.
    Mono14,
    /// 16 bit.
    Mono16,
    /// Red-green / green-blue mosaic, 8 bit.
    BayerRg8,
    /// Green-blue / red-green mosaic, 8 bit.
    BayerGb8,
    /// Blue-green / green-red mosaic, 12 bit in words.
    BayerBg12,
}

// === impl PixelCode ===

impl PixelCode {
    /// All formats the twin offers.
    pub const ALL: [PixelCode; 10] = [
        PixelCode::Mono8,
        PixelCode::Mono10,
        PixelCode::Mono12,
        PixelCode::Mono12p,
        PixelCode::Mono12Packed,
        PixelCode::Mono14,
        PixelCode::Mono16,
        PixelCode::BayerRg8,
        PixelCode::BayerGb8,
        PixelCode::BayerBg12,
    ];

    /// The name in the XML.
    pub fn name(self) -> &'static str {
        match self {
            PixelCode::Mono8 => "Mono8",
            PixelCode::Mono10 => "Mono10",
            PixelCode::Mono12 => "Mono12",
            PixelCode::Mono12p => "Mono12p",
            PixelCode::Mono12Packed => "Mono12Packed",
            PixelCode::Mono14 => "Mono14",
            PixelCode::Mono16 => "Mono16",
            PixelCode::BayerRg8 => "BayerRG8",
            PixelCode::BayerGb8 => "BayerGB8",
            PixelCode::BayerBg12 => "BayerBG12",
        }
    }

    /// The code in register and leader.
    pub fn code(self) -> u32 {
        match self {
            PixelCode::Mono8 => 0x0108_0001,
            PixelCode::Mono10 => 0x0110_0003,
            PixelCode::Mono12 => 0x0110_0005,
            PixelCode::Mono12p => 0x010c_0047,
            PixelCode::Mono12Packed => 0x010c_0006,
            PixelCode::Mono14 => 0x0110_0025,
            PixelCode::Mono16 => 0x0110_0007,
            PixelCode::BayerRg8 => 0x0108_0009,
            PixelCode::BayerGb8 => 0x0108_000a,
            PixelCode::BayerBg12 => 0x0110_0013,
        }
    }

    /// The code of frames of this format, in plain bytes or words; `None` where the twin has none.
    pub fn of(format: PixelFormat) -> Option<PixelCode> {
        match format {
            PixelFormat::Mono8 => Some(PixelCode::Mono8),
            PixelFormat::Mono10 => Some(PixelCode::Mono10),
            PixelFormat::Mono12 => Some(PixelCode::Mono12),
            PixelFormat::Mono14 => Some(PixelCode::Mono14),
            PixelFormat::Mono16 => Some(PixelCode::Mono16),
            PixelFormat::BayerRggb8 => Some(PixelCode::BayerRg8),
            PixelFormat::BayerGbrg8 => Some(PixelCode::BayerGb8),
            PixelFormat::BayerBggr12 => Some(PixelCode::BayerBg12),
            _ => None,
        }
    }

    /// The format with this code.
    pub fn from_code(code: u32) -> Option<PixelCode> {
        PixelCode::ALL.into_iter().find(|f| f.code() == code)
    }

    /// Highest level a pixel can show.
    pub fn max_level(self) -> u16 {
        match self {
            PixelCode::Mono8 | PixelCode::BayerRg8 | PixelCode::BayerGb8 => 0xff,
            PixelCode::Mono10 => 0x3ff,
            PixelCode::Mono12 | PixelCode::Mono12p | PixelCode::Mono12Packed | PixelCode::BayerBg12 => 0xfff,
            PixelCode::Mono14 => 0x3fff,
            PixelCode::Mono16 => 0xffff,
        }
    }

    /// Bytes of `pixels` pixels; the packed forms round up.
    pub fn bytes(self, pixels: usize) -> usize {
        match self {
            PixelCode::Mono8 | PixelCode::BayerRg8 | PixelCode::BayerGb8 => pixels,
            PixelCode::Mono12p | PixelCode::Mono12Packed => (pixels * 3).div_ceil(2),
            _ => pixels * 2,
        }
    }

    /// Appends `levels` as they go over the wire; values above the format's range are cut to it.
    pub fn encode(self, levels: &[u16], out: &mut Vec<u8>) {
        let top = self.max_level();
        match self {
            PixelCode::Mono8 | PixelCode::BayerRg8 | PixelCode::BayerGb8 => {
                out.extend(levels.iter().map(|v| (*v).min(top) as u8))
            }
            PixelCode::Mono12p | PixelCode::Mono12Packed => {
                for pair in levels.chunks(2) {
                    let (a, b) = (pair[0].min(top), pair.get(1).copied().unwrap_or(0).min(top));
                    let bytes = match self {
                        PixelCode::Mono12p => [a as u8, ((a >> 8) | ((b & 0xf) << 4)) as u8, (b >> 4) as u8],
                        _ => [(a >> 4) as u8, ((a & 0xf) | ((b & 0xf) << 4)) as u8, (b >> 4) as u8],
                    };
                    out.extend_from_slice(&bytes[..if pair.len() == 2 { 3 } else { 2 }]);
                }
            }
            _ => {
                let start = out.len();
                out.resize(start + levels.len() * 2, 0);
                for (bytes, v) in out[start..].chunks_exact_mut(2).zip(levels) {
                    bytes.copy_from_slice(&(*v).min(top).to_le_bytes());
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_two_packed_forms_lay_their_nibbles_differently() {
        let mut out = Vec::new();
        PixelCode::Mono12p.encode(&[0xabc, 0x123], &mut out);
        assert_eq!(out, [0xbc, 0x3a, 0x12]);
        out.clear();
        PixelCode::Mono12Packed.encode(&[0xabc, 0x123], &mut out);
        assert_eq!(out, [0xab, 0x3c, 0x12]);
    }

    #[test]
    fn every_format_has_the_size_it_says() {
        for format in PixelCode::ALL {
            let mut out = Vec::new();
            format.encode(&[0xffff; 7], &mut out);
            assert_eq!(out.len(), format.bytes(7), "{format:?}");
            assert_eq!(PixelCode::from_code(format.code()), Some(format));
        }
    }
}
