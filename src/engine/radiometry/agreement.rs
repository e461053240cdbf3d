//! Do the exposures of a bracket agree? A pixel that two of them read well tells the same rate twice; where the sums
//! over such pixels differ by more than noise and response explain, the light changed while the bracket was taken.
//!
//! The longer exposure alone chooses the pixels: chosen by its own noisy reading the shorter would read too much.

use super::dark::Dark;
use super::levels::{Detail, LevelTable, Reading};
use super::merge::Exposure;
use crate::optics::pixel_map::PixelMap;

/// Fewer pixels that both exposures read well prove nothing.
const ENOUGH: usize = 64;

/// Rows looked at: every so manieth, odd, so that every colour of a mosaic stays.
const ROWS: usize = 3;

/// Standard uncertainties that a change must exceed.
const SURE: f64 = 3.0;

/// What two neighbouring exposures of a bracket say of the light between them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// Integration time of the shorter, s.
    pub short_s: f64,
    /// Integration time of the longer, s.
    pub long_s: f64,
    /// Rate that the longer tells over that of the shorter, less 1.
    pub change: f64,
    /// Standard uncertainty of the change: noise of both exposures, the response's residual and half a level at the levels
    /// of each, common to all pixels.
    pub u: f64,
}

/// Sums over the pixels that both exposures read well.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    pixels: usize,
    rate: [f64; 2],
    var: f64,
    slope: [f64; 2],
}

// === impl Agreement ===

impl Agreement {
    /// The part of the change that noise and response do not explain; 0 where they do.
    pub fn unexplained(&self) -> f64 {
        (self.change.abs() - SURE * self.u).max(0.0)
    }
}

