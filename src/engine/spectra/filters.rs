//! Filter stacks: transmittance of coloured glasses one behind the other.

use super::curve::{Curve, Grid};

/// One glass of a stack.
#[derive(Debug, Clone, PartialEq)]
pub struct GlassPlate {
    /// Internal transmittance at 1 mm, tau_1(lambda).
    pub tau_1mm: Curve,
    /// Reflection factor P = 2n/(n^2+1) for both faces.
    pub reflection_factor: f64,
    /// Thickness d.
    pub thickness_mm: f64,
}

/// Transmittance of a stack on the grid: product of P tau_1^d over its glasses (1 for no glass). Outside a glass's
/// table its nearest row counts.
pub fn stack_transmittance(grid: &Grid, stack: &[GlassPlate]) -> Vec<f64> {
    let mut t = vec![1.0; grid.len];
    for glass in stack {
        for (t, w) in t.iter_mut().zip(grid.wavelengths()) {
            *t *= glass.reflection_factor * glass.tau_1mm.at_clamped(w).max(0.0).powf(glass.thickness_mm);
        }
    }
    t
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::spectra::testdata;

    #[test]
    fn thickness_is_an_exponent() {
        let g = Grid::engine();
        let tau_1mm = Curve::constant(0.5, 300.0, 1700.0).unwrap();
        let plate = GlassPlate { tau_1mm, reflection_factor: 0.9, thickness_mm: 3.0 };
        let t = stack_transmittance(&g, &[plate.clone(), plate]);
        assert!(t.iter().all(|t| (t - (0.9_f64 * 0.125).powi(2)).abs() < 1e-15));
        assert_eq!(stack_transmittance(&g, &[]), vec![1.0; g.len]);
    }

    /// Table 1: at least 5 % of the peak lies only inside the stated interval, give or take the edges of the glasses.
    #[test]
    fn table_1_stacks_pass_their_interval() {
        let g = Grid::engine();
        let lamp = g.sample(&testdata::lamp());
        for (stack, [lo, hi]) in testdata::table_1().iter().zip(testdata::INTERVALS_NM).take(7) {
            let power: Vec<f64> = stack_transmittance(&g, stack).iter().zip(&lamp).map(|(t, e)| t * e).collect();
            let inside: f64 = power.iter().zip(g.interval([lo - 10.0, hi + 10.0])).map(|(p, w)| p * w).sum();
            let ccd: f64 = power.iter().zip(g.interval([360.0, 945.0])).map(|(p, w)| p * w).sum();
            assert!(inside / ccd > 0.9, "{lo}-{hi} nm: {}", inside / ccd);
        }
    }
}
