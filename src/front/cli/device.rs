//! `goniod device …`: one device by hand, through the same driver table, instrument file and limits as a run.

mod say;
mod work;

use super::exit::Exit;
use super::input::{bad_input, check_options, instrument_path};
use super::output::{Failure, Outcome, Output};
use super::run::{exit_of_bench, lock_instrument, no_runtime};
use crate::config::check::check_devices;
use crate::config::instrument::Instrument;
use crate::front::bench::by_hand::{ByHand, Entry, entries};
use crate::front::bench::is_simulated;
use crate::front::daemon::lock::Locks;
use goniod_drivers::clock::Clock;
use goniod_drivers::conformance::Subject;
use goniod_drivers::error::DeviceError;
use say::{Listed, Report};
use std::path::{Path, PathBuf};

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    verb: Verb,
    #[command(flatten)]
    of: OfInstrument,
}

/// Which instrument, and what lies in it.
#[derive(Debug, clap::Args)]
pub struct OfInstrument {
    /// The instrument file [default: $GONIOD_INSTRUMENT, config/instrument.toml, /etc/goniod/instrument.toml].
    #[arg(long, value_name = "FILE", global = true)]
    instrument: Option<PathBuf>,
    /// Sample in a simulated bench [default: samples/clear_glazing.toml beside the bench's description].
    #[arg(long, value_name = "FILE", global = true)]
    sample: Option<PathBuf>,
}

/// An instrument that this process has to itself, and the runtime its devices live on.
pub(super) struct Bench<'a> {
    of: &'a OfInstrument,
    path: PathBuf,
    instrument: Instrument,
    _held: Locks,
    runtime: tokio::runtime::Runtime,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    /// All devices with driver, port and identity, or the reason why one cannot be opened.
    List,
    /// Identity, health and state of one device.
    Show {
        /// Name in the instrument file, such as `tilt` or `ccd`.
        name: String,
    },
    /// Move one device; `--` before a negative angle.
    Move {
        /// `tilt`, `spin`, `changer`, `filter_wheel`, `shutter` or `monochromator`.
        name: String,
        /// Angle of the axis in degrees, or `home`; place or band; `open` or `closed`; wavelength in nanometres.
        to: String,
    },
    /// Read one device.
    Read {
        /// `light_monitor`, `spectrometer`, a camera, or any other for its state.
        name: String,
        /// Integration time of a camera or spectrometer, seconds.
        #[arg(long, value_name = "SECONDS")]
        exposure: Option<f64>,
    },
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    let bench = Bench::of(&args.of, "goniod device")?;
    bench.with(async |instrument, bench, clock| match args.verb {
        Verb::List => list(instrument, bench, clock, output).await,
        Verb::Show { name } => {
            let (entry, mut hand) = take(instrument, bench, &name)?;
            let mut report = open(&entry, &mut hand, clock).await?;
            work::look(&mut hand, &mut report, clock).await.map_err(device)?;
            output.result(Exit::Done, &report, || report.text())
        }
        Verb::Move { name, to } => {
            let (entry, mut hand) = take(instrument, bench, &name)?;
            let target = work::Target::of(instrument, &entry.name, &to).map_err(usage)?;
            let mut report = open(&entry, &mut hand, clock).await?;
            work::go(&mut hand, target, &mut report, clock).await.map_err(device)?;
            output.result(Exit::Done, &report, || report.text())
        }
        Verb::Read { name, exposure } => {
            let (entry, mut hand) = take(instrument, bench, &name)?;
            let exposure = exposure.map(|s| work::exposure(instrument, &entry.name, s)).transpose().map_err(usage)?;
            let gain = instrument.camera.get(&entry.name).map_or(0.0, |camera| camera.gain);
            let mut report = open(&entry, &mut hand, clock).await?;
            work::read(&mut hand, (exposure, gain), &mut report, clock).await.map_err(device)?;
            output.result(Exit::Done, &report, || report.text())
        }
    })
}

// === impl Bench ===

impl<'a> Bench<'a> {
    /// Reads the instrument and takes it for `who`.
    ///
    /// # Errors
    /// A wrong file, an instrument in use, or no runtime.
    pub(super) fn of(of: &'a OfInstrument, who: &str) -> Result<Bench<'a>, Failure> {
        let path = instrument_path(of.instrument.as_deref())?;
        let instrument = check_devices(&path, check_options(Clock::system()).today).map_err(bad_input)?;
        let _held = lock_instrument(&path, &instrument, who)?;
        let simulated = is_simulated(&instrument).map_err(|e| Failure::new(exit_of_bench(&e), e.to_string()))?;
        let mut builder = tokio::runtime::Builder::new_current_thread();
        // The simulated bench lives in virtual time, as in a rehearsal.
        let runtime = builder.enable_all().start_paused(simulated).build().map_err(no_runtime)?;
        Ok(Bench { of, path, instrument, _held, runtime })
    }

    /// Works with its devices; none is open before.
    pub(super) fn with(&self, work: impl AsyncFnOnce(&Instrument, &ByHand<'_>, Clock) -> Outcome) -> Outcome {
        let folder = self.path.parent().unwrap_or(Path::new(""));
        self.runtime.block_on(async {
            let clock = Clock::system();
            let bench = ByHand::new(&self.instrument, folder, self.of.sample.as_deref(), clock);
            let bench = bench.map_err(|e| Failure::new(exit_of_bench(&e), e.to_string()))?;
            work(&self.instrument, &bench, clock).await
        })
    }
}

async fn list(instrument: &Instrument, bench: &ByHand<'_>, clock: Clock, output: &Output) -> Outcome {
    let mut devices = Vec::new();
    for entry in entries(instrument) {
        let opened = match bench.make(&entry.name) {
            Ok(Some(mut hand)) => work::identify(&mut hand, clock).await.map_err(|e| e.to_string()),
            Ok(None) => Err(format!("the driver {} has no such part", entry.driver)),
            Err(e) => Err(e.to_string()),
        };
        devices.push(Listed::new(entry, opened));
    }
    let exit = if devices.iter().all(Listed::is_there) { Exit::Done } else { Exit::Device };
    let listed = say::List { devices };
    output.result(exit, &listed, || listed.text())
}

/// The device of this name, made but not opened.
pub(super) fn take(instrument: &Instrument, bench: &ByHand<'_>, name: &str) -> Result<(Entry, Subject), Failure> {
    let all = entries(instrument);
    let unknown = || {
        let known = all.iter().map(|e| e.name.as_str()).collect::<Vec<_>>().join(", ");
        usage(format!("the instrument has no device `{name}`; there are: {known}"))
    };
    let plain = name.strip_prefix("camera.").unwrap_or(name);
    let entry = all.iter().find(|e| e.name == plain).ok_or_else(unknown)?;
    let made = bench.make(plain).map_err(|e| Failure::new(exit_of_bench(&e), e.to_string()))?;
    Ok((entry.clone(), made.ok_or_else(unknown)?))
}

async fn open(entry: &Entry, hand: &mut Subject, clock: Clock) -> Result<Report, Failure> {
    let identity = work::identify(hand, clock).await.map_err(device)?;
    Ok(Report::new(entry, identity))
}

fn usage(message: String) -> Failure {
    Failure::new(Exit::Usage, message)
}

fn device(error: DeviceError) -> Failure {
    Failure::new(Exit::Device, error.to_string())
}
