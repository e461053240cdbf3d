//! What each reading measures: K_k = r E F rho / integral, one kernel for every band and channel (physics 3).

use super::curve::Grid;
use crate::error::EngineError;

/// Normalised spectral weight of one reading on a grid: a reading divided by that of a neutral reference is
/// y = sum K(lambda) S(lambda), and sum K = 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Kernel {
    /// Band it belongs to.
    pub band: String,
    /// Channel of the camera.
    pub channel: usize,
    /// Weights on the grid; their sum is 1.
    pub weights: Vec<f64>,
    /// Integral of r E F rho over wavelength: relative exposure rate per unit of BSDF at normal incidence.
    pub signal: f64,
}

// === impl Kernel ===

impl Kernel {
    /// Kernel of responsivity `r`, lamp `e`, filter stack `f`, mirror `rho`, all on the grid.
    ///
    /// # Errors
    /// A factor of another length than the grid; a product that is zero everywhere.
    pub fn of(grid: &Grid, band: &str, channel: usize, [r, e, f, rho]: [&[f64]; 4]) -> Result<Kernel, EngineError> {
        let product = product(grid, &[r, e, f, rho])?;
        let sum: f64 = product.iter().sum();
        if sum.is_nan() || sum <= 0.0 {
            return Err(EngineError::NoSignal { what: "the product of responsivity, lamp, filter and mirror" });
        }
        let weights = product.iter().map(|p| p / sum).collect();
        Ok(Kernel { band: band.to_owned(), channel, weights, signal: sum * grid.step_nm })
    }

    /// Mean of a spectrum (on the grid) over the kernel: rho_ref,k of the reference for this reading.
    pub fn mean(&self, spectrum: &[f64]) -> f64 {
        self.weights.iter().zip(spectrum).map(|(k, s)| k * s).sum()
    }
}

/// 1/h of eq. (11) and (13): responsivity to a beam of relative spectrum `p` = E F rho, sum of p r / sum of E F. With
/// the mirror in the numerator only, L = X h is the radiance at the sample.
///
/// # Errors
/// A factor of another length than the grid; no light.
pub fn one_over_h(grid: &Grid, [r, e, f, rho]: [&[f64]; 4]) -> Result<f64, EngineError> {
    let signal: f64 = product(grid, &[r, e, f, rho])?.iter().sum();
    let light: f64 = product(grid, &[e, f])?.iter().sum();
    if light > 0.0 && signal > 0.0 {
        Ok(signal / light)
    } else {
        Err(EngineError::NoSignal { what: "the filtered lamp spectrum seen by the camera" })
    }
}

/// Irradiance through the filter at normal incidence, integral of E F, in the unit of E times nm.
///
/// # Errors
/// A factor of another length than the grid.
pub fn irradiance(grid: &Grid, e: &[f64], f: &[f64]) -> Result<f64, EngineError> {
    Ok(product(grid, &[e, f])?.iter().sum::<f64>() * grid.step_nm)
}

fn product(grid: &Grid, factors: &[&[f64]]) -> Result<Vec<f64>, EngineError> {
    let mut out = vec![1.0; grid.len];
    for factor in factors {
        if factor.len() != grid.len {
            let what = "a spectrum on the wavelength grid";
            return Err(EngineError::Length { what, expected: grid.len, got: factor.len() });
        }
        out.iter_mut().zip(factor.iter()).for_each(|(o, f)| *o *= f);
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn a_kernel_is_a_mean() {
        let g = Grid { start_nm: 400.0, step_nm: 10.0, len: 3 };
        let one = [1.0; 3];
        let k = Kernel::of(&g, "f1", 0, [&[0.0, 1.0, 3.0], &[2.0; 3], &one, &one]).unwrap();
        assert_eq!(k.weights, vec![0.0, 0.25, 0.75]);
        assert!((k.signal - 80.0).abs() < 1e-12);
        assert!((k.mean(&[9.0, 1.0, 2.0]) - 1.75).abs() < 1e-12);
        let h = one_over_h(&g, [&[0.0, 1.0, 3.0], &[2.0; 3], &one, &[0.5; 3]]).unwrap();
        assert!((h - 4.0 * 0.5 / 3.0).abs() < 1e-12);
        assert!((irradiance(&g, &[2.0; 3], &one).unwrap() - 60.0).abs() < 1e-12);
        assert!(Kernel::of(&g, "f1", 0, [&one, &one, &[0.0; 3], &one]).is_err());
        assert!(Kernel::of(&g, "f1", 0, [&one, &one, &[1.0; 2], &one]).is_err());
    }
}
