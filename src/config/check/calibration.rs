//! Calibration files: read, and compared with the camera they are for.

use super::inputs::Inputs;
use super::{Options, Report, folder};
use crate::config::calibration::{CameraCalibration, Geometry, Response, ResponseConvention, ResponseForm, Vignetting};
use crate::config::error::{Issue, Severity};
use crate::config::instrument::{Camera, Instrument};
use crate::config::load::{Loaded, parse};
use crate::config::source::Source;
use std::collections::BTreeMap;
use std::path::Path;

/// How far f(1) may be from 0.3 for the convention that says it is: the constants are printed with five digits.
const NORMALISATION_NDL: f64 = 1e-4;

/// Reads and checks the calibration of every camera.
pub(super) fn read(
    instrument: &Loaded<Instrument>,
    options: &Options,
    inputs: &mut Inputs,
    issues: &mut Vec<Issue>,
) -> BTreeMap<String, CameraCalibration> {
    let mut all = BTreeMap::new();
    for (name, camera) in &instrument.value.camera {
        let key = format!("camera.{name}.calibration");
        let path = folder(&instrument.source.path).join(&camera.calibration);
        let mut report = Report { source: &instrument.source, issues };
        let Some(text) = inputs.read(&mut report, &key, &format!("calibration.{name}"), &path) else { continue };
        match Source::parse(&path, text).and_then(parse::<CameraCalibration>) {
            Ok(loaded) => {
                check(name, camera, &loaded, options, inputs, issues);
                all.insert(name.clone(), loaded.value);
            }
            Err(e) => issues.extend_from_slice(e.issues()),
        }
    }
    all
}

fn check(
    name: &str,
    camera: &Camera,
    loaded: &Loaded<CameraCalibration>,
    options: &Options,
    inputs: &mut Inputs,
    issues: &mut Vec<Issue>,
) {
    let mut report = Report { source: &loaded.source, issues };
    let c = &loaded.value;
    if c.camera_serial != camera.serial {
        report.error(
            "camera_serial",
            format!(
                "this calibration belongs to camera \"{}\", but camera `{name}` of the instrument is \"{}\"; name the right file, or calibrate",
                c.camera_serial, camera.serial
            ),
        );
    }
    dates(c, options, &mut report);
    response(&c.response, &mut report);
    report.positive("noise.electrons_at_unit_exposure", c.noise.electrons_at_unit_exposure, 1e12);
    report.range("noise.read_noise_e", c.noise.read_noise_e, 0.0, 1e6);
    geometry(&c.geometry, name, camera, &mut report);
    vignetting(&c.vignetting, &mut report);
    responsivity(name, camera, loaded, inputs, issues);
}

fn dates(c: &CameraCalibration, options: &Options, report: &mut Report<'_>) {
    let today = options.today;
    if c.valid_until < c.date {
        report.error(
            "valid_until",
            format!("`valid_until` is {}, before the day it was made, {}", c.valid_until, c.date),
        );
    } else if today > c.valid_until {
        report.warn(
            "valid_until",
            format!("this calibration ran out on {}, and today is {today}; calibrate again", c.valid_until),
        );
    } else if today < c.date {
        report.warn(
            "date",
            format!("this calibration was made on {}, but today is {today}; is the clock right?", c.date),
        );
    }
}

fn response(r: &Response, report: &mut Report<'_>) {
    report.range("response.residual_ndl", r.residual_ndl, 0.0, 0.2);
    let constants = [("a", r.a), ("b", r.b), ("c", r.c), ("d", r.d)];
    if r.form == ResponseForm::Linear {
        for (name, _) in constants.iter().filter(|(_, v)| v.is_some()) {
            let key = format!("response.{name}");
            report.error(&key, format!("`{key}` has no meaning for a straight line; take it out"));
        }
        return;
    }
    for (name, _) in constants.iter().filter(|(_, v)| v.is_none()) {
        let key = format!("response.{name}");
        report.error(&key, format!("`{key}` is missing; a logistic-dose-response needs a, b, c and d of eq. (4)"));
    }
    let (Some(a), Some(b), Some(c), Some(d)) = (r.a, r.b, r.c, r.d) else { return };
    let sound = a.is_finite()
        && a < 1.0
        && b.is_finite()
        && a + b > 1.0
        && c > 0.0
        && c.is_finite()
        && d < 0.0
        && d.is_finite();
    if !sound {
        report.error(
            "response",
            format!("NDL = a + b/(1 + (x/c)^d) with a = {a}, b = {b}, c = {c}, d = {d} does not rise through 0 to 1; needed are a < 1, a + b > 1, c > 0, d < 0"),
        );
        return;
    }
    let at_one = a + b / (1.0 + c.recip().powf(d));
    if r.convention == ResponseConvention::FOfOneIs03 && (at_one - 0.3).abs() > NORMALISATION_NDL {
        report.error(
            "response.convention",
            format!("`response.convention` says f(1) = 0.3, but these constants give {at_one:.6}; use c' = c/g(0.3), or write \"as-printed\""),
        );
    }
}

