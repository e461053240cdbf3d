//! The simulated bench. The only file outside `sim/` that names the simulator, but for the type of its errors.

use super::{BenchError, FaultMix, Fired, Opened, Rehearsal, devices, hardware};
use crate::config::check::Checked;
use crate::config::instrument::Instrument;
use crate::control::devices::bench::{Bench, Devices, Settle};
use crate::control::sequencer::verbs::Verb;
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::Camera;
use goniod_drivers::transport::{Connector, UsbConnector};
use goniod_sim::camera::FaultQueue;
use goniod_sim::faults::{Around, Counts, Mix, Targets, Wish, carry_out};
use goniod_sim::firmware::usb::oceanoptics::{OceanModel, OceanSpec, OceanTwin};
use goniod_sim::front::UsbBus;
use goniod_sim::truth::error::SimError;
use goniod_sim::twins::{PORTS, Twins, TwinsSpec};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;

pub use goniod_sim::faults::Schedule;
pub use goniod_sim::oracle::read_pixels;
pub use goniod_sim::paint::PaintedTruth;

/// Faults to come on a simulated bench.
pub struct Faults {
    /// Holder, wheel and shutter.
    pub twins: Twins,
    /// Frames of each simulated camera.
    pub cameras: BTreeMap<String, FaultQueue>,
    /// What is to go wrong during the run.
    pub mix: FaultMix,
    /// The bench has a light monitor, so that faults of the lamp are told.
    pub light_monitor: bool,
}

// === impl Faults ===

impl Faults {
    /// Lets the faults of the mix happen from now on, drawn from `seed` over a night of `span_s` seconds; the operator's
    /// part goes to `verbs`.
    pub(super) fn begin(&self, seed: u64, span_s: f64, verbs: mpsc::Sender<Verb>, clock: Clock) -> Option<Fired> {
        let mix = match self.mix {
            FaultMix::None => return None,
            FaultMix::Typical => Mix::Typical,
            FaultMix::Nasty => Mix::Nasty,
        };
        let span = Duration::try_from_secs_f64(span_s).unwrap_or_default();
        let schedule = Schedule::of(mix, self.light_monitor, seed, span);
        // Disk and process of a rehearsal are real; what happens to those is for tests.
        let around = move |what| matches!(what, Around::Ask(wish) if verbs.try_send(verb(wish)).is_ok());
        let counts = self.carry_out(schedule, Arc::new(around), clock);
        Some(Box::new(move || counts.fired().into_iter().map(|(kind, n)| (kind.to_string(), n)).collect()))
    }

    /// Lets the faults of a schedule happen from now on; what is around the bench is done by `around`.
    pub fn carry_out(
        &self,
        schedule: Schedule,
        around: Arc<dyn Fn(Around) -> bool + Send + Sync>,
        clock: Clock,
    ) -> Counts {
        let counts = Counts::default();
        let targets = Targets { twins: self.twins.clone(), cameras: self.cameras.clone(), around };
        tokio::spawn(carry_out(schedule, targets, clock, counts.clone()));
        counts
    }
}

/// What an operator wishes, as the verb for the run.
pub fn verb(wish: Wish) -> Verb {
    match wish {
        Wish::Pause => Verb::Pause,
        Wish::PauseNow => Verb::PauseNow,
        Wish::Resume => Verb::Resume,
        Wish::Stop => Verb::Stop,
        Wish::Abort => Verb::Abort,
        Wish::Safe => Verb::Safe,
    }
}

/// Opens the simulated bench that an instrument names, with simulated cameras whatever the file calls them: a rehearsal.
///
/// # Errors
/// [`BenchError`]: no simulation table, no sample, files of the bench that are wrong.
pub fn open_simulated(checked: &Checked, rehearsal: &Rehearsal, clock: Clock) -> Result<Opened, BenchError> {
    open(checked, rehearsal, clock, false)
}

/// The same with the cameras of the instrument file: a real one photographs what is before it.
///
/// # Errors
/// As [`open_simulated`]; a camera driver that is not in this build or refuses its configuration.
pub fn open_with_own_cameras(checked: &Checked, rehearsal: &Rehearsal, clock: Clock) -> Result<Opened, BenchError> {
    open(checked, rehearsal, clock, true)
}

