//! `goniod serve`: the daemon, in the foreground; the service manager starts it.

use super::daemon::socket_path;
use super::exit::Exit;
use super::input::instrument_path;
use super::output::{Failure, Outcome, Output};
use super::run::no_runtime;
use crate::config::error::ConfigError;
use crate::config::instrument::Instrument;
use crate::config::load::load;
use crate::front::daemon::error::DaemonError;
use crate::front::daemon::serve::{Place, serve};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Folder of the queue inside the runs folder, where nothing else is said.
const STATE: &str = ".goniod";

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The instrument file [default: $GONIOD_INSTRUMENT, config/instrument.toml, /etc/goniod/instrument.toml].
    #[arg(long, value_name = "FILE")]
    instrument: Option<PathBuf>,
    /// The socket [default: $GONIOD_SOCKET, `[daemon] socket`, $RUNTIME_DIRECTORY/goniod.sock, /run/goniod/goniod.sock].
    #[arg(long, value_name = "FILE")]
    socket: Option<PathBuf>,
    /// Folder of the queue [default: `[daemon] state_dir`, $STATE_DIRECTORY, `.goniod` in `runs_dir`].
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
}

#[derive(Serialize)]
struct Served {
    socket: PathBuf,
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    let path = instrument_path(args.instrument.as_deref())?;
    let bad = |e: &ConfigError| Failure::new(Exit::BadInput, e.to_string());
    let loaded = load::<Instrument>(&path, "instrument").map_err(|e| bad(&e))?;
    let mut issues = Vec::new();
    loaded.value.daemon.check(&loaded.source, &mut issues);
    if !issues.is_empty() {
        return Err(bad(&ConfigError::Faulty { issues }));
    }
    let instrument = loaded.value;
    let place = Place {
        state: state_dir(args.state.as_deref(), &instrument),
        socket: socket_path(args.socket.as_deref(), || instrument.daemon.clone()),
        listen: instrument.daemon.address(),
        instrument: path,
    };
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(no_runtime)?;
    let ready = || output.say(&format!("{} is served at {}", instrument.name, place.socket.display()));
    let served = runtime.block_on(serve(&place, &instrument, ready));
    // Products that are being made now are made again at the next start: nothing waits for them.
    runtime.shutdown_background();
    served.map_err(|e| Failure::new(exit_of(&e), e.to_string()))?;
    let served = Served { socket: place.socket };
    output.result(Exit::Done, &served, || "ended; the queue is kept".to_owned())
}

fn state_dir(given: Option<&Path>, instrument: &Instrument) -> PathBuf {
    let given = given.map(Path::to_owned).or_else(|| instrument.daemon.state_dir.clone());
    given
        .or_else(|| std::env::var_os("STATE_DIRECTORY").map(PathBuf::from))
        .unwrap_or_else(|| instrument.runs_dir.join(STATE))
}

/// The exit code of what kept the daemon from its work.
pub fn exit_of(e: &DaemonError) -> Exit {
    match e {
        DaemonError::InUse { .. } => Exit::Refused,
        DaemonError::Archive(_) | DaemonError::Io { .. } => Exit::Storage,
        DaemonError::Config(_) | DaemonError::Plan(_) => Exit::BadInput,
        _ => Exit::Failed,
    }
}
