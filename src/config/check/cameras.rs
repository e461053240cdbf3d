//! Cameras of an instrument: numbers, pixel formats, the tables of their drivers.

use super::Report;
use crate::config::instrument::{Camera, Instrument};
use goniod_drivers::devices::camera::{AravisTable, Packing, TriggerKind, V4l2Control, V4l2Table};
use goniod_drivers::frame::PixelFormat;
use std::collections::BTreeMap;

/// A day in seconds: more is a slip of the unit.
const DAY_S: f64 = 86_400.0;

/// Checks every camera.
pub(super) fn check(i: &Instrument, report: &mut Report<'_>) {
    if i.camera.is_empty() {
        report.error("camera", "there is no camera; add a table [camera.NAME]");
    }
    for (name, camera) in &i.camera {
        self::camera(name, camera, report);
        format(name, camera, report);
        tables(name, camera, report);
    }
    unique_serials(i, report);
}

fn camera(name: &str, camera: &Camera, report: &mut Report<'_>) {
    let at = |key: &str| format!("camera.{name}.{key}");
    report.text(&at("serial"), &camera.serial);
    for (key, size) in [("width_px", camera.width_px), ("height_px", camera.height_px)] {
        report.range(&at(key), size as f64, 16.0, 16384.0);
    }
    report.range(&at("gain"), camera.gain, 0.0, 1e6);
    let sound = report.positive(&at("shortest_s"), camera.shortest_s, DAY_S)
        && report.positive(&at("longest_s"), camera.longest_s, DAY_S);
    if sound && camera.longest_s < camera.shortest_s {
        let key = at("longest_s");
        report
            .error(&key, format!("`{key}` is {}, below shortest_s {}; swap them", camera.longest_s, camera.shortest_s));
    }
    report.range(&at("readout_s"), camera.readout_s, 0.0, 600.0);
    report.range(&at("frame_interval_s"), camera.frame_interval_s, 0.0, 600.0);
    report.range(&at("discard_frames"), f64::from(camera.discard_frames), 0.0, 100.0);
    if let Some(restart_s) = camera.restart_s {
        report.range(&at("restart_s"), restart_s, 0.0, 600.0);
    }
}

fn unique_serials(i: &Instrument, report: &mut Report<'_>) {
    let mut seen: BTreeMap<&str, &str> = BTreeMap::new();
    for (name, camera) in &i.camera {
        if let Some(other) = seen.insert(&camera.serial, name) {
            let key = format!("camera.{name}.serial");
            report.error(&key, format!("`{key}` is \"{}\", the serial number of camera {other} too", camera.serial));
        }
    }
}

/// Formats that frames of a camera may have.
fn format(name: &str, camera: &Camera, report: &mut Report<'_>) {
    let key = format!("camera.{name}.format");
    if let PixelFormat::Summed { .. } = camera.format {
        report
            .error(&key, format!("`{key}` is a sum; write the format of one frame and `sum_frames` in its table v4l2"));
    }
    if let Some(caution) = camera.format.caution() {
        report.warn(&key, format!("`{key}`: {caution}; choose a mono or Bayer format where the camera has one"));
        if camera.format == PixelFormat::Yuyv8 && camera.width_px % 2 == 1 {
            report.error(
                &format!("camera.{name}.width_px"),
                format!("`camera.{name}.width_px` is odd, but pixels of `{key}` come in pairs"),
            );
        }
        if camera.driver != "v4l2" {
            report.error(&key, format!("`{key}` comes through driver \"v4l2\" only; write a mono or Bayer format"));
        }
    }
}

/// The tables of the drivers: only that of the camera's own driver may be there.
fn tables(name: &str, camera: &Camera, report: &mut Report<'_>) {
    let there = [("v4l2", camera.v4l2.is_some()), ("aravis", camera.aravis.is_some())];
    for (driver, _) in there.into_iter().filter(|(driver, there)| *there && camera.driver != *driver) {
        let key = format!("camera.{name}.{driver}");
        report.error(
            &key,
            format!(
                "`[{key}]` is there, but the camera's driver is \"{}\"; take the table out or change the driver",
                camera.driver
            ),
        );
    }
    match camera.driver.as_str() {
        "v4l2" => v4l2(name, camera, &camera.v4l2.clone().unwrap_or_default(), report),
        "aravis" => aravis(name, camera, &camera.aravis.clone().unwrap_or_default(), report),
        _ => {}
    }
}

