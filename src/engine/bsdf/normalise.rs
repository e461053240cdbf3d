//! Eq. (1): BSDF = L/E, as the ratio to a known diffuser or with the irradiance known.

use super::budget::{Budget, PatchBsdf};
use super::patches::PatchMean;
use crate::error::EngineError;

/// What the ratio to a diffuser needs, for one channel of one band.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RatioTerms {
    /// BSDF of the diffuser for this reading, rho_k / pi in 1/sr (`Kernel::mean` of its spectrum over pi).
    pub reference_bsdf: f64,
    /// Relative standard uncertainty of it.
    pub reference_relative_u: f64,
    /// Incident polar angle at which the diffuser was photographed, radians.
    pub reference_theta: f64,
    /// Incident polar angle of the sample view, radians.
    pub theta: f64,
    /// Standard uncertainty of incident angles, radians.
    pub theta_u: f64,
    /// Relative standard uncertainty of the lamp between sample and (interpolated) reference.
    pub drift_relative_u: f64,
}

/// What the absolute mode needs, for one channel of one band.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AbsoluteTerms {
    /// 1/h of eq. (11)/(13): `kernels::one_over_h`, in 1/(uJ/(cm2 sr)).
    pub one_over_h: f64,
    /// Irradiance through the filter at normal incidence, `kernels::irradiance`, in uW/cm2.
    pub irradiance: f64,
    /// Relative standard uncertainty of responsivity and irradiance together.
    pub scale_relative_u: f64,
    /// Relative standard uncertainty of VC.
    pub vignetting_relative_u: f64,
    /// Incident polar angle, radians.
    pub theta: f64,
    /// Standard uncertainty of it, radians.
    pub theta_u: f64,
    /// Relative standard uncertainty of the lamp since the irradiance was measured.
    pub drift_relative_u: f64,
}

/// Correlation of the response's residual between two brackets.
const SHARED_LEVELS: f64 = 0.5;

/// Ratio mode: BSDF = (X_sample / X_reference) BSDF_ref cos(theta_ref) / cos(theta_i), patch by patch. Mirror, lens,
/// responsivity and irradiance cancel. A patch without a positive reference is unknown.
///
/// The response residual is one error of one curve: where sample and reference were read at the same level it
/// cancels. Two brackets share their levels
/// only in part: of the effects a and b half is taken as common.
///
/// # Errors
/// Lists of different length; grazing or backward incidence; a reference BSDF that is not positive.
pub fn ratio(sample: &[PatchMean], reference: &[PatchMean], terms: &RatioTerms) -> Result<Vec<PatchBsdf>, EngineError> {
    if sample.len() != reference.len() {
        let what = "the reference view";
        return Err(EngineError::Length { what, expected: sample.len(), got: reference.len() });
    }
    let cos_ratio = positive_cos("reference_theta", terms.reference_theta)? / positive_cos("theta", terms.theta)?;
    if terms.reference_bsdf.is_nan() || terms.reference_bsdf <= 0.0 {
        let allowed = "the diffuser must scatter";
        return Err(EngineError::Parameter { name: "reference_bsdf", value: terms.reference_bsdf, allowed });
    }
    let scale = terms.reference_bsdf * cos_ratio;
    Ok(sample.iter().zip(reference).map(|(s, r)| ratio_patch(s, r, scale, terms)).collect())
}

fn ratio_patch(s: &PatchMean, r: &PatchMean, scale: f64, terms: &RatioTerms) -> PatchBsdf {
    if r.rate.is_nan() || r.rate <= 0.0 {
        return PatchBsdf::nothing();
    }
    let k = scale / r.rate;
    let bsdf = k * s.rate;
    let (a, b) = (s.u_response * k, r.u_response / r.rate * bsdf);
    let incidence = (terms.theta.tan() * terms.theta_u).hypot(terms.reference_theta.tan() * terms.theta_u);
    let geometry = [0, 1, 2].map(|i| k * s.u_geometry[i] - bsdf * r.u_geometry[i] / r.rate);
    let budget = Budget {
        random: (k * s.u_random).hypot(bsdf * r.u_random / r.rate),
        floor: (k * s.u_floor).hypot(bsdf * r.u_floor / r.rate),
        // one dark rate under both views
        dark: (k * s.u_dark - bsdf * r.u_dark / r.rate).abs(),
        response: (a * a + b * b - 2.0 * SHARED_LEVELS * a * b).max(0.0).sqrt(),
        scale: bsdf * terms.reference_relative_u,
        drift: bsdf * terms.drift_relative_u,
        geometry,
        incidence: bsdf * incidence,
        vignetting: 0.0,
        spectral: 0.0,
        missing: k * (s.lower_bound - s.rate).max(0.0),
    };
    finish(s, k, budget)
}