fn geometry(g: &Geometry, name: &str, camera: &Camera, report: &mut Report<'_>) {
    report.range("geometry.roll_deg", g.roll_deg, -360.0, 360.0);
    if !report.positive("geometry.deg_per_px", g.deg_per_px, 45.0) {
        return;
    }
    let radius = 90.0 / g.deg_per_px;
    // Pixel centres at whole numbers: the picture reaches from -0.5 to size - 0.5.
    let (width, height) = (camera.width_px as f64, camera.height_px as f64);
    let top = g.reserved_rows as f64 - 0.5;
    let edges = [
        ("geometry.centre_x_px", "left", g.centre_x_px - radius, -0.5, false),
        ("geometry.centre_x_px", "right", g.centre_x_px + radius, width - 0.5, true),
        ("geometry.centre_y_px", "top", g.centre_y_px - radius, top, false),
        ("geometry.centre_y_px", "bottom", g.centre_y_px + radius, height - 0.5, true),
    ];
    for (key, edge, at, limit, upper) in edges {
        let inside = if upper { at <= limit } else { at >= limit };
        if !inside {
            report.error(
                key,
                format!(
                    "the hemisphere (radius {radius:.1} px) reaches to {at:.1} px, beyond the {edge} edge of camera `{name}` at {limit:.1} px below {} reserved rows; correct centre, deg_per_px or the picture's size",
                    g.reserved_rows
                ),
            );
        }
    }
}

fn vignetting(v: &Vignetting, report: &mut Report<'_>) {
    report.range("vignetting.relative_uncertainty", v.relative_uncertainty, 0.0, 1.0);
    if v.even_coefficients.len() > 8 {
        report.error(
            "vignetting.even_coefficients",
            "`vignetting.even_coefficients` has more than 8 terms; a smooth drop needs fewer",
        );
    }
    let signal = |t: f64| {
        let powers = (1..).map(|k| t.powi(2 * k));
        1.0 + v.even_coefficients.iter().zip(powers).map(|(c, p)| c * p).sum::<f64>()
    };
    let lowest = (0..=90)
        .map(|deg| signal(f64::from(deg) / 90.0))
        .fold(f64::INFINITY, |a, b| if b < a || b.is_nan() { b } else { a });
    if !(lowest > 0.0 && lowest.is_finite()) {
        report.error(
            "vignetting.even_coefficients",
            format!("`vignetting.even_coefficients` let the signal fall to {lowest:.3} of its centre; it must stay above 0 up to 90 degrees"),
        );
    }
}

fn responsivity(
    name: &str,
    camera: &Camera,
    loaded: &Loaded<CameraCalibration>,
    inputs: &mut Inputs,
    issues: &mut Vec<Issue>,
) {
    let r = &loaded.value.responsivity;
    let mut report = Report { source: &loaded.source, issues };
    report.range("responsivity.scale_relative_uncertainty", r.scale_relative_uncertainty, 0.0, 1.0);
    report.range("responsivity.shape_relative_uncertainty", r.shape_relative_uncertainty, 0.0, 1.0);
    let key = "responsivity.file";
    let path = folder(&loaded.source.path).join(&r.file);
    let role = format!("responsivity.{name}");
    let Some(curves) = inputs.curves(&mut report, key, &role, &path) else { return };
    let coloured = camera.format.mosaic().is_some() || camera.format.values_per_pixel() > 1;
    let wanted: &[&str] = if coloured { &["r", "g", "b"] } else { &["value"] };
    let lacking: Vec<&&str> = wanted.iter().filter(|w| curves.column(w).is_none()).collect();
    if !lacking.is_empty() || curves.names.len() != wanted.len() {
        report.error(
            key,
            format!(
                "`{key}` names {}, which has the columns {:?}, but camera `{name}` needs {wanted:?}",
                shown(&path),
                curves.names
            ),
        );
    }
    if curves.value_range().0 < 0.0 {
        report.issues.push(report.source.issue(
            Severity::Error,
            key,
            format!("`{key}` names {}, which has negative values; a responsivity is not negative", shown(&path)),
        ));
    }
    inputs.responsivity.insert(name.to_owned(), curves);
}

fn shown(path: &Path) -> std::path::Display<'_> {
    path.display()
}
