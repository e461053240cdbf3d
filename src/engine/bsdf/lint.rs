//! What no reader of the files polices: physics. Every finding says what, where and which number is wrong.

use super::set::{BsdfSet, Column};
use crate::optics::side::Side;
use std::fmt;

/// Polar angle from which a transmittance that grows like 1/cos is suspicious, degrees.
const GRAZING_DEG: f64 = 55.0;

/// What is wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rule {
    /// A measured patch holds NaN or infinity.
    NotFinite,
    /// A value below zero by more than three standard uncertainties.
    Negative,
    /// Transmittance plus reflectance above one by more than two standard uncertainties.
    EnergyGained,
    /// Transmittance grows towards grazing like an extra 1/cos: divided by the cosine twice.
    GrowsTowardsGrazing,
    /// A column of which a part was not measured.
    Incomplete,
}

/// One finding.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// What is wrong.
    pub rule: Rule,
    /// Hemisphere pair.
    pub side: Side,
    /// Index into `BsdfSet::quantities`.
    pub quantity: usize,
    /// Incident polar angle and azimuth of the source in degrees.
    pub incident_deg: (f64, f64),
    /// Patch, where it is one.
    pub patch: Option<usize>,
    /// The number found.
    pub found: f64,
    /// The bound it should keep.
    pub allowed: f64,
}

/// Everything in a set that physics forbids or that is not complete, in the order of its columns.
pub fn lint(set: &BsdfSet) -> Vec<Finding> {
    let mut findings = Vec::new();
    for column in &set.columns {
        patches(column, &mut findings);
        energy(set, column, &mut findings);
        grazing(set, column, &mut findings);
    }
    findings
}

fn patches(column: &Column, findings: &mut Vec<Finding>) {
    let mut least = 1.0_f64;
    for (i, p) in column.patches.iter().enumerate() {
        least = least.min(p.coverage);
        if p.coverage > 0.0 && !p.bsdf.is_finite() {
            findings.push(Finding::of(Rule::NotFinite, column, Some(i), p.bsdf, f64::INFINITY));
        }
        if p.bsdf < -3.0 * p.u {
            findings.push(Finding::of(Rule::Negative, column, Some(i), p.bsdf, -3.0 * p.u));
        }
    }
    if !column.hemispherical.is_finite() {
        findings.push(Finding::of(Rule::NotFinite, column, None, column.hemispherical, 1.0));
    }
    if least < 0.99 {
        findings.push(Finding::of(Rule::Incomplete, column, None, least, 0.99));
    }
}

/// T + R of the same light must not exceed one; reported once, with the transmission column (or a lone column).
fn energy(set: &BsdfSet, column: &Column, findings: &mut Vec<Finding>) {
    let partner = set.columns.iter().find(|c| {
        c.quantity == column.quantity
            && c.side.from_exterior() == column.side.from_exterior()
            && c.side.is_transmission() != column.side.is_transmission()
            && c.incident.vector().angle_to(column.incident.vector()) < 1e-3
    });
    let (sum, u) = match partner {
        Some(_) if !column.side.is_transmission() => return,
        Some(p) => (column.hemispherical + p.hemispherical, column.hemispherical_u + p.hemispherical_u),
        None => (column.hemispherical, column.hemispherical_u),
    };
    if sum > 1.0 + 2.0 * u {
        findings.push(Finding::of(Rule::EnergyGained, column, None, sum, 1.0 + 2.0 * u));
    }
}

/// Compares with the column nearest to the normal: T(theta) / T(0) of 1/cos is what a second division would give a
/// flat transmittance; glass falls towards grazing, so a quarter of that growth is already suspicious.
fn grazing(set: &BsdfSet, column: &Column, findings: &mut Vec<Finding>) {
    let (theta, _) = column.incident.degrees();
    if theta < GRAZING_DEG || !column.side.is_transmission() {
        return;
    }
    let same = set.columns.iter().filter(|c| c.side == column.side && c.quantity == column.quantity);
    let Some(normal) = same.min_by(|a, b| a.incident.theta.total_cmp(&b.incident.theta)) else { return };
    if normal.incident.degrees().0 > 30.0 || normal.hemispherical <= 0.0 {
        return;
    }
    let extra = normal.incident.theta.cos() / column.incident.theta.cos();
    let allowed = normal.hemispherical * (1.0 + 0.25 * (extra - 1.0)) + 2.0 * column.hemispherical_u;
    if column.hemispherical > allowed {
        findings.push(Finding::of(Rule::GrowsTowardsGrazing, column, None, column.hemispherical, allowed));
    }
}

