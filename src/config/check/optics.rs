//! Lamp, mirror and references of the instrument: numbers in range, references where they can be lit.

use super::Report;
use crate::config::error::Issue;
use crate::config::instrument::Instrument;
use crate::config::load::Loaded;
use crate::config::pose::Pose;

pub(super) fn check(instrument: &Loaded<Instrument>, issues: &mut Vec<Issue>) {
    let mut report = Report { source: &instrument.source, issues };
    let i = &instrument.value;
    lamp(i, &mut report);
    if !(i.optics.eccentricity >= 0.0 && i.optics.eccentricity < 1.0) {
        let e = i.optics.eccentricity;
        report.error(
            "optics.eccentricity",
            format!("`optics.eccentricity` is {e}, but an ellipsoid's is from 0 to below 1; write f/a"),
        );
    }
    report.positive("optics.half_axis_mm", i.optics.half_axis_mm, 10_000.0);
    report.positive("optics.beam_half_angle_deg", i.optics.beam_half_angle_deg, 45.0);
    report.range("optics.direction_uncertainty_deg", i.optics.direction_uncertainty_deg, 0.0, 45.0);
    for (name, transmission, reference) in
        [("reflection", false, &i.reference.reflection), ("transmission", true, &i.reference.transmission)]
    {
        let Some(reference) = reference else { continue };
        let at = |key: &str| format!("reference.{name}.{key}");
        report.text(&at("name"), &reference.name);
        report.range(&at("relative_uncertainty"), reference.relative_uncertainty, 0.0, 1.0);
        let key = at("theta_deg");
        if !(reference.theta_deg >= 0.0 && reference.theta_deg < 90.0) {
            report.error(&key, format!("`{key}` is {}, but must be from 0 to below 90 degrees", reference.theta_deg));
        } else if let Err(why) = Pose::of_reference(i, transmission, reference.theta_deg) {
            report.error(
                &key,
                format!("`reference.{name}` cannot be shown: {why}; correct the holder or take the reference out"),
            );
        }
    }
}

fn lamp(i: &Instrument, report: &mut Report<'_>) {
    if let Some(e) = i.lamp.irradiance_uw_per_cm2 {
        report.positive("lamp.irradiance_uw_per_cm2", e, 1e9);
    }
    let key = "lamp.irradiance_relative_uncertainty";
    match (i.lamp.irradiance_uw_per_cm2, i.lamp.irradiance_relative_uncertainty) {
        (_, Some(u)) => {
            report.range(key, u, 0.0, 1.0);
        }
        (Some(_), None) => {
            report.error(
                key,
                format!("`{key}` is missing, but the irradiance is given; write its relative standard uncertainty"),
            );
        }
        (None, None) => {}
    }
    report.range("lamp.drift_relative_uncertainty", i.lamp.drift_relative_uncertainty, 0.0, 1.0);
}
