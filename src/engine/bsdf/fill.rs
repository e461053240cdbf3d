//! From measured columns to the basis-by-basis matrix of the files: exact hits, rotation of isotropic samples,
//! interpolation in theta, reciprocity.

use super::matrix::{Matrix, Origin};
use super::set::{BsdfSet, Column};
use crate::optics::basis::AngleBasis;
use crate::optics::direction::Direction;
use crate::optics::side::Side;

/// A measured direction this near to a patch's centre counts as that patch.
const HIT_DEG: f64 = 1.0;

/// Matrix of `side` and `quantity` from the measured columns. `isotropic` allows to turn columns about the normal and
/// to interpolate between measured polar angles; nothing is extrapolated. What cannot be known stays NaN.
pub fn fill(set: &BsdfSet, side: Side, quantity: usize, isotropic: bool) -> Matrix {
    let basis = &set.basis;
    let columns: Vec<&Column> = set
        .columns
        .iter()
        .filter(|c| c.side == side && c.quantity == quantity && c.patches.len() == basis.len())
        .collect();
    let mut matrix = Matrix::unknown(basis.len());
    for i in 0..basis.len() {
        let Some(centre) = basis.centre(i) else { continue };
        if let Some(hit) = exact_hit(&columns, centre) {
            matrix.set_column(i, &values(hit), Origin::Measured);
        } else if isotropic && let Some((column, origin)) = by_symmetry(basis, &columns, centre) {
            matrix.set_column(i, &column, origin);
        }
    }
    matrix
}

/// Fills what `matrix` lacks from the other direction of light (Transmission Front for Back and the reverse; for a
/// reflection, its own matrix). Columns that are known stay.
pub fn fill_by_reciprocity(matrix: &mut Matrix, other: &Matrix, basis: &AngleBasis) {
    let reciprocal = other.reciprocal(basis);
    for i in 0..matrix.n {
        let lacking = matrix.origin.get(i) == Some(&Origin::NotMeasured);
        if lacking && reciprocal.origin.get(i) == Some(&Origin::Reciprocity) {
            matrix.set_column(i, &reciprocal.column(i), Origin::Reciprocity);
        }
    }
}

fn values(column: &Column) -> Vec<(f64, f64)> {
    column.patches.iter().map(|p| (p.bsdf, p.u)).collect()
}

fn exact_hit<'a>(columns: &[&'a Column], centre: Direction) -> Option<&'a Column> {
    let angle = |c: &Column| Side::file_incident(c.incident).vector().angle_to(centre.vector()).to_degrees();
    let best = columns.iter().copied().min_by(|a, b| angle(a).total_cmp(&angle(b)))?;
    (angle(best) <= HIT_DEG).then_some(best)
}

/// The column at `centre` from columns at other azimuths, interpolated between the measured polar angles on both
/// sides.
fn by_symmetry(basis: &AngleBasis, columns: &[&Column], centre: Direction) -> Option<(Vec<(f64, f64)>, Origin)> {
    let (theta, phi) = centre.degrees();
    let of = |c: &Column| c.incident.degrees().0;
    let turned = |c: &Column| {
        let travel = Side::file_incident(c.incident).degrees().1;
        // at normal incidence azimuth means nothing, but the column is that of any azimuth
        rotate(basis, &values(c), phi - travel)
    };
    let nearest_phi = |candidates: &mut dyn Iterator<Item = &&Column>| -> Option<Column> {
        let apart = |c: &Column| {
            let d = (Side::file_incident(c.incident).degrees().1 - phi).rem_euclid(360.0);
            d.min(360.0 - d)
        };
        candidates.min_by(|a, b| apart(a).total_cmp(&apart(b))).map(|c| (*c).clone())
    };
    let same = nearest_phi(&mut columns.iter().filter(|c| (of(c) - theta).abs() <= HIT_DEG));
    if let Some(c) = same {
        return Some((turned(&c), Origin::Symmetry));
    }
    let below = columns.iter().map(|c| of(c)).filter(|t| *t < theta).max_by(f64::total_cmp)?;
    let above = columns.iter().map(|c| of(c)).filter(|t| *t > theta).min_by(f64::total_cmp)?;
    let a = nearest_phi(&mut columns.iter().filter(|c| (of(c) - below).abs() <= HIT_DEG))?;
    let b = nearest_phi(&mut columns.iter().filter(|c| (of(c) - above).abs() <= HIT_DEG))?;
    let w = (theta - of(&a)) / (of(&b) - of(&a));
    let column = turned(&a).into_iter().zip(turned(&b)).map(|(a, b)| between(a, b, w)).collect();
    Some((column, Origin::Interpolated))
}

/// Straight line between two values; how far they differ says how wrong the line can be.
fn between((a, ua): (f64, f64), (b, ub): (f64, f64), w: f64) -> (f64, f64) {
    let bend = w * (1.0 - w) * (b - a);
    let value = (1.0 - w) * a + w * b;
    (value, ((1.0 - w) * ua + w * ub).hypot(bend))
}

