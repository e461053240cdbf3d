//! The bench of real devices: serial ports, USB, network.

use super::{BenchError, Opened, devices};
use crate::config::check::Checked;
use crate::config::instrument::{self, Instrument};
use crate::control::devices::bench::{Bench, Devices, Settle};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::Camera;
use goniod_drivers::devices::CameraConfig;
use goniod_drivers::table;
use goniod_drivers::transport::Connector;
use std::collections::BTreeMap;

/// Opens the hardware of an instrument.
///
/// # Errors
/// [`BenchError`]: a camera of the simulated bench, a driver that is not in this build or refuses its configuration.
pub fn open_hardware(checked: &Checked, clock: Clock) -> Result<Opened, BenchError> {
    let instrument = &checked.instrument;
    let cameras = cameras(instrument, clock)?;
    let devices = devices(instrument, clock, |driver, port| connect(instrument, driver, port, clock), cameras)?;
    Ok(Opened {
        bench: Bench::new(devices, Settle::of(instrument)),
        seed: None,
        #[cfg(feature = "sim")]
        faults: None,
    })
}

/// What moves, and every real camera whose driver can be had: for the safe state, one missing must not stop the others.
pub(super) fn direct(instrument: &Instrument, clock: Clock) -> Result<Devices, BenchError> {
    let real = instrument.camera.iter().filter(|(_, c)| !c.driver.starts_with("sim-"));
    let cameras = real.filter_map(|(name, c)| Some((name.clone(), camera(name, c, clock).ok()?))).collect();
    devices(instrument, clock, |driver, port| connect(instrument, driver, port, clock), cameras)
}

/// The real cameras of an instrument; simulated ones are refused.
fn cameras(instrument: &Instrument, clock: Clock) -> Result<BTreeMap<String, Box<dyn Camera>>, BenchError> {
    let made = instrument.camera.iter().map(|(name, camera)| match camera.driver.starts_with("sim-") {
        true => Err(BenchError::CameraDriver { camera: name.clone(), driver: camera.driver.clone() }),
        false => Ok((name.clone(), self::camera(name, camera, clock)?)),
    });
    made.collect()
}

/// A real camera, made by its driver; nothing is sent.
pub(super) fn camera(name: &str, camera: &instrument::Camera, clock: Clock) -> Result<Box<dyn Camera>, BenchError> {
    Ok(table::camera(&camera.driver, camera_config(name, camera), clock)?)
}

/// What the instrument file says about a camera, for its driver or its twin.
pub(super) fn camera_config(name: &str, camera: &instrument::Camera) -> CameraConfig {
    CameraConfig {
        name: format!("camera.{name}"),
        port: camera.port.clone(),
        serial: camera.serial.clone(),
        width: camera.width_px,
        height: camera.height_px,
        format: camera.format,
        shortest_s: camera.shortest_s,
        longest_s: camera.longest_s,
        readout_s: camera.readout_s,
        frame_interval_s: camera.frame_interval_s,
        discard_frames: camera.discard_frames,
        v4l2: camera.v4l2.clone(),
        aravis: camera.aravis.clone(),
    }
}

#[cfg(feature = "serial")]
pub(super) fn connect(
    instrument: &Instrument,
    driver: &str,
    port: &str,
    clock: Clock,
) -> Result<Box<dyn Connector>, BenchError> {
    let baud = table::lookup(driver)?.baud;
    let asked = instrument.holder.flow_control.filter(|_| instrument.holder.port == port);
    let flow = asked.unwrap_or_else(|| table::flow_control(driver));
    Ok(Box::new(goniod_drivers::transport::SerialConnector::new(port, baud, clock).with_flow(flow)))
}

#[cfg(not(feature = "serial"))]
pub(super) fn connect(_: &Instrument, _: &str, _: &str, _: Clock) -> Result<Box<dyn Connector>, BenchError> {
    Err(BenchError::Lacks { what: "serial ports", feature: "serial" })
}
