//! Can it be trusted? Green, amber or red, with the reasons in words.

use crate::engine::bsdf::set::{BsdfSet, Column};
use crate::engine::optics::side::Side;
use crate::products::context::ProductContext;

/// The colour of one finding and of the whole.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Light {
    /// Good.
    Green,
    /// Usable with care; the reason says where.
    Amber,
    /// Not to be used before the reason is cleared.
    Red,
}

/// One thing that was looked at.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// How good it is.
    pub light: Light,
    /// What was looked at.
    pub what: &'static str,
    /// What was found, with numbers.
    pub text: String,
}

/// All findings, and the worst of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// The worst light.
    pub light: Light,
    /// Every finding, worst first.
    pub findings: Vec<Finding>,
}

/// Fraction of missing exposures above which the result is red.
const MISSING_RED: f64 = 0.05;
/// Coverage of a column's hemisphere below which it is amber, and red.
const COVERAGE: [f64; 2] = [0.98, 0.90];
/// Relative reciprocity error; really measured fabrics reach 9 to 27 %.
const RECIPROCITY: [f64; 2] = [0.15, 0.30];
/// Relative change between reference views.
const DRIFT: [f64; 2] = [0.02, 0.05];
/// What light below the instrument's floor may add to a hemispherical value, relative (k = 2).
const FLOOR: [f64; 2] = [0.05, 0.25];

/// Judges a result.
pub fn verdict(context: &ProductContext, set: &BsdfSet) -> Verdict {
    let mut findings = vec![exposures(context), coverage(set), values(set)];
    findings.extend(energy(set));
    let checks = &context.checks;
    findings.push(checked(checks.reciprocity, RECIPROCITY, "Reciprocity", "weighted relative error"));
    findings.push(checked(checks.drift, DRIFT, "Drift", "largest change between reference views"));
    findings.push(checked(checks.below_floor, FLOOR, "Floor", "light too dim to read may be this much of a T or R"));
    findings.push(calibration(context));
    findings.sort_by_key(|f| std::cmp::Reverse(f.light));
    Verdict { light: findings.first().map_or(Light::Red, |f| f.light), findings }
}

fn exposures(context: &ProductContext) -> Finding {
    let c = &context.counts;
    let what = "Exposures";
    if c.missing == 0 && c.stored == c.planned && c.planned > 0 {
        let text =
            format!("all {} planned exposures are stored; {} frames were refused and retaken", c.planned, c.rejected);
        return Finding { light: Light::Green, what, text };
    }
    let reasons: Vec<String> = c.missing_reasons.iter().map(|(reason, n)| format!("{n} x {reason}")).collect();
    let open = c.planned.saturating_sub(c.stored);
    let share = open as f64 / c.planned.max(1) as f64;
    let light = if share > MISSING_RED || c.planned == 0 { Light::Red } else { Light::Amber };
    let why = if reasons.is_empty() { "no reason recorded".to_owned() } else { reasons.join("; ") };
    let how = if c.missing > 0 { "goniod resume RUN --missing" } else { "goniod resume RUN" };
    let text = format!("{open} of {} planned exposures are not there ({why}); `{how}` tries them again", c.planned);
    Finding { light, what, text }
}

/// Fraction of the hemisphere's projected solid angle that was measured in a column.
pub fn column_coverage(set: &BsdfSet, column: &Column) -> f64 {
    let solid = set.basis.projected_solid_angles();
    let sum: f64 = column.patches.iter().zip(&solid).map(|(p, l)| l * p.coverage).sum();
    sum / solid.iter().sum::<f64>()
}

fn coverage(set: &BsdfSet) -> Finding {
    let what = "Coverage";
    let worst = set.columns.iter().map(|c| column_coverage(set, c)).fold(f64::INFINITY, f64::min);
    if !worst.is_finite() {
        return Finding {
            light: Light::Red,
            what,
            text: "the result holds no column, or a coverage that is no number".to_owned(),
        };
    }
    let light = graded(1.0 - worst, [1.0 - COVERAGE[0], 1.0 - COVERAGE[1]]);
    Finding { light, what, text: format!("the least covered column saw {:.1} % of its hemisphere", 100.0 * worst) }
}

fn values(set: &BsdfSet) -> Finding {
    let what = "Values";
    let bad = set.columns.iter().filter(|c| !c.hemispherical.is_finite() || !c.hemispherical_u.is_finite()).count();
    let negative = set.columns.iter().filter(|c| c.hemispherical < -2.0 * c.hemispherical_u).count();
    let light = if bad + negative > 0 { Light::Red } else { Light::Green };
    let text = if light == Light::Green {
        format!("all {} hemispherical values are finite and none is negative beyond its uncertainty", set.columns.len())
    } else {
        format!("{bad} columns have no finite hemispherical value, {negative} are negative beyond their uncertainty")
    };
    Finding { light, what, text }
}

