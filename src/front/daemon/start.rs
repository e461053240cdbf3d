//! From an entry of the queue to a bench that is open and a run directory that is there.

use super::entry::{Entry, EntryState, QueuedScan, Work};
use super::hub::Hub;
use super::snapshot;
use super::worker::change;
use crate::config::check::{Checked, check};
use crate::config::instrument::Instrument;
use crate::config::load::load;
use crate::front::bands::what_bands_give;
use crate::front::bench::{Opened, open_as_written};
use crate::front::cli::input::check_options;
use crate::front::cli::output::Failure;
use crate::front::night::{self, Night};
use crate::front::resume::Unfinished;
use crate::front::runs::status_of;
use goniod_drivers::clock::Clock;
use std::path::Path;

/// A run that can begin or go on.
pub struct Begun {
    /// What it was checked with.
    pub checked: Checked,
    /// Plan and run directory.
    pub night: Night,
    /// The bench.
    pub opened: Opened,
    /// The run's time.
    pub clock: Clock,
    /// The run.
    pub run: String,
}

/// Why an entry is not begun.
pub enum NotBegun {
    /// It cannot be: one sentence.
    Failed(String),
    /// The queue was held meanwhile; the entry stays as it was.
    Held,
}

/// Checks a scan for the queue; gives what somebody should know too.
///
/// # Errors
/// Every fault of the files, or a scan that cannot be planned.
pub fn check_for_queue(
    hub: &Hub,
    scan: &Path,
    clock: Clock,
) -> Result<(QueuedScan, Checked, Vec<String>), super::error::DaemonError> {
    let (scan, instrument) = (snapshot::plain(scan), &hub.facts.instrument);
    let checked = check(&scan, instrument, &check_options(clock))?;
    let plan = night::plan(&checked).map_err(|f| super::error::DaemonError::Plan(f.messages.join("; ")))?;
    let warnings = checked.warnings.iter().map(ToString::to_string);
    let bands = what_bands_give(&checked).map_err(|e| super::error::DaemonError::Plan(e.to_string()))?;
    let lamp = night::lamp_warning(&checked.instrument, &plan, &hub.facts.runs_dir);
    let warnings = warnings.chain(bands).chain(lamp).collect();
    let queued = QueuedScan {
        name: checked.scan.name.clone(),
        scan,
        instrument: instrument.clone(),
        exposures: plan.steps.len() as u32,
        forecast_s: plan.forecast.total_s(),
        plan_hash: plan.hash,
        files: snapshot::kept(&checked),
        simulated: snapshot::simulated(&checked),
    };
    Ok((queued, checked, warnings))
}

/// Prepares an entry's run; the entry is then written as running under its run's name. Reads files and, of a run that is
/// gone on with, every frame: nothing for an async thread. Nothing is sent to a device yet.
///
/// # Errors
/// [`NotBegun`]: copies that are damaged, a bench that cannot be opened, a run directory that cannot be made; a queue that
/// is held, also because the entry could not be written.
pub fn begin(hub: &Hub, entry: &Entry, clock: Clock) -> Result<Begun, NotBegun> {
    let scan = match (&entry.work, &entry.state) {
        (Work::Resume { run }, _) => return go_on(hub, entry, run, clock),
        (Work::Scan(_), EntryState::Running { run }) if hub.facts.runs_dir.join(run).exists() => {
            return go_on(hub, entry, run, clock);
        }
        (Work::Scan(scan), _) => scan,
    };
    let folder = hub.queue(|queue| queue.folder_of(entry.id));
    let checked = snapshot::read(&folder, scan, &check_options(clock)).map_err(failed)?;
    let plan = night::plan(&checked).map_err(sentence)?;
    if let Some(warning) = night::lamp_warning(&checked.instrument, &plan, &hub.facts.runs_dir) {
        tracing::warn!(entry = entry.id, warning);
    }
    let opened = open_as_written(&checked, clock).map_err(failed)?;
    let run = free_name(&hub.facts.runs_dir, night::name(&checked, &plan, clock));
    // First the name, then the directory: whichever a crash finds, the next start knows what to do.
    is_running(hub, entry, &run, false)?;
    let night =
        night::prepare_named(&checked, plan, &hub.facts.runs_dir, clock, opened.seed, &run).map_err(sentence)?;
    is_running(hub, entry, &run, true)?;
    Ok(Begun { checked, night, opened, clock, run })
}

