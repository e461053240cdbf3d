//! `goniod safe`: asks the daemon to make the bench safe; `--direct` does it without a run and without the daemon:
//! opens what the safe state lists, tries all of it, and tells how each device stands.

use super::daemon::{DaemonArgs, asked};
use super::exit::Exit;
use super::input::instrument_path;
use super::output::{Failure, Outcome, Output};
use super::run::{exit_of_bench, no_runtime};
use crate::config::instrument::Instrument;
use crate::config::load::load;
use crate::control::devices::safe::{SafeReport, SafeResult};
use crate::front::api::answers::Status;
use crate::front::api::client::ClientError;
use crate::front::bench::open_direct;
use crate::front::daemon::error::DaemonError;
use crate::front::daemon::lock::Locks;
use goniod_drivers::clock::Clock;
use hyper::Method;
use serde::Serialize;
use std::path::Path;
use std::time::Duration;

/// How long a daemon that is well takes at most to tell its status.
const AT_ONCE: Duration = Duration::from_secs(3);

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Open the devices here and now; refused while a daemon or a run holds the instrument.
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
        // A daemon that is stuck is found out before it is waited for; every other fault the request itself tells.
        let asked = asked(&args.daemon, |client| async move {
            client.within(AT_ONCE).ask::<Status>(Method::GET, "/v1/status", None::<&()>).await
        });
        if let Err(silent @ ClientError::Silent { .. }) = asked {
            return Err(silent.into());
        }
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
    let _locks = take(&file, &instrument)?;
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

/// Takes the instrument, so that nobody else commands it meanwhile. A lock that cannot be had for another reason than a
/// holder keeps nobody from making the bench safe.
fn take(file: &Path, instrument: &Instrument) -> Result<Option<Locks>, Failure> {
    match Locks::of_instrument(file, instrument, "goniod safe --direct") {
        Ok(locks) => Ok(Some(locks)),
        Err(DaemonError::InUse { what, holder, .. }) => {
            let message = format!(
                "{what} is in use by {holder}; `goniod safe` asks the daemon to make the bench safe, a run in the \
                 foreground does it when it gets SIGTERM; where neither answers, kill that process and try again"
            );
            Err(Failure::new(Exit::Refused, message))
        }
        Err(_) => Ok(None),
    }
}

fn text(devices: &[SafeReport]) -> String {
    let line = |r: &SafeReport| {
        let message = r.message.as_deref().map(|m| format!("  {m}")).unwrap_or_default();
        format!("{:<14} {:<12}{message}", r.device, r.outcome.word())
    };
    devices.iter().map(line).collect::<Vec<_>>().join("\n")
}
