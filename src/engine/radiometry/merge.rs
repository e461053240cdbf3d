//! The bracket merge: all exposures of one view in one pass, straight into the patches of the basis.
//!
//! For each pixel L = sum w L_k / sum w over the exposures, w = 1/var(L_k), minus the dark rate, divided by VC. The
//! frame is cut into fixed tiles that are summed in tile order, so the result does not depend on the number of threads.

use super::dark::Dark;
use super::levels::{Class, LevelTable, Reading};
use crate::engine::bsdf::patches::{PatchMean, ViewPatches};
use crate::engine::error::EngineError;
use crate::engine::optics::pixel_map::{PixelMap, Row};
use rayon::prelude::*;

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
    /// Rate, its variance, rate x s(N) (1/s).
    Measured { l: f64, var: f64, ls: f64 },
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
    floor_weight: f64,
    floor: f64,
    missing: f64,
    least: f64,
    max: f64,
    g: [f64; 2],
    gl: [f64; 2],
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
    let channels = sum
        .chunks(map.patches().max(1))
        .map(|c| c.iter().zip(map.in_frame()).map(|(p, &f)| p.mean(residual, dark.u_rate, f)).collect())
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
                Pixel::Measured { l: s.wl * v - dark, var: v, ls: s.wls * v }
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
                    return Pixel::Measured { l: d.x / t - dark, var: d.var / (t * t), ls: d.xs / t };
                }
                Class::Black if k == 0 => return Pixel::BelowFloor { floor: (self.floor_x / t - dark).max(0.0) },
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
            patch.g = [patch.g[0] + edge.gx, patch.g[1] + edge.gy];
            patch.gl = [patch.gl[0] + edge.gx * l, patch.gl[1] + edge.gy * l];
        }
    }
}

// === impl Pixel ===

impl Pixel {
    /// Divided by VC, told as the gain 1/VC.
    fn scaled(self, gain: f64) -> Pixel {
        match self {
            Pixel::Measured { l, var, ls } => Pixel::Measured { l: l * gain, var: var * gain * gain, ls: ls * gain },
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
            Pixel::Measured { l, var, ls } => {
                self.measured += weight;
                self.l += weight * l;
                self.var += weight * weight * var;
                self.ls += weight * ls;
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
        self.floor_weight += other.floor_weight;
        self.floor += other.floor;
        self.missing += other.missing;
        self.least += other.least;
        self.max = self.max.max(other.max);
        self.pixels += other.pixels;
        for k in 0..2 {
            self.g[k] += other.g[k];
            self.gl[k] += other.gl[k];
        }
    }

    /// Mean over what was measured or is known to lie below the floor.
    fn mean(&self, residual_ndl: f64, u_dark: f64, in_frame: f64) -> PatchMean {
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
            u_floor: self.floor / 12.0_f64.sqrt() / known,
            u_response: residual_ndl * self.ls / known,
            u_geometry: [gradient(0), gradient(1)],
            measured: in_frame * self.measured / all,
            below_floor: in_frame * self.floor_weight / all,
            missing: in_frame * self.missing / all,
            max: self.max,
            lower_bound: (self.l + 0.5 * self.floor + self.least) / all,
            pixels: self.pixels,
        }
    }
}
