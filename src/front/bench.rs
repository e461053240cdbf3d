//! Opens the bench for a plan: what moves through the driver table or, when its ports start with `sim:`, as twins of the
//! simulated bench; cameras by their drivers, so that a real camera may photograph beside a simulated bench.

pub mod by_hand;
mod hardware;
mod light;
#[cfg(feature = "sim")]
pub mod served;
#[cfg(feature = "sim")]
mod simulated;

pub use hardware::open_hardware;
#[cfg(feature = "sim")]
pub use simulated::{Faults, PaintedTruth, Schedule, open_simulated, open_with_own_cameras, read_pixels, verb};

use crate::config::check::Checked;
use crate::config::instrument::{Axis, Instrument, Link};
use crate::control::devices::bench::{Bench, Devices, Settle};
use crate::control::sequencer::verbs::Verb;
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{Camera, FilterWheel, RotaryAxis, Shutter};
use goniod_drivers::devices::operator::{Desk, Operator, Place};
use goniod_drivers::devices::{AxisConfig, ShutterConfig, WheelConfig};
use goniod_drivers::error::DeviceError;
use goniod_drivers::table;
use goniod_drivers::transport::Connector;
use goniod_drivers::units::{Degrees, DegreesPerSecond, Slot};
use std::collections::BTreeMap;
use std::time::Duration;
use thiserror::Error;
use tokio::sync::mpsc;

/// Drivers of the simulated bench's own cameras that this build has, for the checks of instrument files.
pub const CAMERA_DRIVERS: &[&str] = if cfg!(feature = "sim") { &["sim-ccd", "sim-ingaas"] } else { &[] };

/// Why a bench cannot be opened.
#[derive(Debug, Error)]
pub enum BenchError {
    /// Simulated and real ports together.
    #[error(
        "the instrument mixes simulated and real ports ({simulated} starts with `sim:`, {real} does not); \
         what moves is all hardware or all simulated: make the ports of holder, filter wheel and shutter `sim:…` or none of them"
    )]
    Mixed {
        /// A simulated one.
        simulated: String,
        /// A real one.
        real: String,
    },
    /// A simulated camera before a real bench.
    #[error(
        "camera `{camera}`: driver `{driver}` photographs the simulated bench only; rehearse the scan, \
         name the driver of a real camera, or make every port of the instrument `sim:…`"
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
    /// A part that only another build has.
    #[error("this build has no {what}; build goniod with `--features {feature}`")]
    Lacks {
        /// What it lacks.
        what: &'static str,
        /// The feature that brings it.
        feature: &'static str,
    },
    /// The simulated bench's files.
    #[cfg(feature = "sim")]
    #[error(transparent)]
    Simulation(#[from] goniod_sim::truth::error::SimError),
    /// A bench for other processes.
    #[cfg(feature = "sim")]
    #[error(transparent)]
    Served(goniod_sim::served::ServeError),
    /// A device's driver.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

/// What a rehearsal changes about the simulated bench.
#[derive(Debug, Clone, Default)]
pub struct Rehearsal {
    /// Seed instead of the instrument's.
    pub seed: Option<u64>,
    /// What goes wrong on the way.
    pub faults: FaultMix,
}

/// How much goes wrong in a rehearsal.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum FaultMix {
    /// Nothing.
    #[default]
    None,
    /// A few faults that pass by themselves.
    Typical,
    /// Many, some at the same time, some that last.
    Nasty,
}

/// A bench ready for the sequencer.
pub struct Opened {
    /// The devices.
    pub bench: Bench,
    /// Seed of the simulated bench; absent on hardware.
    pub seed: Option<u64>,
    /// Where faults are put into the simulated bench; absent on hardware.
    #[cfg(feature = "sim")]
    pub faults: Option<Faults>,
}

/// Tells how often each kind of fault really happened so far.
pub type Fired = Box<dyn Fn() -> BTreeMap<String, u32> + Send>;

// === impl Opened ===

impl Opened {
    /// Begins what is to go wrong during a run forecast to last `span_s` seconds; `None` where nothing is.
    #[cfg(feature = "sim")]
    pub fn begin_faults(&self, span_s: f64, verbs: mpsc::Sender<Verb>, clock: Clock) -> Option<Fired> {
        self.faults.as_ref()?.begin(self.seed.unwrap_or_default(), span_s, verbs, clock)
    }

    /// Nothing goes wrong by plan without a simulated bench.
    #[cfg(not(feature = "sim"))]
    pub fn begin_faults(&self, _: f64, _: mpsc::Sender<Verb>, _: Clock) -> Option<Fired> {
        None
    }
}

/// True when what moves belongs to the simulated bench.
///
/// # Errors
/// [`BenchError::Mixed`].
pub fn is_simulated(instrument: &Instrument) -> Result<bool, BenchError> {
    let wires = instrument.links().into_iter().filter(|link| link.camera().is_none());
    let (simulated, real): (Vec<_>, Vec<_>) = wires.partition(Link::is_simulated);
    match (simulated.first(), real.first()) {
        (Some(s), Some(r)) => Err(BenchError::Mixed { simulated: s.key.clone(), real: r.key.clone() }),
        (s, _) => Ok(s.is_some()),
    }
}

/// Opens the bench as the instrument file says it: hardware, or the simulated bench with the cameras that are named.
///
/// # Errors
/// [`BenchError`].
pub fn open_as_written(checked: &Checked, clock: Clock) -> Result<Opened, BenchError> {
    if is_simulated(&checked.instrument)? {
        open_with_own_cameras(checked, &Rehearsal::default(), clock)
    } else {
        open_hardware(checked, clock)
    }
}