fn v4l2(name: &str, camera: &Camera, table: &V4l2Table, report: &mut Report<'_>) {
    let at = |key: &str| format!("camera.{name}.v4l2.{key}");
    if !camera.port.starts_with('/') {
        let key = format!("camera.{name}.port");
        let message = format!(
            "`{key}` is \"{}\", but driver \"v4l2\" needs a device path such as \"/dev/v4l/by-id/…\"",
            camera.port
        );
        report.error(&key, message);
    }
    for (key, control) in [("exposure", table.exposure), ("gain", table.gain)] {
        if let Some(control) = control {
            self::control(&at(key), control, report);
        }
    }
    if table.gain.is_some() && table.has_gain == Some(false) {
        let key = at("gain");
        report.error(&key, format!("`{key}` is there, but `has_gain` is false; take one of them out"));
    }
    for (n, control) in table.controls.iter().enumerate() {
        let key = at(&format!("controls[{n}].value"));
        if report.range(&key, control.value, f64::from(i32::MIN), f64::from(i32::MAX)) && control.value.fract() != 0.0 {
            report.error(&key, format!("`{key}` is {}, but raw values are whole numbers", control.value));
        }
    }
    let sums = table.sum_frames.unwrap_or(1);
    report.range(&at("sum_frames"), f64::from(sums), 1.0, 257.0);
    let longest = table.longest_frame_s.unwrap_or(camera.longest_s);
    if report.positive(&at("longest_frame_s"), longest, DAY_S) && camera.longest_s > longest * f64::from(sums) {
        let key = format!("camera.{name}.longest_s");
        report.error(
            &key,
            format!(
                "`{key}` is {}, more than {sums} frame(s) of at most {longest} s give; lower it, or raise `sum_frames`",
                camera.longest_s
            ),
        );
    }
    if sums > 1 && camera.format.values_per_pixel() > 1 {
        let key = at("sum_frames");
        report.error(&key, format!("`{key}` is {sums}, but frames of {:?} cannot be summed; write 1", camera.format));
    }
    report.range(&at("buffers"), f64::from(table.buffers.unwrap_or(4)), 2.0, 32.0);
    report.positive(&at("command_limit_s"), table.command_limit_s.unwrap_or(2.0), 600.0);
}

fn control(key: &str, control: V4l2Control, report: &mut Report<'_>) {
    let key = format!("{key}.scale");
    if control.scale == 0.0 || !control.scale.is_finite() {
        report.error(&key, format!("`{key}` is {}; write the physical value of one raw step", control.scale));
    }
}

fn aravis(name: &str, camera: &Camera, table: &AravisTable, report: &mut Report<'_>) {
    let at = |key: &str| format!("camera.{name}.aravis.{key}");
    if table.packing.is_some_and(|p| p != Packing::Words) && camera.format != PixelFormat::Mono12 {
        let key = at("packing");
        report.error(
            &key,
            format!("`{key}` packs 12-bit mono pixels, but the format is {:?}; write \"words\"", camera.format),
        );
    }
    match (table.trigger, table.frame_rate_hz) {
        (Some(TriggerKind::FreeRun), rate) => {
            report.positive(&at("frame_rate_hz"), rate.unwrap_or(1.0), 10_000.0);
        }
        (_, Some(_)) => {
            let key = at("frame_rate_hz");
            report.error(
                &key,
                format!("`{key}` has no meaning with a software trigger; take it out, or write trigger = \"free-run\""),
            );
        }
        (_, None) => {}
    }
    let seconds = [
        ("margin_s", table.margin_s),
        ("command_limit_s", table.command_limit_s),
        ("frame_retention_s", table.frame_retention_s),
    ];
    for (key, value) in seconds {
        report.positive(&at(key), value.unwrap_or(1.0), 600.0);
    }
    report.range(&at("heartbeat_s"), table.heartbeat_s.unwrap_or(3.0), 0.5, 65.0);
    report.range(&at("packet_size_bytes"), f64::from(table.packet_size_bytes.unwrap_or(8000)), 576.0, 16_260.0);
    report.range(&at("packet_delay_ns"), f64::from(table.packet_delay_ns.unwrap_or(0)), 0.0, 1e9);
    let buffer = f64::from(table.socket_buffer_bytes.unwrap_or(4 << 20));
    report.range(&at("socket_buffer_bytes"), buffer, 65_536.0, f64::from(i32::MAX));
    if let Some(cooler) = &table.cooler {
        report.text(&at("cooler.feature"), &cooler.feature);
    }
}
