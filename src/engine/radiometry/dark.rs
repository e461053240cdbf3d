//! The dark rate: relative exposure per second that comes without light, pixel by pixel, from dark frames at several
//! integration times.

use super::levels::{Class, LevelTable, Reading};
use super::merge::{Exposure, check_exposures};
use crate::error::EngineError;

/// A pixel is hot when its dark current alone fills this share of the range in the longest exposure.
const HOT_SHARE: f64 = 0.2;

/// Above this share of black readings the others are too few to tell the rate.
const MOST_BLACK: f64 = 0.95;

/// Relative standard uncertainty of [`cut_shift`]: the formula, the noise model, and that pixels differ.
const CUT_SHIFT_U: f64 = 0.25;

/// How many standard deviations the mean of a normal variable lies above its centre if the share `p` is cut off from
/// below: phi(z)/(1 - p) with z the quantile of p, within a tenth for p below 0.75, a third up to 0.95.
pub(super) fn cut_shift(p: f64) -> f64 {
    if p > 0.0 { p * (1.45 - 0.28 * p.ln()) } else { 0.0 }
}

/// Stands for the rate of all pixels near the floor until it is known.
const POOLED: f32 = f32::INFINITY;

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
    /// Standard uncertainty of the rate of a single pixel, independent from pixel to pixel, 1/s.
    pub u_rate: f64,
    /// Standard uncertainty that all pixels share, 1/s: what is not known of a rate below or near the floor.
    pub u_common: f64,
    /// Pixels masked as hot.
    pub hot: usize,
    /// Pixels that noise could have carried below the floor: they have the rate of all such pixels together.
    pub unreadable: usize,
}

/// Sums of the readable frames of one pixel, and of its frames of the longest time alone.
#[derive(Debug, Clone, Copy, Default)]
struct Fit {
    tx: f64,
    tt: f64,
    var: f64,
    x: f64,
    readable: u32,
    black: u32,
    saturated: bool,
}

/// Readings of the longest time of all pixels that cannot be read one by one.
#[derive(Debug, Clone, Copy, Default)]
struct Pool {
    pixels: usize,
    x: f64,
    readable: u64,
    black: u64,
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
        Dark { map: DarkMap::Constant(0.0), typical: 0.0, u_rate: 0.0, u_common: 0.0, hot: 0, unreadable: 0 }
    }

    /// Least rate that the dark frames allow pixel `i`, 1/s; NaN for a masked pixel.
    pub fn least(&self, i: usize) -> f64 {
        let rate = self.map.at(i);
        if rate.is_nan() { rate } else { (rate - 3.0_f64.sqrt() * self.u_common).max(0.0) }
    }

    /// Rate from dark frames, one fit through the origin a pixel: x = D t.
    ///
    /// A pixel whose frames of the longest time lie so near the floor that noise could have cut some off is not read by
    /// itself, a choice by value would bias its rate: all such pixels share one rate ([`Pool::exposure`]). The first
    /// `reserved` pixels are no picture and are masked.
    ///
    /// # Errors
    /// No frames, frames of different sizes, a time that is not positive.
    pub fn estimate<P: Reading>(
        table: &LevelTable,
        frames: &[Exposure<'_, P>],
        reserved: usize,
    ) -> Result<Dark, EngineError> {
        let all = frames.first().map_or(0, |f| f.pixels.len());
        check_exposures(frames, all)?;
        let longest = frames.iter().map(|f| f.t_s).fold(0.0, f64::max);
        let hot_rate = HOT_SHARE * table.top_x() / longest;
        let mut rates = vec![f32::NAN; reserved.min(all)];
        let (mut hot, mut pool, mut sum, mut variance) = (0, Pool::default(), 0.0, 0.0);
        for i in reserved..all {
            let fit = Fit::of(table, frames, i, longest);
            let rate = fit.rate();
            rates.push(if fit.saturated || rate > hot_rate {
                hot += 1;
                f32::NAN
            } else if fit.is_sure(table) {
                sum += rate;
                variance += fit.var / (fit.tt * fit.tt);
                rate as f32
            } else {
                pool.add(&fit);
                POOLED
            });
        }
        let (x, u_x) = pool.exposure::<P>(table);
        let (kept, pooled) = ((all.saturating_sub(reserved) - hot).max(1) as f64, pool.pixels as f64);
        rates.iter_mut().filter(|rate| **rate == POOLED).for_each(|rate| *rate = (x / longest) as f32);
        Ok(Dark {
            map: DarkMap::PerPixel(rates),
            typical: (sum + pooled * x / longest) / kept,
            u_rate: ((variance + pooled * table.variance_at(x) / (longest * longest)) / kept).sqrt(),
            u_common: u_x / longest * pooled / kept,
            hot,
            unreadable: pool.pixels,
        })
    }
}

