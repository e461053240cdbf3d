//! `goniod resume [RUN]`: goes on with a run at the exposure where it ended, was stopped or was cut short.

use super::daemon::{DaemonArgs, runs};
use super::exit::Exit;
use super::input::instrument_path;
use super::output::{Failure, Outcome, Output};
use super::run::{carry_out, exit_of_bench, finish, lock_instrument, no_runtime};
use crate::config::instrument::Instrument;
use crate::config::load::load;
use crate::front::api::answers::NewEntry;
use crate::front::bench::{Rehearsal, open_as_written, open_simulated};
use crate::front::daemon::lock::Locks;
use crate::front::resume::{Unfinished, accept_lost_end, newest_unfinished};
use crate::front::runs::{RunStatus, status_of};
use goniod_drivers::clock::Clock;
use std::path::{Path, PathBuf};

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The run directory [default: the newest unfinished run of the instrument].
    run: Option<PathBuf>,
    #[command(flatten)]
    daemon: DaemonArgs,
    /// Folder to look for the newest unfinished run in [default: `runs_dir` of the instrument file].
    #[arg(long, value_name = "DIR")]
    runs: Option<PathBuf>,
    /// Try exposures that are listed as missing once more.
    #[arg(long)]
    missing: bool,
    /// Where the end of the journal's log is damaged, take the exposures whose rows are lost again
    #[arg(long, requires = "run")]
    accept_loss: bool,
    /// Sample of the simulated bench, where it no longer lies where the run found it.
    #[arg(long, value_name = "FILE")]
    sample: Option<PathBuf>,
    /// Measure only; products can be made later with `goniod reduce`.
    #[arg(long)]
    no_products: bool,
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    if let (true, Some(run)) = (args.accept_loss, &args.run) {
        accept_lost_end(run)?;
    }
    if let Some(outcome) = ask_daemon(&args, output) {
        return outcome;
    }
    let file = instrument_path(args.daemon.instrument.as_deref())?;
    let loaded = load::<Instrument>(&file, "instrument").map_err(|e| Failure::new(Exit::BadInput, e.to_string()))?;
    let instrument = loaded.value;
    let path = match args.run {
        Some(path) => path,
        None => {
            let runs = args.runs.unwrap_or_else(|| instrument.runs_dir.clone());
            newest_unfinished(&runs)?.ok_or_else(|| {
                let message = format!("{}: every run is finished; `goniod status` lists them", runs.display());
                Failure::new(Exit::BadInput, message)
            })?
        }
    };
    let nothing_to_do = |status: RunStatus| status.is_finished() && !(args.missing && status.missing > 0);
    if status_of(&path).is_some_and(nothing_to_do) {
        let what = format!(
            "{}: this run is finished, every exposure is stored or listed as missing; `goniod reduce` makes its products \
             again, --missing tries again what is missing",
            path.display()
        );
        return Err(Failure::new(Exit::Refused, what));
    }
    let base = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let unfinished = Unfinished::compare(&path, &instrument, base, args.sample)?;
    let locks = lock_instrument(&file, &instrument, "goniod resume")?;
    go_on(unfinished, args.missing, !args.no_products, (&locks, output))
}

/// Where the daemon runs, it is asked: without RUN to go on with what is paused or held, with RUN to put the run into
/// its queue. `None` where no daemon runs, or where the options are those of a run in the foreground.
fn ask_daemon(args: &Args, output: &Output) -> Option<Outcome> {
    let foreground = args.runs.is_some() || args.sample.is_some() || args.missing || args.no_products;
    if foreground || !runs(&args.daemon) {
        return None;
    }
    Some(match &args.run {
        None => super::verbs::give("resume", &args.daemon, output),
        Some(run) => {
            let name = run.file_name().map(|n| n.to_string_lossy().into_owned());
            super::queue::added(&NewEntry { scan: None, resume: name }, &args.daemon, output)
        }
    })
}

/// Goes on with a run, in the kind of time it was started in.
pub fn go_on(unfinished: Unfinished, missing: bool, products: bool, to: (&Locks, &Output)) -> Outcome {
    let (locks, output) = to;
    let checked = unfinished.checked();
    let rehearsed = unfinished.document.virtual_time;
    let start = unfinished.last_told()?;
    let rehearsal = Rehearsal { seed: unfinished.document.simulated_seed, ..Rehearsal::default() };
    let runtime = if rehearsed {
        tokio::runtime::Builder::new_current_thread().enable_all().start_paused(true).build()
    } else {
        tokio::runtime::Builder::new_multi_thread().enable_all().build()
    };
    let work = async {
        let clock = if rehearsed { Clock::starting_at(start) } else { Clock::system() };
        let opened =
            if rehearsed { open_simulated(&checked, &rehearsal, clock) } else { open_as_written(&checked, clock) };
        let mut opened = opened.map_err(|e| Failure::new(exit_of_bench(&e), e.to_string()))?;
        let night = unfinished.night(missing)?;
        carry_out(&checked, night, &mut opened, clock, (Some(locks), output)).await
    };
    let (ran, exit) = runtime.map_err(no_runtime)?.block_on(work)?;
    finish(ran, exit, products, output)
}
