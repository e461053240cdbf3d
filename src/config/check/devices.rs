//! The instrument's devices by themselves: drivers, ports, axes, wheel, cameras, safe state.

use super::{Options, Report, cameras, light};
use crate::config::error::Issue;
use crate::config::hint;
use crate::config::instrument::{Axis, Changer, FilterSlot, Instrument, Link};
use crate::config::load::Loaded;
use goniod_drivers::table::feature_of;
use std::collections::BTreeMap;

/// Names that `safe_state.order` may hold.
const SAFE_NAMES: [&str; 6] = ["shutter", "tilt", "spin", "changer", "filter_wheel", "cameras"];

/// Least speed of an axis, degrees per second, and least acceleration, degrees per second².
const SLOWEST: f64 = 0.001;

/// Bands that no camera photographs.
pub(super) const NOT_BANDS: [&str; 2] = ["open", "dark"];

pub(super) fn check(instrument: &Loaded<Instrument>, options: &Options, issues: &mut Vec<Issue>) {
    let mut report = Report { source: &instrument.source, issues };
    let i = &instrument.value;
    report.text("name", &i.name);
    if i.runs_dir.as_os_str().is_empty() {
        report.error("runs_dir", "`runs_dir` is empty; write the folder that run directories are made in");
    }
    drivers(i, options, &mut report);
    ports(i, &mut report);
    axes(i, &mut report);
    wheel(i, &mut report);
    report.range("shutter.settle_s", i.shutter.settle_s, 0.0, 60.0);
    light::check(i, &mut report);
    cameras::check(i, &mut report);
    safe_state(i, &mut report);
    super::night::check(i, &mut report);
}

fn drivers(i: &Instrument, options: &Options, report: &mut Report<'_>) {
    for Link { key: device, driver, .. } in i.links() {
        if options.drivers.is_empty() || options.drivers.iter().any(|d| d == driver) {
            continue;
        }
        let known: Vec<&str> = options.drivers.iter().map(String::as_str).collect();
        let key = format!("{device}.driver");
        if let Some(feature) = feature_of(driver) {
            let message =
                format!("`{key}` is \"{driver}\", which this build lacks; build goniod with `--features {feature}`");
            report.error(&key, message);
            continue;
        }
        let meant = match hint::nearest(driver, known.iter().copied()) {
            Some(near) => format!("did you mean \"{near}\"?"),
            None => format!("known are {}", hint::quoted(&known)),
        };
        report.error(&key, format!("`{key}` is \"{driver}\", a driver that does not exist; {meant}"));
    }
}

fn ports(i: &Instrument, report: &mut Report<'_>) {
    let (cameras, moving): (Vec<_>, Vec<_>) = i.links().into_iter().partition(|link| link.camera().is_some());
    let bench = moving.iter().find(|link| link.is_simulated());
    let real = moving.iter().find(|link| !link.is_simulated());
    if let (Some(first), Some(Link { key: device, port, .. })) = (bench, real) {
        let key = format!("{device}.port");
        let message = format!(
            "`{key}` is \"{port}\", but the port of {} starts with `sim:`; what moves is all hardware or all simulated: make every port of holder, filter wheel and shutter `sim:…` or none",
            first.key
        );
        report.error(&key, message);
    }
    for camera in &cameras {
        let (key, driver, port) = (format!("{}.port", camera.key), camera.driver, camera.port);
        match (driver.starts_with("sim-"), camera.is_simulated()) {
            (false, true) => report.error(
                &key,
                format!("`{key}` is \"{port}\", but driver \"{driver}\" drives real cameras; write its address or device path, or name a simulated camera's driver"),
            ),
            (true, true) if bench.is_none() => report.error(
                &key,
                format!("`{key}` is \"{port}\", but holder, filter wheel and shutter are real, so there is nothing for it to photograph; name a real camera, or make their ports `sim:…`"),
            ),
            _ => {}
        }
    }
    let mut seen: BTreeMap<&str, String> = BTreeMap::new();
    for link in i.links() {
        let (key, port) = (format!("{}.port", link.key), link.port);
        report.text(&key, port);
        if link.is_simulated() && i.simulation.is_none() {
            report.error(
                &key,
                format!("`{key}` is \"{port}\", but there is no table [simulation]; add it, or name a real port"),
            );
        }
        if let Some(other) = seen.insert(port, link.key.clone()) {
            report.error(&key, format!("`{key}` is \"{port}\", which {other} uses already; each link has one device"));
        }
    }
}

