//! What a digital level is worth: a table from level to relative exposure, its weight 1/variance, and its class.
//!
//! The table is in exposure x, not in rate, so one table serves every integration time: with L = x/t the weight of a
//! reading is t^2 w(x), its weighted rate t w(x) x.

use super::response::{LevelConvention, Response};
use crate::error::EngineError;

/// One-sided limit in standard deviations: a level counts as safe from an end of the range when noise carries it
/// there with a probability below 1e-3.
const SAFE_SIGMA: f64 = 3.09;

/// Photon-transfer numbers of a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Electrons collected at x = 1.
    pub electrons_at_unit_exposure: f64,
    /// Read noise in electrons.
    pub read_noise_e: f64,
}

/// Everything that turns a level into an exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Radiometer {
    /// Response of eq. (4), in the convention f(1) = 0.3.
    pub response: Response,
    /// Which NDL a level stands for.
    pub convention: LevelConvention,
    /// Number of digital levels, 2^bits.
    pub levels: u32,
    /// Noise model.
    pub noise: Noise,
    /// Standard uncertainty of the response curve in NDL.
    pub residual_ndl: f64,
}

/// What a reading can be used for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Class {
    /// Clipped at zero: the exposure is below the floor.
    Black,
    /// Above zero, but noise would often clip it: choosing it by its value would bias, so it counts only where no
    /// other exposure of the bracket has anything to say.
    Low,
    /// Usable.
    Good,
    /// Top level, or so near that noise would often clip it.
    Saturated,
}

/// Sums a usable reading contributes.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Entry {
    /// w = 1/var(x); zero unless `Good`.
    pub w: f64,
    /// w x.
    pub wx: f64,
    /// w x s(N), s = d ln x / dN: what one unit of NDL error of the response costs.
    pub wxs: f64,
}

/// Everything about one reading, for the rare pixels that need more than sums.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detail {
    /// Relative exposure.
    pub x: f64,
    /// Its variance.
    pub var: f64,
    /// x s(N).
    pub xs: f64,
    /// What it can be used for.
    pub class: Class,
}

/// Look-up table of a camera.
#[derive(Debug, Clone, PartialEq)]
pub struct LevelTable {
    radiometer: Radiometer,
    entries: Vec<Entry>,
    details: Vec<Detail>,
    floor_x: f64,
    top_x: f64,
}

/// A pixel value that a table can read: a digital level, or an NDL of the ideal bench without quantisation.
pub trait Reading: Copy + Send + Sync {
    /// Sums of this reading.
    fn entry(self, table: &LevelTable) -> Entry;
    /// All about this reading.
    fn detail(self, table: &LevelTable) -> Detail;
    /// Exposure below which such a reading is black.
    fn floor_x(table: &LevelTable) -> f64;
}

// === impl Radiometer ===

impl Radiometer {
    /// Variance of x: shot noise, read noise and, for a digital level, a uniform bin of one level.
    pub fn variance(&self, x: f64, ndl: f64, quantised: bool) -> f64 {
        let e1 = self.noise.electrons_at_unit_exposure;
        let electrons = (x * e1).max(0.0) + self.noise.read_noise_e.powi(2);
        let bin = if quantised { x * self.response.sensitivity(ndl) / f64::from(self.levels) } else { 0.0 };
        electrons / (e1 * e1) + bin * bin / 12.0
    }

    pub(super) fn classify(&self, ndl: f64, floor_x: f64, top_x: f64, quantised: bool) -> Detail {
        let x = self.response.exposure(ndl);
        let var = self.variance(x, ndl, quantised);
        let reach = SAFE_SIGMA * var.sqrt();
        let class = if x + reach >= top_x {
            Class::Saturated
        } else if x - reach < floor_x {
            Class::Low
        } else {
            Class::Good
        };
        Detail { x, var, xs: x * self.response.sensitivity(ndl), class }
    }
}

// === impl Entry ===

impl Entry {
    pub(super) fn of(d: &Detail) -> Entry {
        if d.class == Class::Good {
            let w = 1.0 / d.var;
            Entry { w, wx: w * d.x, wxs: w * d.xs }
        } else {
            Entry::default()
        }
    }
}

// === impl Detail ===

