//! The bracket merge: all exposures of one view in one pass, straight into the patches of the basis.
//!
//! For each pixel L = sum w L_k / sum w over the exposures, w = 1/var(L_k), minus the dark rate, divided by VC. The
//! frame is cut into fixed tiles that are summed in tile order, so the result does not depend on the number of
//! threads.

use super::dark::{Dark, cut_shift};
use super::levels::{Class, LevelTable, Reading};
use crate::bsdf::patches::{PatchMean, ViewPatches};
use crate::error::EngineError;
use crate::optics::pixel_map::{PixelMap, Row};
use rayon::prelude::*;

/// How much of a patch mean the point spread can have moved over its border, against what one more point spread moves:
/// 1 for a smooth field, 1 + sqrt 2 for a step at the border; the bound as a rectangular distribution.
const RESOLUTION: f64 = 2.414 / 1.732;

/// Rows of a tile.
const TILE_ROWS: usize = 32;

/// One frame of a bracket.
#[derive(Debug, Clone, Copy)]
pub struct Exposure<'a, P> {
    /// Integration time in seconds.
    pub t_s: f64,
    /// Pixels, row by row.
    pub pixels: &'a [P],
}

/// Weighted sums of one pixel over the bracket.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    w: f64,
    wl: f64,
    wls: f64,
}

/// What the bracket says of one pixel.
#[derive(Debug, Clone, Copy)]
enum Pixel {
    /// Rate, its variance, rate x s(N) (1/s), the dark's common uncertainty; where noise could have cut the reading off, the
    /// standard deviation of that noise, else 0.
    Measured { l: f64, var: f64, ls: f64, dark: f64, low: f64 },
    /// Black even in the longest exposure: the rate lies between 0 and `floor`.
    BelowFloor { floor: f64 },
    /// Saturated even in the shortest exposure: the rate is at least `least`.
    Missing { least: f64 },
    /// Masked.
    Masked,
}

/// Sums of one patch in one channel. Weights are projected solid angles.
#[derive(Debug, Clone, Copy, Default)]
struct Patch {
    measured: f64,
    l: f64,
    var: f64,
    ls: f64,
    dark: f64,
    low_weight: f64,
    low: f64,
    floor_weight: f64,
    floor: f64,
    missing: f64,
    least: f64,
    max: f64,
    g: [f64; 3],
    gl: [f64; 3],
    pixels: u64,
}

/// The bracket and what is needed to read it.
struct Merge<'a, P> {
    map: &'a PixelMap,
    table: &'a LevelTable,
    dark: &'a Dark,
    /// Longest first.
    exposures: Vec<Exposure<'a, P>>,
    floor_x: f64,
}