/// A column turned by `degrees` about the normal (x towards y). Where the turn is not a whole number of patches the
/// two patches that overlap are mixed by area, which keeps the hemispherical sum.
pub fn rotate(basis: &AngleBasis, column: &[(f64, f64)], degrees: f64) -> Vec<(f64, f64)> {
    let mut out = Vec::with_capacity(column.len());
    let mut first = 0;
    for ring in &basis.rings {
        let n = ring.patches;
        let steps = (degrees / 360.0 * n as f64).rem_euclid(n as f64);
        let nearest = steps.round();
        // rounding of angles must not mix neighbours
        let steps = if (steps - nearest).abs() < 1e-9 { nearest } else { steps };
        let (whole, part) = (steps.floor() as usize, steps.fract());
        for k in 0..n {
            let from =
                |shift: usize| column.get(first + (k + 2 * n - shift) % n).copied().unwrap_or((f64::NAN, f64::NAN));
            let (a, ua) = from(whole % n);
            if part == 0.0 || n == 1 {
                out.push((a, ua));
            } else {
                let (b, ub) = from(whole % n + 1);
                out.push(((1.0 - part) * a + part * b, (1.0 - part) * ua + part * ub));
            }
        }
        first += n;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bsdf::set::{PatchValue, Quantity};

    /// An isotropic scatterer: value depends on both polar angles and the azimuth between them.
    fn brdf(theta_i: f64, phi_i: f64, out: Direction) -> f64 {
        let (theta_o, phi_o) = out.degrees();
        1.0 + theta_i / 90.0 + theta_o / 45.0 + (phi_o - phi_i).to_radians().cos() * theta_i * theta_o / 8100.0
    }

    fn set(directions: &[(f64, f64)]) -> BsdfSet {
        let basis = AngleBasis::klems_full();
        let column = |&(theta, travel): &(f64, f64)| Column {
            side: Side::TransmissionFront,
            incident: Direction::from_degrees(theta, travel + 180.0),
            quantity: 0,
            patches: (0..basis.len())
                .filter_map(|o| basis.centre(o))
                .map(|d| PatchValue { bsdf: brdf(theta, travel, d), u: 0.01, u_random: 0.0, coverage: 1.0, max: 0.0 })
                .collect(),
            hemispherical: 0.0,
            hemispherical_u: 0.0,
        };
        BsdfSet { quantities: vec![Quantity::Visible], columns: directions.iter().map(column).collect(), basis }
    }

    #[test]
    fn a_hit_needs_no_symmetry() {
        let set = set(&[(40.0, 90.0)]);
        let m = fill(&set, Side::TransmissionFront, 0, false);
        let i = set.basis.index(4, 6);
        assert_eq!(m.origin[i], Origin::Measured);
        assert_eq!(m.origin.iter().filter(|o| **o != Origin::NotMeasured).count(), 1);
        assert_eq!(m.at(17, i).0, set.columns[0].patches[17].bsdf);
        assert!(m.at(17, i + 1).0.is_nan());
    }

    #[test]
    fn an_isotropic_sample_needs_one_azimuth_a_ring() {
        let set = set(&[(0.0, 0.0), (20.0, 0.0), (40.0, 0.0), (82.5, 0.0)]);
        let m = fill(&set, Side::TransmissionFront, 0, true);
        let ring = |r: usize| m.origin[set.basis.index(r, 1)];
        assert_eq!(ring(2), Origin::Symmetry);
        assert_eq!(ring(3), Origin::Interpolated);
        assert_eq!(m.origin[set.basis.index(4, 0)], Origin::Measured);
        for (r, k, tolerance) in [(2, 4, 1e-9), (4, 7, 0.05), (3, 5, 0.06), (8, 3, 0.06)] {
            let i = set.basis.index(r, k);
            let (theta, phi) = set.basis.centre(i).map(|d| d.degrees()).unwrap_or_default();
            for o in 0..145 {
                let truth = set.basis.centre(o).map_or(0.0, |d| brdf(theta, phi, d));
                assert!((m.at(o, i).0 - truth).abs() < tolerance, "{theta} {phi} -> {o}: {} {truth}", m.at(o, i).0);
            }
        }
    }

    #[test]
    fn nothing_is_extrapolated() {
        let set = set(&[(0.0, 0.0), (40.0, 0.0)]);
        let m = fill(&set, Side::TransmissionFront, 0, true);
        assert_eq!(m.origin[set.basis.index(5, 0)], Origin::NotMeasured);
        assert_eq!(fill(&set, Side::ReflectionFront, 0, true).origin[0], Origin::NotMeasured);
    }

    #[test]
    fn turning_keeps_the_hemispherical_sum() {
        let basis = AngleBasis::klems_full();
        let lambda = basis.projected_solid_angles();
        let column: Vec<(f64, f64)> = (0..145).map(|i| ((i * i % 31) as f64, 0.1)).collect();
        let sum = |c: &[(f64, f64)]| c.iter().zip(&lambda).map(|((b, _), l)| b * l).sum::<f64>();
        for degrees in [-721.3, 15.0, 7.2, 180.0, 359.999] {
            let turned = rotate(&basis, &column, degrees);
            assert!((sum(&turned) - sum(&column)).abs() < 1e-9);
        }
        let quarter = rotate(&basis, &column, 90.0);
        assert_eq!(quarter[basis.index(5, 6)], column[basis.index(5, 0)]);
    }

    #[test]
    fn the_other_direction_fills_what_lacks() {
        let basis = AngleBasis::klems_full();
        let mut front = Matrix::unknown(145);
        for i in 0..145 {
            let column: Vec<(f64, f64)> = (0..145).map(|o| ((o + 2 * i) as f64, 0.1)).collect();
            front.set_column(i, &column, Origin::Measured);
        }
        let mut back = Matrix::unknown(145);
        back.set_column(0, &vec![(5.0, 0.1); 145], Origin::Measured);
        fill_by_reciprocity(&mut back, &front, &basis);
        assert_eq!((back.origin[0], back.at(3, 0).0), (Origin::Measured, 5.0));
        let turned = super::super::matrix::half_turn(&basis);
        assert_eq!(back.at(turned[20], turned[50]).0, front.at(50, 20).0);
        assert_eq!(back.origin[7], Origin::Reciprocity);
    }
}
