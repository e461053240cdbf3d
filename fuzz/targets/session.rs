//! What every driver of the table is put through: open, ask, act, make safe. Nothing may panic or stay away, and what a
//! driver says to have proven must be what it was told to prove.

use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{
    Device, FilterWheel, LightMonitor, Monochromator, RotaryAxis, Shutter, ShutterState, Spectrometer,
};
use goniod_drivers::devices::{
    AxisConfig, LightMonitorConfig, MonochromatorConfig, ShutterConfig, SpectrometerConfig, WheelConfig,
};
use goniod_drivers::error::Result as Answer;
use goniod_drivers::table::{Make, lookup};
use goniod_drivers::transport::{Connector, UsbConnector};
use goniod_drivers::units::{Degrees, DegreesPerSecond, ExposureTime, Nanometres, Slot};
use std::future::Future;
use std::time::Duration;

/// Longest that one call may take in the driver's own time: far beyond every limit of any driver, near enough to never.
const NEVER: Duration = Duration::from_secs(3600);
/// Places of the wheels by driver: what the twins have.
const PLACES: [(&str, u8); 2] = [("thorlabs-fw212c", 12), ("optec-ifw", 9)];

/// What carries a driver's bytes.
pub enum Wire {
    /// A serial line.
    Line(Box<dyn Connector>),
    /// A USB device.
    Usb(Box<dyn UsbConnector>),
}

/// A runtime whose time passes when nobody has anything to do.
pub fn paused() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().expect("a runtime")
}

/// The driver called `name` over `wire`. Must be called in a runtime.
///
/// # Errors
/// The promise that it broke.
pub async fn session(name: &str, wire: Wire) -> Result<(), String> {
    let driver = lookup(name).map_err(|e| e.to_string())?;
    let clock = Clock::system();
    let settle = Duration::from_millis(50);
    match (driver.make, wire) {
        (Make::Holder(make), Wire::Line(line)) => axis(make(line, vec![axis_config()], clock)).await,
        (Make::FilterWheel(make), Wire::Line(line)) => {
            let places = PLACES.iter().find(|(n, _)| *n == name).map_or(6, |p| p.1);
            let config = WheelConfig { name: "wheel".into(), places, dark: Some(Slot(places)), settle };
            wheel(make(line, config, clock)).await
        }
        (Make::Shutter(make), Wire::Line(line)) => {
            shutter(make(line, ShutterConfig { name: "shutter".into(), settle }, clock)).await
        }
        (Make::Monochromator(make), Wire::Line(line)) => monochromator(make(line, tuning(settle), clock)).await,
        (Make::LightMonitor(make), Wire::Line(line)) => monitor(make(line, meter(""), clock)).await,
        (Make::UsbLightMonitor(make), Wire::Usb(usb)) => monitor(make(usb, meter("P0001234"), clock)).await,
        (Make::Spectrometer(make), Wire::Usb(usb)) => {
            let config = SpectrometerConfig { name: "spectrometer".into(), serial: "USB2G1234".into() };
            spectrometer(make(usb, config, clock)).await
        }
        _ => Err(format!("`{name}` is not made over this kind of wire")),
    }
}

fn axis_config() -> AxisConfig {
    AxisConfig {
        name: "tilt".into(),
        device: 1,
        axis: 1,
        serial: "1001".into(),
        min: Degrees(-5.0),
        max: Degrees(365.0),
        speed: DegreesPerSecond(10.0),
        acceleration_deg_per_s2: 20.0,
        tolerance: Degrees(0.01),
        settle: Duration::from_millis(200),
    }
}

fn tuning(settle: Duration) -> MonochromatorConfig {
    MonochromatorConfig {
        name: "monochromator".into(),
        serial: "11042".into(),
        min: Nanometres(300.0),
        max: Nanometres(1100.0),
        tolerance: Nanometres(0.2),
        settle,
    }
}

fn meter(serial: &str) -> LightMonitorConfig {
    LightMonitorConfig {
        name: "light_monitor".into(),
        serial: serial.into(),
        wavelength: Nanometres(550.0),
        average: 30,
    }
}

