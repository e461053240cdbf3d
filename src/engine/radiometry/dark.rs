//! The dark rate: relative exposure per second that comes without light, pixel by pixel, from dark frames at several
//! integration times.

use super::levels::{Class, LevelTable, Reading};
use super::merge::{Exposure, check_exposures};
use crate::error::EngineError;

/// A pixel is hot when its dark current alone fills this share of the range in the longest exposure.
const HOT_SHARE: f64 = 0.2;

/// Dark rate of a camera, in relative exposure per second.
#[derive(Debug, Clone, PartialEq)]
pub enum DarkMap {
    /// The same for every pixel.
    Constant(f64),
    /// One a pixel; NaN marks a pixel that must not be used.
    PerPixel(Vec<f32>),
}

/// What the dark frames say.
#[derive(Debug, Clone, PartialEq)]
pub struct Dark {
    /// Rate.
    pub map: DarkMap,
    /// Mean rate of the pixels that could be read, 1/s.
    pub typical: f64,
    /// Standard uncertainty of the rate of a single pixel, 1/s.
    pub u_rate: f64,
    /// Pixels masked as hot.
    pub hot: usize,
    /// Pixels that stayed black in every frame: their rate is known only to lie below the floor.
    pub unreadable: usize,
}

/// Sums of the readable frames of one pixel.
#[derive(Debug, Clone, Copy, Default)]
struct Fit {
    tx: f64,
    tt: f64,
    var: f64,
    saturated: bool,
    black: bool,
}

// === impl DarkMap ===

impl DarkMap {
    /// Rate of pixel `i`; NaN for a masked pixel.
    pub fn at(&self, i: usize) -> f64 {
        match self {
            DarkMap::Constant(rate) => *rate,
            DarkMap::PerPixel(map) => map.get(i).map_or(f64::NAN, |&r| f64::from(r)),
        }
    }
}

// === impl Dark ===

impl Dark {
    /// No dark current at all (the ideal bench).
    pub fn none() -> Dark {
        Dark { map: DarkMap::Constant(0.0), typical: 0.0, u_rate: 0.0, hot: 0, unreadable: 0 }
    }

    /// Rate from dark frames, one fit through the origin a pixel: x = D t.
    ///
    /// Frames in which a pixel is black are used only if every frame of the longest time reads it: a choice by value
    /// would bias the rate upward. A pixel that cannot be read has a rate between 0 and floor/t: it gets the middle.
    ///
    /// # Errors
    /// No frames, frames of different sizes, a time that is not positive.
    pub fn estimate<P: Reading>(table: &LevelTable, frames: &[Exposure<'_, P>]) -> Result<Dark, EngineError> {
        let pixels = frames.first().map_or(0, |f| f.pixels.len());
        check_exposures(frames, pixels)?;
        let longest = frames.iter().map(|f| f.t_s).fold(0.0, f64::max);
        let upper = P::floor_x(table) / longest;
        let hot_rate = HOT_SHARE * table.top_x() / longest;
        let mut map = Vec::with_capacity(pixels);
        let (mut hot, mut unreadable, mut variance, mut sum) = (0, 0, 0.0, 0.0);
        for i in 0..pixels {
            let fit = Fit::of(table, frames, i, longest);
            let rate = if fit.tt > 0.0 { fit.tx / fit.tt } else { 0.5 * upper };
            if fit.saturated || rate > hot_rate {
                hot += 1;
                map.push(f32::NAN);
            } else {
                unreadable += usize::from(fit.tt == 0.0);
                if fit.tt > 0.0 {
                    variance += fit.var / (fit.tt * fit.tt);
                    sum += rate;
                }
                map.push(rate as f32);
            }
        }
        let readable = pixels - hot - unreadable;
        let u_read = if readable > 0 { (variance / readable as f64).sqrt() } else { 0.0 };
        let share = unreadable as f64 / (pixels - hot).max(1) as f64;
        let u_rate = (share * upper * upper / 12.0 + (1.0 - share) * u_read * u_read).sqrt();
        if readable == 0 && hot == 0 {
            return Ok(Dark { map: DarkMap::Constant(0.5 * upper), typical: 0.0, u_rate, hot, unreadable });
        }
        let typical = if readable > 0 { sum / readable as f64 } else { 0.0 };
        Ok(Dark { map: DarkMap::PerPixel(map), typical, u_rate, hot, unreadable })
    }
}

// === impl Fit ===

impl Fit {
    fn of<P: Reading>(table: &LevelTable, frames: &[Exposure<'_, P>], i: usize, longest: f64) -> Fit {
        let mut fit = Fit::default();
        for frame in frames {
            let Some(p) = frame.pixels.get(i) else { continue };
            let d = p.detail(table);
            match d.class {
                Class::Good | Class::Low if d.var > 0.0 => {
                    // shorter times add only where they are safe from clipping
                    if d.class == Class::Good || frame.t_s == longest {
                        // weights from the times alone: a weight that knows the noise of its reading would bias
                        fit.tx += frame.t_s * d.x;
                        fit.tt += frame.t_s * frame.t_s;
                        fit.var += frame.t_s * frame.t_s * d.var;
                    }
                }
                Class::Saturated => fit.saturated |= frame.t_s == longest,
                _ => fit.black |= frame.t_s == longest,
            }
        }
        if fit.black {
            return Fit { tx: 0.0, tt: 0.0, var: 0.0, ..fit };
        }
        fit
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::radiometry::levels::tests::{ccd, ingaas};

    #[test]
    fn a_linear_camera_gives_its_rate_and_its_hot_pixels() {
        let table = LevelTable::of(ingaas()).unwrap();
        let rate = [0.02, 0.05, 0.0003, 2.9];
        let frame = |t: f64| rate.map(|r: f64| (r * t * 0.3 * 4096.0).floor().min(4095.0) as u16);
        let (a, b) = (frame(1.0), frame(4.0));
        let frames = [Exposure { t_s: 1.0, pixels: &a[..] }, Exposure { t_s: 4.0, pixels: &b[..] }];
        let dark = Dark::estimate(&table, &frames).unwrap();
        for (i, r) in rate.iter().enumerate().take(3) {
            assert!((dark.map.at(i) - r).abs() < 3e-4, "{i}: {}", dark.map.at(i));
        }
        assert!(dark.map.at(3).is_nan(), "saturates in the longest exposure");
        assert_eq!((dark.hot, dark.unreadable), (1, 0));
        assert!(dark.u_rate > 1e-5 && dark.u_rate < 1e-3);
    }

    #[test]
    fn what_stays_black_is_known_only_to_lie_below_the_floor() {
        let table = LevelTable::of(ccd()).unwrap();
        let black = [0_u8; 6];
        let dark = Dark::estimate(&table, &[Exposure { t_s: 60.0, pixels: &black[..] }]).unwrap();
        let upper = table.radiometer().response.exposure(1.0 / 256.0) / 60.0;
        assert_eq!(dark.map, DarkMap::Constant(0.5 * upper));
        assert!((dark.u_rate - upper / 12.0_f64.sqrt()).abs() < 1e-15);
        assert_eq!(dark.unreadable, 6);
        assert!(Dark::estimate::<u8>(&table, &[]).is_err());
    }
}
