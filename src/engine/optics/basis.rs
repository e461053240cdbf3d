//! Angle bases: the hemisphere cut into rings of equal patches (LBNL Klems Full, Half, Quarter).

use super::direction::Direction;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// One ring of patches between two polar angles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Ring {
    /// Lower bound in degrees.
    pub lower_deg: f64,
    /// Upper bound in degrees.
    pub upper_deg: f64,
    /// Patches around; patch k is centred on phi = 360 k / patches.
    pub patches: usize,
}

/// A basis: rings from the normal outward. Patches are counted from theta 0 outward, then phi 0 upward.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AngleBasis {
    /// Name as the files write it.
    pub name: String,
    /// The rings.
    pub rings: Vec<Ring>,
}

// === impl Ring ===

impl Ring {
    /// Nominal polar angle in degrees: the middle, 0 for the cap.
    pub fn nominal_deg(&self) -> f64 {
        if self.lower_deg == 0.0 { 0.0 } else { 0.5 * (self.lower_deg + self.upper_deg) }
    }

    /// Projected solid angle of one of its patches, sr.
    pub fn projected_solid_angle(&self) -> f64 {
        let s = |deg: f64| deg.to_radians().sin().powi(2);
        PI * (s(self.upper_deg) - s(self.lower_deg)) / self.patches as f64
    }
}

// === impl AngleBasis ===

impl AngleBasis {
    fn of(name: &str, bounds: &[f64], patches: &[usize]) -> AngleBasis {
        let rings = patches
            .iter()
            .zip(bounds.windows(2))
            .map(|(&patches, b)| Ring { lower_deg: b[0], upper_deg: b[1], patches })
            .collect();
        AngleBasis { name: name.to_owned(), rings }
    }

    /// LBNL/Klems Full, 145 patches.
    pub fn klems_full() -> AngleBasis {
        AngleBasis::of(
            "LBNL/Klems Full",
            &[0.0, 5.0, 15.0, 25.0, 35.0, 45.0, 55.0, 65.0, 75.0, 90.0],
            &[1, 8, 16, 20, 24, 24, 24, 16, 12],
        )
    }

    /// LBNL/Klems Half, 77 patches.
    pub fn klems_half() -> AngleBasis {
        AngleBasis::of("LBNL/Klems Half", &[0.0, 6.5, 19.5, 32.5, 45.5, 58.5, 71.5, 90.0], &[1, 8, 12, 16, 20, 12, 8])
    }

    /// LBNL/Klems Quarter, 41 patches.
    pub fn klems_quarter() -> AngleBasis {
        AngleBasis::of("LBNL/Klems Quarter", &[0.0, 9.0, 27.0, 45.0, 63.0, 90.0], &[1, 8, 12, 12, 8])
    }

    /// Number of patches.
    pub fn len(&self) -> usize {
        self.rings.iter().map(|r| r.patches).sum()
    }

    /// True without patches.
    pub fn is_empty(&self) -> bool {
        self.rings.is_empty()
    }

    /// Ring and place in the ring of patch `index`; `None` past the end.
    pub fn place(&self, index: usize) -> Option<(usize, usize)> {
        let mut first = 0;
        for (r, ring) in self.rings.iter().enumerate() {
            if index < first + ring.patches {
                return Some((r, index - first));
            }
            first += ring.patches;
        }
        None
    }

    /// Index of patch `k` of ring `ring`.
    pub fn index(&self, ring: usize, k: usize) -> usize {
        self.rings[..ring].iter().map(|r| r.patches).sum::<usize>() + k
    }

    /// Nominal direction (centre) of patch `index`; `None` past the end.
    pub fn centre(&self, index: usize) -> Option<Direction> {
        let (r, k) = self.place(index)?;
        let ring = &self.rings[r];
        Some(Direction::from_degrees(ring.nominal_deg(), 360.0 * k as f64 / ring.patches as f64))
    }

    /// Patch that a direction falls in; `None` below the horizon.
    pub fn patch_of(&self, d: Direction) -> Option<usize> {
        let theta = d.theta.to_degrees();
        let r = self.rings.iter().position(|ring| theta < ring.upper_deg).or_else(|| {
            let last = self.rings.last()?;
            (theta <= last.upper_deg).then_some(self.rings.len() - 1)
        })?;
        let n = self.rings[r].patches;
        let k = ((d.phi.rem_euclid(TAU) / TAU * n as f64) + 0.5).floor() as usize % n;
        Some(self.index(r, k))
    }

    /// Projected solid angle of every patch, sr; the sum is pi.
    pub fn projected_solid_angles(&self) -> Vec<f64> {
        self.rings.iter().flat_map(|r| std::iter::repeat_n(r.projected_solid_angle(), r.patches)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bases_have_their_patches_and_sum_to_pi() {
        for (basis, n) in
            [(AngleBasis::klems_full(), 145), (AngleBasis::klems_half(), 77), (AngleBasis::klems_quarter(), 41)]
        {
            assert_eq!(basis.len(), n);
            let sum: f64 = basis.projected_solid_angles().iter().sum();
            assert!((sum - PI).abs() < 1e-14);
            for i in 0..n {
                assert_eq!(basis.centre(i).and_then(|d| basis.patch_of(d)), Some(i));
            }
        }
        let full = AngleBasis::klems_full().projected_solid_angles();
        for (i, quoted) in [(0, 0.023864), (1, 0.023323), (9, 0.021916), (25, 0.023622), (133, 0.017537)] {
            assert!((full[i] - quoted).abs() < 1e-6);
        }
    }
}