/// The answer of a call that came back.
async fn back<T>(what: &str, call: impl Future<Output = Answer<T>>) -> Result<Option<T>, String> {
    match tokio::time::timeout(NEVER, call).await {
        Err(_) => Err(format!("`{what}` did not come back within an hour of its own time")),
        Ok(Ok(value)) => Ok(Some(value)),
        Ok(Err(error)) if error.message.is_empty() || error.device.is_empty() => {
            Err(format!("`{what}` fails without words: {error:?}"))
        }
        Ok(Err(_)) => Ok(None),
    }
}

fn proven(what: &str, holds: bool) -> Result<(), String> {
    if holds { Ok(()) } else { Err(format!("{what} is said to be proven")) }
}

async fn device(device: &mut (impl Device + ?Sized), serial: &str) -> Result<(), String> {
    if let Some(identity) = back("open", device.open()).await? {
        proven(&format!("{identity:?}"), serial.is_empty() || identity.serial.contains(serial))?;
    }
    back("health", device.health()).await?;
    Ok(())
}

async fn axis(axes: Vec<Box<dyn RotaryAxis>>) -> Result<(), String> {
    for mut axis in axes {
        device(axis.as_mut(), "1001").await?;
        back("home", axis.home()).await?;
        if let Some(at) = back("move_to", axis.move_to(Degrees(30.0))).await? {
            proven(&format!("{at} for 30"), (at.0 - 30.0).abs() <= 0.01)?;
        }
        if let Some(Some(at)) = back("position", axis.position()).await? {
            proven(&format!("position {at}"), at.0.is_finite())?;
        }
        back("stop", axis.stop()).await?;
        back("make_safe", axis.make_safe()).await?;
    }
    Ok(())
}

async fn wheel(mut wheel: Box<dyn FilterWheel>) -> Result<(), String> {
    device(wheel.as_mut(), "").await?;
    if let Some(slot) = back("select", wheel.select(Slot(5))).await? {
        proven(&format!("{slot} for 5"), slot == Slot(5))?;
    }
    if let Some(Some(slot)) = back("slot", wheel.slot()).await? {
        proven(&format!("{slot}"), (1..=wheel.slots()).contains(&slot.0))?;
    }
    back("make_safe", wheel.make_safe()).await?;
    Ok(())
}

async fn shutter(mut shutter: Box<dyn Shutter>) -> Result<(), String> {
    device(shutter.as_mut(), "").await?;
    back("set", shutter.set(ShutterState::Open)).await?;
    back("state", shutter.state()).await?;
    back("make_safe", shutter.make_safe()).await?;
    Ok(())
}

async fn monochromator(mut monochromator: Box<dyn Monochromator>) -> Result<(), String> {
    device(monochromator.as_mut(), "11042").await?;
    if let Some(at) = back("tune", monochromator.tune(Nanometres(550.0))).await? {
        proven(&format!("{at} for 550 nm"), (at.0 - 550.0).abs() <= 0.2)?;
    }
    back("wavelength", monochromator.wavelength()).await?;
    back("make_safe", monochromator.make_safe()).await?;
    Ok(())
}

async fn monitor(mut monitor: Box<dyn LightMonitor>) -> Result<(), String> {
    device(monitor.as_mut(), "").await?;
    if let Some(at) = back("apply", monitor.apply(Nanometres(633.0))).await? {
        proven(&format!("{at} for 633 nm"), (at.0 - 633.0).abs() <= 1.0)?;
    }
    if let Some(reading) = back("read", monitor.read()).await? {
        proven(&format!("{reading:?}"), reading.power_w.is_finite())?;
    }
    back("make_safe", monitor.make_safe()).await?;
    Ok(())
}

async fn spectrometer(mut spectrometer: Box<dyn Spectrometer>) -> Result<(), String> {
    device(spectrometer.as_mut(), "USB2G1234").await?;
    back("apply", spectrometer.apply(ExposureTime(50_000))).await?;
    if let Some(spectrum) = back("acquire", spectrometer.acquire()).await? {
        let nm = &spectrum.wavelength_nm;
        proven("a spectrum of two lengths", nm.len() == spectrum.counts.len())?;
        proven("a wavelength that does not rise", nm.windows(2).all(|w| w[0] < w[1]))?;
        proven("a count that is no number", spectrum.counts.iter().all(|c| c.is_finite()))?;
    }
    back("make_safe", spectrometer.make_safe()).await?;
    Ok(())
}
