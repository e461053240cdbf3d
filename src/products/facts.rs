//! From a run and its reduction to what every product says about them.

use super::context::{BandRow, Checks, Counts, ProductContext, SampleHeader, UncertaintyComponent};
use super::error::Result;
use super::export::matrix::FilledBlock;
use super::night::night;
use super::reduce::{Facts, Run};
use crate::archive::rows::{EventRow, StepState};
use crate::config::scan::{ReferenceMode, Symmetry};
use crate::control::events::Event;
use crate::control::lamp_hours::LampAge;
use crate::engine::bsdf::fill::fill;
use crate::engine::bsdf::matrix::Matrix;
use crate::engine::bsdf::set::{BsdfSet, Quantity};
use crate::engine::optics::side::Side;
use jiff::Timestamp;
use std::collections::BTreeMap;

/// The context of a run's products. Holds only the run's own dates.
pub fn context(run: &Run, set: &BsdfSet, facts: &Facts) -> Result<ProductContext> {
    let (scan, instrument) = (&run.document.scan, &run.document.instrument);
    let (events, steps) = run.dir.with(|journal| Ok((journal.events()?, journal.steps()?)))?;
    let Story { serials, finished, lamp_hours } = story(&events);
    let sample = &scan.sample;
    Ok(ProductContext {
        run_id: run.document.run_id.clone(),
        scan_name: scan.name.clone(),
        sample: SampleHeader {
            name: sample.name.clone().unwrap_or_else(|| scan.name.clone()),
            manufacturer: sample.manufacturer.clone().unwrap_or_default(),
            thickness_mm: sample.thickness_mm,
            device_type: sample.device_type.clone(),
        },
        instrument: instrument.name.clone(),
        serials,
        started: run.document.started.parse().unwrap_or(Timestamp::UNIX_EPOCH),
        finished,
        lamp: run.document.instrument.lamp.spectrum.display().to_string(),
        lamp_hours,
        normalisation: normalisation(run),
        bands: bands(run),
        plan_hash: run.document.plan.hash.clone(),
        versions: versions(run),
        counts: counts(run)?,
        night: night(&run.document, &events, &steps),
        checks: checks(run, set, facts),
        uncertainty: budget(facts),
        notes: notes(run, facts),
    })
}

/// Who answered, when the last thing happened, and how old the lamp became.
struct Story {
    serials: Vec<(String, String)>,
    finished: Option<Timestamp>,
    lamp_hours: Option<String>,
}

/// Reads the story from the journal.
fn story(events: &[EventRow]) -> Story {
    let mut serials: Vec<(String, String)> = Vec::new();
    let mut finished = None;
    // Of the first process that worked on the run, and of the last one.
    let (mut first, mut ages): (Option<LampAge>, Vec<LampAge>) = (None, Vec::new());
    for row in events {
        match serde_json::from_str::<Event>(&row.json) {
            Ok(Event::DeviceOpened { device, identity }) => {
                let words = format!("{} {} (firmware {})", identity.model, identity.serial, identity.firmware);
                if !serials.iter().any(|(d, w)| *d == device && *w == words) {
                    serials.push((device, words));
                }
            }
            Ok(Event::RunStarted { .. }) => ages.clear(),
            Ok(Event::LampHours { age }) => {
                first.get_or_insert_with(|| age.clone());
                ages.push(age);
            }
            Ok(Event::RunEnded { .. }) => finished = Timestamp::from_microsecond(row.utc_us).ok(),
            _ => {}
        }
    }
    let lamp_hours = first.map(|first| lamp_hours(&first, ages.get(1)));
    Story { serials, finished, lamp_hours }
}

/// Hours at the beginning and the end of the run; a process that was killed tells none at its end.
fn lamp_hours(first: &LampAge, last: Option<&LampAge>) -> String {
    let end = last.map_or_else(|| "unknown".to_owned(), LampAge::hours_in_words);
    let rated = first.rated_h.map_or_else(|| "rated hours unknown".to_owned(), |rated| format!("rated {rated:.0} h"));
    format!("lamp {}: {} at the beginning, {end} at the end; {rated}", first.serial, first.hours_in_words())
}

fn normalisation(run: &Run) -> String {
    let references = &run.document.instrument.reference;
    match run.document.scan.reference.mode {
        ReferenceMode::Irradiance => "by the lamp's irradiance and absolute camera calibration (eq. 1, 12)".to_owned(),
        ReferenceMode::Diffuser => {
            let names: Vec<String> = [&references.reflection, &references.transmission]
                .into_iter()
                .flatten()
                .map(|r| format!("{} at {:.0} degrees", r.name, r.theta_deg))
                .collect();
            format!("ratio to known diffusers: {}", names.join("; "))
        }
    }
}

fn bands(run: &Run) -> Vec<BandRow> {
    let used = &run.document.scan.bands.names;
    let slots = run.document.instrument.filter_wheel.slot.values();
    let mut rows: Vec<BandRow> = slots
        .filter(|s| used.contains(&s.band))
        .map(|s| BandRow {
            name: s.band.clone(),
            interval_nm: s.interval_nm.unwrap_or_default(),
            glasses: s
                .glasses
                .iter()
                .map(|g| format!("{} {} mm", g.glass, g.thickness_mm))
                .collect::<Vec<_>>()
                .join(" + "),
            camera: s.camera.clone().unwrap_or_default(),
        })
        .collect();
    rows.sort_by_key(|r| used.iter().position(|u| *u == r.name));
    rows
}