// === impl Finding ===

impl Finding {
    fn of(rule: Rule, column: &Column, patch: Option<usize>, found: f64, allowed: f64) -> Finding {
        let (side, quantity, incident_deg) = (column.side, column.quantity, column.incident.degrees());
        Finding { rule, side, quantity, incident_deg, patch, found, allowed }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (theta, phi) = self.incident_deg;
        write!(f, "{:?}, light from ({theta:.1}, {phi:.1}) degrees", self.side)?;
        if let Some(patch) = self.patch {
            write!(f, ", patch {patch}")?;
        }
        let (found, allowed) = (self.found, self.allowed);
        match self.rule {
            Rule::NotFinite => write!(f, ": the value is {found}; measure this column again"),
            Rule::Negative => write!(f, ": BSDF {found:.5} is below {allowed:.5}; check darks and stray light"),
            Rule::EnergyGained => write!(f, ": T + R = {found:.4} exceeds {allowed:.4}; check reference and angles"),
            Rule::GrowsTowardsGrazing => write!(
                f,
                ": T = {found:.4} grows towards grazing beyond {allowed:.4}, as after dividing by the cosine twice"
            ),
            Rule::Incomplete => {
                write!(
                    f,
                    ": a patch is covered to {:.0} % only; add a shorter exposure or check the view",
                    100.0 * found
                )
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bsdf::set::{PatchValue, Quantity};
    use crate::optics::basis::AngleBasis;
    use crate::optics::direction::Direction;
    use std::f64::consts::PI;

    fn column(side: Side, theta: f64, t: f64) -> Column {
        let patch = PatchValue { bsdf: t / PI, u: 0.001, u_random: 0.0, coverage: 1.0, max: t / PI };
        Column {
            side,
            incident: Direction::from_degrees(theta, 0.0),
            quantity: 0,
            patches: vec![patch; 145],
            hemispherical: t,
            hemispherical_u: 0.01,
        }
    }

    fn rules(columns: Vec<Column>) -> Vec<Rule> {
        let set = BsdfSet { basis: AngleBasis::klems_full(), quantities: vec![Quantity::Visible], columns };
        lint(&set).into_iter().map(|f| f.rule).collect()
    }

    #[test]
    fn a_good_set_has_no_findings() {
        let t = |theta, v| column(Side::TransmissionFront, theta, v);
        let columns = vec![t(0.0, 0.6), t(60.0, 0.55), t(82.5, 0.2), column(Side::ReflectionFront, 0.0, 0.39)];
        assert_eq!(rules(columns), vec![]);
    }

    #[test]
    fn each_sin_is_found() {
        let t = |theta, v| column(Side::TransmissionFront, theta, v);
        assert_eq!(rules(vec![t(0.0, 0.7), column(Side::ReflectionFront, 0.0, 0.4)]), vec![Rule::EnergyGained]);
        // frads' ec60: T rises .177 -> .685 towards grazing
        assert_eq!(rules(vec![t(0.0, 0.177), t(82.5, 0.685)]), vec![Rule::GrowsTowardsGrazing]);
        let mut bad = t(0.0, 0.5);
        bad.patches[3].bsdf = -0.01;
        bad.patches[4].bsdf = f64::NAN;
        bad.patches[5].coverage = 0.4;
        assert_eq!(rules(vec![bad]), vec![Rule::Negative, Rule::NotFinite, Rule::Incomplete]);
    }

    #[test]
    fn findings_read_as_sentences() {
        let set = BsdfSet {
            basis: AngleBasis::klems_full(),
            quantities: vec![Quantity::Visible],
            columns: vec![column(Side::ReflectionBack, 40.0, 1.2)],
        };
        let text: Vec<String> = lint(&set).iter().map(Finding::to_string).collect();
        assert_eq!(
            text,
            [
                "ReflectionBack, light from (40.0, 0.0) degrees: T + R = 1.2000 exceeds 1.0200; check reference and angles"
            ]
        );
    }
}