fn open(checked: &Checked, rehearsal: &Rehearsal, clock: Clock, own_cameras: bool) -> Result<Opened, BenchError> {
    let instrument = &checked.instrument;
    let simulation = instrument.simulation.as_ref().ok_or(BenchError::NoSimulation)?;
    let description = checked.bench.as_ref().ok_or(BenchError::NoSimulation)?;
    let sample = checked.simulated_sample.as_ref().ok_or(BenchError::NoSample)?;
    let seed = rehearsal.seed.unwrap_or(simulation.seed);
    let (twins, bench) = parts(instrument, description, sample, seed, clock)?;
    let mut cameras: BTreeMap<String, Box<dyn Camera>> = BTreeMap::new();
    let light_monitor = instrument.light_monitor.is_some();
    let mut faults = Faults { twins: twins.clone(), cameras: BTreeMap::new(), mix: rehearsal.faults, light_monitor };
    for (name, camera) in &instrument.camera {
        if own_cameras && !camera.driver.starts_with("sim-") {
            cameras.insert(name.clone(), hardware::camera(name, camera, clock)?);
        } else {
            faults.cameras.insert(name.clone(), bench.faults(name)?);
            cameras.insert(name.clone(), Box::new(bench.camera(name)?));
        }
    }
    let connect = |_: &str, port: &str| connect(&twins, port, clock);
    let devices = devices(&twin_ports(instrument), clock, connect, cameras)?;
    Ok(Opened { bench: Bench::new(devices, Settle::of(instrument)), seed: Some(seed), faults: Some(faults) })
}

/// The twins and the bench whose lamp they look at.
pub(super) fn parts(
    instrument: &Instrument,
    description: &Path,
    sample: &Path,
    seed: u64,
    clock: Clock,
) -> Result<(Twins, goniod_sim::bench::Bench), BenchError> {
    let holder = &instrument.holder;
    let changer = holder.changer.as_ref().map_or("50003", |c| c.axis.serial.as_str());
    let drivers = [&holder.driver, &instrument.filter_wheel.driver, &instrument.shutter.driver].map(String::as_str);
    let mut spec = TwinsSpec::with_serials(&holder.tilt.serial, &holder.spin.serial, changer).with_drivers(drivers)?;
    spec.wheel.places = instrument.filter_wheel.places;
    let serial = instrument.monochromator.as_ref().and_then(|m| m.serial.as_deref());
    if let Some(serial) = serial.and_then(|s| s.parse().ok()) {
        spec.monochromator.serial = serial;
    }
    let twins = Twins::new(spec);
    let bench = goniod_sim::bench::Bench::open(description, sample, seed, Arc::new(twins.clone()), clock)?;
    twins.look_at(bench.lamp());
    Ok((twins, bench))
}

pub(super) fn connect(twins: &Twins, port: &str, clock: Clock) -> Result<Box<dyn Connector>, BenchError> {
    twins.connector(port, clock).ok_or_else(|| {
        let known = PORTS.map(|p| format!("`{p}`")).join(", ");
        BenchError::Simulation(SimError::Unknown { what: "port", name: port.to_owned(), known })
    })
}

/// Name of the simulated spectrometer's port.
const SPECTROMETER: &str = "sim:spectrometer";

/// A spectrometer with this serial number in the light of the lamp's model, powered up now.
pub(super) fn spectrometer(port: &str, serial: &str, clock: Clock) -> Result<Box<dyn UsbConnector>, BenchError> {
    if port != SPECTROMETER {
        let (what, name, known) = ("spectrometer port", port.to_owned(), format!("`{SPECTROMETER}`"));
        return Err(BenchError::Simulation(SimError::Unknown { what, name, known }));
    }
    let twin = OceanTwin::new(OceanSpec::new(OceanModel::Usb2000, serial), clock.now());
    Ok(Box::new(UsbBus::new(port, twin).connector(clock)))
}

/// A rehearsal of a real instrument reaches the twins whatever the instrument's ports are called; a light monitor of
/// another make is played by the twin that there is.
pub(super) fn twin_ports(instrument: &Instrument) -> Instrument {
    let mut twins = instrument.clone();
    twins.holder.port = "sim:holder".to_owned();
    twins.filter_wheel.port = "sim:filter-wheel".to_owned();
    twins.shutter.port = "sim:shutter".to_owned();
    if let Some(changer) = &mut twins.holder.changer {
        // Nobody stands at a simulated bench: the twin's third axis turns the sample.
        changer.driver = None;
    }
    if let Some(monitor) = &mut twins.light_monitor {
        monitor.port = "sim:light-monitor".to_owned();
        monitor.driver = "newport-1830c".to_owned();
        monitor.serial = None;
    }
    twins
}

/// What moves on a simulated bench of its own: nothing outside this process is reached.
pub(super) fn direct(instrument: &Instrument, clock: Clock) -> Result<Devices, BenchError> {
    let holder = &instrument.holder;
    let changer = holder.changer.as_ref().map_or("50003", |c| c.axis.serial.as_str());
    let drivers = [&holder.driver, &instrument.filter_wheel.driver, &instrument.shutter.driver].map(String::as_str);
    let spec = TwinsSpec::with_serials(&holder.tilt.serial, &holder.spin.serial, changer).with_drivers(drivers)?;
    let twins = Twins::new(spec);
    devices(instrument, clock, |_, port| connect(&twins, port, clock), BTreeMap::new())
}
