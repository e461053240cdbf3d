//! Tabulated spectra: linear between the rows, zero outside; and the wavelength grid of the engine.

use crate::error::EngineError;

/// A spectrum as a table of ascending wavelengths.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    wavelength_nm: Vec<f64>,
    value: Vec<f64>,
}

/// Evenly spaced wavelengths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// First wavelength in nm.
    pub start_nm: f64,
    /// Distance in nm.
    pub step_nm: f64,
    /// Number of points.
    pub len: usize,
}

// === impl Curve ===

impl Curve {
    /// A curve from two columns.
    ///
    /// # Errors
    /// Columns of different length, no rows, wavelengths not ascending, values not finite.
    pub fn new(wavelength_nm: Vec<f64>, value: Vec<f64>) -> Result<Curve, EngineError> {
        if wavelength_nm.len() != value.len() {
            let (expected, got) = (wavelength_nm.len(), value.len());
            return Err(EngineError::Length { what: "the value column of a spectral curve", expected, got });
        }
        if value.is_empty() {
            return Err(EngineError::Curve { row: 0, reason: "is absent: the table is empty" });
        }
        if let Some(row) = wavelength_nm.iter().zip(&value).position(|(w, v)| !w.is_finite() || !v.is_finite()) {
            return Err(EngineError::Curve { row, reason: "is not a finite number" });
        }
        let falling = wavelength_nm.iter().zip(wavelength_nm.iter().skip(1)).position(|(a, b)| b <= a);
        if let Some(row) = falling {
            return Err(EngineError::Curve { row: row + 1, reason: "does not ascend in wavelength" });
        }
        Ok(Curve { wavelength_nm, value })
    }

    /// The same value from `lo_nm` to `hi_nm`.
    ///
    /// # Errors
    /// Bounds that do not ascend.
    pub fn constant(value: f64, lo_nm: f64, hi_nm: f64) -> Result<Curve, EngineError> {
        Curve::new(vec![lo_nm, hi_nm], vec![value, value])
    }

    /// Wavelengths of the table, nm.
    pub fn wavelength_nm(&self) -> &[f64] {
        &self.wavelength_nm
    }

    /// Values at the wavelengths of the table.
    pub fn values(&self) -> &[f64] {
        &self.value
    }

    /// First and last wavelength in nm.
    pub fn range_nm(&self) -> [f64; 2] {
        let end = |w: Option<&f64>| w.copied().unwrap_or(0.0);
        [end(self.wavelength_nm.first()), end(self.wavelength_nm.last())]
    }

    fn row(&self, i: usize) -> Option<(f64, f64)> {
        Some((*self.wavelength_nm.get(i)?, *self.value.get(i)?))
    }

    /// Value at a wavelength: linear between rows, zero outside the table.
    pub fn at(&self, nm: f64) -> f64 {
        let [lo, hi] = self.range_nm();
        if nm < lo || nm > hi { 0.0 } else { self.at_clamped(nm) }
    }

    /// Value at a wavelength; outside the table the nearest row's (reflectances, internal transmittances).
    pub fn at_clamped(&self, nm: f64) -> f64 {
        let above = self.wavelength_nm.partition_point(|&w| w <= nm);
        match (above.checked_sub(1).and_then(|i| self.row(i)), self.row(above)) {
            (Some((w0, v0)), Some((w1, v1))) => v0 + (v1 - v0) * (nm - w0) / (w1 - w0),
            (Some((_, v)), None) | (None, Some((_, v))) => v,
            (None, None) => 0.0,
        }
    }

    /// Integral over [lo, hi] in value x nm, exact for the straight lines between the rows.
    pub fn integrate(&self, lo_nm: f64, hi_nm: f64) -> f64 {
        let [first, last] = self.range_nm();
        let (lo, hi) = (lo_nm.max(first), hi_nm.min(last));
        if hi <= lo {
            return 0.0;
        }
        let inner = self.wavelength_nm.iter().copied().filter(|&w| w > lo && w < hi);
        let (mut sum, mut w0, mut v0) = (0.0, lo, self.at(lo));
        for w in inner.chain([hi]) {
            let v = self.at(w);
            sum += 0.5 * (v0 + v) * (w - w0);
            (w0, v0) = (w, v);
        }
        sum
    }

