//! Recovery and interlocks of the instrument file: numbers in their bounds, devices that exist, alarms beyond warnings.

use super::Report;
use crate::config::hint;
use crate::config::instrument::Instrument;
use crate::config::night::Interlocks;

/// A day in seconds: more is a slip of the unit.
const DAY_S: f64 = 86_400.0;

pub(super) fn check(i: &Instrument, report: &mut Report<'_>) {
    let all = &i.recovery;
    policy(report, "recovery", (Some(all.attempts), Some(&all.backoff_s), Some(all.longest_outage_s)));
    let mut known = vec!["shutter", "filter_wheel", "tilt", "spin"];
    known.extend(i.holder.changer.as_ref().map(|_| "changer"));
    known.extend(i.camera.keys().map(String::as_str));
    for (name, own) in &all.device {
        let key = format!("recovery.device.{name}");
        if !known.contains(&name.as_str()) {
            let meant = hint::nearest(name, known.iter().copied());
            let meant = meant.map_or_else(
                || format!("known are {}", hint::quoted(&known)),
                |near| format!("did you mean \"{near}\"?"),
            );
            report.error(&key, format!("`{key}` is for \"{name}\", which is no device of this instrument; {meant}"));
        }
        policy(report, &key, (own.attempts, own.backoff_s.as_ref(), own.longest_outage_s));
    }
    if let Some(interlocks) = &i.interlocks {
        self::interlocks(interlocks, report);
    }
}

fn policy(
    report: &mut Report<'_>,
    key: &str,
    (attempts, backoff_s, outage_s): (Option<u32>, Option<&Vec<f64>>, Option<f64>),
) {
    if let Some(attempts) = attempts {
        report.range(&format!("{key}.attempts"), f64::from(attempts), 0.0, 100.0);
    }
    if let Some(outage_s) = outage_s {
        report.range(&format!("{key}.longest_outage_s"), outage_s, 0.0, 7.0 * DAY_S);
    }
    let Some(waits) = backoff_s else { return };
    if waits.is_empty() {
        let at = format!("{key}.backoff_s");
        report
            .error(&at, format!("`{at}` is empty; write the waits before the attempts in seconds, such as [1.0, 5.0]"));
    }
    for (n, wait_s) in waits.iter().enumerate() {
        report.range(&format!("{key}.backoff_s[{n}]"), *wait_s, 0.1, 3600.0);
    }
}

fn interlocks(i: &Interlocks, report: &mut Report<'_>) {
    let at = |name: &str| format!("interlocks.{name}");
    report.range(&at("period_s"), i.period_s, 0.5, 3600.0);
    report.range(&at("warm_up_s"), i.warm_up_s, 0.0, DAY_S);
    report.range(&at("longest_suspension_s"), i.longest_suspension_s, 0.0, 7.0 * DAY_S);
    for (name, value, most) in [
        ("lamp_drift_warning", i.lamp_drift_warning, 1.0),
        ("lamp_drift_alarm", i.lamp_drift_alarm, 10.0),
        ("drift_per_view", i.drift_per_view, 1.0),
        ("temperature_warning_c", i.temperature_warning_c, 200.0),
        ("temperature_alarm_c", i.temperature_alarm_c, 200.0),
        ("free_disk_warning_mb", i.free_disk_warning_mb, 1e9),
        ("free_disk_alarm_mb", i.free_disk_alarm_mb, 1e9),
    ] {
        if let Some(value) = value {
            report.positive(&at(name), value, most);
        }
    }
    ordered(report, ("lamp_drift_warning", i.lamp_drift_warning), ("lamp_drift_alarm", i.lamp_drift_alarm));
    ordered(report, ("temperature_warning_c", i.temperature_warning_c), ("temperature_alarm_c", i.temperature_alarm_c));
    ordered(report, ("free_disk_alarm_mb", i.free_disk_alarm_mb), ("free_disk_warning_mb", i.free_disk_warning_mb));
}

/// Refuses a second limit that is not above the first.
fn ordered(report: &mut Report<'_>, (first, low): (&str, Option<f64>), (second, high): (&str, Option<f64>)) {
    if let (Some(low), Some(high)) = (low, high)
        && high <= low
    {
        let key = format!("interlocks.{second}");
        report.error(&key, format!("`{key}` is {high}, not above {first} {low}; correct one of them"));
    }
}
