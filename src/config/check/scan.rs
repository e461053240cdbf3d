//! The scan against the instrument: directions, sides, bands, exposures, references.

use super::Report;
use super::devices::NOT_BANDS;
use crate::config::error::Issue;
use crate::config::hint;
use crate::config::incidence::{Incident, MOST_DIRECTIONS, MOST_EXPOSURES};
use crate::config::instrument::{Camera, FilterSlot, Instrument};
use crate::config::load::Loaded;
use crate::config::pose::{Pose, Unreachable};
use crate::config::scan::{Incidence, ReferenceMode, Scan};
use crate::engine::optics::side::Side;
use std::collections::{BTreeMap, BTreeSet};

pub(super) fn check(scan: &Loaded<Scan>, instrument: &Loaded<Instrument>, issues: &mut Vec<Issue>) {
    let mut report = Report { source: &scan.source, issues };
    let (s, i) = (&scan.value, &instrument.value);
    report.text("name", &s.name);
    report.positive("sample.thickness_mm", s.sample.thickness_mm, 10_000.0);
    if sound_incidence(&s.incidence, &mut report) {
        directions(s, i, &mut report);
    }
    sides(&s.incidence, &mut report);
    let slots = bands(s, i, &mut report);
    exposure(s, i, &slots, &mut report);
    report.range("dark.frames", f64::from(s.dark.frames), 1.0, 1000.0);
    references(s, i, &mut report);
    if s.products.formats.is_empty() {
        report
            .error("products.formats", "`products.formats` is empty; name a format, or leave the table [products] out");
    }
}

/// Exactly one way to name directions, with numbers in range. True where the list may be used.
fn sound_incidence(incidence: &Incidence, report: &mut Report<'_>) -> bool {
    let ways = [
        ("basis", incidence.basis.is_some()),
        ("directions", incidence.directions.is_some()),
        ("grid", incidence.grid.is_some()),
        ("ring", incidence.ring.is_some()),
    ];
    let used: Vec<&str> = ways.iter().filter(|(_, there)| *there).map(|(name, _)| *name).collect();
    if used.len() != 1 {
        let message = match used.get(1) {
            None => "[incidence] names no directions; write one of `basis`, `directions`, `grid`, `ring`".to_owned(),
            Some(_) => {
                format!("[incidence] names directions in {} ways ({}); keep one", used.len(), hint::quoted(&used))
            }
        };
        report.error(
            &used.get(1).map_or_else(|| "incidence".to_owned(), |second| format!("incidence.{second}")),
            message,
        );
        return false;
    }
    let before = report.issues.len();
    for (n, [t, p]) in incidence.directions.iter().flatten().enumerate() {
        let key = format!("incidence.directions[{n}]");
        theta(&format!("{key}[0]"), *t, report);
        phi(&format!("{key}[1]"), *p, report);
    }
    if let Some(grid) = &incidence.grid {
        grid.theta_deg
            .iter()
            .enumerate()
            .for_each(|(n, t)| theta(&format!("incidence.grid.theta_deg[{n}]"), *t, report));
        grid.phi_deg.iter().enumerate().for_each(|(n, p)| phi(&format!("incidence.grid.phi_deg[{n}]"), *p, report));
    }
    if let Some(ring) = &incidence.ring {
        theta("incidence.ring.theta_deg", ring.theta_deg, report);
        phi("incidence.ring.start_phi_deg", ring.start_phi_deg, report);
        report.range("incidence.ring.count", f64::from(ring.count), 1.0, 3600.0);
    }
    report.issues.len() == before
}

fn theta(key: &str, value: f64, report: &mut Report<'_>) {
    if !(0.0..90.0).contains(&value) {
        report.error(
            key,
            format!("`{key}` is {value}, but a polar angle is from 0 to below 90 degrees; name the side in `sides`"),
        );
    }
}

fn phi(key: &str, value: f64, report: &mut Report<'_>) {
    report.range(key, value, -360.0, 360.0);
}