fn versions(run: &Run) -> Vec<(String, String)> {
    let mut versions = vec![
        ("goniod, run".to_owned(), run.document.goniod_version.clone()),
        ("goniod, products".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
    ];
    for (camera, c) in &run.document.calibrations {
        versions.push((format!("calibration of {camera}"), format!("{} (valid until {})", c.date, c.valid_until)));
    }
    for file in &run.document.files {
        versions.push((format!("{} ({})", file.name, file.role), file.sha256.get(..16).unwrap_or("").to_owned()));
    }
    versions
}

fn counts(run: &Run) -> Result<Counts> {
    let (steps, summary) = run.dir.with(|journal| Ok((journal.steps()?, journal.summary()?)))?;
    let mut reasons: BTreeMap<String, u64> = BTreeMap::new();
    for step in &steps {
        if let StepState::Missing(reason) = &step.state {
            *reasons.entry(reason.clone()).or_default() += 1;
        }
    }
    Ok(Counts {
        planned: steps.len() as u64,
        stored: u64::from(summary.stored),
        missing: u64::from(summary.missing),
        rejected: u64::from(summary.rejected),
        missing_reasons: reasons.into_iter().collect(),
    })
}

fn checks(run: &Run, set: &BsdfSet, facts: &Facts) -> Checks {
    let started: Timestamp = run.document.started.parse().unwrap_or(Timestamp::UNIX_EPOCH);
    let day = started.to_zoned(jiff::tz::TimeZone::UTC).date();
    let overdue = run
        .document
        .calibrations
        .values()
        .map(|c| day.since((jiff::Unit::Day, c.valid_until)).map_or(i64::MAX, |span| i64::from(span.get_days())));
    Checks {
        reciprocity: reciprocity(run, set),
        drift: facts.largest_reference_change,
        below_floor: Some(facts.floor_relative),
        calibration_overdue_days: overdue.max(),
    }
}

/// Largest reciprocity error of the headline quantity over what was measured in both directions of light.
fn reciprocity(run: &Run, set: &BsdfSet) -> Option<f64> {
    let quantity = Quantity::headline(&set.quantities);
    let matrix = |side| filled(run, set, quantity, side);
    let pairs = [
        (Side::TransmissionFront, Side::TransmissionBack),
        (Side::ReflectionFront, Side::ReflectionFront),
        (Side::ReflectionBack, Side::ReflectionBack),
    ];
    let errors = pairs.iter().filter_map(|&(a, b)| matrix(a).reciprocity(&matrix(b), &set.basis));
    errors.fold(None, |largest, e| Some(largest.map_or(e, |l: f64| l.max(e))))
}

fn filled(run: &Run, set: &BsdfSet, quantity: usize, side: Side) -> Matrix {
    let isotropic = run.document.scan.sample.symmetry == Symmetry::Isotropic;
    fill(set, side, quantity, isotropic)
}

fn budget(facts: &Facts) -> Vec<UncertaintyComponent> {
    let line = |(name, relative): &(String, f64)| UncertaintyComponent {
        name: name.clone(),
        relative: *relative,
        correlated: !name.starts_with("counting"),
        source: "root mean square over the patches, relative to their root mean square value".to_owned(),
    };
    facts.budget.iter().map(line).collect()
}

fn notes(run: &Run, facts: &Facts) -> Vec<String> {
    let mut notes = facts.notes.clone();
    if let Some(seed) = run.document.simulated_seed {
        notes.push(format!("SIMULATED: measured on the simulated bench, seed {seed}; no real sample was measured."));
    }
    for dark in &facts.darks {
        notes.push(format!(
            "Dark signal of {}: {} hot pixels left out, {} too dark to be read one by one, standard uncertainty {:.2e}/s of a \
             pixel's rate, {:.2e}/s of what all share.",
            dark.camera, dark.hot_pixels, dark.unreadable_pixels, dark.u_rate, dark.u_common
        ));
    }
    notes
}

/// T and R of the measured column nearest to the normal, a line a side and total, for the terminal.
pub fn headline(set: &BsdfSet) -> Vec<String> {
    let mut lines = Vec::new();
    for side in Side::ALL {
        for (q, quantity) in set.quantities.iter().enumerate() {
            if matches!(quantity, Quantity::Band { .. }) {
                continue;
            }
            let of = set.columns.iter().filter(|c| c.side == side && c.quantity == q);
            let Some(c) = of.min_by(|a, b| a.incident.theta.total_cmp(&b.incident.theta)) else { continue };
            lines.push(format!(
                "{:<20} {:<8} at {:>4.1}°   {:.4} ± {:.4} (k = 2)",
                super::context::side_words(side),
                quantity.name(),
                c.incident.degrees().0,
                c.hemispherical,
                2.0 * c.hemispherical_u
            ));
        }
    }
    lines
}

/// Blocks of one quantity for the Klems file, filled as far as symmetry allows.
pub fn blocks(run: &Run, set: &BsdfSet, quantity: usize) -> Vec<FilledBlock> {
    let known = |side: &Side| set.columns.iter().any(|c| c.side == *side && c.quantity == quantity);
    let block = |side: Side| FilledBlock::of_matrix(side, &filled(run, set, quantity, side));
    Side::ALL.into_iter().filter(known).map(block).collect()
}