/// Writes the entry as running, `begun` when its run directory is there; not while the queue is held, and without it on
/// the disk nothing begins: after a crash nobody would know of the run.
fn is_running(hub: &Hub, entry: &Entry, run: &str, begun: bool) -> Result<(), NotBegun> {
    if hub.queue(|queue| queue.held().is_some()) {
        return Err(NotBegun::Held);
    }
    let written = change(hub, entry.id, |e| {
        e.state = EntryState::Running { run: run.to_owned() };
        e.begun = begun;
    });
    if !written {
        if !begun && !matches!(entry.state, EntryState::Running { .. }) {
            hub.queue(|queue| queue.put_back(entry.id));
        }
        return Err(NotBegun::Held);
    }
    Ok(())
}

/// Goes on with a run that was cut short. What is compared with is the instrument that the entry was queued with, and
/// for a run that was put into the queue by its name the instrument as it is now.
fn go_on(hub: &Hub, entry: &Entry, run: &str, clock: Clock) -> Result<Begun, NotBegun> {
    let path = hub.facts.runs_dir.join(run);
    let (unfinished, bench) = match &entry.work {
        Work::Scan(scan) => {
            let folder = hub.queue(|queue| queue.folder_of(entry.id));
            let was = snapshot::read(&folder, scan, &check_options(clock)).map_err(failed)?;
            let sample = was.simulated_sample.clone();
            let unfinished = Unfinished::compare(&path, &was.instrument, &was.instrument_dir, sample);
            (unfinished.map_err(sentence)?, was.bench)
        }
        Work::Resume { .. } => (compare_with_now(hub, run).map_err(failed)?, None),
    };
    must_be_real(&unfinished, run).map_err(failed)?;
    let mut checked = unfinished.checked();
    if bench.is_some() {
        checked.bench = bench;
    }
    let opened = open_as_written(&checked, clock).map_err(failed)?;
    is_running(hub, entry, run, true)?;
    let night = unfinished.night(false).map_err(sentence)?;
    Ok(Begun { checked, night, opened, clock, run: run.to_owned() })
}

fn compare_with_now(hub: &Hub, run: &str) -> Result<Unfinished, String> {
    let file = &hub.facts.instrument;
    let instrument = load::<Instrument>(file, "instrument").map_err(|e| e.to_string())?.value;
    let base = file.parent().unwrap_or(Path::new("/"));
    Unfinished::compare(&hub.facts.runs_dir.join(run), &instrument, base, None).map_err(|f| f.messages.join("; "))
}

/// A rehearsal has a clock of its own, and the daemon has none for it.
fn must_be_real(unfinished: &Unfinished, run: &str) -> Result<(), String> {
    if unfinished.document.virtual_time {
        return Err(format!("{run} is a rehearsal; `goniod resume` goes on with it in virtual time"));
    }
    Ok(())
}

/// The name, or with a number behind it where a run of this name is there already.
fn free_name(runs_dir: &Path, name: String) -> String {
    let mut names = std::iter::once(name.clone()).chain((2..).map(|n| format!("{name}-{n}")));
    names.find(|name| !runs_dir.join(name).exists()).unwrap_or(name)
}

fn sentence(failure: Failure) -> NotBegun {
    NotBegun::Failed(failure.messages.join("; "))
}

fn failed(why: impl ToString) -> NotBegun {
    NotBegun::Failed(why.to_string())
}

/// Whether a run can be put into the queue to be gone on with.
///
/// # Errors
/// Why not: no such run, one that is finished or queued already, one of another instrument.
pub fn check_resumable(hub: &Hub, run: &str) -> Result<(), String> {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
    let known = !run.starts_with('.') && run.chars().all(plain);
    let status = if known { status_of(&hub.facts.runs_dir.join(run)) } else { None };
    let Some(status) = status else {
        return Err(format!(
            "there is no run \"{run}\" in {}; `goniod status` lists them",
            hub.facts.runs_dir.display()
        ));
    };
    let queued = hub.queue(|queue| {
        let asks = |e: &Entry| matches!(&e.work, Work::Resume { run: asked } if asked == run);
        queue.entries().any(|e| !e.is_over() && (e.run() == Some(run) || asks(e)))
    });
    if queued {
        return Err(format!("{run} is in the queue already"));
    }
    if status.is_finished() {
        return Err(format!("{run} is finished: every exposure is stored or listed as missing"));
    }
    must_be_real(&compare_with_now(hub, run)?, run)
}
