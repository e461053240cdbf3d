//! Opens the bench for a plan: hardware through the driver table, or, when every port starts with `sim:`, the
//! simulated one. The only file outside `sim/` that names the simulator.

use crate::config::check::Checked;
use crate::config::instrument::{Axis, Instrument};
use crate::control::devices::bench::{Bench, Devices, Settle};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{Camera, RotaryAxis};
use goniod_drivers::devices::{AxisConfig, ShutterConfig, WheelConfig};
use goniod_drivers::error::DeviceError;
use goniod_drivers::table;
use goniod_drivers::transport::{Connector, SerialConnector};
use goniod_drivers::units::{Degrees, DegreesPerSecond, Slot};
use goniod_sim::camera::FaultQueue;
use goniod_sim::truth::error::SimError;
use goniod_sim::twins::{Twins, TwinsSpec};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// Camera drivers that this build knows, for the checks of instrument files.
pub const CAMERA_DRIVERS: [&str; 2] = ["sim-ccd", "sim-ingaas"];

/// Why a bench cannot be opened.
#[derive(Debug, Error)]
pub enum BenchError {
    /// Simulated and real ports together.
    #[error(
        "the instrument mixes simulated and real ports ({simulated} starts with `sim:`, {real} does not); \
         a bench is all hardware or all simulated: make every port `sim:…` or none"
    )]
    Mixed {
        /// A simulated one.
        simulated: String,
        /// A real one.
        real: String,
    },
    /// A camera driver that is not in this build.
    #[error(
        "camera `{camera}`: driver `{driver}` photographs the simulated bench only, and this build has no other camera \
         driver; rehearse the scan, or make every port of the instrument `sim:…`"
    )]
    CameraDriver {
        /// Camera.
        camera: String,
        /// Its driver.
        driver: String,
    },
    /// The instrument has no simulated bench.
    #[error(
        "the instrument has no [simulation] table, so there is no bench to rehearse on; add it (bench, seed), \
         or name an instrument that has one with --instrument"
    )]
    NoSimulation,
    /// No sample lies in the simulated bench.
    #[error(
        "the scan does not say which sample lies in the simulated bench; set `simulated` in [sample], or give --sample FILE"
    )]
    NoSample,
    /// The simulated bench's files.
    #[error(transparent)]
    Simulation(#[from] SimError),
    /// A device's driver.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

/// What a rehearsal changes about the simulated bench.
#[derive(Debug, Clone, Default)]
pub struct Rehearsal {
    /// Seed instead of the instrument's.
    pub seed: Option<u64>,
    /// Sample file instead of the scan's.
    pub sample: Option<PathBuf>,
}

/// A bench ready for the sequencer.
pub struct Opened {
    /// The devices.
    pub bench: Bench,
    /// Seed of the simulated bench; absent on hardware.
    pub seed: Option<u64>,
    /// Where faults are put into the simulated bench; absent on hardware.
    pub faults: Option<Faults>,
}

/// Faults to come on a simulated bench.
pub struct Faults {
    /// Holder, wheel and shutter.
    pub twins: Twins,
    /// Frames of each camera.
    pub cameras: BTreeMap<String, FaultQueue>,
}

/// True when the instrument's ports all belong to the simulated bench.
///
/// # Errors
/// [`BenchError::Mixed`].
pub fn is_simulated(instrument: &Instrument) -> Result<bool, BenchError> {
    let ports = ports(instrument);
    let (simulated, real): (Vec<_>, Vec<_>) = ports.into_iter().partition(|(_, port)| port.starts_with("sim:"));
    match (simulated.first(), real.first()) {
        (Some((s, _)), Some((r, _))) => Err(BenchError::Mixed { simulated: s.clone(), real: r.clone() }),
        (s, _) => Ok(s.is_some()),
    }
}

fn ports(instrument: &Instrument) -> Vec<(String, String)> {
    let mut ports = vec![
        ("holder".to_owned(), instrument.holder.port.clone()),
        ("filter_wheel".to_owned(), instrument.filter_wheel.port.clone()),
        ("shutter".to_owned(), instrument.shutter.port.clone()),
    ];
    ports.extend(instrument.camera.iter().map(|(name, c)| (format!("camera.{name}"), c.port.clone())));
    ports
}

/// Opens what the instrument file says: hardware, or in real time the simulated bench.
///
/// # Errors
/// Those of the two.
pub fn open(checked: &Checked, clock: Clock) -> Result<Opened, BenchError> {
    if is_simulated(&checked.instrument)? {
        open_simulated(checked, &Rehearsal::default(), clock)
    } else {
        open_hardware(checked, clock)
    }
}

/// Opens the hardware of an instrument.
///
/// # Errors
/// [`BenchError`]: a camera driver that is not in this build, a driver that refuses its configuration.
pub fn open_hardware(checked: &Checked, clock: Clock) -> Result<Opened, BenchError> {
    let instrument = &checked.instrument;
    if let Some((name, camera)) = instrument.camera.iter().next() {
        return Err(BenchError::CameraDriver { camera: name.clone(), driver: camera.driver.clone() });
    }
    let connect = |driver: &str, port: &str| -> Result<Box<dyn Connector>, BenchError> {
        Ok(Box::new(SerialConnector::new(port, table::lookup(driver)?.baud, clock)))
    };
    let devices = devices(instrument, clock, connect, BTreeMap::new())?;
    Ok(Opened { bench: Bench::new(devices, Settle::of(instrument)), seed: None, faults: None })
}

/// Opens the simulated bench that an instrument names.
///
/// # Errors
/// [`BenchError`]: no simulation table, no sample, files of the bench that are wrong.
pub fn open_simulated(checked: &Checked, rehearsal: &Rehearsal, clock: Clock) -> Result<Opened, BenchError> {
    let instrument = &checked.instrument;
    let simulation = instrument.simulation.as_ref().ok_or(BenchError::NoSimulation)?;
    let description = checked.bench.as_ref().ok_or(BenchError::NoSimulation)?;
    let sample = rehearsal.sample.as_ref().or(checked.simulated_sample.as_ref()).ok_or(BenchError::NoSample)?;
    let seed = rehearsal.seed.unwrap_or(simulation.seed);
    let holder = &instrument.holder;
    let changer = holder.changer.as_ref().map_or("50003", |c| c.axis.serial.as_str());
    let twins = Twins::new(TwinsSpec::with_serials(&holder.tilt.serial, &holder.spin.serial, changer));
    let bench = goniod_sim::bench::Bench::open(description, sample, seed, Arc::new(twins.clone()), clock)?;
    let mut cameras: BTreeMap<String, Box<dyn Camera>> = BTreeMap::new();
    let mut faults = Faults { twins: twins.clone(), cameras: BTreeMap::new() };
    for name in instrument.camera.keys() {
        faults.cameras.insert(name.clone(), bench.faults(name)?);
        cameras.insert(name.clone(), Box::new(bench.camera(name)?));
    }
    let connect = |_: &str, port: &str| {
        twins.connector(port, clock).ok_or_else(|| {
            BenchError::Simulation(SimError::Unknown {
                what: "port",
                name: port.to_owned(),
                known: "`sim:holder`, `sim:filter-wheel`, `sim:shutter`".to_owned(),
            })
        })
    };
    // A rehearsal of a real instrument reaches the twins whatever the instrument's ports are called.
    let mut twin_ports = instrument.clone();
    twin_ports.holder.port = "sim:holder".to_owned();
    twin_ports.filter_wheel.port = "sim:filter-wheel".to_owned();
    twin_ports.shutter.port = "sim:shutter".to_owned();
    let devices = devices(&twin_ports, clock, connect, cameras)?;
    Ok(Opened { bench: Bench::new(devices, Settle::of(instrument)), seed: Some(seed), faults: Some(faults) })
}

fn devices(
    instrument: &Instrument,
    clock: Clock,
    mut connect: impl FnMut(&str, &str) -> Result<Box<dyn Connector>, BenchError>,
    cameras: BTreeMap<String, Box<dyn Camera>>,
) -> Result<Devices, BenchError> {
    let holder = &instrument.holder;
    let mut axes = vec![axis("tilt", &holder.tilt), axis("spin", &holder.spin)];
    axes.extend(holder.changer.as_ref().map(|c| axis("changer", &c.axis)));
    let connector = connect(&holder.driver, &holder.port)?;
    let mut made = table::holder(&holder.driver, connector, axes, clock)?.into_iter();
    let lacking =
        || DeviceError::new(goniod_drivers::error::ErrorKind::Broken, "holder", "its driver made too few axes");
    let mut next = || -> Result<Box<dyn RotaryAxis>, DeviceError> { made.next().ok_or_else(lacking) };
    let (tilt, spin) = (next()?, next()?);
    let changer = holder.changer.as_ref().map(|_| next()).transpose()?;
    let wheel = &instrument.filter_wheel;
    let dark = wheel.slot.iter().find(|(_, s)| s.band == "dark").and_then(|(number, _)| number.parse().ok());
    let wheel_config = WheelConfig {
        name: "filter_wheel".to_owned(),
        places: wheel.places,
        dark: dark.map(Slot),
        settle: Duration::ZERO,
    };
    let shutter_config = ShutterConfig { name: "shutter".to_owned(), settle: Duration::ZERO };
    Ok(Devices {
        tilt,
        spin,
        changer,
        wheel: table::filter_wheel(&wheel.driver, connect(&wheel.driver, &wheel.port)?, wheel_config, clock)?,
        shutter: table::shutter(
            &instrument.shutter.driver,
            connect(&instrument.shutter.driver, &instrument.shutter.port)?,
            shutter_config,
            clock,
        )?,
        cameras,
    })
}

/// The driver's configuration of an axis. Settling is the sequencer's wait, so the driver has none.
fn axis(name: &str, axis: &Axis) -> AxisConfig {
    AxisConfig {
        name: name.to_owned(),
        device: axis.device,
        axis: axis.axis,
        serial: axis.serial.clone(),
        min: Degrees(axis.min_deg),
        max: Degrees(axis.max_deg),
        speed: DegreesPerSecond(axis.speed_deg_per_s),
        acceleration_deg_per_s2: axis.acceleration_deg_per_s2,
        tolerance: Degrees(axis.tolerance_deg),
        settle: Duration::ZERO,
    }
}
