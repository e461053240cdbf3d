//! What a picture shows at a glance: a few numbers, a fingerprint and a thinned sample of its levels.

use goniod_drivers::frame::{FrameInfo, Pixels};
use std::hash::{DefaultHasher, Hasher};

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
        let light = (f64::from(levels) * LIGHT) as u16;
        match pixels {
            Pixels::U8(v) => {
                let mut hasher = DefaultHasher::new();
                hasher.write(v.get(first..)?);
                Some(Picture::from_levels(
                    hasher.finish(),
                    v.get(first..)?.iter().map(|b| u16::from(*b)),
                    levels,
                    light,
                ))
            }
            Pixels::U16(v) => {
                let mut hasher = DefaultHasher::new();
                for word in v.get(first..)? {
                    hasher.write_u16(*word);
                }
                Some(Picture::from_levels(hasher.finish(), v.get(first..)?.iter().copied(), levels, light))
            }
        }
    }

    fn from_levels(fingerprint: u64, of: impl ExactSizeIterator<Item = u16>, levels: u32, light: u16) -> Picture {
        let count = of.len();
        let stride = if count > WHOLE_SAMPLE { STRIDE } else { 1 };
        let mut picture = Picture {
            fingerprint,
            lowest: u16::MAX,
            highest: 0,
            mean: 0.0,
            levels,
            sample: Vec::with_capacity(count / stride + 1),
            lit: 0,
            between: 0,
            shows_light: false,
        };
        let mut sum = 0_u64;
        for (i, level) in of.enumerate() {
            picture.lowest = picture.lowest.min(level);
            picture.highest = picture.highest.max(level);
            sum += u64::from(level);
            picture.lit += usize::from(level > light);
            picture.between += usize::from(level > 0 && u32::from(level) + 1 < levels);
            if i % stride == 0 {
                picture.sample.push(level);
            }
        }
        picture.mean = sum as f64 / count as f64;
        picture
    }

    /// All pixels have the same level.
    pub fn is_constant(&self) -> bool {
        self.lowest == self.highest
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