/// Absolute mode: L = X h, eq. (12) with 1/h of eq. (13), BSDF = L / (E cos theta_i).
///
/// # Errors
/// Grazing or backward incidence; a responsivity or irradiance that is not positive.
pub fn absolute(sample: &[PatchMean], terms: &AbsoluteTerms) -> Result<Vec<PatchBsdf>, EngineError> {
    let cos = positive_cos("theta", terms.theta)?;
    for (name, value) in [("one_over_h", terms.one_over_h), ("irradiance", terms.irradiance)] {
        if !(value > 0.0 && value.is_finite()) {
            return Err(EngineError::Parameter { name, value, allowed: "it must be positive" });
        }
    }
    let k = 1.0 / (terms.one_over_h * terms.irradiance * cos);
    let patch = |s: &PatchMean| {
        let bsdf = k * s.rate;
        let budget = Budget {
            random: k * s.u_random,
            floor: k * s.u_floor,
            dark: k * s.u_dark,
            response: k * s.u_response,
            scale: bsdf * terms.scale_relative_u,
            drift: bsdf * terms.drift_relative_u,
            geometry: s.u_geometry.map(|g| k * g),
            incidence: bsdf * terms.theta.tan() * terms.theta_u,
            vignetting: bsdf * terms.vignetting_relative_u,
            spectral: 0.0,
            missing: k * (s.lower_bound - s.rate).max(0.0),
        };
        finish(s, k, budget)
    };
    Ok(sample.iter().map(patch).collect())
}

fn finish(s: &PatchMean, k: f64, budget: Budget) -> PatchBsdf {
    let known = !s.rate.is_nan();
    PatchBsdf {
        bsdf: k * s.rate,
        budget: if known { budget } else { Budget::default() },
        coverage: s.coverage(),
        below_floor: s.below_floor,
        missing: s.missing,
        max: k * s.max,
        lower_bound: k * s.lower_bound,
    }
}

fn positive_cos(name: &'static str, theta: f64) -> Result<f64, EngineError> {
    let cos = theta.cos();
    if cos > 1e-6 {
        return Ok(cos);
    }
    Err(EngineError::Parameter { name, value: theta, allowed: "incidence must be below 90 degrees" })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use std::f64::consts::PI;

    fn patch(rate: f64) -> PatchMean {
        PatchMean { rate, lower_bound: rate, measured: 1.0, max: rate, u_response: 0.01 * rate, ..PatchMean::nothing() }
    }

    const TERMS: RatioTerms = RatioTerms {
        reference_bsdf: 0.99 / PI,
        reference_relative_u: 0.005,
        reference_theta: 0.0,
        theta: 0.0,
        theta_u: 0.0,
        drift_relative_u: 0.003,
    };

    #[test]
    fn a_view_of_the_reference_is_the_reference() {
        let bsdf = ratio(&[patch(40.0)], &[patch(40.0)], &TERMS).unwrap()[0];
        assert!((bsdf.bsdf - 0.99 / PI).abs() < 1e-15);
        // Both readings feel 1 % and half of it is common: sqrt(1 + 1 - 2 * 0.5) %.
        assert!((bsdf.budget.response / bsdf.bsdf - 0.01).abs() < 1e-12);
        assert!((bsdf.budget.total() / bsdf.bsdf - 0.005_f64.hypot(0.003).hypot(0.01)).abs() < 1e-12);
        assert_eq!(bsdf.value().coverage, 1.0);
    }

    #[test]
    fn oblique_incidence_divides_by_its_cosine_and_feels_the_angle() {
        let terms = RatioTerms { theta: 60_f64.to_radians(), theta_u: 0.001, ..TERMS };
        let bsdf = ratio(&[patch(20.0)], &[patch(40.0)], &terms).unwrap()[0];
        assert!((bsdf.bsdf - 0.99 / PI).abs() < 1e-12);
        assert!((bsdf.budget.incidence / bsdf.bsdf - 3.0_f64.sqrt() * 0.001).abs() < 1e-12);
    }

    /// A signal of h exposures per radiance and cos: absolute mode returns L/E.
    #[test]
    fn absolute_mode_is_radiance_over_irradiance() {
        let terms = AbsoluteTerms {
            one_over_h: 8.0,
            irradiance: 50.0,
            scale_relative_u: 0.03,
            vignetting_relative_u: 0.01,
            theta: 0.5,
            theta_u: 0.0,
            drift_relative_u: 0.0,
        };
        let radiance = 0.2 * 50.0 * 0.5_f64.cos();
        let bsdf = absolute(&[patch(8.0 * radiance)], &terms).unwrap()[0];
        assert!((bsdf.bsdf - 0.2).abs() < 1e-14);
        assert!((bsdf.budget.vignetting - 0.002).abs() < 1e-14);
        assert!((bsdf.budget.total() / 0.2 - (0.0009_f64 + 0.0001 + 0.0001).sqrt()).abs() < 1e-12);
        assert!(absolute(&[], &AbsoluteTerms { irradiance: 0.0, ..terms }).is_err());
    }

    #[test]
    fn what_was_not_measured_stays_unknown() {
        let b = ratio(&[patch(1.0), PatchMean::nothing()], &[PatchMean::nothing(), patch(1.0)], &TERMS).unwrap();
        assert!(b.iter().all(|p| p.bsdf.is_nan() && p.coverage == 0.0 && p.value().u.is_nan()));
        assert!(ratio(&[patch(1.0)], &[], &TERMS).is_err());
        let grazing = RatioTerms { theta: PI / 2.0, ..TERMS };
        assert!(ratio(&[patch(1.0)], &[patch(1.0)], &grazing).unwrap_err().to_string().contains("below 90"));
    }
}
