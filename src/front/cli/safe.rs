//! `goniod safe`: asks the daemon to make the bench safe; `--direct` does it without a run and without the daemon:
//! opens what the safe state lists, tries all of it, and tells how each device stands.

use super::daemon::DaemonArgs;
use super::exit::Exit;
use super::input::instrument_path;
use super::output::{Failure, Outcome, Output};
use super::run::{exit_of_bench, no_runtime};
use crate::config::instrument::Instrument;
use crate::config::load::load;
use crate::control::devices::safe::{SafeReport, SafeResult};
use crate::front::bench::open_direct;
use goniod_drivers::clock::Clock;
use serde::Serialize;

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Open the devices here and now; a run that holds them should be told with SIGTERM first.
    #[arg(long)]
    direct: bool,
    #[command(flatten)]
    daemon: DaemonArgs,
}

#[derive(Serialize)]
struct Safe {
    safe: bool,
    devices: Vec<SafeReport>,
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    if !args.direct {
        return super::verbs::give("safe", &args.daemon, output).map_err(|mut failure| {
            if failure.exit == Exit::NoDaemon {
                failure.messages.push("without the daemon, `goniod safe --direct` opens the devices itself".to_owned());
            }
            failure
        });
    }
    let file = instrument_path(args.daemon.instrument.as_deref())?;
    let loaded = load::<Instrument>(&file, "instrument").map_err(|e| Failure::new(Exit::BadInput, e.to_string()))?;
    let instrument = loaded.value;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(no_runtime)?;
    let devices = runtime.block_on(async {
        let clock = Clock::system();
        let mut bench = open_direct(&instrument, clock).map_err(|e| Failure::new(exit_of_bench(&e), e.to_string()))?;
        Ok::<_, Failure>(bench.make_safe(&instrument.safe_state, clock).await)
    })?;
    let safe = devices.iter().all(|report| report.outcome == SafeResult::Confirmed);
    let exit = if safe { Exit::Done } else { Exit::Device };
    let result = Safe { safe, devices };
    output.result(exit, &result, || text(&result.devices))
}

fn text(devices: &[SafeReport]) -> String {
    let line = |r: &SafeReport| {
        let message = r.message.as_deref().map(|m| format!("  {m}")).unwrap_or_default();
        format!("{:<14} {:<12}{message}", r.device, r.outcome.word())
    };
    devices.iter().map(line).collect::<Vec<_>>().join("\n")
}
