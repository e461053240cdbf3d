//! Synthetic results for tests: a sample with a Lambertian and a direct part, and a context to go with it.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use super::*;
use crate::engine::bsdf::set::{Column, PatchValue};
use crate::engine::optics::basis::AngleBasis;
use crate::engine::optics::direction::Direction;
use crate::engine::optics::side::Side;
use std::f64::consts::PI;

/// Context of an imaginary run.
pub fn context() -> ProductContext {
    let row = |name: &str, lo, hi, glasses: &str, camera: &str| BandRow {
        name: name.to_owned(),
        interval_nm: [lo, hi],
        glasses: glasses.to_owned(),
        camera: camera.to_owned(),
    };
    let part = |name: &str, relative, correlated, source: &str| UncertaintyComponent {
        name: name.to_owned(),
        relative,
        correlated,
        source: source.to_owned(),
    };
    ProductContext {
        run_id: "2026-03-04T18-00-00-blind".to_owned(),
        scan_name: "venetian blind, slats 30 degrees".to_owned(),
        sample: SampleHeader {
            name: "blind <30> & \"test\"".to_owned(),
            manufacturer: String::new(),
            thickness_mm: 16.0,
            device_type: Some("Venetian blind horizontal".to_owned()),
        },
        instrument: "bench 1".to_owned(),
        serials: vec![("ccd".to_owned(), "KD-20-0117".to_owned()), ("ingaas".to_owned(), "SU-4471".to_owned())],
        started: "2026-03-04T18:00:00Z".parse().unwrap(),
        finished: Some("2026-03-05T03:12:44Z".parse().unwrap()),
        lamp: "HMI 2.5 kW".to_owned(),
        lamp_hours: None,
        normalisation: "reference diffuser, views after every 20 directions".to_owned(),
        bands: vec![
            row("f1", 380.0, 450.0, "BG3 2 mm + GG385 2 mm", "ccd"),
            row("f3", 500.0, 560.0, "VG9 2 mm + OG515 1 mm", "ccd"),
            row("f5", 590.0, 650.0, "OG590 3 mm + BG39 1 mm", "ccd"),
            row("nir1", 900.0, 1700.0, "BG3 3 mm", "ingaas"),
        ],
        plan_hash: "9f2c6a1d0b".to_owned(),
        versions: vec![("goniod".to_owned(), "0.1.0".to_owned())],
        night: vec![("Took".to_owned(), "1 h 02 min, forecast 1 h 00 min".to_owned())],
        counts: Counts { planned: 1200, stored: 1200, missing: 0, rejected: 3, missing_reasons: vec![] },
        checks: Checks {
            reciprocity: Some(0.012),
            drift: Some(0.004),
            below_floor: Some(0.02),
            calibration_overdue_days: Some(-40),
        },
        uncertainty: vec![
            part("counting noise", 0.004, false, "photon transfer"),
            part("response curve", 0.012, true, "calibration file"),
            part("lamp drift", 0.005, true, "reference views"),
            part("reference diffuser", 0.010, true, "certificate"),
        ],
        notes: vec!["The sample was turned by hand once.".to_owned()],
    }
}

/// The quantities of the imaginary run.
pub fn quantities() -> Vec<Quantity> {
    let mut all: Vec<Quantity> =
        context().bands.into_iter().map(|b| Quantity::Band { name: b.name, interval_nm: b.interval_nm }).collect();
    all.push(Quantity::RadiometricTotal { interval_nm: [380.0, 945.0] });
    all.push(Quantity::Visible);
    all.push(Quantity::Solar { measured_nm: [380.0, 1700.0] });
    all
}

/// One column: Lambertian `diffuse` plus `direct` in the straight-through or mirror patch.
pub fn column(side: Side, incident: Direction, quantity: usize, diffuse: f64, direct: f64) -> Column {
    let basis = AngleBasis::klems_full();
    let solid = basis.projected_solid_angles();
    let hit = basis.patch_of(Side::file_incident(incident)).unwrap();
    let patches = (0..basis.len())
        .map(|p| {
            let bsdf = diffuse / PI + if p == hit { direct / solid[p] } else { 0.0 };
            PatchValue { bsdf, u: 0.02 * bsdf, u_random: 0.004 * bsdf, coverage: 1.0, max: 1.5 * bsdf }
        })
        .collect();
    let hemispherical = diffuse + direct;
    Column { side, incident, quantity, patches, hemispherical, hemispherical_u: 0.015 * hemispherical }
}

/// A full measurement: T = 0.2 Lambertian + 0.5 direct, R exterior 0.1 + 0.05, R interior 0.12, every patch centre as
/// incident direction, on the sides given.
pub fn full(sides: &[Side]) -> BsdfSet {
    directions(sides, &(0..145).collect::<Vec<_>>())
}

/// The same for the source at the centres of some patches.
pub fn directions(sides: &[Side], patches: &[usize]) -> BsdfSet {
    let basis = AngleBasis::klems_full();
    let quantities = quantities();
    let mut columns = Vec::new();
    for &side in sides {
        for &p in patches {
            for (q, quantity) in quantities.iter().enumerate() {
                let tint = match quantity {
                    Quantity::Band { interval_nm, .. } => 1.0 - 0.0001 * (interval_nm[0] - 380.0),
                    _ => 1.0,
                };
                let (diffuse, direct) = match side {
                    Side::TransmissionFront | Side::TransmissionBack => (0.2, 0.5),
                    Side::ReflectionFront => (0.1, 0.05),
                    Side::ReflectionBack => (0.12, 0.0),
                };
                columns.push(column(side, basis.centre(p).unwrap(), q, tint * diffuse, tint * direct));
            }
        }
    }
    BsdfSet { basis, quantities, columns }
}
