//! `goniod status`: what is going on, asked of the daemon where it runs, else read from the run directories.

use super::daemon::{DaemonArgs, asked};
use super::exit::Exit;
use super::input::instrument_path;
use super::output::{Failure, Outcome, Output};
use crate::config::instrument::Instrument;
use crate::config::load::load;
use crate::control::lamp_hours::{LampAge, LampLog};
use crate::front::api::answers::{RunNow, Status};
use crate::front::api::client::ClientError;
use crate::front::runs::{RunStatus, latest};
use crate::products::night::duration;
use hyper::Method;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder with run directories; the daemon is then not asked [default: `runs_dir` of the instrument file].
    #[arg(long, value_name = "DIR")]
    runs: Option<PathBuf>,
    #[command(flatten)]
    daemon: DaemonArgs,
    /// How many of the latest runs to tell.
    #[arg(long, default_value_t = 10)]
    last: usize,
}

#[derive(Serialize)]
struct Told {
    /// What the daemon says; absent where none runs.
    daemon: Option<Status>,
    runs_dir: PathBuf,
    runs: Vec<RunStatus>,
    /// How old the lamp is; absent where its hours are not kept.
    #[serde(skip_serializing_if = "Option::is_none")]
    lamp: Option<LampAge>,
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    let daemon = match args.runs {
        Some(_) => None,
        None => ask(&args.daemon)?,
    };
    let runs_dir = match (&args.runs, &daemon) {
        (Some(runs), _) => runs.clone(),
        (None, Some(status)) => status.runs_dir.clone(),
        (None, None) => runs_of(&instrument_path(args.daemon.instrument.as_deref())?)?,
    };
    let runs = match latest(&runs_dir, args.last) {
        Ok(runs) => runs,
        // A daemon that has not begun its first run.
        Err(_) if daemon.is_some() => Vec::new(),
        Err(e) => {
            let why = format!("{}: cannot be read ({e}); there are no runs yet?", runs_dir.display());
            return Err(Failure::new(Exit::Storage, why));
        }
    };
    let lamp = lamp_of(args.daemon.instrument.as_deref(), &runs_dir);
    let told = Told { daemon, runs_dir, runs, lamp };
    output.result(Exit::Done, &told, || text(&told))
}

/// What the daemon says, where one runs.
fn ask(args: &DaemonArgs) -> Result<Option<Status>, Failure> {
    match asked(args, |client| async move { client.ask(Method::GET, "/v1/status", None::<&()>).await }) {
        Ok(status) => Ok(Some(status)),
        Err(ClientError::NotRunning { .. }) if args.socket.is_none() => Ok(None),
        Err(e) => Err(e.into()),
    }
}

fn runs_of(instrument: &Path) -> Result<PathBuf, Failure> {
    load::<Instrument>(instrument, "instrument")
        .map(|loaded| loaded.value.runs_dir)
        .map_err(|e| Failure::new(Exit::BadInput, e.to_string()))
}

/// The hours of the lamp that is in now, by the instrument file where there is one.
fn lamp_of(instrument: Option<&Path>, runs_dir: &Path) -> Option<LampAge> {
    let loaded = load::<Instrument>(&instrument_path(instrument).ok()?, "instrument").ok()?;
    LampLog::of(&loaded.value, runs_dir).map(|log| log.age_if_known())
}

fn text(told: &Told) -> String {
    let mut lines: Vec<String> = told.daemon.iter().flat_map(daemon_lines).collect();
    if told.runs.is_empty() {
        lines.push(format!("{}: no runs", told.runs_dir.display()));
    }
    lines.extend(told.runs.iter().map(run_line));
    lines.extend(told.lamp.as_ref().map(LampAge::words));
    lines.join("\n")
}

fn daemon_lines(status: &Status) -> Vec<String> {
    let mut lines = Vec::new();
    match &status.run {
        Some(run) => {
            lines.push(now_line(run));
            lines.extend(run.lamp.clone());
        }
        None => lines.push(format!("{}: idle", status.instrument)),
    }
    lines.extend(status.held.as_ref().map(|why| format!("the queue is held: {why}")));
    lines.push(format!("{} waiting", status.waiting));
    if status.bad_entries > 0 {
        lines.push(format!(
            "{} entries of the queue cannot be read; `goniod queue list` names them",
            status.bad_entries
        ));
    }
    if let Some(headline) = &status.headline {
        lines.push(String::new());
        lines.push(headline.run.clone());
        lines.extend(headline.lines.iter().cloned());
    }
    lines.push(String::new());
    lines
}

/// The run under way in one line.
pub fn now_line(run: &RunNow) -> String {
    format!(
        "{} {}: {} of {} exposures stored, {} missing; {} left, done at {}",
        run.state,
        run.run,
        run.stored,
        run.exposures,
        run.missing,
        duration(run.left_s),
        run.done_at
    )
}

fn run_line(r: &RunStatus) -> String {
    if let Some(why) = &r.reason {
        return format!("{:<10} {why}", r.state);
    }
    format!(
        "{:<10} {:>6} stored {:>5} missing {:>6} not done  {:>8.1} MB  {}",
        r.state,
        r.stored,
        r.missing,
        r.planned,
        r.bytes as f64 / 1e6,
        r.run.display()
    )
}
