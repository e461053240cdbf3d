//! The true answers: patch means and hemispherical values of a sample under a spectral weight, without any pixel.

use super::law::Emission;
use super::sample::Sample;
use super::spectrum::Curve;
use super::vector::{Side, V3};
use std::f64::consts::{PI, TAU};

/// A patch between two polar angles, centred on an azimuth (file coordinates of the emergent side).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    /// Lower polar angle.
    pub theta_low_deg: f64,
    /// Upper polar angle.
    pub theta_high_deg: f64,
    /// Azimuth of the middle.
    pub phi_deg: f64,
    /// Width in azimuth, 360 for a cap.
    pub phi_width_deg: f64,
}

/// Incidence: theta from the normal on the source's side, phi azimuth of the vector to the source (degrees).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Incidence {
    /// Hemisphere pair.
    pub side: Side,
    /// Polar angle.
    pub theta_deg: f64,
    /// Azimuth.
    pub phi_deg: f64,
}

/// The true values of one sample under a beam of given half angle.
#[derive(Debug, Clone)]
pub struct Expectation<'a> {
    sample: &'a Sample,
    half_angle: f64,
}

/// Cells along each coordinate of a patch.
const CELLS: usize = 96;

// === impl Patch ===

impl Patch {
    /// Projected solid angle, sr.
    pub fn projected(&self) -> f64 {
        let (low, high) = self.sin2();
        PI * (high - low) * self.phi_width_deg / 360.0
    }

    fn sin2(&self) -> (f64, f64) {
        (self.theta_low_deg.to_radians().sin().powi(2), self.theta_high_deg.to_radians().sin().powi(2))
    }

    fn holds(&self, u: V3) -> bool {
        let (low, high) = self.sin2();
        let sin2 = u.x * u.x + u.y * u.y;
        let away = (u.y.atan2(u.x) - self.phi_deg.to_radians() + PI).rem_euclid(TAU) - PI;
        (low..high).contains(&sin2) && away.abs() <= 0.5 * self.phi_width_deg.to_radians() + 1e-12
    }
}

// === impl Expectation ===

impl<'a> Expectation<'a> {
    /// True values of `sample` under a beam of `half_angle_deg`.
    pub fn new(sample: &'a Sample, half_angle_deg: f64) -> Expectation<'a> {
        Expectation { sample, half_angle: half_angle_deg.to_radians() }
    }

    /// Mean BSDF (1/sr, weighted with projected solid angle) over a patch; `weights` are (nm, weight) pairs.
    pub fn patch_mean(&self, incidence: Incidence, patch: &Patch, weights: &[(f64, f64)]) -> f64 {
        self.sum(incidence, weights, |emission| match emission {
            Emission::Disc(disc) => {
                let inside: f64 = disc.points().iter().filter(|(u, _)| patch.holds(*u)).map(|p| p.1).sum();
                inside / patch.projected()
            }
            other => grid_mean(other, patch, incidence.side.emergent_sign()),
        })
    }

    /// Direct-hemispherical value.
    pub fn hemispherical(&self, incidence: Incidence, weights: &[(f64, f64)]) -> f64 {
        self.sum(incidence, weights, Emission::hemispherical)
    }

    fn sum(&self, incidence: Incidence, weights: &[(f64, f64)], value: impl Fn(&Emission) -> f64) -> f64 {
        let s = incidence.side.source_vector(incidence.theta_deg, incidence.phi_deg);
        let components = self.sample.components.iter().filter(|c| c.sides.contains(&incidence.side));
        components
            .filter_map(|c| {
                let emission = c.law.emission(incidence.side, s, self.half_angle)?;
                Some(weighted(&c.spectrum, weights) * value(&emission))
            })
            .sum()
    }
}

/// Weighted mean of a curve.
fn weighted(curve: &Curve, weights: &[(f64, f64)]) -> f64 {
    let total: f64 = weights.iter().map(|w| w.1).sum();
    weights.iter().map(|(nm, w)| w * curve.at(*nm)).sum::<f64>() / total
}

/// Mean over cells of equal projected solid angle.
fn grid_mean(emission: &Emission, patch: &Patch, sign: f64) -> f64 {
    let (low, high) = patch.sin2();
    let mut sum = 0.0;
    for i in 0..CELLS {
        let sin2 = low + (high - low) * (i as f64 + 0.5) / CELLS as f64;
        for k in 0..CELLS {
            let turn = (k as f64 + 0.5) / CELLS as f64 - 0.5;
            let phi = (patch.phi_deg + turn * patch.phi_width_deg).to_radians();
            let r = sin2.sqrt();
            sum += emission.at(V3::new(r * phi.cos(), r * phi.sin(), sign * (1.0 - sin2).max(0.0).sqrt()));
        }
    }
    sum / (CELLS * CELLS) as f64
}