fn directions(s: &Scan, i: &Instrument, report: &mut Report<'_>) {
    let incidents = s.incidence.incidents();
    if incidents.is_empty() || incidents.len() > MOST_DIRECTIONS {
        report.error(
            "incidence",
            format!("[incidence] gives {} directions, but a scan has 1 to {MOST_DIRECTIONS}", incidents.len()),
        );
        return;
    }
    let mut seen: BTreeMap<(i64, i64), usize> = BTreeMap::new();
    for (n, incident) in incidents.iter().enumerate() {
        if let Some(first) = seen.insert(incident.key(), n) {
            let key = direction_key(&s.incidence, n);
            report.error(
                &key,
                format!(
                    "direction {} (theta {}, phi {}) is direction {} again; each is measured once, so take one out",
                    n + 1,
                    incident.theta_deg,
                    incident.phi_deg,
                    first + 1
                ),
            );
        }
    }
    for (n, side) in s.incidence.sides.iter().enumerate() {
        reachable(s, i, &incidents, (n, *side), report);
    }
}

/// One issue for each axis and side, at the first direction that cannot be reached.
fn reachable(s: &Scan, i: &Instrument, incidents: &[Incident], (place, side): (usize, Side), report: &mut Report<'_>) {
    let mut beyond: BTreeMap<&str, (usize, usize, String)> = BTreeMap::new();
    for (n, incident) in incidents.iter().enumerate() {
        match Pose::of_sample(i, side, *incident) {
            Ok(_) => {}
            Err(why @ Unreachable::Limit { axis, .. }) => {
                beyond.entry(axis).or_insert_with(|| (n, 0, why.to_string())).1 += 1;
            }
            Err(why) => {
                let key = format!("incidence.sides[{place}]");
                report.error(&key, format!("{} cannot be measured: {why}; take the side out", side_name(side)));
                return;
            }
        }
    }
    for (n, count, why) in beyond.into_values() {
        let Some(incident) = incidents.get(n) else { continue };
        report.error(
            &direction_key(&s.incidence, n),
            format!(
                "{count} of {} directions cannot be lit for {}, the first at theta {}, phi {}: {why}; take them out",
                incidents.len(),
                side_name(side),
                incident.theta_deg,
                incident.phi_deg
            ),
        );
    }
}

fn direction_key(incidence: &Incidence, n: usize) -> String {
    let way = match incidence {
        Incidence { directions: Some(_), .. } => return format!("incidence.directions[{n}]"),
        Incidence { grid: Some(_), .. } => "grid",
        Incidence { ring: Some(_), .. } => "ring",
        _ => "basis",
    };
    format!("incidence.{way}")
}

fn side_name(side: Side) -> &'static str {
    match side {
        Side::TransmissionFront => "transmission-front",
        Side::ReflectionFront => "reflection-front",
        Side::TransmissionBack => "transmission-back",
        Side::ReflectionBack => "reflection-back",
    }
}

fn sides(incidence: &Incidence, report: &mut Report<'_>) {
    if incidence.sides.is_empty() {
        report.error(
            "incidence.sides",
            "`incidence.sides` is empty; name at least one side, such as \"transmission-front\"",
        );
    }
    let mut seen = BTreeSet::new();
    for (n, side) in incidence.sides.iter().enumerate() {
        if !seen.insert(side) {
            report.error(
                &format!("incidence.sides[{n}]"),
                format!("{} is named twice in `incidence.sides`; take one out", side_name(*side)),
            );
        }
    }
}

