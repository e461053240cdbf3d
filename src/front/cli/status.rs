//! `goniod status`: what the runs of an instrument are doing or how they ended.

use super::exit::Exit;
use super::input::instrument_path;
use super::output::{Failure, Outcome, Output};
use crate::archive::RunDir;
use crate::config::instrument::Instrument;
use crate::config::load::load;
use crate::control::events::Event;
use crate::front::night::stamp;
use goniod_drivers::clock::UtcMicros;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder with run directories [default: `runs_dir` of the instrument file].
    #[arg(long, value_name = "DIR")]
    runs: Option<PathBuf>,
    /// The instrument file.
    #[arg(long, value_name = "FILE")]
    instrument: Option<PathBuf>,
    /// How many of the latest runs to tell.
    #[arg(long, default_value_t = 10)]
    last: usize,
}

#[derive(Serialize)]
struct Status {
    runs_dir: PathBuf,
    runs: Vec<RunStatus>,
}

#[derive(Serialize)]
struct RunStatus {
    run: PathBuf,
    /// `open` (under way or cut short), or how it ended.
    state: String,
    stored: u32,
    missing: u32,
    planned: u32,
    rejected: u32,
    bytes: u64,
    last_event: Option<String>,
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    let runs_dir = match args.runs {
        Some(runs) => runs,
        None => runs_of(&instrument_path(args.instrument.as_deref())?)?,
    };
    let entries = std::fs::read_dir(&runs_dir).map_err(|e| {
        Failure::new(Exit::Storage, format!("{}: cannot be read ({e}); there are no runs yet?", runs_dir.display()))
    })?;
    let mut paths: Vec<PathBuf> = entries.flatten().map(|e| e.path()).collect();
    paths.sort();
    let mut runs: Vec<RunStatus> = paths.iter().rev().filter_map(|p| status_of(p)).take(args.last).collect();
    runs.reverse();
    let status = Status { runs_dir, runs };
    output.result(Exit::Done, &status, || text(&status))
}

fn runs_of(instrument: &Path) -> Result<PathBuf, Failure> {
    load::<Instrument>(instrument, "instrument")
        .map(|loaded| loaded.value.runs_dir)
        .map_err(|e| Failure::new(Exit::BadInput, e.to_string()))
}

/// `None` for a folder that is no run.
fn status_of(path: &Path) -> Option<RunStatus> {
    let dir = RunDir::open(path).ok()?;
    let (summary, events) = dir.with(|j| Ok((j.summary()?, j.events()?))).ok()?;
    let ending = events.iter().rev().find_map(|e| match serde_json::from_str::<Event>(&e.json) {
        Ok(Event::RunEnded { ending, .. }) => Some(format!("{ending:?}").to_lowercase()),
        _ => None,
    });
    let last = events.last().map(|e| format!("{} {}", stamp(UtcMicros(e.utc_us)), e.kind));
    Some(RunStatus {
        run: path.to_owned(),
        state: ending.unwrap_or_else(|| "open".to_owned()),
        stored: summary.stored,
        missing: summary.missing,
        planned: summary.planned,
        rejected: summary.rejected,
        bytes: summary.bytes,
        last_event: last,
    })
}

fn text(status: &Status) -> String {
    if status.runs.is_empty() {
        return format!("{}: no runs", status.runs_dir.display());
    }
    let line = |r: &RunStatus| {
        format!(
            "{:<10} {:>6} stored {:>5} missing {:>6} not done  {:>8.1} MB  {}",
            r.state,
            r.stored,
            r.missing,
            r.planned,
            r.bytes as f64 / 1e6,
            r.run.display()
        )
    };
    status.runs.iter().map(line).collect::<Vec<_>>().join("\n")
}