    /// Product on the rows of both, over the range they share.
    ///
    /// # Errors
    /// No shared range.
    pub fn product(&self, other: &Curve) -> Result<Curve, EngineError> {
        let ([a0, a1], [b0, b1]) = (self.range_nm(), other.range_nm());
        let (lo, hi) = (a0.max(b0), a1.min(b1));
        let mut nodes: Vec<f64> = self.wavelength_nm.iter().chain(&other.wavelength_nm).copied().collect();
        nodes.retain(|&w| w >= lo && w <= hi);
        nodes.sort_by(f64::total_cmp);
        nodes.dedup();
        let value = nodes.iter().map(|&w| self.at(w) * other.at(w)).collect();
        Curve::new(nodes, value)
    }
}

// === impl Grid ===

impl Grid {
    /// 360 to 1700 nm in 5 nm steps: below 380 nm because light there enters the kernel of the first band.
    pub fn engine() -> Grid {
        Grid { start_nm: 360.0, step_nm: 5.0, len: 269 }
    }

    /// Wavelengths in nm.
    pub fn wavelengths(&self) -> impl Iterator<Item = f64> + '_ {
        (0..self.len).map(|i| self.start_nm + self.step_nm * i as f64)
    }

    /// Values of a curve on the grid, zero outside its table.
    pub fn sample(&self, curve: &Curve) -> Vec<f64> {
        self.wavelengths().map(|w| curve.at(w)).collect()
    }

    /// Values of a curve on the grid, the nearest row's outside its table.
    pub fn sample_clamped(&self, curve: &Curve) -> Vec<f64> {
        self.wavelengths().map(|w| curve.at_clamped(w)).collect()
    }

    /// Mean of a curve over the cell of each grid point, for tables finer than the grid (the solar lines).
    pub fn cell_means(&self, curve: &Curve) -> Vec<f64> {
        let h = 0.5 * self.step_nm;
        self.wavelengths().map(|w| curve.integrate(w - h, w + h) / self.step_nm).collect()
    }

    /// Length in nm of each grid cell inside [lo, hi]: the weights of a sum over an interval.
    pub fn interval(&self, [lo, hi]: [f64; 2]) -> Vec<f64> {
        let h = 0.5 * self.step_nm;
        self.wavelengths().map(|w| ((w + h).min(hi) - (w - h).max(lo)).max(0.0)).collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn lines_are_read_and_integrated_exactly() {
        let c = Curve::new(vec![400.0, 500.0, 520.0], vec![0.0, 1.0, 0.0]).unwrap();
        assert_eq!((c.at(450.0), c.at(510.0), c.at(399.9), c.at_clamped(900.0)), (0.5, 0.5, 0.0, 0.0));
        assert!((c.integrate(0.0, 1000.0) - 60.0).abs() < 1e-12);
        assert!((c.integrate(450.0, 510.0) - (37.5 + 7.5)).abs() < 1e-12);
        let square = c.product(&Curve::constant(2.0, 450.0, 600.0).unwrap()).unwrap();
        assert!((square.integrate(450.0, 520.0) - 2.0 * 47.5).abs() < 1e-12);
        assert!(c.product(&Curve::constant(1.0, 600.0, 700.0).unwrap()).is_err());
    }

    #[test]
    fn bad_tables_are_refused_with_their_row() {
        let text = |w: Vec<f64>, v: Vec<f64>| Curve::new(w, v).unwrap_err().to_string();
        assert!(text(vec![400.0, 390.0], vec![1.0, 1.0]).contains("row 1"));
        assert!(text(vec![400.0, 410.0], vec![1.0, f64::NAN]).contains("finite"));
        assert!(text(vec![], vec![]).contains("empty"));
        assert!(text(vec![400.0], vec![]).contains("0 entries"));
    }

    #[test]
    fn the_grid_covers_its_interval() {
        let g = Grid::engine();
        assert_eq!(g.wavelengths().last(), Some(1700.0));
        assert!((g.interval([380.0, 945.0]).iter().sum::<f64>() - 565.0).abs() < 1e-9);
        let c = Curve::constant(3.0, 300.0, 1800.0).unwrap();
        assert!(g.cell_means(&c).iter().all(|v| (v - 3.0).abs() < 1e-12));
    }
}
