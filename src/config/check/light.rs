//! What makes and measures light by itself: lamp, light monitor, monochromator, spectrometer.

use super::Report;
use crate::config::instrument::{Instrument, Lamp};

/// A day in seconds: more is a slip of the unit.
const DAY_S: f64 = 86_400.0;

pub(super) fn check(i: &Instrument, report: &mut Report<'_>) {
    for (key, time) in [("lamp.warm_up_s", i.lamp.warm_up_s), ("lamp.restrike_s", i.lamp.restrike_s)] {
        if let Some(time) = time {
            report.range(key, time, 0.0, DAY_S);
        }
    }
    lamp_hours(&i.lamp, report);
    light_monitor(i, report);
    unwatched(i, report);
    monochromator(i, report);
    if let Some(spectrometer) = &i.spectrometer {
        report.text("spectrometer.serial", &spectrometer.serial);
    }
}

/// The lamp that is in, and its hours.
fn lamp_hours(lamp: &Lamp, report: &mut Report<'_>) {
    if let Some(hours) = lamp.rated_hours {
        report.positive("lamp.rated_hours", hours, 1e6);
    }
    if let Some(hours) = lamp.hours_at_start {
        report.range("lamp.hours_at_start", hours, 0.0, 1e6);
    }
    match &lamp.serial {
        Some(serial) if !Lamp::is_serial(serial) => {
            let most = Lamp::SERIAL_CHARS;
            let why = "but must begin with a letter or digit and have letters, digits, `-`, `_` and `.` only";
            report.error("lamp.serial", format!("`lamp.serial` is \"{serial}\", {why}, at most {most}; correct it"));
        }
        Some(_) => {}
        None => {
            for (key, written) in [
                ("lamp.rated_hours", lamp.rated_hours.is_some()),
                ("lamp.hours_at_start", lamp.hours_at_start.is_some()),
            ] {
                if written {
                    let why = "no effect without `lamp.serial`, by which the hours of a lamp are kept; add it";
                    report.warn(key, format!("`{key}` has {why}, or take the key out"));
                }
            }
        }
    }
}

fn light_monitor(i: &Instrument, report: &mut Report<'_>) {
    let Some(monitor) = &i.light_monitor else { return };
    if let Some(serial) = &monitor.serial {
        report.text("light_monitor.serial", serial);
    }
    report.range("light_monitor.wavelength_nm", monitor.wavelength_nm, 200.0, 2000.0);
    if let Some(average) = monitor.average {
        report.range("light_monitor.average", f64::from(average), 1.0, 1000.0);
    }
    for (key, power) in [("light_monitor.min_w", monitor.min_w), ("light_monitor.max_w", monitor.max_w)] {
        if let Some(power) = power {
            report.range(key, power, 0.0, 1000.0);
        }
    }
    if let (Some(min), Some(max)) = (monitor.min_w, monitor.max_w)
        && min >= max
    {
        let key = "light_monitor.max_w";
        report.error(key, format!("`{key}` is {max}, not above min_w {min}; swap them"));
    }
}

/// Keys of lamp and monitor that only the interlocks heed.
fn unwatched(i: &Instrument, report: &mut Report<'_>) {
    let monitor = i.light_monitor.as_ref();
    let keys = [
        ("lamp.warm_up_s", i.lamp.warm_up_s.is_some()),
        ("light_monitor.min_w", monitor.is_some_and(|m| m.min_w.is_some())),
        ("light_monitor.max_w", monitor.is_some_and(|m| m.max_w.is_some())),
    ];
    for (key, _) in keys.into_iter().filter(|(_, written)| *written) {
        let lacking = match (monitor, &i.interlocks) {
            (None, _) => "[light_monitor]",
            (_, None) => "[interlocks]",
            _ => continue,
        };
        report.warn(key, format!("`{key}` has no effect without a table {lacking}; add it, or take the key out"));
    }
    if i.lamp.restrike_s.is_some() && i.lamp.warm_up_s.is_none() {
        let key = "lamp.restrike_s";
        report.warn(key, format!("`{key}` has no effect without `lamp.warm_up_s`; add it, or take the key out"));
    }
}

fn monochromator(i: &Instrument, report: &mut Report<'_>) {
    let Some(monochromator) = &i.monochromator else { return };
    if let Some(serial) = &monochromator.serial {
        report.text("monochromator.serial", serial);
    }
    let (min, max) = (monochromator.min_nm, monochromator.max_nm);
    let finite = report.range("monochromator.min_nm", min, 0.0, 6000.0)
        && report.range("monochromator.max_nm", max, 0.0, 6000.0);
    if finite && min >= max {
        let key = "monochromator.max_nm";
        report.error(key, format!("`{key}` is {max}, not above min_nm {min}; swap them"));
    }
    report.positive("monochromator.tolerance_nm", monochromator.tolerance_nm, 10.0);
    report.range("monochromator.settle_s", monochromator.settle_s, 0.0, 60.0);
}