// === impl Fit ===

impl Fit {
    fn of<P: Reading>(table: &LevelTable, frames: &[Exposure<'_, P>], i: usize, longest: f64) -> Fit {
        let mut fit = Fit::default();
        for frame in frames {
            let Some(p) = frame.pixels.get(i) else { continue };
            let (d, is_longest) = (p.detail(table), frame.t_s == longest);
            match d.class {
                Class::Good | Class::Low if d.var > 0.0 => {
                    // shorter times add only where they are safe from clipping
                    if d.class == Class::Good || is_longest {
                        // weights from the times alone: a weight that knows the noise of its reading would bias
                        fit.tx += frame.t_s * d.x;
                        fit.tt += frame.t_s * frame.t_s;
                        fit.var += frame.t_s * frame.t_s * d.var;
                    }
                    if is_longest {
                        fit.x += d.x;
                        fit.readable += 1;
                    }
                }
                Class::Saturated => fit.saturated |= is_longest,
                _ => fit.black += u32::from(is_longest),
            }
        }
        fit
    }

    fn rate(&self) -> f64 {
        if self.tt > 0.0 { self.tx / self.tt } else { 0.0 }
    }

    /// The mean of the longest time is so far above the floor that noise cut off none of its readings.
    fn is_sure(&self, table: &LevelTable) -> bool {
        self.black == 0 && self.readable > 0 && self.x / f64::from(self.readable) >= table.least_good_x()
    }
}

// === impl Pool ===

impl Pool {
    fn add(&mut self, fit: &Fit) {
        self.pixels += 1;
        self.x += fit.x;
        self.readable += u64::from(fit.readable);
        self.black += u64::from(fit.black);
    }