impl Detail {
    pub(super) fn clipped(class: Class, x: f64) -> Detail {
        Detail { x, var: f64::INFINITY, xs: 0.0, class }
    }
}

// === impl LevelTable ===

impl LevelTable {
    /// Table of a camera.
    ///
    /// # Errors
    /// A number of levels outside 2 to 65536, electrons at unit exposure that are not positive.
    pub fn of(radiometer: Radiometer) -> Result<LevelTable, EngineError> {
        let Radiometer { response, convention, levels, noise, .. } = radiometer;
        if !(2..=65536).contains(&levels) {
            let allowed = "a sensor has 2 to 65536 levels";
            return Err(EngineError::Parameter { name: "levels", value: f64::from(levels), allowed });
        }
        let e1 = noise.electrons_at_unit_exposure;
        if !(e1 > 0.0 && e1.is_finite() && noise.read_noise_e >= 0.0) {
            let allowed = "electrons must be positive and read noise not negative";
            return Err(EngineError::Parameter { name: "electrons_at_unit_exposure", value: e1, allowed });
        }
        let floor_x = response.exposure(1.0 / f64::from(levels));
        let top_x = response.exposure(f64::from(levels - 1) / f64::from(levels));
        let details: Vec<Detail> = (0..levels)
            .map(|level| match level {
                0 => Detail::clipped(Class::Black, 0.0),
                n if n == levels - 1 => Detail::clipped(Class::Saturated, top_x),
                n => radiometer.classify(convention.ndl(n, levels), floor_x, top_x, true),
            })
            .collect();
        let entries = details.iter().map(Entry::of).collect();
        Ok(LevelTable { radiometer, entries, details, floor_x, top_x })
    }

    /// The camera it was made for.
    pub fn radiometer(&self) -> &Radiometer {
        &self.radiometer
    }

    /// Exposure at which the top level begins.
    pub fn top_x(&self) -> f64 {
        self.top_x
    }

    /// Exposure at which a reading leaves zero.
    pub(super) fn bottom_x(&self) -> f64 {
        self.floor_x
    }

    /// Least exposure of class [`Class::Good`]: noise does not carry it below the floor.
    pub(super) fn least_good_x(&self) -> f64 {
        self.details.iter().find(|d| d.class == Class::Good).map_or(f64::INFINITY, |d| d.x)
    }

    /// Variance of a reading at exposure `x`.
    pub(super) fn variance_at(&self, x: f64) -> f64 {
        let x = x.max(self.floor_x);
        self.radiometer.variance(x, self.radiometer.response.ndl(x), true)
    }

    /// Least and greatest exposure that noise carries to no end of the range, twice as far as [`Class::Good`] asks: such
    /// readings are unbiased also where another reading of the pixel chose them.
    pub(super) fn sure_x(&self) -> (f64, f64) {
        let sure = |d: &&Detail| {
            let reach = 2.0 * SAFE_SIGMA * d.var.sqrt();
            d.x - reach >= self.floor_x && d.x + reach < self.top_x
        };
        let mut x = self.details.iter().filter(sure).map(|d| d.x);
        let least = x.next().unwrap_or(f64::INFINITY);
        (least, x.next_back().unwrap_or(least))
    }

    fn digital_entry(&self, level: usize) -> Entry {
        self.entries.get(level).copied().unwrap_or_default()
    }

    fn digital_detail(&self, level: usize) -> Detail {
        self.details.get(level).copied().unwrap_or(Detail::clipped(Class::Saturated, self.top_x))
    }
}

// === impl Reading ===

impl Reading for u8 {
    #[inline]
    fn entry(self, table: &LevelTable) -> Entry {
        table.digital_entry(usize::from(self))
    }

    fn detail(self, table: &LevelTable) -> Detail {
        table.digital_detail(usize::from(self))
    }

    fn floor_x(table: &LevelTable) -> f64 {
        table.floor_x
    }
}

impl Reading for u16 {
    #[inline]
    fn entry(self, table: &LevelTable) -> Entry {
        table.digital_entry(usize::from(self))
    }

    fn detail(self, table: &LevelTable) -> Detail {
        table.digital_detail(usize::from(self))
    }

    fn floor_x(table: &LevelTable) -> f64 {
        table.floor_x
    }
}

/// NDL of the ideal bench: the same path without quantisation.
impl Reading for f64 {
    fn entry(self, table: &LevelTable) -> Entry {
        Entry::of(&self.detail(table))
    }

