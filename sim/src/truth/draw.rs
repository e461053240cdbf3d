//! How the bench as built differs from its description: drawn once from the seed.

use super::config::{BenchFile, DeviationFile, LampFile};
use super::rng::Key;

/// Deviations of one camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraDraw {
    /// Pointing errors about x and y, radians.
    pub pointing_rad: [f64; 2],
    /// Factor on the responsivity.
    pub responsivity: f64,
    /// Coefficients of the response residual, NDL.
    pub response_ndl: [f64; 2],
    /// Coefficients of the vignetting field.
    pub vignetting: [f64; 4],
}

/// The lamp's factor over time.
#[derive(Debug, Clone)]
pub struct LampDraw {
    amplitude: f64,
    period_s: f64,
    phase: f64,
    walk_per_knot: f64,
    flicker: f64,
    key: Key,
}

const KNOT_S: f64 = 600.0;
const MAX_KNOTS: u64 = 100_000;

/// Factors on the reflecting and the transmitting diffuser.
pub fn reference_factors(file: &BenchFile, seed: u64) -> [f64; 2] {
    let key = Key::new(seed).named("reference");
    [0, 1].map(|i| 1.0 + file.deviation.reference_scale * key.normal(i))
}

// === impl CameraDraw ===

impl CameraDraw {
    /// Draws for the camera `name`.
    pub fn new(deviation: &DeviationFile, seed: u64, name: &str) -> CameraDraw {
        let key = Key::new(seed).named("camera").named(name);
        let pointing = deviation.pointing_deg.to_radians();
        CameraDraw {
            pointing_rad: [0, 1].map(|i| pointing * key.normal(i)),
            responsivity: 1.0 + deviation.responsivity_scale * key.normal(2),
            response_ndl: [3, 4].map(|i| deviation.response_ndl * key.normal(i)),
            vignetting: [5, 6, 7, 8].map(|i| deviation.vignetting * key.normal(i)),
        }
    }

    /// Residual of the response at `ndl`: smooth, zero at both ends.
    pub fn response_residual(&self, ndl: f64) -> f64 {
        let t = std::f64::consts::PI * ndl.clamp(0.0, 1.0);
        self.response_ndl[0] * t.sin() + self.response_ndl[1] * (2.0 * t).sin()
    }

    /// Factor of the vignetting residual at image coordinates (1 = edge of the hemisphere).
    pub fn vignetting_residual(&self, x: f64, y: f64) -> f64 {
        let [a, b, c, d] = self.vignetting;
        1.0 + a * x + b * y + c * (x * x - y * y) + d * 2.0 * x * y
    }
}

// === impl LampDraw ===

impl LampDraw {
    /// The lamp of this seed.
    pub fn new(lamp: &LampFile, seed: u64) -> LampDraw {
        let key = Key::new(seed).named("lamp");
        let period_h = lamp.drift_period_h;
        LampDraw {
            amplitude: lamp.drift_per_hour * period_h / std::f64::consts::TAU,
            period_s: period_h * 3600.0,
            phase: std::f64::consts::TAU * key.uniform(0),
            walk_per_knot: lamp.walk_per_sqrt_hour * (KNOT_S / 3600.0).sqrt(),
            flicker: lamp.flicker,
            key: key.named("walk"),
        }
    }

    /// Slow factor at `seconds` since the bench was opened; 1 at the start.
    pub fn slow(&self, seconds: f64) -> f64 {
        let turn = |s: f64| (std::f64::consts::TAU * s / self.period_s + self.phase).sin();
        let sine = self.amplitude * (turn(seconds) - turn(0.0));
        let knots = (seconds.max(0.0) / KNOT_S).min(MAX_KNOTS as f64);
        let whole = knots.floor() as u64;
        let walked: f64 = if self.walk_per_knot > 0.0 {
            let sum: f64 = (0..whole).map(|i| self.key.normal(i)).sum();
            sum + (knots - knots.floor()) * self.key.normal(whole)
        } else {
            0.0
        };
        1.0 + sine + self.walk_per_knot * walked
    }

    /// Factor of one exposure: slow part at its middle times flicker of this frame.
    pub fn exposure(&self, seconds: f64, camera: &str, frame: u64) -> f64 {
        self.slow(seconds) * (1.0 + self.flicker * self.deviate(camera, frame))
    }

    /// Standard normal number of one exposure.
    pub fn deviate(&self, camera: &str, frame: u64) -> f64 {
        self.key.named(camera).named("flicker").normal(frame)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::test_bench;

    #[test]
    fn the_lamp_starts_at_one_and_drifts_slowly_and_steadily() {
        let file = test_bench::file(false);
        let lamp = LampDraw::new(&file.lamp, 5);
        assert_eq!(lamp.slow(0.0), 1.0);
        let mut largest: f64 = 0.0;
        for minute in 0..840 {
            let (a, b) = (lamp.slow(60.0 * f64::from(minute)), lamp.slow(60.0 * f64::from(minute + 1)));
            // Sine slope 0.004/h and a walk of 0.002/sqrt(h) in knots of 10 minutes, five sigma.
            assert!((a - b).abs() < 0.004 / 60.0 + 5.0 * 0.002 * (1.0f64 / 6.0).sqrt() / 10.0, "{minute}");
            largest = largest.max((a - 1.0).abs());
        }
        assert!((1e-3..0.05).contains(&largest), "{largest}");
        let ideal = LampDraw::new(&test_bench::file(true).lamp, 5);
        assert_eq!(ideal.exposure(30_000.0, "ccd", 7), 1.0);
    }

    #[test]
    fn an_ideal_bench_is_built_to_plan() {
        let file = test_bench::file(true);
        assert_eq!(reference_factors(&file, 9), [1.0, 1.0]);
        let draw = CameraDraw::new(&file.deviation, 9, "ccd");
        assert_eq!(
            (draw.responsivity, draw.response_residual(0.4), draw.vignetting_residual(0.3, 0.2)),
            (1.0, 0.0, 1.0)
        );
        let real = test_bench::file(false);
        assert_ne!(CameraDraw::new(&real.deviation, 9, "ccd"), CameraDraw::new(&real.deviation, 10, "ccd"));
    }
}
