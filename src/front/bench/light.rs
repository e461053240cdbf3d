//! Light monitor, monochromator and spectrometer of an instrument, on serial lines or on USB.

use super::{BenchError, Connect};
use crate::config::instrument::Instrument;
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{LightMonitor, Monochromator, Spectrometer};
use goniod_drivers::devices::{LightMonitorConfig, MonochromatorConfig, SpectrometerConfig};
use goniod_drivers::table::{self, Make};
use goniod_drivers::transport::UsbConnector;
use goniod_drivers::units::Nanometres;
use std::time::Duration;

/// The light monitor, where the instrument has one; nothing is sent.
pub(super) fn monitor(
    instrument: &Instrument,
    clock: Clock,
    connect: Connect<'_>,
) -> Result<Option<Box<dyn LightMonitor>>, BenchError> {
    let Some(monitor) = &instrument.light_monitor else { return Ok(None) };
    let config = LightMonitorConfig {
        name: "light_monitor".to_owned(),
        serial: monitor.serial.clone().unwrap_or_default(),
        wavelength: Nanometres(monitor.wavelength_nm),
        average: monitor.average.unwrap_or(1),
    };
    let (driver, port) = (monitor.driver.as_str(), monitor.port.as_str());
    Ok(Some(match table::lookup(driver)?.make {
        Make::UsbLightMonitor(_) => table::usb_light_monitor(driver, usb(port, clock)?, config, clock)?,
        _ => table::light_monitor(driver, connect(driver, port)?, config, clock)?,
    }))
}

/// The monochromator, where the instrument has one.
pub(super) fn monochromator(
    instrument: &Instrument,
    clock: Clock,
    connect: Connect<'_>,
) -> Result<Option<Box<dyn Monochromator>>, BenchError> {
    let Some(monochromator) = &instrument.monochromator else { return Ok(None) };
    let config = MonochromatorConfig {
        name: "monochromator".to_owned(),
        serial: monochromator.serial.clone().unwrap_or_default(),
        min: Nanometres(monochromator.min_nm),
        max: Nanometres(monochromator.max_nm),
        tolerance: Nanometres(monochromator.tolerance_nm),
        settle: Duration::try_from_secs_f64(monochromator.settle_s).unwrap_or_default(),
    };
    let (driver, port) = (monochromator.driver.as_str(), monochromator.port.as_str());
    Ok(Some(table::monochromator(driver, connect(driver, port)?, config, clock)?))
}

/// The spectrometer, where the instrument has one.
pub(super) fn spectrometer(instrument: &Instrument, clock: Clock) -> Result<Option<Box<dyn Spectrometer>>, BenchError> {
    let Some(spectrometer) = &instrument.spectrometer else { return Ok(None) };
    let config = SpectrometerConfig { name: "spectrometer".to_owned(), serial: spectrometer.serial.clone() };
    let port = spectrometer.port.as_str();
    let connector = if port.starts_with("sim:") { simulated(port, &config.serial, clock)? } else { usb(port, clock)? };
    Ok(Some(table::spectrometer(&spectrometer.driver, connector, config, clock)?))
}

#[cfg(feature = "usb")]
fn usb(port: &str, clock: Clock) -> Result<Box<dyn UsbConnector>, BenchError> {
    use goniod_drivers::transport::usb::{LibUsb, UsbThread};
    Ok(Box::new(UsbThread::new(LibUsb::new(port.parse()?), clock)))
}

#[cfg(not(feature = "usb"))]
fn usb(_: &str, _: Clock) -> Result<Box<dyn UsbConnector>, BenchError> {
    Err(BenchError::Lacks { what: "USB instruments", feature: "usb" })
}

#[cfg(feature = "sim")]
use super::simulated::spectrometer as simulated;

#[cfg(not(feature = "sim"))]
fn simulated(_: &str, _: &str, _: Clock) -> Result<Box<dyn UsbConnector>, BenchError> {
    Err(BenchError::Lacks { what: "simulated spectrometer", feature: "sim" })
}
