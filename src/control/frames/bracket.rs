//! What the frames of a bracket say about the next one: the same pixels under the same light rise with exposure.
//!
//! No response is assumed beyond what every sensor of the bench keeps: levels rise with exposure, faster than its fourth
//! root and not faster than the exposure itself. (The CCD's response, eq. 4, follows exposure to the power 0.41 with a
//! negative offset; the InGaAs camera is linear with a positive one.)

use super::picture::Picture;
use goniod_drivers::units::ExposureTime;
use serde::{Deserialize, Serialize};

/// Part of full scale between which a level of the shorter exposure tells something.
const TELLING: (f64, f64) = (0.1, 0.5);

/// Fewer telling pixels than this prove nothing.
const ENOUGH: usize = 64;

/// Exposure ratio below which two frames are too alike to be told apart by level.
const LEAST_RATIO: f64 = 1.5;

/// Rise beyond which saturation may hide more.
const MOST_LEAST_RISE: f64 = 1.3;

/// Allowance on the greatest rise, for noise and lamp flicker.
const GREATEST_MARGIN: f64 = 1.25;

/// Level of a longer exposure (part of full scale) at which a shorter one cannot be black, up to the ratio beside it.
const VISIBLE: (f64, f64) = (0.5, 4.5);

/// The frames of one bracket so far.
#[derive(Debug, Default)]
pub struct Bracket {
    taken: Vec<(ExposureTime, Picture)>,
}

/// How a frame contradicts its bracket.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Contradiction {
    /// Exposure of the frame it was compared with, microseconds.
    pub other_us: u64,
    /// Ratio of levels found, longer over shorter.
    pub rise: f64,
    /// Least ratio that fits.
    pub least: f64,
    /// Greatest ratio that fits.
    pub greatest: f64,
}

/// What the bracket says about a black frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Black {
    /// A longer exposure was black: this one must be.
    Expected,
    /// A shorter exposure had light, or a longer one so much that this one must show it.
    Impossible,
    /// Nothing is known.
    Open,
}

// === impl Bracket ===

impl Bracket {
    /// Adds an accepted frame.
    pub fn add(&mut self, exposure: ExposureTime, picture: Picture) {
        self.taken.push((exposure, picture));
    }

    /// Compares a frame with the nearest shorter and the nearest longer exposure.
    ///
    /// # Errors
    /// The first contradiction.
    pub fn judge(&self, exposure: ExposureTime, picture: &Picture) -> Result<(), Contradiction> {
        let shorter = self.taken.iter().filter(|(t, _)| *t < exposure).max_by_key(|(t, _)| *t);
        let longer = self.taken.iter().filter(|(t, _)| *t > exposure).min_by_key(|(t, _)| *t);
        if let Some((t, other)) = shorter {
            compare((*t, other), (exposure, picture), *t)?;
        }
        if let Some((t, other)) = longer {
            compare((exposure, picture), (*t, other), *t)?;
        }
        Ok(())
    }

    /// What is to be thought of a black frame at this exposure.
    pub fn black_at(&self, exposure: ExposureTime) -> Black {
        let mut verdict = Black::Open;
        for (t, other) in &self.taken {
            if *t >= exposure && other.is_black() {
                verdict = Black::Expected;
            }
            let visible = f64::from(other.levels) * VISIBLE.0;
            let near = t.seconds() <= exposure.seconds() * VISIBLE.1;
            let bright = other.sample.iter().filter(|l| f64::from(**l) >= visible).count() >= ENOUGH;
            if (*t <= exposure && !other.is_black()) || (near && bright) {
                return Black::Impossible;
            }
        }
        verdict
    }

    /// True when a shorter exposure was saturated all over.
    pub fn saturated_before(&self, exposure: ExposureTime) -> bool {
        self.taken.iter().any(|(t, other)| *t <= exposure && other.is_saturated())
    }
}

