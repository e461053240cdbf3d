//! `goniod run SCAN`: measures in the foreground, on the hardware or in real time on a simulated bench.

use super::exit::Exit;
use super::input::{ScanArgs, instrument_path};
use super::output::{Failure, Outcome, Output};
use super::progress::Progress;
use crate::config::check::Checked;
use crate::config::instrument::Instrument;
use crate::control::events::EventBus;
use crate::control::sequencer::verbs::listen_to_signals;
use crate::front::bench::{BenchError, Opened, open_as_written};
use crate::front::daemon::lock::Locks;
use crate::front::night::{self, Night, exit_of};
use crate::front::resume::{Unfinished, newest_unfinished};
use crate::products::make::{Made, make_all};
use crate::products::night::duration;
use goniod_drivers::clock::Clock;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use tokio::sync::mpsc;

/// Verbs that may wait for the sequencer.
const VERBS: usize = 8;

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scan: ScanArgs,
    /// Folder for the run directory [default: `runs_dir` of the instrument file].
    #[arg(long, value_name = "DIR")]
    runs: Option<PathBuf>,
    /// Measure only; products can be made later with `goniod reduce`.
    #[arg(long)]
    no_products: bool,
}

/// What a run gives back.
#[derive(Debug, Serialize)]
pub struct Ran {
    run: PathBuf,
    ending: String,
    stored: u32,
    missing: u32,
    planned: u32,
    rejected: u32,
    safe: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    message: Option<String>,
    /// Frames that waited for a slow disk.
    #[serde(skip_serializing_if = "is_zero")]
    disk_waits: u64,
    forecast_s: f64,
    took_s: f64,
    products: Vec<PathBuf>,
    /// Faults that really happened on a simulated bench, by kind.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    faults: BTreeMap<String, u32>,
    /// What the oracle says where faults happened.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    oracle: Vec<String>,
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    let checked = args.scan.check(output)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(no_runtime)?;
    let runs = args.runs.unwrap_or_else(|| checked.instrument.runs_dir.clone());
    if let Some(warning) = night::lamp_warning(&checked.instrument, &night::plan(&checked)?, &runs) {
        output.warn(&warning);
    }
    let path = instrument_path(args.scan.instrument.as_deref())?;
    let locks = lock_instrument(&path, &checked.instrument, "goniod run")?;
    if let Some(unfinished) = to_go_on_with(&checked, &runs, output)? {
        output.say(&format!("going on with {}", unfinished.path.display()));
        return super::resume::go_on(unfinished, false, !args.no_products, (&locks, output));
    }
    let open = |clock| open_as_written(&checked, clock);
    let work = measure(&checked, &runs, Clock::system, open, (Some(&locks), output));
    let (ran, exit) = runtime.block_on(work)?;
    finish(ran, exit, !args.no_products, output)
}

/// The newest unfinished run, where the instrument wants it gone on with by itself and it is the same scan and plan.
fn to_go_on_with(checked: &Checked, runs: &Path, output: &Output) -> Result<Option<Unfinished>, Failure> {
    if !checked.instrument.auto_resume {
        return Ok(None);
    }
    let sample = checked.simulated_sample.clone();
    let compare = |path: PathBuf| Unfinished::compare(&path, &checked.instrument, &checked.instrument_dir, sample);
    let run = match newest_unfinished(runs).and_then(|path| path.map(compare).transpose()) {
        Ok(Some(run)) => run,
        Ok(None) => return Ok(None),
        Err(failure) => {
            // A run that is damaged, or of another instrument or calibration, does not stand in tonight's way.
            let why = failure.messages.join("; ");
            output.warn(&format!("an unfinished run is not gone on with, a new one is begun: {why}"));
            return Ok(None);
        }
    };
    let same = run.document.scan == checked.scan && run.document.plan.hash == night::plan(checked)?.hash;
    Ok((same && !run.document.virtual_time).then_some(run))
}

/// Takes the instrument for this process.
///
/// # Errors
/// Somebody else has it, as a refused command.
pub fn lock_instrument(path: &Path, instrument: &Instrument, who: &str) -> Result<Locks, Failure> {
    Locks::of_instrument(path, instrument, who).map_err(|e| Failure::new(super::serve::exit_of(&e), e.to_string()))
}

/// Opens the bench, makes the run directory and measures, on the runtime it is called on.
pub async fn measure(
    checked: &Checked,
    runs: &Path,
    clock: impl FnOnce() -> Clock,
    open: impl FnOnce(Clock) -> Result<Opened, BenchError>,
    (locks, output): (Option<&Locks>, &Output),
) -> Result<(Ran, Exit), Failure> {
    let plan = night::plan(checked)?;
    let clock = clock();
    let mut opened = open(clock).map_err(|e| Failure::new(exit_of_bench(&e), e.to_string()))?;
    let night = night::prepare(checked, plan, runs, clock, opened.seed)?;
    carry_out(checked, night, &mut opened, clock, (locks, output)).await
}