    /// Exposure in the longest time and its standard uncertainty. The mean of what was not cut off, less what cutting off
    /// adds to it. Where nearly all is black the rate lies between zero and the floor, the less likely the nearer to the floor,
    /// because noise would carry some readings over it: a triangular distribution that falls from zero.
    fn exposure<P: Reading>(&self, table: &LevelTable) -> (f64, f64) {
        let share = self.black as f64 / ((self.black + self.readable) as f64).max(1.0);
        if self.readable == 0 || share > MOST_BLACK {
            let floor = P::floor_x(table);
            return (floor / 3.0, floor / 18.0_f64.sqrt());
        }
        let mean = self.x / self.readable as f64;
        let shift = cut_shift(share) * table.variance_at(mean).sqrt();
        ((mean - shift).max(0.0), CUT_SHIFT_U * shift)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::radiometry::levels::tests::{ccd, ingaas, noisy};

    #[test]
    fn a_linear_camera_gives_its_rate_and_its_hot_pixels() {
        let table = LevelTable::of(ingaas()).unwrap();
        let rate = [0.02, 0.05, 0.0003, 2.9];
        let frame = |t: f64| rate.map(|r: f64| (r * t * 0.3 * 4096.0).floor().min(4095.0) as u16);
        let (a, b) = (frame(1.0), frame(4.0));
        let frames = [Exposure { t_s: 1.0, pixels: &a[..] }, Exposure { t_s: 4.0, pixels: &b[..] }];
        let dark = Dark::estimate(&table, &frames, 0).unwrap();
        for (i, r) in rate.iter().enumerate().take(3) {
            assert!((dark.map.at(i) - r).abs() < 3e-4, "{i}: {}", dark.map.at(i));
        }
        assert!(dark.map.at(3).is_nan(), "saturates in the longest exposure");
        assert_eq!((dark.hot, dark.unreadable), (1, 1), "the third is near the floor");
        assert!(dark.u_rate > 1e-5 && dark.u_rate < 1e-3);
    }

    #[test]
    fn what_stays_black_is_known_only_to_lie_below_the_floor() {
        let table = LevelTable::of(ccd()).unwrap();
        let black = [0_u8; 6];
        let dark = Dark::estimate(&table, &[Exposure { t_s: 60.0, pixels: &black[..] }], 0).unwrap();
        let upper = table.radiometer().response.exposure(1.0 / 256.0) / 60.0;
        assert!((dark.map.at(5) / (upper / 3.0) - 1.0).abs() < 1e-6);
        assert!((dark.u_common - upper / 18.0_f64.sqrt()).abs() < 1e-15 && dark.least(0) == 0.0);
        assert_eq!(dark.unreadable, 6);
        let dark = Dark::estimate(&table, &[Exposure { t_s: 60.0, pixels: &[80_u8, 200, 0, 0] }], 2).unwrap();
        assert!(dark.map.at(0).is_nan() && dark.map.at(1).is_nan() && dark.map.at(2) > 0.0, "no picture, no dark");
        assert_eq!((dark.hot, dark.unreadable), (0, 2));
        assert!(Dark::estimate::<u8>(&table, &[], 0).is_err());
    }

    #[test]
    fn the_mean_of_what_is_not_cut_off_lies_higher_by_what_the_normal_distribution_says() {
        // phi(z)/(1 - p) for the shares that a table of the normal distribution gives
        for (p, shift) in
            [(0.001, 0.00337), (0.01, 0.0269), (0.05, 0.1086), (0.1587, 0.2876), (0.5, 0.7979), (0.7, 1.159)]
        {
            assert!((cut_shift(p) / shift - 1.0).abs() < 0.1, "{p}: {} for {shift}", cut_shift(p));
        }
        assert!((cut_shift(0.95) / 2.063 - 1.0).abs() < 0.34 && cut_shift(0.0) == 0.0);
    }

    /// Three noisy frames of 32 s of pixels that all have one rate, from far below the floor to far above it: a rate of
    /// floor/32 is where half of the readings are black.
    #[test]
    fn a_rate_near_the_floor_is_within_its_common_uncertainty() {
        for radiometer in [ccd(), ingaas()] {
            let table = LevelTable::of(radiometer).unwrap();
            let floor = u16::floor_x(&table);
            for relative in [0.0, 0.3, 0.7, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.36, 1.6, 2.0, 4.0] {
                let (mut seed, rate) = (3, relative * floor / 32.0);
                let mut frame = || (0..20_000).map(|_| noisy(&radiometer, relative * floor, &mut seed)).collect();
                let frames: [Vec<u16>; 3] = [frame(), frame(), frame()];
                let exposures = frames.each_ref().map(|f| Exposure { t_s: 32.0, pixels: &f[..] });
                let dark = Dark::estimate(&table, &exposures, 0).unwrap();
                let mean = (0..20_000).map(|i| dark.map.at(i)).sum::<f64>() / 20_000.0;
                let u = dark.u_common.hypot(0.002 * rate);
                assert!((mean - rate).abs() < 2.0 * u, "{relative}: {mean} for {rate}, u {u}");
                assert!(dark.u_common < 0.35 * floor / 32.0 && dark.hot == 0);
            }
        }
    }
}
