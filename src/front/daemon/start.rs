//! From an entry of the queue to a bench that is open and a run directory that is there.

use super::entry::{Entry, EntryState, QueuedScan, Work};
use super::hub::Hub;
use super::snapshot;
use super::worker::change;
use crate::config::check::{Checked, Options, check};
use crate::front::bench::{CAMERA_DRIVERS, Opened, open};
use crate::front::cli::output::Failure;
use crate::front::night::{self, Night};
use goniod_drivers::clock::Clock;
use goniod_drivers::table::DRIVERS;
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

/// What the checks are to know.
pub fn options(clock: Clock) -> Options {
    let drivers = DRIVERS.iter().map(|d| d.name).chain(CAMERA_DRIVERS).map(str::to_owned).collect();
    Options { drivers, today: night::stamp(clock.utc()).to_zoned(jiff::tz::TimeZone::UTC).date() }
}

/// Checks a scan for the queue.
///
/// # Errors
/// Every fault of the files, or a scan that cannot be planned.
pub fn check_for_queue(hub: &Hub, scan: &Path, clock: Clock) -> Result<(QueuedScan, Checked), super::error::DaemonError> {
    let (scan, instrument) = (snapshot::plain(scan), &hub.facts.instrument);
    let checked = check(&scan, instrument, &options(clock))?;
    let plan = night::plan(&checked).map_err(|f| super::error::DaemonError::Plan(f.messages.join("; ")))?;
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
    Ok((queued, checked))
}

/// Prepares an entry's run; the entry is then written as running under its run's name.
///
/// # Errors
/// One sentence: copies that are damaged, a bench that cannot be opened, a run directory that cannot be made.
pub fn begin(hub: &Hub, entry: &Entry, clock: Clock) -> Result<Begun, String> {
    let scan = match (&entry.work, &entry.state) {
        (Work::Resume { run }, _) => return go_on(hub, entry, run, clock),
        (Work::Scan(_), EntryState::Running { run }) if hub.facts.runs_dir.join(run).exists() => {
            return go_on(hub, entry, run, clock);
        }
        (Work::Scan(scan), _) => scan,
    };
    let folder = hub.queue(|queue| queue.folder_of(entry.id));
    let checked = snapshot::read(&folder, scan, &options(clock)).map_err(|e| e.to_string())?;
    let plan = night::plan(&checked).map_err(sentence)?;
    let opened = open(&checked, clock).map_err(|e| e.to_string())?;
    let run = free_name(&hub.facts.runs_dir, night::name(&checked, &plan, clock));
    // First the name, then the directory: whichever a crash finds, the next start knows what to do.
    change(hub, entry.id, |e| e.state = EntryState::Running { run: run.clone() });
    let night =
        night::prepare_named(&checked, plan, &hub.facts.runs_dir, clock, opened.seed, &run).map_err(sentence)?;
    Ok(Begun { checked, night, opened, clock, run })
}

/// Goes on with a run that was cut short.
fn go_on(_hub: &Hub, _entry: &Entry, run: &str, _clock: Clock) -> Result<Begun, String> {
    Err(format!("{run}: going on is not built yet"))
}

/// The name, or with a number behind it where a run of this name is there already.
fn free_name(runs_dir: &Path, name: String) -> String {
    let mut names = std::iter::once(name.clone()).chain((2..).map(|n| format!("{name}-{n}")));
    names.find(|name| !runs_dir.join(name).exists()).unwrap_or(name)
}

fn sentence(failure: Failure) -> String {
    failure.messages.join("; ")
}

/// Whether a run can be gone on with.
///
/// # Errors
/// Why not.
pub fn check_resumable(hub: &Hub, run: &str) -> Result<(), String> {
    Err(format!("{}/{run}: going on is not built yet", hub.facts.runs_dir.display()))
}
