//! From exposure to digital level: shot and read noise in electrons, response by a fine table, quantisation.

use super::config::{CameraFile, ResponseFile};
use super::draw::CameraDraw;
use super::rng::{Key, normals};

/// The sensor behind the lens.
#[derive(Debug, Clone)]
pub struct Sensor {
    response: ResponseFile,
    draw: CameraDraw,
    levels: f64,
    electrons: f64,
    read_noise_e: f64,
    /// Dark signal, relative exposure per second.
    pub dark_per_s: f64,
    noisy: bool,
    /// Level (unrounded) over sqrt(x), uniform.
    table: Vec<f64>,
    per_root: f64,
    /// Below it the level is surely 0.
    x_black: f64,
}

const STEPS: usize = 4096;

// === impl ResponseFile ===

impl ResponseFile {
    /// NDL of relative exposure `x`, eq. (4) or a straight line; not clamped.
    pub fn ndl(&self, x: f64) -> f64 {
        match *self {
            ResponseFile::Linear { slope } => slope * x,
            ResponseFile::Logistic { a, .. } if x <= 0.0 => a,
            ResponseFile::Logistic { a, b, c, d } => a + b / (1.0 + (x / c).powf(d)),
        }
    }
}

// === impl Sensor ===

impl Sensor {
    /// The sensor of `file`; without noise on an ideal bench.
    pub fn new(file: &CameraFile, draw: CameraDraw, ideal: bool) -> Sensor {
        let response = file.response;
        let ndl = |x: f64| {
            let n = response.ndl(x);
            n + draw.response_residual(n)
        };
        let mut x_full = 1.0;
        while ndl(x_full) < 1.0 && x_full < 1e9 {
            x_full *= 1.05;
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if ndl(middle) * f64::from(file.levels()) < 1.0 { low = middle } else { high = middle }
        }
        let root = x_full.sqrt();
        let levels = f64::from(file.levels());
        let step = root / STEPS as f64;
        Sensor {
            response,
            draw,
            levels,
            electrons: file.electrons_at_unit_exposure,
            read_noise_e: file.read_noise_e,
            dark_per_s: file.dark_per_s,
            noisy: !ideal,
            table: (0..=STEPS).map(|i| levels * ndl((i as f64 * step).powi(2))).collect(),
            per_root: 1.0 / step,
            x_black: low,
        }
    }

    /// NDL without noise and without quantisation; clamped to nothing.
    pub fn ndl(&self, x: f64) -> f64 {
        let n = self.response.ndl(x);
        n + self.draw.response_residual(n)
    }

    /// Standard deviation of `x` by shot and read noise.
    #[inline]
    pub fn sigma(&self, x: f64) -> f64 {
        (x.max(0.0) * self.electrons + self.read_noise_e * self.read_noise_e).sqrt() / self.electrons
    }

    /// Level of exposure `x` without noise: floor(levels NDL), clamped.
    #[inline]
    pub fn level(&self, x: f64) -> u16 {
        let t = x.max(0.0).sqrt() * self.per_root;
        let i = t as usize;
        let raw = match (self.table.get(i), self.table.get(i + 1)) {
            (Some(low), Some(high)) => low + (t - i as f64) * (high - low),
            _ => self.levels,
        };
        raw.clamp(0.0, self.levels - 1.0) as u16
    }

    /// Levels of a row of exposures; `key` belongs to this frame, `first` is the index of the row's first pixel.
    pub fn expose_row(&self, exposures: &[f64], key: Key, first: usize, mut put: impl FnMut(usize, u16)) {
        let table = normals();
        for (i, &x) in exposures.iter().enumerate() {
            if !self.noisy {
                put(i, self.level(x));
                continue;
            }
            let sigma = self.sigma(x);
            if x + 5.0 * sigma < self.x_black {
                put(i, 0);
                continue;
            }
            let noise = f64::from(table.of(key.bits((first + i) as u64)));
            put(i, self.level(x + sigma * noise));
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::test_bench;

    #[test]
    fn the_table_reproduces_the_curve() {
        let file = test_bench::file(true);
        for camera in file.camera.values() {
            let draw = CameraDraw::new(&file.deviation, 1, "ccd");
            let sensor = Sensor::new(camera, draw, true);
            for i in 1..2000 {
                let x = 10.0 * (f64::from(i) / 2000.0).powi(2);
                let exact = sensor.levels * sensor.ndl(x);
                let t = x.sqrt() * sensor.per_root;
                let k = t as usize;
                if k + 1 < sensor.table.len() && exact > 0.0 {
                    let by_table = sensor.table[k] + (t - k as f64) * (sensor.table[k + 1] - sensor.table[k]);
                    assert!((by_table - exact).abs() < 1e-4, "{x}: {by_table} {exact}");
                }
            }
        }
    }

    /// f(1) = 0.3 exactly with c'; black end and saturation of the printed curve (x = 0.0521 and 10.098) times c'/c.
    #[test]
    fn the_ccd_curve_has_its_known_points() {
        let file = test_bench::file(true);
        let sensor = Sensor::new(&file.camera["ccd"], CameraDraw::new(&file.deviation, 1, "ccd"), true);
        assert!((sensor.ndl(1.0) - 0.3).abs() < 1e-7, "{}", sensor.ndl(1.0));
        let shift = 1.5177818 / 1.4468;
        assert!(sensor.ndl(0.0520 * shift) < 0.0 && sensor.ndl(0.0522 * shift) > 0.0);
        assert_eq!(sensor.level(0.0557 * shift), 0);
        assert_eq!(sensor.level(0.0561 * shift), 1);
        assert_eq!(sensor.level(10.08 * shift), 254);
        assert_eq!(sensor.level(10.11 * shift), 255);
        assert_eq!(sensor.level(1e4), 255);
    }
}