    fn detail(self, table: &LevelTable) -> Detail {
        if self.is_nan() || self <= 0.0 {
            return Detail::clipped(Class::Black, 0.0);
        }
        table.radiometer.classify(self, f64::floor_x(table), table.top_x, false)
    }

    fn floor_x(table: &LevelTable) -> f64 {
        table.radiometer.response.exposure(0.0)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    /// The silicon camera of the conventions: 18 ke at NDL = 1, 10 e read noise, 8 bit.
    pub(crate) fn ccd() -> Radiometer {
        Radiometer {
            response: Response::paper(),
            convention: LevelConvention::BinCentre,
            levels: 256,
            noise: Noise { electrons_at_unit_exposure: 1767.5, read_noise_e: 10.0 },
            residual_ndl: 0.001,
        }
    }

    /// The InGaAs camera: linear, 12 bit.
    pub(crate) fn ingaas() -> Radiometer {
        Radiometer {
            response: Response::Linear,
            levels: 4096,
            noise: Noise { electrons_at_unit_exposure: 240_000.0, read_noise_e: 150.0 },
            ..ccd()
        }
    }

    /// Noisy levels: Gaussian shot and read noise from a small generator.
    pub fn noisy(r: &Radiometer, x: f64, seed: &mut u64) -> u16 {
        let mut uniform = || {
            *seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            ((*seed >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
        };
        let normal = (-2.0 * uniform().ln()).sqrt() * (std::f64::consts::TAU * uniform()).cos();
        let e1 = r.noise.electrons_at_unit_exposure;
        let e = x * e1 + normal * (x * e1 + r.noise.read_noise_e.powi(2)).sqrt();
        let level = (f64::from(r.levels) * r.response.ndl((e / e1).max(0.0))).floor();
        level.clamp(0.0, f64::from(r.levels - 1)) as u16
    }

    #[test]
    fn ends_of_the_range_have_no_weight() {
        for radiometer in [ccd(), ingaas()] {
            let table = LevelTable::of(radiometer).unwrap();
            let top = u16::try_from(radiometer.levels - 1).unwrap();
            for level in [0, 1, top - 1, top, u16::MAX] {
                assert_eq!(level.entry(&table), Entry::default(), "level {level}");
            }
            assert!((top / 2).entry(&table).w > 0.0);
            assert_eq!(0_u16.detail(&table).class, Class::Black);
            assert_eq!(1_u16.detail(&table).class, Class::Low);
        }
        assert!(0.5_f64.entry(&LevelTable::of(ccd()).unwrap()).w > 0.0);
    }

    /// One-pixel noise of the exposure ladder, physics 2.1: at N = 0.684 the half level is 0.59 % of L and the
    /// standard deviation of one pixel, read at x(N), 1.17 % with shot noise of 18 ke at N = 1.
    #[test]
    fn one_pixel_noise_is_that_of_the_ladder_table() {
        let r = ccd();
        for (n, percent) in [(0.684, 1.17), (0.484, 1.66), (0.332, 2.36), (0.218, 3.40), (0.132, 4.99)] {
            let x = r.response.exposure(n);
            let sd = 100.0 * r.variance(x, n, true).sqrt() / x;
            assert!((sd / percent - 1.0).abs() < 0.05, "N = {n}: {sd} %, table {percent} %");
        }
    }

    #[test]
    fn levels_and_sums_agree() {
        let table = LevelTable::of(ccd()).unwrap();
        let (e, d) = (100_u8.entry(&table), 100_u8.detail(&table));
        assert!((e.wx / e.w / Response::paper().exposure(100.5 / 256.0) - 1.0).abs() < 1e-12);
        assert!((1.0 / e.w / d.var - 1.0).abs() < 1e-12);
        assert!((e.wxs / e.wx / Response::paper().sensitivity(100.5 / 256.0) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn impossible_cameras_are_refused() {
        assert!(LevelTable::of(Radiometer { levels: 1, ..ccd() }).is_err());
        let noise = Noise { electrons_at_unit_exposure: 0.0, read_noise_e: 1.0 };
        assert!(LevelTable::of(Radiometer { noise, ..ccd() }).unwrap_err().to_string().contains("must be positive"));
    }
}
