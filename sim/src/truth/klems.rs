//! Klems matrices as a sample's law: bases by the file's own theta bounds, values band means in 1/sr.

use std::f64::consts::{PI, TAU};

/// A basis: rings of equal patches, patch k centred on phi = 360 k / n.
#[derive(Debug, Clone, PartialEq)]
pub struct Basis {
    rings: Vec<Ring>,
}

/// One ring.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Ring {
    sin2_upper: f64,
    patches: usize,
    first: usize,
    projected: f64,
}

/// A matrix of one block.
#[derive(Debug, Clone, PartialEq)]
pub struct Matrix {
    /// Basis of rows (outgoing).
    pub rows: Basis,
    /// Basis of columns (incident).
    pub columns: Basis,
    /// Values, row by row.
    pub values: Vec<f64>,
}

// === impl Basis ===

impl Basis {
    /// A basis of (lower, upper, patches) in degrees; says what is wrong with them.
    pub fn new(bounds: &[(f64, f64, usize)]) -> Result<Basis, String> {
        let (mut rings, mut first, mut last) = (Vec::new(), 0, 0.0);
        for &(lower, upper, patches) in bounds {
            if (lower - last).abs() > 1e-6 || upper <= lower || upper > 90.0 + 1e-9 || patches == 0 {
                return Err(format!("ring {lower}-{upper} degrees with {patches} patches does not follow {last}"));
            }
            let sin2 = |deg: f64| deg.to_radians().sin().powi(2);
            let projected = PI * (sin2(upper) - sin2(lower)) / patches as f64;
            rings.push(Ring { sin2_upper: sin2(upper), patches, first, projected });
            first += patches;
            last = upper;
        }
        if (last - 90.0).abs() > 1e-6 {
            return Err(format!("the last ring ends at {last} degrees, 90 is needed"));
        }
        Ok(Basis { rings })
    }

    /// Number of patches.
    pub fn len(&self) -> usize {
        self.rings.iter().map(|r| r.patches).sum()
    }

    /// True without patches.
    pub fn is_empty(&self) -> bool {
        self.rings.is_empty()
    }

    /// Patch of in-plane direction cosines (x, y).
    pub fn index(&self, p: [f64; 2]) -> usize {
        let sin2 = p[0] * p[0] + p[1] * p[1];
        let ring = self.rings.iter().find(|r| sin2 < r.sin2_upper).or(self.rings.last());
        let Some(ring) = ring else { return 0 };
        if ring.patches == 1 {
            return ring.first;
        }
        let n = ring.patches as f64;
        let turn = p[1].atan2(p[0]) / TAU * n + 0.5;
        let turn = if turn < 0.0 { turn + n } else { turn };
        ring.first + (turn as usize).min(ring.patches - 1)
    }

    /// Projected solid angle of patch `index`, sr.
    pub fn projected(&self, index: usize) -> f64 {
        self.rings.iter().find(|r| index < r.first + r.patches).map_or(0.0, |r| r.projected)
    }
}

// === impl Matrix ===

impl Matrix {
    /// All outgoing values of the incident patch that holds `p`.
    pub fn column(&self, p: [f64; 2]) -> Vec<f64> {
        let (n, incident) = (self.columns.len(), self.columns.index(p));
        self.values.iter().skip(incident).step_by(n).copied().collect()
    }

    /// All incident values of the outgoing patch that holds `p`.
    pub fn row(&self, p: [f64; 2]) -> Vec<f64> {
        let (n, out) = (self.columns.len(), self.rows.index(p));
        self.values.iter().skip(out * n).take(n).copied().collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn patches_are_centred_and_sum_to_pi() {
        let full = Basis::new(&[
            (0.0, 5.0, 1),
            (5.0, 15.0, 8),
            (15.0, 25.0, 16),
            (25.0, 35.0, 20),
            (35.0, 45.0, 24),
            (45.0, 55.0, 24),
            (55.0, 65.0, 24),
            (65.0, 75.0, 16),
            (75.0, 90.0, 12),
        ])
        .unwrap();
        assert_eq!(full.len(), 145);
        let sum: f64 = (0..145).map(|i| full.projected(i)).sum();
        assert!((sum - PI).abs() < 1e-12);
        let at = |theta: f64, phi: f64| {
            let (t, p) = (theta.to_radians(), phi.to_radians());
            full.index([t.sin() * p.cos(), t.sin() * p.sin()])
        };
        assert_eq!(at(40.0, 90.0), 51);
        assert_eq!(at(30.0, 0.0), 25);
        assert_eq!(at(30.0, 359.0), 25);
        assert_eq!(at(10.0, -22.4), 1);
        assert_eq!(at(10.0, -22.6), 8);
        assert_eq!(at(82.5, 330.0), 144);
    }

    #[test]
    fn a_gap_between_rings_is_told() {
        let wrong = Basis::new(&[(0.0, 5.0, 1), (6.0, 90.0, 4)]);
        assert!(wrong.unwrap_err().contains("does not follow 5"));
    }
}