/// The slots of the scan's bands.
fn bands<'a>(s: &Scan, i: &'a Instrument, report: &mut Report<'_>) -> Vec<&'a FilterSlot> {
    let known: Vec<&str> =
        i.filter_wheel.slot.values().map(|s| s.band.as_str()).filter(|b| !NOT_BANDS.contains(b)).collect();
    if s.bands.names.is_empty() {
        report.error("bands.use", format!("`bands.use` is empty; name bands of the wheel: {}", hint::quoted(&known)));
    }
    let mut slots = Vec::new();
    for (n, name) in s.bands.names.iter().enumerate() {
        let key = format!("bands.use[{n}]");
        if s.bands.names.iter().take(n).any(|other| other == name) {
            report.error(&key, format!("`{key}` is \"{name}\" a second time; each band is measured once"));
            continue;
        }
        match i.filter_wheel.slot.values().find(|slot| slot.band == *name && known.contains(&name.as_str())) {
            Some(slot) => slots.push(slot),
            None => report.error(
                &key,
                format!(
                    "`{key}` is \"{name}\", a band that the filter wheel does not have; it has {}",
                    hint::quoted(&known)
                ),
            ),
        }
    }
    slots
}

fn exposure(s: &Scan, i: &Instrument, slots: &[&FilterSlot], report: &mut Report<'_>) {
    let e = &s.exposure;
    let sound_ratio = e.ratio > 1.0 && e.ratio <= 1000.0;
    if !sound_ratio {
        report.error(
            "exposure.ratio",
            format!(
                "`exposure.ratio` is {}, but must be above 1 and at most 1000; 4 is for a goal of 1 %, 8 for 2 %",
                e.ratio
            ),
        );
    }
    // Integration times are whole microseconds.
    let sound_times = report.range("exposure.shortest_s", e.shortest_s, 1e-6, 86_400.0)
        && report.positive("exposure.longest_s", e.longest_s, 86_400.0);
    if !(sound_ratio && sound_times) {
        return;
    }
    let ladder = e.ladder();
    let (Some(longest), Some(shortest)) = (ladder.first(), ladder.last()) else {
        report.error(
            "exposure.longest_s",
            format!(
                "no integration time lies between `shortest_s` {} and `longest_s` {}; make longest_s the larger one",
                e.shortest_s, e.longest_s
            ),
        );
        return;
    };
    if ladder.len() > MOST_EXPOSURES {
        report
            .error("exposure.ratio", format!("this ladder has more than {MOST_EXPOSURES} times; take a larger ratio"));
    }
    let cameras: BTreeMap<&String, &Camera> =
        slots.iter().filter_map(|slot| i.camera.get_key_value(slot.camera.as_ref()?)).collect();
    for (name, camera) in cameras {
        if longest.seconds() > camera.longest_s {
            report.error(
                "exposure.longest_s",
                format!(
                    "`exposure.longest_s` gives {longest}, but camera `{name}` exposes {} s at most; write {} or less",
                    camera.longest_s, camera.longest_s
                ),
            );
        }
        if shortest.seconds() < camera.shortest_s {
            report.error(
                "exposure.shortest_s",
                format!("`exposure.shortest_s` leads to {shortest}, but camera `{name}` exposes {} s at least; write {} or more", camera.shortest_s, camera.shortest_s),
            );
        }
    }
}

fn references(s: &Scan, i: &Instrument, report: &mut Report<'_>) {
    if s.reference.mode == ReferenceMode::Irradiance {
        if i.lamp.irradiance_uw_per_cm2.is_none() {
            report.error(
                "reference.mode",
                "`reference.mode` is \"irradiance\", but the instrument file does not say `lamp.irradiance_uw_per_cm2`; add it there, or write \"diffuser\"",
            );
        }
        return;
    }
    let key = if report.source.has("reference.mode") { "reference.mode" } else { "reference" };
    for (name, transmission, reference) in
        [("reflection", false, &i.reference.reflection), ("transmission", true, &i.reference.transmission)]
    {
        if !s.incidence.sides.iter().any(|side| side.is_transmission() == transmission) {
            continue;
        }
        let Some(reference) = reference else {
            report.error(
                key,
                format!("the scan measures {name} against a diffuser, but the instrument file has no [reference.{name}]; add it there, or write `mode = \"irradiance\"` under [reference]"),
            );
            continue;
        };
        if let Err(why) = Pose::of_reference(i, transmission, reference.theta_deg) {
            report
                .error(key, format!("the scan needs views of the diffuser for {name}, but it cannot be shown: {why}"));
        }
    }
}