fn axes(i: &Instrument, report: &mut Report<'_>) {
    let mut all = vec![("holder.tilt", &i.holder.tilt), ("holder.spin", &i.holder.spin)];
    if let Some(changer) = &i.holder.changer {
        all.push(("holder.changer.axis", &changer.axis));
    }
    let mut seen: BTreeMap<(u8, u8), &str> = BTreeMap::new();
    for (key, axis) in &all {
        self::axis(key, axis, report);
        if let Some(other) = seen.insert((axis.device, axis.axis), key) {
            report.error(
                &format!("{key}.device"),
                format!(
                    "`{key}` is axis {} of device {} in the chain, which is {other} already; each axis has one place",
                    axis.axis, axis.device
                ),
            );
        }
    }
    changer_places(i, report);
}

fn axis(key: &str, axis: &Axis, report: &mut Report<'_>) {
    let at = |name: &str| format!("{key}.{name}");
    for (name, number) in [("device", axis.device), ("axis", axis.axis)] {
        if number == 0 {
            report.error(&at(name), format!("`{}` is 0; devices and axes are counted from 1", at(name)));
        }
    }
    report.text(&at("serial"), &axis.serial);
    let finite = report.range(&at("min_deg"), axis.min_deg, -3600.0, 3600.0)
        && report.range(&at("max_deg"), axis.max_deg, -3600.0, 3600.0);
    if finite && axis.min_deg >= axis.max_deg {
        report.error(
            &at("max_deg"),
            format!("`{}` is {}, not above min_deg {}; swap them", at("max_deg"), axis.max_deg, axis.min_deg),
        );
    }
    report.range(&at("zero_deg"), axis.zero_deg, -3600.0, 3600.0);
    // Slower is no stage: a turn would take more than four days.
    report.range(&at("speed_deg_per_s"), axis.speed_deg_per_s, SLOWEST, 1000.0);
    report.range(&at("acceleration_deg_per_s2"), axis.acceleration_deg_per_s2, SLOWEST, 1e5);
    report.positive(&at("tolerance_deg"), axis.tolerance_deg, 5.0);
    report.range(&at("settle_s"), axis.settle_s, 0.0, 600.0);
}

fn changer_places(i: &Instrument, report: &mut Report<'_>) {
    let Some(changer) = &i.holder.changer else { return };
    operator(changer, report);
    let places = [
        ("sample_deg", Some(changer.sample_deg)),
        ("sample_flipped_deg", Some(changer.sample_flipped_deg)),
        ("reflection_reference_deg", changer.reflection_reference_deg),
        ("transmission_reference_deg", changer.transmission_reference_deg),
    ];
    let mut seen: Vec<(&str, f64)> = Vec::new();
    for (name, angle) in places.into_iter().filter_map(|(n, a)| a.map(|a| (n, a))) {
        let key = format!("holder.changer.{name}");
        let (min, max) = (changer.axis.min_deg, changer.axis.max_deg);
        let commanded = changer.axis.zero_deg + angle;
        if !(commanded >= min && commanded <= max) {
            report.error(
                &key,
                format!("`{key}` is {angle}, which needs the changer at {commanded} degrees, but it may go from {min} to {max}"),
            );
        }
        if let Some((other, _)) = seen.iter().find(|(_, a)| (a - angle).abs() <= 2.0 * changer.axis.tolerance_deg) {
            report.error(
                &key,
                format!("`{key}` is {angle}, the same place as {other}; the changer shows one thing a place"),
            );
        }
        seen.push((name, angle));
    }
}

fn operator(changer: &Changer, report: &mut Report<'_>) {
    let key = "holder.changer.driver";
    if let Some(driver) = changer.driver.as_deref().filter(|d| *d != Changer::OPERATOR) {
        report.error(
            key,
            format!(
                "`{key}` is \"{driver}\"; write \"operator\" for a person, or take it out for an axis of the holder"
            ),
        );
    }
    let key = "holder.changer.confirm_within_s";
    match (changer.confirm_within_s, &changer.driver) {
        (Some(_), None) => {
            report.error(key, format!("`{key}` is for an operator; add driver = \"operator\", or take it out"))
        }
        (Some(within), _) => {
            report.range(key, within, 1.0, 604_800.0);
        }
        (None, _) => {}
    }
}

