//! Random numbers that depend on what they are for and on nothing else: a hash of (seed, stream, frame, pixel), so
//! results do not depend on threads or order.

use std::sync::OnceLock;

const GOLDEN: u64 = 0x9E37_79B9_7F4A_7C15;
const NORMALS: usize = 1 << 16;

/// A key for one purpose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Key(u64);

/// Table of the inverse normal distribution, one entry a bin of probability 2^-16.
#[derive(Debug)]
pub struct Normals(Vec<f32>);

// === impl Key ===

impl Key {
    /// The key of a seed.
    pub fn new(seed: u64) -> Key {
        Key(mix(seed ^ GOLDEN))
    }

    /// A key for a part of this purpose.
    pub fn with(self, part: u64) -> Key {
        Key(mix(self.0.wrapping_mul(GOLDEN) ^ mix(part.wrapping_add(GOLDEN))))
    }

    /// A key for a named part.
    pub fn named(self, name: &str) -> Key {
        name.bytes().fold(self, |key, byte| key.with(u64::from(byte)))
    }

    /// 64 random bits for counter `i`.
    #[inline]
    pub fn bits(self, i: u64) -> u64 {
        mix(self.0.wrapping_add(i.wrapping_mul(GOLDEN)))
    }

    /// A standard normal number for counter `i`.
    pub fn normal(self, i: u64) -> f64 {
        f64::from(normals().of(self.bits(i)))
    }

    /// A number from 0 to 1 for counter `i`.
    pub fn uniform(self, i: u64) -> f64 {
        (self.bits(i) >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Finaliser with two multiplications: every input bit reaches every output bit.
#[inline]
fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 32)).wrapping_mul(0xD6E8_FEB8_6659_FD93);
    z = (z ^ (z >> 32)).wrapping_mul(0xD6E8_FEB8_6659_FD93);
    z ^ (z >> 32)
}

// === impl Normals ===

impl Normals {
    /// A standard normal number of 64 random bits (the top 16 are used).
    #[inline]
    pub fn of(&self, bits: u64) -> f32 {
        self.0[(bits >> 48) as usize]
    }

    /// Integrates exp(-x^2/2) in small steps and notes the mean x of each bin; scaled to variance one.
    fn build() -> Normals {
        let (step, reach) = (1e-5, 6.0);
        let total = (2.0 * std::f64::consts::PI).sqrt();
        let mut table = vec![0.0f64; NORMALS];
        let (mut x, mut mass, mut bin) = (-reach, 0.0, 0usize);
        while bin < NORMALS / 2 {
            let middle = (bin as f64 + 0.5) / NORMALS as f64;
            while mass < middle {
                let at: f64 = x + 0.5 * step;
                mass += step * (-0.5 * at * at).exp() / total;
                x += step;
            }
            table[bin] = x;
            table[NORMALS - 1 - bin] = -x;
            bin += 1;
        }
        let variance = table.iter().map(|v| v * v).sum::<f64>() / NORMALS as f64;
        Normals(table.iter().map(|v| (v / variance.sqrt()) as f32).collect())
    }
}

/// The table, made once.
pub fn normals() -> &'static Normals {
    static TABLE: OnceLock<Normals> = OnceLock::new();
    TABLE.get_or_init(Normals::build)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_numbers_have_mean_zero_variance_one_and_tails() {
        let key = Key::new(7).named("test");
        let n = 200_000;
        let values: Vec<f64> = (0..n).map(|i| key.normal(i)).collect();
        let mean = values.iter().sum::<f64>() / n as f64;
        let variance = values.iter().map(|v| v * v).sum::<f64>() / n as f64;
        let beyond_two = values.iter().filter(|v| v.abs() > 2.0).count() as f64 / n as f64;
        assert!(mean.abs() < 0.01, "{mean}");
        assert!((variance - 1.0).abs() < 0.012, "{variance}");
        assert!((beyond_two - 0.0455).abs() < 0.002, "{beyond_two}");
    }

    #[test]
    fn neighbouring_counters_and_frames_are_independent() {
        let (a, b) = (Key::new(1).with(10), Key::new(1).with(11));
        let n = 50_000;
        let lag: f64 = (0..n).map(|i| a.normal(i) * a.normal(i + 1)).sum::<f64>() / n as f64;
        let cross: f64 = (0..n).map(|i| a.normal(i) * b.normal(i)).sum::<f64>() / n as f64;
        assert!(lag.abs() < 0.02 && cross.abs() < 0.02, "{lag} {cross}");
    }
}
