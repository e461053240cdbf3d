//! The oracle's second look, without the painting: the frames of a bracket must stand to each other as the response says.
//!
//! Pixels that a frame shows well (above the noise, below saturation) tell through the calibrated response, eq. 4, how much
//! light there was; through the ratio of the two exposures they predict the level in the neighbouring frame. The mean level
//! found there must lie between what [`TOLERANCE`] less and more light would give.

use crate::config::calibration::CameraCalibration;
use crate::config::instrument::Camera;
use crate::engine::radiometry::levels::Radiometer;
use crate::products::reduce::radiometer;

/// By how much the light of two neighbouring exposures may differ beside the ratio of their times: lamp, noise, response.
pub const TOLERANCE: f64 = 0.2;

/// Allowance on a mean level, part of full scale: rounding and dark signal.
const MARGIN: f64 = 0.006;

/// Relative noise of the light above which a pixel tells nothing.
const NOISE: f64 = 0.06;

/// Level above which a pixel tells nothing, part of full scale.
const HIGHEST: f64 = 0.9;

/// Fewer telling pixels than this prove nothing.
const ENOUGH: usize = 64;

/// Part of full scale by which the mean of a longer exposure may lie below that of a shorter one, where no pixel tells.
const FALL: f64 = 0.002;

/// Larger frames are thinned: by an odd prime, so that every column, row and colour stays.
const WHOLE: usize = 1 << 16;
const STRIDE: usize = 17;

/// One frame of a bracket.
pub struct BracketFrame {
    /// Exposure by its label, microseconds.
    pub exposure_us: u64,
    /// Levels of the picture, thinned.
    pub levels: Vec<u16>,
}

/// What two neighbouring exposures say about each other.
#[derive(Debug, Clone, PartialEq)]
pub enum Told {
    /// Too dark or too bright to tell more than that levels do not fall.
    Little,
    /// The levels are what the response predicts.
    Fits,
    /// They are not: one sentence.
    Contradicts(String),
}

/// The sensor of a calibrated camera.
pub struct Sensor {
    /// Level to part of full scale.
    ndl: Vec<f64>,
    /// Level to relative exposure; `None` where it tells nothing.
    light: Vec<Option<f64>>,
    radiometer: Radiometer,
}

// === impl BracketFrame ===

impl BracketFrame {
    /// Keeps `count` levels, every one or a sample.
    pub fn of(exposure_us: u64, count: usize, level: impl Fn(usize) -> u16) -> BracketFrame {
        let stride = if count > WHOLE { STRIDE } else { 1 };
        BracketFrame { exposure_us, levels: (0..count).step_by(stride).map(level).collect() }
    }

    fn mean(&self) -> f64 {
        self.levels.iter().map(|l| f64::from(*l)).sum::<f64>() / self.levels.len().max(1) as f64
    }
}

// === impl Sensor ===

impl Sensor {
    /// The sensor as the run's calibration describes it; `None` for sums of several exposures and for chroma, whose
    /// levels are no plain function of one exposure.
    pub fn of(camera: &Camera, calibration: &CameraCalibration) -> Option<Sensor> {
        if camera.format.exposures() > 1 || camera.v4l2.as_ref().is_some_and(|t| t.sum_frames.is_some_and(|n| n > 1)) {
            return None;
        }
        if camera.format.values_per_pixel() == 2 {
            return None;
        }
        let radiometer = radiometer(camera, calibration);
        let (q, noise) = (NOISE * NOISE, radiometer.noise);
        // Shot and read noise, n electrons: sqrt(n + r^2) = NOISE n.
        let electrons = (1.0 + (1.0 + 4.0 * q * noise.read_noise_e.powi(2)).sqrt()) / (2.0 * q);
        let least = electrons / noise.electrons_at_unit_exposure;
        let levels = radiometer.levels;
        let ndl: Vec<f64> = (0..levels).map(|level| radiometer.convention.ndl(level, levels)).collect();
        let telling = |ndl: &f64| Some(radiometer.response.exposure(*ndl)).filter(|x| *x >= least && *ndl <= HIGHEST);
        let light = ndl.iter().map(telling).collect();
        Some(Sensor { ndl, light, radiometer })
    }

    /// Compares two neighbouring exposures of one bracket.
    pub fn compare(&self, short: &BracketFrame, long: &BracketFrame) -> Told {
        let both = [self.predict(short, long), self.predict(long, short)];
        if let Some(wrong) = both.iter().flatten().find(|p| !p.holds()) {
            return Told::Contradicts(format!(
                "{:.2} % at {} us, where {:.2} to {:.2} % would follow from {} us",
                100.0 * wrong.found,
                wrong.to_us,
                100.0 * wrong.least,
                100.0 * wrong.greatest,
                wrong.from_us
            ));
        }
        if both.iter().any(Option::is_some) {
            return Told::Fits;
        }
        let full = f64::from(self.radiometer.levels);
        let (a, b) = (short.mean() / full, long.mean() / full);
        if b + FALL < a {
            let (short, long) = (short.exposure_us, long.exposure_us);
            return Told::Contradicts(format!("{:.2} % at {short} us, {:.2} % at {long} us", 100.0 * a, 100.0 * b));
        }
        Told::Little
    }

    /// What the telling pixels of `from` predict for `to`, and what is found there; `None` where too few tell.
    fn predict(&self, from: &BracketFrame, to: &BracketFrame) -> Option<Prediction> {
        let ratio = to.exposure_us as f64 / from.exposure_us as f64;
        let (first, last) = (*self.ndl.first()?, *self.ndl.last()?);
        let ends = |x: f64| {
            let at = |factor: f64| self.radiometer.response.ndl(x * ratio * factor).clamp(first, last);
            (at(1.0 - TOLERANCE), at(1.0 + TOLERANCE))
        };
        let predicted: Vec<Option<(f64, f64)>> = self.light.iter().map(|light| light.map(ends)).collect();
        let (mut n, mut sums) = (0_usize, (0.0, 0.0, 0.0));
        for (a, b) in from.levels.iter().zip(&to.levels) {
            let Some((least, greatest)) = predicted.get(usize::from(*a)).copied().flatten() else { continue };
            n += 1;
            sums.0 += least;
            sums.1 += self.ndl.get(usize::from(*b)).copied().unwrap_or(last);
            sums.2 += greatest;
        }
        let mean = |sum: f64| sum / n as f64;
        (n >= ENOUGH).then(|| Prediction {
            from_us: from.exposure_us,
            to_us: to.exposure_us,
            least: mean(sums.0),
            found: mean(sums.1),
            greatest: mean(sums.2),
        })
    }
}

/// A mean level that one frame predicts for another.
struct Prediction {
    from_us: u64,
    to_us: u64,
    least: f64,
    found: f64,
    greatest: f64,
}

// === impl Prediction ===

impl Prediction {
    fn holds(&self) -> bool {
        (self.least - MARGIN..=self.greatest + MARGIN).contains(&self.found)
    }
}
