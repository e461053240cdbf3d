//! What a picture shows at a glance: a few numbers, a fingerprint and a thinned sample of its levels.

use goniod_drivers::frame::{FrameInfo, Pixels};

/// Pictures with more pixels are thinned by [`STRIDE`] for the bracket's comparison.
const WHOLE_SAMPLE: usize = 1 << 16;

/// Odd and prime, so that the sample runs over rows, columns and all four sites of a colour mosaic.
const STRIDE: usize = 17;

/// Levels above this part of full scale are light; below it, only dark current and noise.
const LIGHT: f64 = 0.03;

/// Pixels with light that make a picture not black; fewer may be hot pixels.
const LIT_PIXELS: usize = 12;

/// Pixels between the ends of the scale from which on noise makes every picture another one.
const GRAINY_PIXELS: usize = 64;

/// Basis and prime of FNV-1a (Fowler, Noll, Vo), here over levels: pictures that differ in one level have two fingerprints.
const FNV_BASIS: u64 = 0xcbf2_9ce4_8422_2325;
const FNV_PRIME: u64 = 0x0000_0100_0000_01b3;

/// A picture in short. Computing it reads every pixel once (a few milliseconds for a megapixel).
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Fingerprint of all pixels below the reserved rows.
    pub fingerprint: u64,
    /// Lowest level.
    pub lowest: u16,
    /// Highest level.
    pub highest: u16,
    /// Mean level.
    pub mean: f64,
    /// Number of digital levels that can occur.
    pub levels: u32,
    /// Levels of some pixels, always the same ones for the same camera.
    pub sample: Vec<u16>,
    /// Pixels with light.
    pub lit: usize,
    /// Pixels that are neither at zero nor at the highest level.
    pub between: usize,
    /// More pixels have light than in the darks of this exposure: however few they are, the light was there.
    pub shows_light: bool,
}

// === impl Picture ===

impl Picture {
    /// The picture below the first `skip_rows` rows; `None` when the pixels are not as many as the frame says.
    pub fn of(info: &FrameInfo, pixels: &Pixels, skip_rows: usize) -> Option<Picture> {
        let line = info.width * info.format.values_per_pixel();
        let first = skip_rows * line;
        if pixels.len() != line * info.height || first >= pixels.len() {
            return None;
        }
        // The highest level of a sum of n frames is n times that of one.
        let levels = info.format.levels() + 1 - info.format.exposures();
        match pixels {
            Pixels::U8(v) => v.get(first..).map(|v| Picture::from_levels(v, levels)),
            Pixels::U16(v) => v.get(first..).map(|v| Picture::from_levels(v, levels)),
        }
    }

    fn from_levels<T: Copy + Into<u16>>(of: &[T], levels: u32) -> Picture {
        let (light, top) = ((f64::from(levels) * LIGHT) as u16, u16::try_from(levels - 1).unwrap_or(u16::MAX));
        let (mut lowest, mut highest, mut sum) = (u16::MAX, 0_u16, 0_u64);
        let (mut lit, mut between, mut fingerprint) = (0_usize, 0_usize, FNV_BASIS);
        for level in of {
            let level: u16 = (*level).into();
            lowest = lowest.min(level);
            highest = highest.max(level);
            sum += u64::from(level);
            lit += usize::from(level > light);
            between += usize::from(level > 0 && level < top);
            fingerprint = (fingerprint ^ u64::from(level)).wrapping_mul(FNV_PRIME);
        }
        let stride = if of.len() > WHOLE_SAMPLE { STRIDE } else { 1 };
        Picture {
            fingerprint,
            lowest,
            highest,
            mean: sum as f64 / of.len() as f64,
            levels,
            sample: of.iter().step_by(stride).map(|level| (*level).into()).collect(),
            lit,
            between,
            shows_light: false,
        }
    }

    /// All pixels have the same level.
    pub fn is_constant(&self) -> bool {
        self.lowest == self.highest
    }

    /// This black picture confirms the next one, unless that has lost even what little this one shows.
    pub fn confirms(&self, next: &Picture) -> bool {
        self.is_constant() || !next.is_constant()
    }

    /// No pixel but a few hot ones has light.
    pub fn is_black(&self) -> bool {
        self.lit < LIT_PIXELS
    }

    /// So many pixels carry noise that no other picture can be equal.
    pub fn is_grainy(&self) -> bool {
        self.between >= GRAINY_PIXELS
    }

    /// Every pixel is at the highest level.
    pub fn is_saturated(&self) -> bool {
        u32::from(self.lowest) + 1 >= self.levels
    }
}