/// The bench for the safe state alone: no calibration, no spectra, no sample; nothing is sent yet.
///
/// # Errors
/// [`BenchError`]: a driver that is not in this build or refuses its configuration.
pub fn open_direct(instrument: &Instrument, clock: Clock) -> Result<Bench, BenchError> {
    #[cfg(feature = "sim")]
    if is_simulated(instrument)? {
        return Ok(Bench::new(simulated::direct(instrument, clock)?, Settle::of(instrument)));
    }
    Ok(Bench::new(hardware::direct(instrument, clock)?, Settle::of(instrument)))
}

/// The simulated bench of a build without one.
///
/// # Errors
/// [`BenchError::Lacks`], always.
#[cfg(not(feature = "sim"))]
pub fn open_simulated(_: &Checked, _: &Rehearsal, _: Clock) -> Result<Opened, BenchError> {
    Err(BenchError::Lacks { what: "simulated bench", feature: "sim" })
}

#[cfg(not(feature = "sim"))]
use open_simulated as open_with_own_cameras;

/// What moves, through the driver table, with these cameras.
fn devices(
    instrument: &Instrument,
    clock: Clock,
    mut connect: impl FnMut(&str, &str) -> Result<Box<dyn Connector>, BenchError>,
    cameras: BTreeMap<String, Box<dyn Camera>>,
) -> Result<Devices, BenchError> {
    let mut axes = holder(instrument, clock, &mut connect)?.into_iter();
    let lacking =
        || DeviceError::new(goniod_drivers::error::ErrorKind::Broken, "holder", "its driver made too few axes");
    let mut next = || -> Result<Box<dyn RotaryAxis>, DeviceError> { axes.next().ok_or_else(lacking) };
    let (tilt, spin) = (next()?, next()?);
    let person = operator(instrument);
    let desk = person.as_ref().map(|(_, desk)| desk.clone());
    let changer: Option<Box<dyn RotaryAxis>> = match person {
        Some((operator, _)) => Some(Box::new(operator)),
        None => instrument.holder.changer.as_ref().map(|_| next()).transpose()?,
    };
    Ok(Devices {
        tilt,
        spin,
        changer,
        operator: desk,
        wheel: filter_wheel(instrument, clock, &mut connect)?,
        shutter: shutter(instrument, clock, &mut connect)?,
        light_monitor: light::monitor(instrument, clock, &mut connect)?,
        cameras,
    })
}

/// How a serial device's link is opened: driver and port to a connector.
type Connect<'a> = &'a mut dyn FnMut(&str, &str) -> Result<Box<dyn Connector>, BenchError>;

/// Tilt, spin and, where there is one, changer.
fn holder(instrument: &Instrument, clock: Clock, connect: Connect<'_>) -> Result<Vec<Box<dyn RotaryAxis>>, BenchError> {
    let holder = &instrument.holder;
    let mut axes = vec![axis("tilt", &holder.tilt), axis("spin", &holder.spin)];
    let driven = holder.changer.as_ref().filter(|c| c.operator_within().is_none());
    axes.extend(driven.map(|c| axis("changer", &c.axis)));
    Ok(table::holder(&holder.driver, connect(&holder.driver, &holder.port)?, axes, clock)?)
}

/// A person as changer, where the instrument has one, and the desk where they are asked.
fn operator(instrument: &Instrument) -> Option<(Operator, Desk)> {
    let changer = instrument.holder.changer.as_ref().filter(|c| c.operator_within().is_some())?;
    let place = |angle: f64, words: &str| Place { at: Degrees(changer.axis.zero_deg + angle), words: words.to_owned() };
    let mut places = vec![
        place(changer.sample_deg, "put the sample in with its interior side to the camera"),
        place(changer.sample_flipped_deg, "turn the sample about the vertical, its exterior side to the camera"),
    ];
    places.extend(changer.reflection_reference_deg.map(|at| place(at, "put the reflecting diffuser in")));
    places.extend(changer.transmission_reference_deg.map(|at| place(at, "put the transmitting diffuser in")));
    let desk = Desk::default();
    Some((Operator::new(axis("changer", &changer.axis), places, desk.clone()), desk))
}

fn filter_wheel(
    instrument: &Instrument,
    clock: Clock,
    connect: Connect<'_>,
) -> Result<Box<dyn FilterWheel>, BenchError> {
    let wheel = &instrument.filter_wheel;
    let dark = wheel.slot.iter().find(|(_, s)| s.band == "dark").and_then(|(number, _)| number.parse().ok());
    let config = WheelConfig {
        name: "filter_wheel".to_owned(),
        places: wheel.places,
        dark: dark.map(Slot),
        settle: Duration::ZERO,
    };
    Ok(table::filter_wheel(&wheel.driver, connect(&wheel.driver, &wheel.port)?, config, clock)?)
}

fn shutter(instrument: &Instrument, clock: Clock, connect: Connect<'_>) -> Result<Box<dyn Shutter>, BenchError> {
    let shutter = &instrument.shutter;
    let config = ShutterConfig { name: "shutter".to_owned(), settle: Duration::ZERO };
    Ok(table::shutter(&shutter.driver, connect(&shutter.driver, &shutter.port)?, config, clock)?)
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
