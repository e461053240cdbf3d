//! What the twin paints: the truth about a picture in its first row, levels that follow the exposure below.

/// First bytes of a painted row.
const MAGIC: [u8; 2] = [0xA5, 0x5A];
/// Bytes of a painted truth.
pub const BYTES: usize = 23;

/// What really happened while a picture was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Truth {
    /// Number of the picture since the twin was made.
    pub number: u64,
    /// Raw exposure of the upper half.
    pub upper: u32,
    /// Raw exposure of the lower half; differs while a change runs through the sensor.
    pub lower: u32,
    /// Raw gain.
    pub gain: u32,
}

/// A small generator of noise.
#[derive(Debug, Clone)]
pub struct Dice(u64);

/// The level a raw exposure gives, before noise.
pub fn level(raw_exposure: u32) -> u8 {
    (f64::from(raw_exposure) + 1.0).log2().mul_add(10.0, 20.0) as u8
}

// === impl Truth ===

impl Truth {
    /// The truth as bytes, with a checksum.
    pub fn bytes(&self) -> [u8; BYTES] {
        let mut out = [0; BYTES];
        out[..2].copy_from_slice(&MAGIC);
        out[2..10].copy_from_slice(&self.number.to_le_bytes());
        out[10..14].copy_from_slice(&self.upper.to_le_bytes());
        out[14..18].copy_from_slice(&self.lower.to_le_bytes());
        out[18..22].copy_from_slice(&self.gain.to_le_bytes());
        out[22] = sum(&out[..22]);
        out
    }

    /// Reads the truth from a row; `None` where nothing whole is painted.
    pub fn read(row: &[u8]) -> Option<Truth> {
        let row = row.get(..BYTES)?;
        if row[..2] != MAGIC || sum(&row[..22]) != row[22] {
            return None;
        }
        let word = |at: usize| Some(u32::from_le_bytes(row.get(at..at + 4)?.try_into().ok()?));
        let number = u64::from_le_bytes(row[2..10].try_into().ok()?);
        Some(Truth { number, upper: word(10)?, lower: word(14)?, gain: word(18)? })
    }

    /// A picture of `stride` by `height` bytes with words of `word` bytes.
    pub fn picture(&self, stride: usize, height: usize, word: usize, dice: &mut Dice) -> Vec<u8> {
        let mut out = vec![0; stride * height];
        let (upper, lower) = (level(self.upper), level(self.lower));
        for (row, line) in out.chunks_exact_mut(stride).enumerate() {
            let base = if row < height / 2 { upper } else { lower };
            for pixels in line.chunks_mut(8 * word) {
                let noise = dice.next();
                pixels.iter_mut().step_by(word).enumerate().for_each(|(i, p)| *p = base + (noise >> i & 1) as u8);
            }
        }
        out.iter_mut().step_by(word).zip(self.bytes()).for_each(|(p, b)| *p = b);
        out
    }
}

fn sum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0x3C, |s: u8, b| s.rotate_left(1) ^ b)
}

// === impl Dice ===

impl Dice {
    /// The dice of a seed.
    pub fn new(seed: u64) -> Dice {
        Dice(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    /// The next 64 bits (xorshift).
    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 8
    }

    /// A number below `end`.
    pub fn below(&mut self, end: u64) -> u64 {
        self.next() % end.max(1)
    }
}