/// T + R <= 1 where both were measured for the same source; each alone else.
fn energy(set: &BsdfSet) -> Option<Finding> {
    let mut worst: Option<(f64, f64, &Column)> = None;
    for column in &set.columns {
        let partner = set.columns.iter().find(|c| {
            c.side == partner_of(column.side)
                && c.quantity == column.quantity
                && (c.incident.theta - column.incident.theta).abs() < 1e-9
                && (c.incident.phi - column.incident.phi).abs() < 1e-9
        });
        let sum = column.hemispherical + partner.map_or(0.0, |p| p.hemispherical);
        // Transmission and reflection share lamp and calibration: their errors are taken as correlated.
        let u = column.hemispherical_u + partner.map_or(0.0, |p| p.hemispherical_u);
        if sum.is_finite() && worst.is_none_or(|(s, v, _)| (sum - 1.0) / u.max(1e-9) > (s - 1.0) / v.max(1e-9)) {
            worst = Some((sum, u, column));
        }
    }
    let (sum, u, column) = worst?;
    let light = if sum <= 1.0 {
        Light::Green
    } else if sum <= 1.0 + 2.0 * u {
        Light::Amber
    } else {
        Light::Red
    };
    let (theta, phi) = column.incident.degrees();
    let name = set.quantities.get(column.quantity).map(|q| q.name()).unwrap_or_default();
    let text = format!(
        "largest T + R against its uncertainty: {sum:.4} ± {:.4} (k = 2) for {name}, source at ({theta:.0}°, {phi:.0}°)",
        2.0 * u
    );
    Some(Finding { light, what: "Energy", text })
}

fn partner_of(side: Side) -> Side {
    match side {
        Side::TransmissionFront => Side::ReflectionFront,
        Side::ReflectionFront => Side::TransmissionFront,
        Side::TransmissionBack => Side::ReflectionBack,
        Side::ReflectionBack => Side::TransmissionBack,
    }
}

fn checked(value: Option<f64>, limits: [f64; 2], what: &'static str, words: &str) -> Finding {
    match value {
        Some(v) if v.is_finite() => {
            Finding { light: graded(v, limits), what, text: format!("{words}: {:.1} %", 100.0 * v) }
        }
        Some(_) => Finding { light: Light::Red, what, text: format!("{words}: not a number") },
        None => Finding { light: Light::Amber, what, text: format!("{words}: not checked in this run") },
    }
}

fn calibration(context: &ProductContext) -> Finding {
    let what = "Calibration";
    match context.checks.calibration_overdue_days {
        Some(days) if days <= 0 => {
            Finding { light: Light::Green, what, text: "valid on the day of the run".to_owned() }
        }
        Some(days) => Finding { light: Light::Red, what, text: format!("{days} days past its validity") },
        None => Finding { light: Light::Amber, what, text: "its validity is not known".to_owned() },
    }
}

fn graded(value: f64, [amber, red]: [f64; 2]) -> Light {
    if value > red {
        Light::Red
    } else if value > amber {
        Light::Amber
    } else {
        Light::Green
    }
}

// === impl Light ===

impl Light {
    /// The answer in words.
    pub fn answer(self) -> &'static str {
        match self {
            Light::Green => "Yes",
            Light::Amber => "With care",
            Light::Red => "No",
        }
    }

    /// Name of the style class.
    pub fn class(self) -> &'static str {
        match self {
            Light::Green => "green",
            Light::Amber => "amber",
            Light::Red => "red",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::products::context::synthetic;

    fn set() -> BsdfSet {
        synthetic::directions(&[Side::TransmissionFront, Side::ReflectionFront], &[0, 51])
    }

    fn light_of(verdict: &Verdict, what: &str) -> Option<Light> {
        verdict.findings.iter().find(|f| f.what == what).map(|f| f.light)
    }

    #[test]
    fn a_clean_night_is_green() {
        let v = verdict(&synthetic::context(), &set());
        assert_eq!(v.light, Light::Green, "{:?}", v.findings);
        assert_eq!(v.findings.len(), 8);
    }

    #[test]
    fn missing_exposures_are_amber_then_red_and_told_with_their_reason() {
        let mut context = synthetic::context();
        (context.counts.stored, context.counts.missing) = (1190, 10);
        context.counts.missing_reasons = vec![("camera lost".to_owned(), 10)];
        let v = verdict(&context, &set());
        assert_eq!(v.light, Light::Amber);
        assert!(
            v.findings.first().is_some_and(|f| f.text.contains("10 x camera lost") && f.text.contains("10 of 1200"))
        );
        context.counts.stored = 900;
        assert_eq!(verdict(&context, &set()).light, Light::Red);
    }

    #[test]
    fn too_much_light_is_red_only_beyond_its_uncertainty() {
        let mut set = set();
        set.columns[0].hemispherical = 0.87;
        let v = verdict(&synthetic::context(), &set);
        assert_eq!(light_of(&v, "Energy"), Some(Light::Amber), "0.87 + 0.15 = 1.02 within k = 2");
        set.columns[0].hemispherical = 1.2;
        assert_eq!(light_of(&verdict(&synthetic::context(), &set), "Energy"), Some(Light::Red));
    }

    #[test]
    fn holes_bad_numbers_and_unchecked_things_are_seen() {
        let mut set = set();
        set.columns[3].patches.iter_mut().for_each(|p| p.coverage = 0.93);
        assert_eq!(light_of(&verdict(&synthetic::context(), &set), "Coverage"), Some(Light::Amber));
        set.columns[3].hemispherical = f64::NAN;
        assert_eq!(light_of(&verdict(&synthetic::context(), &set), "Values"), Some(Light::Red));
        let mut context = synthetic::context();
        context.checks.drift = None;
        context.checks.calibration_overdue_days = Some(3);
        let v = verdict(&context, &set);
        assert_eq!(light_of(&v, "Drift"), Some(Light::Amber));
        assert_eq!(light_of(&v, "Calibration"), Some(Light::Red));
        set.columns.clear();
        assert_eq!(verdict(&context, &set).light, Light::Red);
    }
}
