//! A basis-by-basis BSDF matrix in the file's indices, and reciprocity.

use crate::optics::basis::AngleBasis;

/// How a column of the matrix came about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// Measured at the patch's centre.
    Measured,
    /// A measured column turned about the normal (isotropic sample).
    Symmetry,
    /// Between two measured polar angles (isotropic sample).
    Interpolated,
    /// From the other direction of light.
    Reciprocity,
    /// Nothing known.
    NotMeasured,
}

/// Matrix of one hemisphere pair and one quantity. Row = emergent patch, column = incident patch, both by the file's
/// table (an incident patch is named by the azimuth in which light travels).
#[derive(Debug, Clone, PartialEq)]
pub struct Matrix {
    /// Number of patches.
    pub n: usize,
    /// BSDF in 1/sr, number = emergent x n + incident; NaN where nothing is known.
    pub bsdf: Vec<f64>,
    /// Standard uncertainty in 1/sr, same order.
    pub u: Vec<f64>,
    /// One entry a column.
    pub origin: Vec<Origin>,
}

// === impl Matrix ===

impl Matrix {
    /// A matrix of which nothing is known.
    pub fn unknown(n: usize) -> Matrix {
        Matrix { n, bsdf: vec![f64::NAN; n * n], u: vec![f64::NAN; n * n], origin: vec![Origin::NotMeasured; n] }
    }

    /// Value and uncertainty at emergent patch `o`, incident patch `i`; NaN outside.
    pub fn at(&self, o: usize, i: usize) -> (f64, f64) {
        let k = o * self.n + i;
        let of = |v: &[f64]| if o < self.n && i < self.n { v.get(k).copied().unwrap_or(f64::NAN) } else { f64::NAN };
        (of(&self.bsdf), of(&self.u))
    }

    /// Writes a column.
    pub fn set_column(&mut self, i: usize, column: &[(f64, f64)], origin: Origin) {
        for (o, &(bsdf, u)) in column.iter().enumerate() {
            let k = o * self.n + i;
            if let (Some(b), Some(v)) = (self.bsdf.get_mut(k), self.u.get_mut(k)) {
                (*b, *v) = (bsdf, u);
            }
        }
        if let Some(slot) = self.origin.get_mut(i) {
            *slot = origin;
        }
    }

    /// Column `i` as (value, uncertainty) a patch.
    pub fn column(&self, i: usize) -> Vec<(f64, f64)> {
        (0..self.n).map(|o| self.at(o, i)).collect()
    }

    /// The matrix of the other direction of light by reciprocity, `TB[R(i)][R(o)] = TF[o][i]` with R = same theta,
    /// phi + 180 degrees (of a reflection matrix: its own transpose). A column is known where every entry of it is.
    pub fn reciprocal(&self, basis: &AngleBasis) -> Matrix {
        let turned = half_turn(basis);
        let mut out = Matrix::unknown(self.n);
        for (o, &column) in turned.iter().enumerate() {
            let mut values = vec![(f64::NAN, f64::NAN); self.n];
            for (i, &row) in turned.iter().enumerate() {
                if let Some(v) = values.get_mut(row) {
                    *v = self.at(o, i);
                }
            }
            if values.iter().all(|(b, _)| !b.is_nan()) {
                out.set_column(column, &values, Origin::Reciprocity);
            }
        }
        out
    }

    /// How far `other` (the other direction of light; for reflection the same matrix) is from reciprocity: root mean
    /// square difference over root mean square value, weighted by projected solid angles, over entries that both know
    /// and that were not themselves made by reciprocity. `None` if there are none.
    pub fn reciprocity(&self, other: &Matrix, basis: &AngleBasis) -> Option<f64> {
        let turned = half_turn(basis);
        let lambda = basis.projected_solid_angles();
        let made = |m: &Matrix, i: usize| m.origin.get(i) == Some(&Origin::Reciprocity);
        let (mut difference, mut value) = (0.0, 0.0);
        for (i, (&ri, li)) in turned.iter().zip(&lambda).enumerate() {
            for (o, (&ro, lo)) in turned.iter().zip(&lambda).enumerate() {
                let (a, b) = (self.at(o, i).0, other.at(ri, ro).0);
                if a.is_nan() || b.is_nan() || made(self, i) || made(other, ro) {
                    continue;
                }
                difference += li * lo * (a - b).powi(2);
                value += li * lo * (0.5 * (a + b)).powi(2);
            }
        }
        (value > 0.0).then(|| (difference / value).sqrt())
    }
}

/// R of every patch: same theta, phi + 180 degrees.
pub fn half_turn(basis: &AngleBasis) -> Vec<usize> {
    (0..basis.len())
        .map(|i| match basis.place(i) {
            Some((r, k)) => {
                let n = basis.rings.get(r).map_or(1, |r| r.patches);
                basis.index(r, (k + n / 2) % n)
            }
            None => i,
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_half_turn_keeps_theta_and_adds_180_degrees() {
        let basis = AngleBasis::klems_full();
        let turned = half_turn(&basis);
        assert_eq!((turned[0], turned[turned[77]]), (0, 77));
        let at = |i: usize| basis.centre(i).map(|d| d.degrees()).unwrap_or_default();
        let ((t, p), (t2, p2)) = (at(77), at(turned[77]));
        assert!((t - t2).abs() < 1e-12 && ((p + 180.0).rem_euclid(360.0) - p2).abs() < 1e-9);
    }

    #[test]
    fn reciprocity_turns_back_into_itself() {
        let basis = AngleBasis::klems_quarter();
        let n = basis.len();
        let mut front = Matrix::unknown(n);
        for i in 0..n {
            let column: Vec<(f64, f64)> = (0..n).map(|o| ((o * 7 + i * 3) as f64, 0.1)).collect();
            front.set_column(i, &column, Origin::Measured);
        }
        let back = front.reciprocal(&basis);
        let again = back.reciprocal(&basis);
        assert_eq!(front.bsdf, again.bsdf);
        assert!(back.origin.iter().all(|o| *o == Origin::Reciprocity));
        let measured = Matrix { origin: vec![Origin::Measured; n], ..back.clone() };
        assert_eq!(front.reciprocity(&measured, &basis), Some(0.0));
        assert_eq!(front.reciprocity(&back, &basis), None, "a matrix made by reciprocity proves nothing");
        let mut worse = measured;
        worse.bsdf.iter_mut().for_each(|b| *b *= 1.1);
        let number = front.reciprocity(&worse, &basis).unwrap_or_default();
        assert!((number - 0.1 / 1.05).abs() < 1e-9, "{number}");
        front.set_column(3, &vec![(f64::NAN, f64::NAN); n], Origin::NotMeasured);
        assert!(front.reciprocal(&basis).origin.iter().all(|o| *o == Origin::NotMeasured));
    }
}
