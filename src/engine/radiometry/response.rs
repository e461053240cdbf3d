//! The response NDL = f(x) of eq. (4), its inverse, and the conventions of exposure scale and level.

use serde::{Deserialize, Serialize};

/// Constant a as printed below eq. (4).
pub const A: f64 = -0.13254;
/// Constant b as printed.
pub const B: f64 = 363.51;
/// Constant c as printed; f(1) is then 0.308508, not 0.3.
pub const C: f64 = 1.4468e7;
/// Constant d as printed.
pub const D: f64 = -0.40717;
/// The level at which the paper normalises exposure, NDL = 0.3.
pub const NDL_NORM: f64 = 0.3;

/// NDL as a function of relative exposure x.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Response {
    /// Logistic dose response, eq. (4): NDL = a + b / (1 + (x/c)^d).
    LogisticDoseResponse {
        /// Asymptote a.
        a: f64,
        /// Height b.
        b: f64,
        /// Scale c (printed) or c' = c / g(0.3), which makes f(1) = 0.3.
        c: f64,
        /// Exponent d, negative.
        d: f64,
    },
    /// NDL = 0.3 x.
    Linear,
}

/// Which NDL a digital level stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LevelConvention {
    /// DL / 2^bits.
    BinEdge,
    /// (DL + 0.5) / 2^bits.
    BinCentre,
}

// === impl Response ===

impl Response {
    /// Eq. (4) with the constants as printed; an exposure of one is h* and f(1) = 0.308508.
    pub fn as_printed() -> Response {
        Response::LogisticDoseResponse { a: A, b: B, c: C, d: D }
    }

    /// The same curve with c' = c / g(0.3) = 1.5177818e7, so that f(1) = 0.3 and h is h0.3 as the paper intends.
    pub fn paper() -> Response {
        Response::as_printed().normalised()
    }

    /// The same curve with the exposure scale moved so that f(1) = 0.3 (c' for c).
    pub fn normalised(self) -> Response {
        match self {
            Response::LogisticDoseResponse { a, b, c, d } => {
                Response::LogisticDoseResponse { a, b, c: c / self.exposure(NDL_NORM), d }
            }
            Response::Linear => Response::Linear,
        }
    }

    /// f: NDL at relative exposure `x` >= 0, eq. (4).
    pub fn ndl(&self, x: f64) -> f64 {
        match *self {
            Response::LogisticDoseResponse { a, b, c, d } => a + b / (1.0 + (x / c).powf(d)),
            Response::Linear => NDL_NORM * x,
        }
    }

    /// g: relative exposure at `ndl`, the inverse of eq. (4) as in eq. (5). Zero at and below the lower asymptote a,
    /// infinite at and above the upper one, a + b.
    pub fn exposure(&self, ndl: f64) -> f64 {
        match *self {
            Response::LogisticDoseResponse { a, b, c, d } => {
                let q = b / (ndl - a) - 1.0;
                if ndl <= a {
                    0.0
                } else if q <= 0.0 {
                    f64::INFINITY
                } else {
                    c * q.powf(1.0 / d)
                }
            }
            Response::Linear => ndl / NDL_NORM,
        }
    }

    /// s = d ln x / d NDL at `ndl`: the relative change of exposure for a change of level.
    pub fn sensitivity(&self, ndl: f64) -> f64 {
        match *self {
            Response::LogisticDoseResponse { a, b, d, .. } => {
                let m = ndl - a;
                -(b / d) / (m * m * (b / m - 1.0))
            }
            Response::Linear => 1.0 / ndl,
        }
    }
}

// === impl LevelConvention ===

impl LevelConvention {
    /// NDL that `level` of `levels` (2^bits) stands for.
    pub fn ndl(self, level: u32, levels: u32) -> f64 {
        let offset = match self {
            LevelConvention::BinEdge => 0.0,
            LevelConvention::BinCentre => 0.5,
        };
        (f64::from(level) + offset) / f64::from(levels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn printed_constants_do_not_give_a_level_of_0_3_at_unit_exposure() {
        let f = Response::as_printed();
        assert!((f.ndl(1.0) - 0.308508).abs() < 5e-7);
        assert!((f.exposure(0.3) - 0.953233).abs() < 5e-7);
    }

    #[test]
    fn c_prime_makes_unit_exposure_the_level_0_3() {
        let Response::LogisticDoseResponse { c, .. } = Response::paper() else { unreachable!() };
        assert!((c - 1.5177818e7).abs() < 1.0, "c' = {c}");
        assert!((Response::paper().ndl(1.0) - 0.3).abs() < 1e-12);
        assert!((Response::Linear.ndl(1.0) - 0.3).abs() < 1e-15);
    }

    #[test]
    fn range_ends_are_those_of_the_physics() {
        let f = Response::as_printed();
        assert!((f.exposure(0.0) - 0.0521).abs() < 2e-4, "black {}", f.exposure(0.0));
        let p = Response::paper();
        assert!((p.exposure(1.0) - 10.184).abs() < 0.51, "full {}", p.exposure(1.0));
        assert!((f.exposure(0.95) / f.exposure(0.05) - 79.7).abs() < 0.05);
        assert_eq!(f.exposure(-0.2), 0.0);
        assert_eq!(f.exposure(400.0), f64::INFINITY);
    }

    #[test]
    fn g_inverts_f() {
        for f in [Response::as_printed(), Response::paper(), Response::Linear] {
            for i in 0..400 {
                let x = 0.053 * 1.0135_f64.powi(i);
                assert!((f.exposure(f.ndl(x)) / x - 1.0).abs() < 1e-9, "x = {x}");
            }
        }
    }

    #[test]
    fn sensitivity_is_the_table_of_the_physics() {
        let table = [
            (0.01, 17.2),
            (0.05, 13.46),
            (0.1, 10.57),
            (0.2, 7.39),
            (0.3, 5.69),
            (0.5, 3.89),
            (0.7, 2.96),
            (0.9, 2.39),
            (0.95, 2.28),
        ];
        let f = Response::paper();
        for (n, s) in table {
            let tolerance = if n < 0.02 { 0.06 } else { 0.011 };
            assert!((f.sensitivity(n) - s).abs() < tolerance, "s({n}) = {}", f.sensitivity(n));
            let h = 1e-6;
            let numeric = (f.exposure(n + h).ln() - f.exposure(n - h).ln()) / (2.0 * h);
            assert!((f.sensitivity(n) / numeric - 1.0).abs() < 1e-6);
        }
        assert!((Response::Linear.sensitivity(0.5) - 2.0).abs() < 1e-15);
    }

    #[test]
    fn half_a_level_is_one_percent_at_0_3() {
        let f = Response::paper();
        let edge = f.exposure(LevelConvention::BinEdge.ndl(77, 256));
        let centre = f.exposure(LevelConvention::BinCentre.ndl(77, 256));
        assert!((centre / edge - 1.0 - 0.0111).abs() < 2e-4);
    }
}
