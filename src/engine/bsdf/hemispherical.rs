//! Direct-hemispherical value of a column: sum of projected solid angle x BSDF, with what is missing told, not
//! hidden.

use super::budget::PatchBsdf;
use crate::error::EngineError;
use crate::optics::basis::AngleBasis;

/// Share of the projected solid angle that may lack before a value is flagged.
const COMPLETE: f64 = 0.999;

/// Direct-hemispherical transmittance or reflectance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hemispherical {
    /// Best estimate; missing parts filled from their neighbours. NaN if nothing was measured.
    pub value: f64,
    /// Standard uncertainty, correlated parts taken as fully correlated, the filled share as wholly unsure.
    pub u: f64,
    /// Only what was measured.
    pub lower_bound: f64,
    /// Share of the projected solid angle that has a value, 0 to 1.
    pub measured: f64,
    /// False if a part of the value was not measured.
    pub complete: bool,
}

/// Sums a column. Patches without value take the mean of their ring, or of the nearest rings, as estimate: it enters
/// the value and, in full, the uncertainty. A partly covered patch counts the same for its uncovered share.
///
/// # Errors
/// As many patches as the basis has are needed.
pub fn hemispherical(basis: &AngleBasis, column: &[PatchBsdf]) -> Result<Hemispherical, EngineError> {
    if column.len() != basis.len() {
        let (expected, got) = (basis.len(), column.len());
        return Err(EngineError::Length { what: "a column of the BSDF", expected, got });
    }
    let lambda = basis.projected_solid_angles();
    let rings = ring_means(basis, column);
    if rings.iter().all(Option::is_none) {
        return Ok(Hemispherical { value: f64::NAN, u: f64::NAN, lower_bound: 0.0, measured: 0.0, complete: false });
    }
    let (mut sum, mut filled, mut weight, mut random) = (0.0, 0.0, 0.0, 0.0);
    let (mut common, mut geometry) = ([0.0; 9], [0.0; 3]);
    for (i, (p, l)) in column.iter().zip(&lambda).enumerate() {
        let ring = basis.place(i).map_or(0, |(r, _)| r);
        let known = if p.bsdf.is_nan() { 0.0 } else { p.coverage.clamp(0.0, 1.0) };
        weight += l * known;
        let elsewhere = nearest(&rings, ring);
        if p.bsdf.is_nan() {
            filled += l * elsewhere;
            continue;
        }
        sum += l * known * p.bsdf;
        filled += l * (1.0 - known) * p.bsdf;
        random += (l * p.budget.random).powi(2);
        for (c, part) in common.iter_mut().zip(p.budget.common()) {
            *c += l * part;
        }
        for (g, part) in geometry.iter_mut().zip(p.budget.geometry) {
            *g += l * part;
        }
    }
    let measured = weight / lambda.iter().sum::<f64>();
    let systematic: f64 = common.iter().chain(&geometry).map(|p| p * p).sum();
    Ok(Hemispherical {
        value: sum + filled,
        u: (random + systematic + filled * filled).sqrt(),
        lower_bound: sum,
        measured,
        complete: measured >= COMPLETE,
    })
}

/// Mean over the known patches of each ring.
fn ring_means(basis: &AngleBasis, column: &[PatchBsdf]) -> Vec<Option<f64>> {
    let mut first = 0;
    let mut means = Vec::with_capacity(basis.rings.len());
    for ring in &basis.rings {
        let known = column.iter().skip(first).take(ring.patches).filter(|p| !p.bsdf.is_nan());
        let (sum, n) = known.fold((0.0, 0.0), |(s, n), p| (s + p.bsdf, n + 1.0));
        means.push((n > 0.0).then(|| sum / n));
        first += ring.patches;
    }
    means
}

/// Mean of the ring, else of the nearest rings that have one.
fn nearest(rings: &[Option<f64>], ring: usize) -> f64 {
    for distance in 0..rings.len() {
        let inner = ring.checked_sub(distance).and_then(|r| rings.get(r).copied().flatten());
        let outer = rings.get(ring + distance).copied().flatten();
        match (inner, outer) {
            (Some(a), Some(b)) => return 0.5 * (a + b),
            (Some(a), None) | (None, Some(a)) => return a,
            (None, None) => {}
        }
    }
    0.0
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::bsdf::budget::Budget;
    use std::f64::consts::PI;

    fn lambertian(t: f64) -> Vec<PatchBsdf> {
        let bsdf = t / PI;
        let budget = Budget { random: 0.01 * bsdf, scale: 0.005 * bsdf, ..Budget::default() };
        vec![PatchBsdf { bsdf, budget, coverage: 1.0, ..PatchBsdf::nothing() }; 145]
    }

    #[test]
    fn a_lambertian_sample_gives_its_transmittance() {
        let h = hemispherical(&AngleBasis::klems_full(), &lambertian(0.4)).unwrap();
        assert!((h.value - 0.4).abs() < 1e-14 && h.complete && (h.lower_bound - 0.4).abs() < 1e-14);
        // scale is common to all patches, noise averages over 145
        let noise = 0.4 * 0.01 / 145_f64.sqrt();
        assert!((h.u / 0.002_f64.hypot(noise) - 1.0).abs() < 0.01, "{}", h.u);
    }

    #[test]
    fn a_missing_ring_is_flagged_estimated_and_unsure() {
        let basis = AngleBasis::klems_full();
        let mut column = lambertian(0.4);
        column[133..].fill(PatchBsdf::nothing());
        let h = hemispherical(&basis, &column).unwrap();
        let share = 75_f64.to_radians().cos().powi(2);
        assert!(!h.complete && (h.measured - (1.0 - share)).abs() < 1e-12);
        assert!((h.lower_bound - 0.4 * (1.0 - share)).abs() < 1e-12);
        assert!((h.value - 0.4).abs() < 1e-12 && h.u >= 0.4 * share);
        let nothing = hemispherical(&basis, &vec![PatchBsdf::nothing(); 145]).unwrap();
        assert!(nothing.value.is_nan() && nothing.u.is_nan());
        assert!(hemispherical(&basis, &column[1..]).is_err());
    }

    /// What one patch loses to a shift its neighbour gains: the sum does not feel it.
    #[test]
    fn geometry_moves_light_but_keeps_the_sum() {
        let basis = AngleBasis::klems_full();
        let mut column = lambertian(0.4);
        column[40].budget.geometry = [0.3, 0.0, 0.0];
        column[41].budget.geometry = [-0.3, 0.0, 0.0];
        let quiet = hemispherical(&basis, &lambertian(0.4)).unwrap().u;
        assert!((hemispherical(&basis, &column).unwrap().u - quiet).abs() < 1e-12);
        assert!(column[40].budget.total() > 0.29);
    }
}
