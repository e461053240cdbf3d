//! The simulated bench. The only file outside `sim/` that names the simulator, but for the type of its errors.

use super::{BenchError, FaultMix, Fired, Opened, Rehearsal, devices, hardware};
use crate::config::check::Checked;
use crate::config::instrument::Instrument;
use crate::control::devices::bench::{Bench, Devices, Settle};
use crate::control::sequencer::verbs::Verb;
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::Camera;
use goniod_sim::camera::FaultQueue;
use goniod_sim::faults::{Counts, Mix, Targets, carry_out};
use goniod_sim::truth::error::SimError;
use goniod_sim::twins::{Twins, TwinsSpec};
use std::collections::BTreeMap;
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
        let counts = self.carry_out(Schedule::of(mix, seed, span), verbs, clock);
        Some(Box::new(move || counts.fired().into_iter().map(|(kind, n)| (kind.to_string(), n)).collect()))
    }

    /// Lets the faults of a schedule happen from now on.
    pub fn carry_out(&self, schedule: Schedule, verbs: mpsc::Sender<Verb>, clock: Clock) -> Counts {
        let counts = Counts::default();
        let pause = move |on| {
            // A full queue means that the operator is asking for other things already.
            let _ = verbs.try_send(if on { Verb::Pause } else { Verb::Resume });
        };
        let targets = Targets { twins: self.twins.clone(), cameras: self.cameras.clone(), pause: Arc::new(pause) };
        tokio::spawn(carry_out(schedule, targets, clock, counts.clone()));
        counts
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
    let sample = rehearsal.sample.as_ref().or(checked.simulated_sample.as_ref()).ok_or(BenchError::NoSample)?;
    let seed = rehearsal.seed.unwrap_or(simulation.seed);
    let holder = &instrument.holder;
    let changer = holder.changer.as_ref().map_or("50003", |c| c.axis.serial.as_str());
    let twins = Twins::new(TwinsSpec::with_serials(&holder.tilt.serial, &holder.spin.serial, changer));
    let bench = goniod_sim::bench::Bench::open(description, sample, seed, Arc::new(twins.clone()), clock)?;
    let mut cameras: BTreeMap<String, Box<dyn Camera>> = BTreeMap::new();
    let mut faults = Faults { twins: twins.clone(), cameras: BTreeMap::new(), mix: rehearsal.faults };
    for (name, camera) in &instrument.camera {
        if own_cameras && !camera.driver.starts_with("sim-") {
            cameras.insert(name.clone(), hardware::camera(name, camera, clock)?);
        } else {
            faults.cameras.insert(name.clone(), bench.faults(name)?);
            cameras.insert(name.clone(), Box::new(bench.camera(name)?));
        }
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

/// What moves on a simulated bench of its own: nothing outside this process is reached.
pub(super) fn direct(instrument: &Instrument, clock: Clock) -> Result<Devices, BenchError> {
    let holder = &instrument.holder;
    let changer = holder.changer.as_ref().map_or("50003", |c| c.axis.serial.as_str());
    let twins = Twins::new(TwinsSpec::with_serials(&holder.tilt.serial, &holder.spin.serial, changer));
    let connect = |_: &str, port: &str| {
        let unknown = SimError::Unknown { what: "port", name: port.to_owned(), known: "the ports of the twins".into() };
        twins.connector(port, clock).ok_or(BenchError::Simulation(unknown))
    };
    devices(instrument, clock, connect, BTreeMap::new())
}