/// Compares each exposure of a bracket with the next longer one; pairs that have too few pixels in common are left out.
pub fn agreement<P: Reading>(
    map: &PixelMap,
    table: &LevelTable,
    dark: &Dark,
    exposures: &[Exposure<'_, P>],
) -> Vec<Agreement> {
    let mut sorted = exposures.to_vec();
    sorted.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    let pairs = sorted.windows(2).filter_map(|pair| {
        let [short, long] = pair else { return None };
        let sums = sums_of(map, table, dark, [short, long]);
        // In a flat picture all pixels lie at the same place of one level.
        let bin_ndl = 1.0 / f64::from(table.radiometer().levels) / 12.0_f64.sqrt();
        sums.change(table.radiometer().residual_ndl.hypot(bin_ndl)).map(|(change, u)| Agreement {
            short_s: short.t_s,
            long_s: long.t_s,
            change,
            u,
        })
    });
    pairs.collect()
}

fn sums_of<P: Reading>(map: &PixelMap, table: &LevelTable, dark: &Dark, pair: [&Exposure<'_, P>; 2]) -> Sums {
    let (mut sums, (least, greatest)) = (Sums::default(), table.sure_x());
    let ratio = pair[0].t_s / pair[1].t_s;
    for (row, ranges) in map.rows().iter().enumerate().step_by(ROWS) {
        for i in ranges.columns.clone().map(|column| row * map.width() + column) {
            let rate = dark.map.at(i);
            let [Some(a), Some(b)] = pair.map(|e| e.pixels.get(i)) else { continue };
            let details @ [_, long] = [a, b].map(|p| p.detail(table));
            if !rate.is_nan() && long.x <= greatest && long.x * ratio >= least {
                sums.add(details, pair.map(|e| e.t_s), rate);
            }
        }
    }
    sums
}

// === impl Sums ===

impl Sums {
    fn add(&mut self, details: [Detail; 2], t_s: [f64; 2], dark: f64) {
        self.pixels += 1;
        for (k, (d, t)) in details.iter().zip(t_s).enumerate() {
            self.rate[k] += d.x / t - dark;
            self.slope[k] += d.xs / t;
            self.var += d.var / (t * t);
        }
    }

    /// Relative change and its standard uncertainty; `None` where nothing can be said.
    fn change(&self, u_ndl: f64) -> Option<(f64, f64)> {
        let [short, long] = self.rate;
        if self.pixels < ENOUGH || short <= 0.0 {
            return None;
        }
        let response = u_ndl * self.slope[0].hypot(self.slope[1]);
        Some((long / short - 1.0, self.var.sqrt().hypot(response) / short))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::optics::pixel_map::{Mosaic, tests as maps};
    use crate::radiometry::dark::DarkMap;
    use crate::radiometry::levels::Radiometer;
    use crate::radiometry::levels::tests::{ccd, ingaas, noisy};

    const TIMES: [f64; 5] = [0.01, 0.04, 0.16, 0.64, 2.56];

    /// A bracket of a scene with this rate at each part of its width; from the `from`-th exposure on the light is `light`.
    fn bracket(radiometer: Radiometer, scene: impl Fn(f64) -> f64, from: usize, light: f64) -> Vec<Agreement> {
        let map = PixelMap::build(&maps::small(Mosaic::BayerRggb)).unwrap();
        let table = LevelTable::of(radiometer).unwrap();
        let dark = Dark { map: DarkMap::Constant(0.02), ..Dark::none() };
        let mut seed = 29;
        let mut frame = |k: usize, t: f64| -> Vec<u16> {
            let light = if k < from { 1.0 } else { light };
            let rate = |i: usize| scene((i % map.width()) as f64 / map.width() as f64);
            (0..map.pixels()).map(|i| noisy(&radiometer, (light * rate(i) + 0.02) * t, &mut seed)).collect()
        };
        let frames: Vec<Vec<u16>> = TIMES.iter().enumerate().map(|(k, t)| frame(k, *t)).collect();
        let exposures: Vec<Exposure<'_, u16>> =
            TIMES.iter().zip(&frames).rev().map(|(&t_s, pixels)| Exposure { t_s, pixels }).collect();
        agreement(&map, &table, &dark, &exposures)
    }

    /// Two decades from one side to the other.
    fn gradient(place: f64) -> f64 {
        10_f64.powf(2.0 * place)
    }

    #[test]
    fn flat_scenes_of_any_brightness_agree() {
        for radiometer in [ccd(), ingaas()] {
            for tenth in -5..30 {
                let rate = 10_f64.powf(f64::from(tenth) / 10.0);
                let found = bracket(radiometer, |_| rate, 0, 1.0);
                assert!(found.iter().all(|a| a.unexplained() == 0.0), "{rate}/s: {found:?}");
            }
        }
    }

    #[test]
    fn a_steady_bracket_agrees_and_a_step_of_the_light_is_found_where_it_was() {
        for (radiometer, step) in [(ccd(), 0.15), (ingaas(), 0.06)] {
            let steady = bracket(radiometer, gradient, 0, 1.0);
            assert!(steady.len() >= 2, "{steady:?}");
            assert!(steady.iter().all(|a| a.unexplained() == 0.0), "{steady:?}");
            for light in [1.0 - step, 1.0 + step] {
                let stepped = bracket(radiometer, gradient, 2, light);
                let found: Vec<&Agreement> = stepped.iter().filter(|a| a.unexplained() > 0.0).collect();
                let [one] = found[..] else { panic!("{stepped:?}") };
                assert_eq!((one.short_s, one.long_s), (TIMES[1], TIMES[2]));
                assert!((one.change - (light - 1.0)).abs() < 0.2 * step, "{one:?}");
            }
        }
    }

    #[test]
    fn frames_that_have_nothing_in_common_say_nothing() {
        let map = PixelMap::build(&maps::small(Mosaic::Mono)).unwrap();
        let table = LevelTable::of(ingaas()).unwrap();
        let (black, white) = (vec![0_u16; map.pixels()], vec![u16::MAX; map.pixels()]);
        let exposures = [Exposure { t_s: 1.0, pixels: &white[..] }, Exposure { t_s: 0.1, pixels: &black[..] }];
        assert!(agreement(&map, &table, &Dark::none(), &exposures).is_empty());
    }
}