fn compare(
    short: (ExposureTime, &Picture),
    long: (ExposureTime, &Picture),
    other: ExposureTime,
) -> Result<(), Contradiction> {
    let ratio = long.0.seconds() / short.0.seconds();
    let full = f64::from(short.1.levels);
    let telling = (full * TELLING.0) as u16..=(full * TELLING.1) as u16;
    let (mut count, mut sums) = (0, (0.0, 0.0));
    for (a, b) in short.1.sample.iter().zip(&long.1.sample).filter(|(a, _)| telling.contains(*a)) {
        count += 1;
        sums = (sums.0 + f64::from(*a), sums.1 + f64::from(*b));
    }
    let (rise, least) = if count >= ENOUGH && ratio >= LEAST_RATIO {
        (sums.1 / sums.0, ratio.powf(0.25).min(MOST_LEAST_RISE))
    } else {
        // Too little light to tell more than that it does not fall: half a level of rounding, a hundredth of noise.
        ((long.1.mean + 0.5) / short.1.mean.max(0.5), 0.99)
    };
    let greatest = if count >= ENOUGH { ratio * GREATEST_MARGIN } else { f64::MAX };
    if (least..=greatest).contains(&rise) {
        return Ok(());
    }
    Err(Contradiction { other_us: other.0, rise, least, greatest })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    fn picture(light: f64, response: impl Fn(f64) -> f64) -> Picture {
        let sample: Vec<u16> = (0..400)
            .map(|i| (response(light * (0.2 + f64::from(i) / 200.0)) * 256.0).floor().clamp(0.0, 255.0) as u16)
            .collect();
        crate::control::frames::guard::test_support::picture_of(&sample)
    }

    /// Eq. 4 with the paper's constants, x = 1 at NDL 0.3.
    fn ccd(x: f64) -> f64 {
        0.441_58 * x.powf(0.407_17) - 0.132_54
    }

    fn linear(x: f64) -> f64 {
        0.3 * x + 0.01
    }

    #[test]
    fn true_brackets_of_both_sensors_fit_in_either_order() {
        for response in [ccd as fn(f64) -> f64, linear] {
            for ratio in [2.0, 4.0, 16.0] {
                let exposures: Vec<f64> = (0..6).map(|k| 1e-3 * f64::powi(ratio, k)).collect();
                for reversed in [false, true] {
                    let mut bracket = Bracket::default();
                    let mut order = exposures.clone();
                    if reversed {
                        order.reverse();
                    }
                    for t in order {
                        let frame = picture(t * 30.0, response);
                        let exposure = ExposureTime::from_seconds(t);
                        assert_eq!(bracket.judge(exposure, &frame), Ok(()), "ratio {ratio}, {t} s");
                        bracket.add(exposure, frame);
                    }
                }
            }
        }
    }

    #[test]
    fn a_frame_of_the_exposure_before_contradicts_its_bracket() {
        for response in [ccd as fn(f64) -> f64, linear] {
            let mut bracket = Bracket::default();
            bracket.add(ExposureTime(10_000), picture(1.0, response));
            assert!(bracket.judge(ExposureTime(40_000), &picture(1.0, response)).is_err());
            assert!(bracket.judge(ExposureTime(40_000), &picture(0.25, response)).is_err());
            assert!(bracket.judge(ExposureTime(2_500), &picture(1.0, response)).is_err());
            assert!(bracket.judge(ExposureTime(40_000), &picture(4.0, response)).is_ok());
        }
    }

    #[test]
    fn blackness_is_predicted_by_longer_and_excluded_by_shorter_exposures() {
        let mut bracket = Bracket::default();
        assert_eq!(bracket.black_at(ExposureTime(1000)), Black::Open);
        bracket.add(ExposureTime(4000), picture(1e-4, ccd));
        assert_eq!(bracket.black_at(ExposureTime(1000)), Black::Expected);
        assert_eq!(bracket.black_at(ExposureTime(16_000)), Black::Open);
        bracket.add(ExposureTime(64_000), picture(5.0, ccd));
        assert_eq!(bracket.black_at(ExposureTime(128_000)), Black::Impossible);
        assert_eq!(bracket.black_at(ExposureTime(16_000)), Black::Impossible);
    }
}
