//! Picture formats and sizes of the camera, and how levels become bytes.

/// A picture format of the UVC "uncompressed" kind, by the four-character code that begins its GUID.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum UvcFormat {
    /// Red-green / green-blue mosaic, 8 bit.
    Rggb,
    /// Luma of each pixel, chroma (here neutral) of two.
    Yuyv,
    /// One byte a pixel.
    Grey,
    /// One little-endian 16-bit word a pixel.
    Y16,
}

/// A format with its one size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mode {
    /// Format.
    pub format: UvcFormat,
    /// Columns.
    pub width: u16,
    /// Rows.
    pub height: u16,
}

// === impl UvcFormat ===

impl UvcFormat {
    /// First four bytes of the GUID.
    pub fn code(self) -> [u8; 4] {
        match self {
            UvcFormat::Rggb => *b"RGGB",
            UvcFormat::Yuyv => *b"YUY2",
            UvcFormat::Grey => *b"Y800",
            UvcFormat::Y16 => *b"Y16 ",
        }
    }

    /// Bytes a pixel.
    pub fn bytes_per_pixel(self) -> usize {
        match self {
            UvcFormat::Rggb | UvcFormat::Grey => 1,
            UvcFormat::Yuyv | UvcFormat::Y16 => 2,
        }
    }

    /// Highest level.
    pub fn max_level(self) -> u16 {
        if self == UvcFormat::Y16 { u16::MAX } else { 0xff }
    }

    /// Levels as they go over the wire.
    pub fn encode(self, levels: &[u16]) -> Vec<u8> {
        match self {
            UvcFormat::Rggb | UvcFormat::Grey => levels.iter().map(|v| *v as u8).collect(),
            UvcFormat::Yuyv => levels.iter().flat_map(|v| [*v as u8, 0x80]).collect(),
            UvcFormat::Y16 => levels.iter().flat_map(|v| v.to_le_bytes()).collect(),
        }
    }
}

// === impl Mode ===

impl Mode {
    /// What the camera offers: the mosaic of a colour CCD first, then smaller ones.
    pub const ALL: [Mode; 4] = [
        Mode { format: UvcFormat::Rggb, width: 1360, height: 1024 },
        Mode { format: UvcFormat::Yuyv, width: 640, height: 480 },
        Mode { format: UvcFormat::Grey, width: 320, height: 240 },
        Mode { format: UvcFormat::Y16, width: 160, height: 120 },
    ];

    /// Pixels of a picture.
    pub fn pixels(&self) -> usize {
        usize::from(self.width) * usize::from(self.height)
    }

    /// Bytes of a picture.
    pub fn bytes(&self) -> usize {
        self.pixels() * self.format.bytes_per_pixel()
    }
}