/// Measures what a run has to do, with progress and signals, on the runtime it is called on.
pub async fn carry_out(
    checked: &Checked,
    night: Night,
    opened: &mut Opened,
    clock: Clock,
    (locks, output): (Option<&Locks>, &Output),
) -> Result<(Ran, Exit), Failure> {
    output.say(&format!("run {}", night.path.display()));
    if let Some(locks) = locks {
        locks.tell(Some(&night.path.display().to_string()));
    }
    let events = EventBus::default();
    let progress = Progress::begin(&night.plan, events.subscribe(), output.json);
    let (sender, verbs) = mpsc::channel(VERBS);
    listen_to_signals(sender.clone())
        .map_err(|e| Failure::new(Exit::Failed, format!("SIGINT and SIGTERM cannot be listened to: {e}")))?;
    let fired = opened.begin_faults(night.plan.forecast.total_s(), sender, clock);
    let outcome = night::measure(checked, &night, opened, clock, verbs, &events).await;
    progress.end();
    let outcome = outcome?;
    let ran = Ran {
        run: night.path.clone(),
        ending: format!("{:?}", outcome.ending).to_lowercase(),
        stored: outcome.summary.stored,
        missing: outcome.summary.missing,
        planned: outcome.summary.planned,
        rejected: outcome.summary.rejected,
        safe: outcome.is_safe(),
        message: outcome.message.clone(),
        disk_waits: outcome.disk_waits,
        forecast_s: night.plan.forecast.total_s(),
        took_s: clock.elapsed().as_secs_f64(),
        products: Vec::new(),
        faults: fired.map(|fired| fired()).unwrap_or_default(),
        oracle: Vec::new(),
    };
    Ok((ran, exit_of(&outcome)))
}

/// Makes the products of a run that has frames and says how everything went.
pub fn finish(mut ran: Ran, exit: Exit, products: bool, output: &Output) -> Outcome {
    let exit = if ran.faults.is_empty() { exit } else { judged(&mut ran, exit)? };
    if !products || ran.stored == 0 || !matches!(exit, Exit::Done | Exit::Incomplete) {
        return output.result(exit, &ran, || text(&ran, None));
    }
    match make_products(&ran.run) {
        Ok(made) => {
            ran.products.clone_from(&made.files);
            output.result(exit, &ran, || text(&ran, Some(&made)))
        }
        // The night is over and well kept, whatever becomes of its products.
        Err(failure) => output.result_with(&failure, &ran, || text(&ran, None)),
    }
}

/// All products of a run.
fn make_products(run: &Path) -> Result<Made, Failure> {
    let made = super::input::open_run(run)
        .and_then(|opened| make_all(&opened).map_err(|e| Failure::new(Exit::Storage, e.to_string())));
    made.map_err(|failure| {
        let (why, run) = (failure.messages.join("; "), run.display());
        Failure::new(failure.exit, format!("the products were NOT MADE: {why}; then `goniod reduce {run}` makes them"))
    })
}

/// Asks the oracle about a run with faults: one wrong label is damage.
#[cfg(feature = "sim")]
fn judged(ran: &mut Ran, exit: Exit) -> Result<Exit, Failure> {
    let verdict = crate::front::oracle::judge(&ran.run).map_err(|e| Failure::new(Exit::Storage, e.to_string()))?;
    ran.oracle = verdict.lines();
    Ok(if verdict.is_clean() { exit } else { Exit::Damaged })
}

/// Without a simulated bench no fault happens on purpose.
#[cfg(not(feature = "sim"))]
fn judged(_: &mut Ran, exit: Exit) -> Result<Exit, Failure> {
    Ok(exit)
}

fn is_zero(n: &u64) -> bool {
    *n == 0
}

fn text(ran: &Ran, made: Option<&Made>) -> String {
    let mut lines = vec![format!(
        "{}: {} stored, {} missing, {} not done, {} rejected and retaken; bench {}",
        ran.ending,
        ran.stored,
        ran.missing,
        ran.planned,
        ran.rejected,
        if ran.safe { "safe" } else { "NOT PROVEN SAFE, look at it" }
    )];
    lines.push(format!("took {}, forecast {}", duration(ran.took_s), duration(ran.forecast_s)));
    if ran.disk_waits > 0 {
        lines.push(format!("{} frames waited for the disk: it is slower than the cameras", ran.disk_waits));
    }
    lines.extend(ran.message.clone());
    if !ran.faults.is_empty() {
        let kinds: Vec<String> = ran.faults.iter().map(|(kind, n)| format!("{kind} {n}")).collect();
        lines.push(format!("{} faults: {}", ran.faults.values().sum::<u32>(), kinds.join(", ")));
    }
    lines.extend(ran.oracle.iter().cloned());
    if let Some(made) = made {
        lines.push(String::new());
        lines.extend(made.headline.iter().chain(&made.not_made).cloned());
        lines.push(String::new());
        lines.push(format!("run directory  {}", ran.run.display()));
        lines.extend(made.files.iter().map(|f| format!("               {}", f.display())));
    }
    lines.join("\n")
}

/// Bad files are bad input, everything else is the bench.
pub fn exit_of_bench(e: &BenchError) -> Exit {
    match e {
        BenchError::Device(_) => Exit::Device,
        _ => Exit::BadInput,
    }
}

/// A runtime that cannot be made.
pub fn no_runtime(e: std::io::Error) -> Failure {
    Failure::new(Exit::Failed, format!("the runtime cannot be started: {e}"))
}