fn wheel(i: &Instrument, report: &mut Report<'_>) {
    let wheel = &i.filter_wheel;
    if wheel.places < 2 {
        report.error("filter_wheel.places", "`filter_wheel.places` must be at least 2; write what the wheel reports");
    }
    report.positive("filter_wheel.step_s", wheel.step_s, 60.0);
    report.range("filter_wheel.settle_s", wheel.settle_s, 0.0, 60.0);
    if wheel.slot.is_empty() {
        report.error("filter_wheel.slot", "the wheel has no slot; add tables [filter_wheel.slot.1] and on");
    }
    let mut bands: BTreeMap<&str, &str> = BTreeMap::new();
    for (number, slot) in &wheel.slot {
        let key = format!("filter_wheel.slot.{number}");
        let written_plainly =
            number.parse::<u8>().is_ok_and(|n| n.to_string() == *number && n >= 1 && n <= wheel.places);
        if !written_plainly {
            report.error(&key, format!("`{key}` is no place of this wheel; its places are 1 to {}", wheel.places));
        }
        if let Some(other) = bands.insert(&slot.band, number) {
            report.error(
                &format!("{key}.band"),
                format!("`{key}.band` is \"{}\", which slot {other} is already; each band has one slot", slot.band),
            );
        }
        self::slot(i, &key, slot, report);
    }
}

fn slot(i: &Instrument, key: &str, slot: &FilterSlot, report: &mut Report<'_>) {
    report.text(&format!("{key}.band"), &slot.band);
    for (n, glass) in slot.glasses.iter().enumerate() {
        report.positive(&format!("{key}.glasses[{n}].thickness_mm"), glass.thickness_mm, 100.0);
    }
    if NOT_BANDS.contains(&slot.band.as_str()) {
        for (name, written) in [("camera", slot.camera.is_some()), ("interval_nm", slot.interval_nm.is_some())] {
            if written {
                report.error(
                    &format!("{key}.{name}"),
                    format!("`{key}.{name}` has no meaning for \"{}\"; take it out", slot.band),
                );
            }
        }
        return;
    }
    if slot.glasses.is_empty() {
        report.error(
            &format!("{key}.glasses"),
            format!("slot `{key}` is band \"{}\" without a filter; name its glasses, or call it \"open\"", slot.band),
        );
    }
    match slot.interval_nm {
        None => report.error(&format!("{key}.interval_nm"), format!("`{key}` lacks `interval_nm`; write [from, to]")),
        Some([lo, hi]) if lo < hi && lo >= 200.0 && hi <= 3000.0 => {}
        Some([lo, hi]) => report.error(
            &format!("{key}.interval_nm"),
            format!("`{key}.interval_nm` is [{lo}, {hi}], but must rise and lie within 200 to 3000 nanometres"),
        ),
    }
    let known: Vec<&str> = i.camera.keys().map(String::as_str).collect();
    match &slot.camera {
        None => report
            .error(&format!("{key}.camera"), format!("`{key}` lacks `camera`; write one of {}", hint::quoted(&known))),
        Some(name) if i.camera.contains_key(name) => {}
        Some(name) => report.error(
            &format!("{key}.camera"),
            format!("`{key}.camera` is \"{name}\", a camera that is not there; write one of {}", hint::quoted(&known)),
        ),
    }
}

fn safe_state(i: &Instrument, report: &mut Report<'_>) {
    report.positive("safe_state.limit_s", i.safe_state.limit_s, 3600.0);
    let order = &i.safe_state.order;
    for (n, name) in order.iter().enumerate() {
        let key = format!("safe_state.order[{n}]");
        if !SAFE_NAMES.contains(&name.as_str()) {
            let meant = hint::nearest(name, SAFE_NAMES.into_iter());
            let meant = meant.map_or_else(
                || format!("known are {}", hint::quoted(&SAFE_NAMES)),
                |m| format!("did you mean \"{m}\"?"),
            );
            report.error(&key, format!("`{key}` is \"{name}\", no name of a device; {meant}"));
        } else if order.iter().take(n).any(|other| other == name) {
            report.error(&key, format!("`{key}` is \"{name}\" a second time; name each device once"));
        } else if name == "changer" && i.holder.changer.is_none() {
            report.error(&key, format!("`{key}` is \"changer\", but the holder has none; take it out"));
        }
    }
    for name in SAFE_NAMES {
        if order.iter().any(|n| n == name) || (name == "changer" && i.holder.changer.is_none()) {
            continue;
        }
        let message = format!("`safe_state.order` does not name \"{name}\", which then stays as it is when a run ends");
        if name == "shutter" {
            report.error("safe_state.order", format!("{message}; the beam must be shut: add it"));
        } else {
            report.warn("safe_state.order", format!("{message}; add it unless that is meant"));
        }
    }
}