/// Merges a bracket into patch means of relative exposure rate (1/s), one list a channel.
///
/// # Errors
/// An empty bracket, a frame or dark map of another size than the map, a time that is not positive.
pub fn merge<P: Reading>(
    map: &PixelMap,
    table: &LevelTable,
    dark: &Dark,
    exposures: &[Exposure<'_, P>],
) -> Result<ViewPatches, EngineError> {
    check_exposures(exposures, map.pixels())?;
    if let super::dark::DarkMap::PerPixel(rates) = &dark.map
        && rates.len() != map.pixels()
    {
        return Err(EngineError::FrameSize { what: "the dark map", expected: map.pixels(), got: rates.len() });
    }
    let mut sorted = exposures.to_vec();
    sorted.sort_by(|a, b| b.t_s.total_cmp(&a.t_s));
    let merge = Merge { map, table, dark, exposures: sorted, floor_x: P::floor_x(table) };
    let tiles = map.rows().len().div_ceil(TILE_ROWS);
    let parts: Vec<Vec<Patch>> = (0..tiles).into_par_iter().map(|tile| merge.tile(tile)).collect();
    let mut sum = vec![Patch::default(); map.channels() * map.patches()];
    for part in &parts {
        for (s, p) in sum.iter_mut().zip(part) {
            s.add(p);
        }
    }
    let residual = table.radiometer().residual_ndl;
    let common = merge.dark_response();
    let channels = sum
        .chunks(map.patches().max(1))
        .map(|c| c.iter().zip(map.in_frame()).map(|(p, &f)| p.mean([residual, common], dark.u_rate, f)).collect())
        .collect();
    Ok(ViewPatches { channels })
}

pub(super) fn check_exposures<P>(exposures: &[Exposure<'_, P>], pixels: usize) -> Result<(), EngineError> {
    if exposures.is_empty() {
        return Err(EngineError::EmptyBracket);
    }
    for e in exposures {
        if !(e.t_s > 0.0 && e.t_s.is_finite()) {
            return Err(EngineError::IntegrationTime { t_s: e.t_s });
        }
        if e.pixels.len() != pixels {
            return Err(EngineError::FrameSize { what: "a frame", expected: pixels, got: e.pixels.len() });
        }
    }
    Ok(())
}

// === impl Merge ===

impl<P: Reading> Merge<'_, P> {
    /// What one unit of NDL error of the response does to the dark rate, 1/s: it does the same to a pixel that sees
    /// little more than the dark, so the difference is free of it.
    fn dark_response(&self) -> f64 {
        let longest = self.exposures.first().map_or(0.0, |e| e.t_s);
        let x = self.dark.typical * longest;
        if x <= self.floor_x {
            return 0.0;
        }
        let response = self.table.radiometer().response;
        x * response.sensitivity(response.ndl(x)) / longest
    }

    fn tile(&self, tile: usize) -> Vec<Patch> {
        let mut patches = vec![Patch::default(); self.map.channels() * self.map.patches()];
        let mut sums = vec![Sums::default(); self.map.width()];
        let mut line = vec![Pixel::Masked; self.map.width()];
        let rows = self.map.rows().iter().enumerate().skip(tile * TILE_ROWS).take(TILE_ROWS);
        for (row, ranges) in rows {
            if !ranges.columns.is_empty() {
                self.read_row(row, ranges, &mut sums, &mut line);
                self.scatter(ranges, &line, &mut patches);
            }
        }
        patches
    }

    /// Merges the exposures of one row pixel by pixel.
    fn read_row(&self, row: usize, ranges: &Row, sums: &mut [Sums], line: &mut [Pixel]) {
        let start = row * self.map.width() + ranges.columns.start;
        let end = row * self.map.width() + ranges.columns.end;
        let sums = sums.get_mut(..end - start).unwrap_or_default();
        sums.fill(Sums::default());
        for e in &self.exposures {
            let (t, t2) = (e.t_s, e.t_s * e.t_s);
            for (s, p) in sums.iter_mut().zip(e.pixels.get(start..end).unwrap_or_default()) {
                let r = p.entry(self.table);
                s.w += t2 * r.w;
                s.wl += t * r.wx;
                s.wls += t * r.wxs;
            }
        }
        let gains = self.map.gain().get(start..end).unwrap_or_default();
        let line = line.get_mut(ranges.columns.clone()).unwrap_or_default();
        for (k, ((pixel, s), &gain)) in line.iter_mut().zip(sums.iter()).zip(gains).enumerate() {
            let dark = self.dark.map.at(start + k);
            *pixel = if dark.is_nan() {
                Pixel::Masked
            } else if s.w > 0.0 {
                let v = 1.0 / s.w;
                Pixel::Measured { l: s.wl * v - dark, var: v, ls: s.wls * v, dark: self.dark.u_common, low: 0.0 }
            } else {
                self.rare(start + k, dark)
            }
            .scaled(gain);
        }
    }

    /// A pixel without any good reading: from the longest exposure down, what can still be said.
    fn rare(&self, i: usize, dark: f64) -> Pixel {
        for (k, e) in self.exposures.iter().enumerate() {
            let Some(p) = e.pixels.get(i) else { return Pixel::Masked };
            let d = p.detail(self.table);
            let t = e.t_s;
            match d.class {
                Class::Good | Class::Low => {
                    let low = if d.class == Class::Low { d.var.sqrt() / t } else { 0.0 };
                    let (var, ls) = (d.var / (t * t), d.xs / t);
                    return Pixel::Measured { l: d.x / t - dark, var, ls, dark: self.dark.u_common, low };
                }
                Class::Black if k == 0 => {
                    return Pixel::BelowFloor { floor: (self.floor_x / t - self.dark.least(i)).max(0.0) };
                }
                Class::Black => break,
                Class::Saturated => {}
            }
        }
        let shortest = self.exposures.last().map_or(f64::INFINITY, |e| e.t_s);
        Pixel::Missing { least: self.table.top_x() / shortest - dark }
    }

    fn scatter(&self, ranges: &Row, line: &[Pixel], patches: &mut [Patch]) {
        for part in self.map.parts().get(ranges.parts.clone()).unwrap_or_default() {
            let (Some(pixel), Some(patch)) = (line.get(part.column as usize), patches.get_mut(part.slot as usize))
            else {
                continue;
            };
            patch.take(pixel, part.weight);
        }
        for edge in self.map.edges().get(ranges.edges.clone()).unwrap_or_default() {
            let (Some(pixel), Some(patch)) = (line.get(edge.column as usize), patches.get_mut(edge.slot as usize))
            else {
                continue;
            };
            let Some(l) = pixel.value() else { continue };
            for (k, g) in [edge.gx, edge.gy, edge.blur].into_iter().enumerate() {
                patch.g[k] += g;
                patch.gl[k] += g * l;
            }
        }
    }
}

// === impl Pixel ===

impl Pixel {
    /// Divided by VC, told as the gain 1/VC.
    fn scaled(self, gain: f64) -> Pixel {
        match self {
            Pixel::Measured { l, var, ls, dark, low } => {
                let (l, var, ls) = (l * gain, var * gain * gain, ls * gain);
                Pixel::Measured { l, var, ls, dark: dark * gain, low: low * gain }
            }
            Pixel::BelowFloor { floor } => Pixel::BelowFloor { floor: floor * gain },
            Pixel::Missing { least } => Pixel::Missing { least: least * gain },
            Pixel::Masked => Pixel::Masked,
        }
    }

    fn value(&self) -> Option<f64> {
        match *self {
            Pixel::Measured { l, .. } => Some(l),
            Pixel::BelowFloor { floor } => Some(0.5 * floor),
            Pixel::Missing { .. } | Pixel::Masked => None,
        }
    }
}

// === impl Patch ===

impl Patch {
    #[inline]
    fn take(&mut self, pixel: &Pixel, weight: f64) {
        match *pixel {
            Pixel::Measured { l, var, ls, dark, low } => {
                self.measured += weight;
                self.l += weight * l;
                self.var += weight * weight * var;
                self.ls += weight * ls;
                self.dark += weight * dark;
                if low > 0.0 {
                    self.low_weight += weight;
                    self.low += weight * low;
                }
                self.max = self.max.max(l);
                self.pixels += 1;
            }
            Pixel::BelowFloor { floor } => {
                self.floor_weight += weight;
                self.floor += weight * floor;
                self.pixels += 1;
            }
            Pixel::Missing { least } => {
                self.missing += weight;
                self.least += weight * least;
                self.max = self.max.max(least);
            }
            Pixel::Masked => {}
        }
    }

    fn add(&mut self, other: &Patch) {
        self.measured += other.measured;
        self.l += other.l;
        self.var += other.var;
        self.ls += other.ls;
        self.dark += other.dark;
        self.low_weight += other.low_weight;
        self.low += other.low;
        self.floor_weight += other.floor_weight;
        self.floor += other.floor;
        self.missing += other.missing;
        self.least += other.least;
        self.max = self.max.max(other.max);
        self.pixels += other.pixels;
        for k in 0..3 {
            self.g[k] += other.g[k];
            self.gl[k] += other.gl[k];
        }
    }

    /// What readings near the floor are too high because others of the patch, cut off, are black.
    fn cut_off(&self) -> f64 {
        let near = self.floor_weight + self.low_weight;
        if self.low_weight > 0.0 { cut_shift(self.floor_weight / near) * self.low } else { 0.0 }
    }

    /// Mean over what was measured or is known to lie below the floor.
    fn mean(&self, [residual_ndl, common]: [f64; 2], u_dark: f64, in_frame: f64) -> PatchMean {
        let known = self.measured + self.floor_weight;
        let all = known + self.missing;
        if known <= 0.0 {
            let missing = if all > 0.0 { in_frame } else { 0.0 };
            let lower_bound = if all > 0.0 { self.least / all } else { 0.0 };
            return PatchMean { missing, lower_bound, max: self.max, ..PatchMean::nothing() };
        }
        let rate = (self.l + 0.5 * self.floor) / known;
        let gradient = |k: usize| (self.gl[k] - rate * self.g[k]) / known;
        let n = (self.pixels.max(1)) as f64;
        PatchMean {
            rate,
            u_random: (self.var / (known * known) + u_dark * u_dark / n).sqrt(),
            u_floor: (self.floor / 12.0_f64.sqrt() + self.cut_off()) / known,
            u_dark: self.dark / known,
            u_response: residual_ndl * (self.ls / known - common * self.measured / known).abs(),
            u_geometry: [gradient(0), gradient(1), RESOLUTION * gradient(2)],
            measured: in_frame * self.measured / all,
            below_floor: in_frame * self.floor_weight / all,
            missing: in_frame * self.missing / all,
            max: self.max,
            lower_bound: (self.l + 0.5 * self.floor + self.least) / all,
            pixels: self.pixels,
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]
    use super::*;
    use crate::optics::pixel_map::{Mosaic, tests as maps, vignetting};
    use crate::radiometry::dark::DarkMap;
    use crate::radiometry::levels::LevelTable;
    use crate::radiometry::levels::tests::{ccd, ingaas, noisy};

    const TIMES: [f64; 5] = [0.01, 0.04, 0.16, 0.64, 2.56];

    /// Exposure x of a pixel that sees `rate` for `t`, with vignetting of the small test camera.
    fn exposure(spec: &crate::optics::pixel_map::PixelMapSpec, i: usize, rate: f64, t: f64) -> f64 {
        let zenith = spec.fisheye.zenith_deg((i % spec.width) as f64, (i / spec.width) as f64);
        rate * t * vignetting(&spec.vignetting, (zenith / 90.0).min(1.0))
    }

    fn exposures<P>(frames: &[Vec<P>]) -> Vec<Exposure<'_, P>> {
        TIMES.iter().zip(frames).map(|(&t_s, f)| Exposure { t_s, pixels: &f[..] }).collect()
    }

    #[test]
    fn the_ideal_bench_is_exact() {
        let spec = maps::small(Mosaic::BayerRggb);
        let map = PixelMap::build(&spec).unwrap();
        let table = LevelTable::of(ccd()).unwrap();
        let f = ccd().response;
        let dark = Dark { map: DarkMap::Constant(0.05), ..Dark::none() };
        let frames: Vec<Vec<f64>> = TIMES
            .iter()
            .map(|t| (0..map.pixels()).map(|i| f.ndl(exposure(&spec, i, 7.0, *t) + 0.05 * t)).collect())
            .collect();
        let view = merge(&map, &table, &dark, &exposures(&frames)).unwrap();
        assert_eq!(view.channels.len(), 3);
        for p in view.channels.iter().flatten() {
            assert!((p.rate / 7.0 - 1.0).abs() < 1e-9, "{}", p.rate);
            assert!(p.coverage() > 0.999 && p.missing == 0.0 && p.u_floor == 0.0);
            assert!(p.u_geometry[0].abs() < 1e-9, "a uniform field does not feel a shift");
        }
    }

    /// Three decades of rate, 8 bit with noise: every patch within 4 standard uncertainties, all within 0.3 %.
    #[test]
    fn noisy_brackets_are_unbiased_over_the_range() {
        let spec = maps::small(Mosaic::Mono);
        let map = PixelMap::build(&spec).unwrap();
        for radiometer in [ccd(), ingaas()] {
            let table = LevelTable::of(radiometer).unwrap();
            for rate in [0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0] {
                let mut seed = 17;
                let frames: Vec<Vec<u16>> = TIMES
                    .iter()
                    .map(|t| {
                        (0..map.pixels()).map(|i| noisy(&radiometer, exposure(&spec, i, rate, *t), &mut seed)).collect()
                    })
                    .collect();
                let view = merge(&map, &table, &Dark::none(), &exposures(&frames)).unwrap();
                let (mut mean, mut n, mut chi2) = (0.0, 0.0, 0.0);
                for p in &view.channels[0] {
                    mean += p.rate;
                    n += 1.0;
                    chi2 += ((p.rate - rate) / p.u_random).powi(2);
                }
                let bias = mean / n / rate - 1.0;
                assert!(bias.abs() < 3e-3, "{rate}/s: bias {bias:.2e}");
                assert!(chi2 / n < 1.7 && chi2 / n > 0.5, "{rate}/s: chi2 {}", chi2 / n);
            }
        }
    }

    /// What dark frames and picture leave open near the floor is in the uncertainty: rates from none at all to many times the
    /// floor, over a dark rate from none to twice the floor.
    #[test]
    fn dim_patches_over_an_unreadable_dark_are_within_two_standard_uncertainties() {
        let spec = maps::small(Mosaic::Mono);
        let map = PixelMap::build(&spec).unwrap();
        let (table, t_s) = (LevelTable::of(ccd()).unwrap(), 2.56);
        let floor = table.bottom_x() / t_s;
        let mut seed = 29;
        let mut frame = |rate: f64, dark: f64| -> Vec<u16> {
            let x = |i| exposure(&spec, i, rate, t_s) + dark * t_s;
            (0..map.pixels()).map(|i| noisy(&ccd(), x(i), &mut seed)).collect()
        };
        for dark_rate in [0.0, 0.1, 0.5, 0.9, 1.0, 1.3, 2.0].map(|d| d * floor) {
            let black = [frame(0.0, dark_rate), frame(0.0, dark_rate)];
            let dark = Dark::estimate(&table, &black.each_ref().map(|f| Exposure { t_s, pixels: &f[..] }), 0).unwrap();
            for rate in [0.0, 0.05, 0.3, 0.8, 1.0, 1.2, 2.0, 10.0, 100.0].map(|r| r * floor) {
                let lit = frame(rate, dark_rate);
                let view = merge(&map, &table, &dark, &[Exposure { t_s, pixels: &lit[..] }]).unwrap();
                let patches = &view.channels[0];
                let mean = |f: fn(&PatchMean) -> f64| patches.iter().map(f).sum::<f64>() / patches.len() as f64;
                let u = mean(|p| p.u_floor).hypot(mean(|p| p.u_dark)).hypot(2e-3 * (rate + dark_rate));
                let error = mean(|p| p.rate) - rate;
                assert!(error.abs() < 2.0 * u, "rate {rate:.4}, dark {dark_rate:.4}: {error:.5} with u {u:.5}");
                assert!(u < 0.6 * floor + 0.005 * rate, "rate {rate:.4}, dark {dark_rate:.4}: u {u:.5}");
            }
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let spec = maps::small(Mosaic::BayerRggb);
        let map = PixelMap::build(&spec).unwrap();
        let table = LevelTable::of(ccd()).unwrap();
        let mut seed = 5;
        let frames: Vec<Vec<u8>> = TIMES
            .iter()
            .map(|t| {
                (0..map.pixels())
                    .map(|i| {
                        let rate = 0.1 + (i % 97) as f64;
                        u8::try_from(noisy(&ccd(), exposure(&spec, i, rate, *t), &mut seed)).unwrap()
                    })
                    .collect()
            })
            .collect();
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| merge(&map, &table, &Dark::none(), &exposures(&frames)).unwrap())
        };
        let one = format!("{:?}", run(1));
        assert_eq!(one, format!("{:?}", run(2)));
        assert_eq!(one, format!("{:?}", run(5)));
    }

    #[test]
    fn black_is_bounded_and_saturated_is_missing() {
        let spec = maps::small(Mosaic::Mono);
        let map = PixelMap::build(&spec).unwrap();
        let table = LevelTable::of(ccd()).unwrap();
        let frames = |level: u8| -> Vec<Vec<u8>> { TIMES.iter().map(|_| vec![level; map.pixels()]).collect() };
        let black = merge(&map, &table, &Dark::none(), &exposures(&frames(0))).unwrap();
        let floor = ccd().response.exposure(1.0 / 256.0) / 2.56;
        for p in &black.channels[0] {
            assert!(p.rate >= 0.5 * floor && p.rate < 0.6 * floor, "half the floor over VC");
            assert!((p.u_floor / p.rate - 2.0 / 12.0_f64.sqrt()).abs() < 1e-12);
            assert!(p.below_floor > 0.999 && p.measured == 0.0);
        }
        let white = merge(&map, &table, &Dark::none(), &exposures(&frames(255))).unwrap();
        for p in &white.channels[0] {
            assert!(p.rate.is_nan() && p.missing > 0.999 && p.coverage() == 0.0);
            assert!(p.lower_bound >= table.top_x() / 0.01);
        }
    }

    /// A bright half: patches that straddle its border feel a shift of direction, the others do not.
    #[test]
    fn a_peak_at_a_border_feels_the_direction_uncertainty() {
        let spec = maps::small(Mosaic::Mono);
        let map = PixelMap::build(&spec).unwrap();
        let table = LevelTable::of(ccd()).unwrap();
        let f = ccd().response;
        let field = |shift: f64| -> ViewPatches {
            let frames: Vec<Vec<f64>> = TIMES
                .iter()
                .map(|t| {
                    (0..map.pixels())
                        .map(|i| {
                            let column = (i % spec.width) as f64 - shift;
                            let rate = 1.0 + 9.0 / (1.0 + (-(column - 80.0) / 1.5).exp());
                            f.ndl(exposure(&spec, i, rate, *t))
                        })
                        .collect()
                })
                .collect();
            merge(&map, &table, &Dark::none(), &exposures(&frames)).unwrap()
        };
        let (here, there) = (field(0.0), field(0.2));
        let mut compared = 0;
        for (a, b) in here.channels[0].iter().zip(&there.channels[0]) {
            let change = b.rate - a.rate;
            if change.abs() > 0.1 {
                // 0.3 degrees at the sample are 0.3 sqrt(J) / 1.886 pixels: 0.09 to 0.29; the shift was 0.2
                let told = a.u_geometry[0];
                assert!(told * change > 0.0, "sign {told} {change}");
                assert!((0.3..2.5).contains(&(told / change)), "{told} for {change}");
                compared += 1;
            }
        }
        assert!(compared >= 3, "{compared}");
    }

    #[test]
    fn wrong_input_is_refused_in_one_sentence() {
        let map = PixelMap::build(&maps::small(Mosaic::Mono)).unwrap();
        let table = LevelTable::of(ccd()).unwrap();
        let short = [0_u8; 3];
        let bad = Exposure { t_s: 1.0, pixels: &short[..] };
        let text = merge(&map, &table, &Dark::none(), &[bad]).unwrap_err().to_string();
        assert!(text.contains("3 pixels") && text.contains("14560"), "{text}");
        assert!(merge::<u8>(&map, &table, &Dark::none(), &[]).is_err());
        let frame = vec![0_u8; map.pixels()];
        let now = Exposure { t_s: 0.0, pixels: &frame[..] };
        assert!(merge(&map, &table, &Dark::none(), &[now]).is_err());
    }

    /// 1392 x 1040, five exposures, one core. Run alone: `cargo test --lib full_size -- --ignored --nocapture`.
    #[test]
    #[ignore = "speed, meaningful only on an idle machine"]
    fn full_size_bracket_takes_25_ms_on_one_core() {
        let map = PixelMap::build(&maps::ccd()).unwrap();
        let table = LevelTable::of(ccd()).unwrap();
        let mut seed = 3;
        let frames: Vec<Vec<u8>> = TIMES
            .iter()
            .map(|t| (0..map.pixels()).map(|_| noisy(&ccd(), 5.0 * t, &mut seed) as u8).collect())
            .collect();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let best = (0..12)
            .map(|_| {
                let start = std::time::Instant::now();
                let view = pool.install(|| merge(&map, &table, &Dark::none(), &exposures(&frames)).unwrap());
                assert!(view.channels[1][0].rate > 4.0);
                start.elapsed().as_secs_f64() * 1e3
            })
            .fold(f64::INFINITY, f64::min);
        eprintln!("merge 1392 x 1040 x 5: {best:.1} ms");
        assert!(best < 25.0);
    }
}
