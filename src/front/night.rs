//! One run from checked files to a closed run directory: plan, document, directory, sequencer.

use super::bench::Opened;
use super::cli::exit::Exit;
use super::cli::output::Failure;
use crate::archive::disk::RealDisk;
use crate::archive::space::must_fit;
use crate::archive::{ArchiveError, NewRun, RunDir};
use crate::config::check::Checked;
use crate::config::instrument::{Changer, Instrument};
use crate::control::events::EventBus;
use crate::control::lamp_hours::LampLog;
use crate::control::plan::Plan;
use crate::control::plan::build::build;
use crate::control::plan::document::{INPUTS, KeptFile, RunDocument};
use crate::control::plan::forecast::Timing;
use crate::control::sequencer::layout::layout;
use crate::control::sequencer::light::LightRules;
use crate::control::sequencer::recovery::Policies;
use crate::control::sequencer::run::{Job, Outcome, run};
use crate::control::sequencer::state::Ending;
use crate::control::sequencer::verbs::Verb;
use goniod_drivers::clock::{Clock, UtcMicros};
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::sync::mpsc;

/// A run that is about to begin.
pub struct Night {
    /// The plan.
    pub plan: Plan,
    /// The run directory, made.
    pub run: Arc<RunDir>,
    /// Its path.
    pub path: PathBuf,
    /// Serial numbers that the devices must have, where the run is gone on with.
    pub serials: BTreeMap<String, String>,
    /// Held while this process works on the run.
    pub lock: File,
}

/// The plan of checked files.
///
/// # Errors
/// A scan that cannot be planned, as bad input.
pub fn plan(checked: &Checked) -> Result<Plan, Failure> {
    build(&checked.instrument, &checked.scan, &Timing::default())
        .map_err(|e| Failure::new(Exit::BadInput, e.to_string()))
}

/// Makes the run directory for a plan.
///
/// # Errors
/// A folder that cannot be written, a full disk, a run of this name that exists: storage failures.
pub fn prepare(
    checked: &Checked,
    plan: Plan,
    runs_dir: &Path,
    clock: Clock,
    seed: Option<u64>,
) -> Result<Night, Failure> {
    let run_id = name(checked, &plan, clock);
    prepare_named(checked, plan, runs_dir, clock, seed, &run_id)
}

/// The name that a run beginning now gets.
pub fn name(checked: &Checked, plan: &Plan, clock: Clock) -> String {
    run_id(&checked.scan.name, clock.utc(), &plan.hash)
}

/// As [`prepare`], under a name that was chosen before.
///
/// # Errors
/// As [`prepare`].
pub fn prepare_named(
    checked: &Checked,
    plan: Plan,
    runs_dir: &Path,
    clock: Clock,
    seed: Option<u64>,
    run_id: &str,
) -> Result<Night, Failure> {
    let files = checked.files.iter();
    let document = RunDocument {
        run_id: run_id.to_owned(),
        goniod_version: env!("CARGO_PKG_VERSION").to_owned(),
        simulated_seed: seed,
        virtual_time: clock.is_virtual(),
        started: stamp(clock.utc()).to_string(),
        files: files
            .clone()
            .map(|f| KeptFile { role: f.role.clone(), name: f.name.clone(), sha256: f.sha256.clone() })
            .collect(),
        scan: checked.scan.clone(),
        instrument: checked.instrument.clone(),
        calibrations: checked.calibrations.clone(),
        plan: plan.clone(),
    };
    let text = toml::to_string(&document)
        .map_err(|e| Failure::new(Exit::Failed, format!("the plan cannot be written as TOML: {e}")))?;
    let kept: Vec<(PathBuf, Vec<u8>)> = files.map(|f| (Path::new(INPUTS).join(&f.name), f.bytes.clone())).collect();
    let shape = layout(&plan, &checked.instrument.camera).map_err(|e| Failure::new(Exit::BadInput, e.to_string()))?;
    must_fit(&RealDisk, runs_dir, plan.forecast.raw_bytes).map_err(storage)?;
    let new = NewRun { run_id, plan_toml: &text, files: &kept, layout: &shape };
    let run = RunDir::create(runs_dir, &new).map_err(storage)?;
    let path = runs_dir.join(run_id);
    let lock = hold(&path)?;
    Ok(Night { plan, run: Arc::new(run), path, serials: BTreeMap::new(), lock })
}

/// What is done about failing devices, and about an operator who does not come.
fn policies(instrument: &Instrument) -> Policies {
    let policies = Policies::of(&instrument.recovery);
    match instrument.holder.changer.as_ref().and_then(Changer::operator_within) {
        Some(within) => policies.with_operator(within),
        None => policies,
    }
}

/// Where the hours of the lamp are kept: beside the run. A rehearsal burns none.
fn lamp_log(instrument: &Instrument, night: &Night, clock: Clock) -> Option<LampLog> {
    let runs_dir = night.path.parent().filter(|_| !clock.is_virtual())?;
    LampLog::of(instrument, runs_dir)
}

/// What to know of the lamp's hours before a run in this folder.
pub fn lamp_warning(instrument: &Instrument, plan: &Plan, runs_dir: &Path) -> Option<String> {
    let log = LampLog::of(instrument, runs_dir)?;
    match log.age() {
        Ok(age) => age.warning(plan.forecast.total_s()),
        Err(e) => Some(e.to_string()),
    }
}

/// Carries the plan out.
///
/// # Errors
/// A journal that cannot be read at the start; everything later is in the outcome.
pub async fn measure(
    checked: &Checked,
    night: &Night,
    opened: &mut Opened,
    clock: Clock,
    verbs: mpsc::Receiver<Verb>,
    events: &EventBus,
) -> Result<Outcome, Failure> {
    let instrument = &checked.instrument;
    let job = Job {
        plan: &night.plan,
        gains: instrument.camera.iter().map(|(name, c)| (name.clone(), c.gain)).collect(),
        reserved_rows: checked.calibrations.iter().map(|(n, c)| (n.clone(), c.geometry.reserved_rows)).collect(),
        safe_state: instrument.safe_state.clone(),
        attempts: Job::ATTEMPTS,
        recovery: policies(instrument),
        interlocks: instrument.interlocks.clone(),
        light: LightRules { hours: lamp_log(instrument, night, clock), ..LightRules::of(instrument) },
        serials: night.serials.clone(),
    };
    run(&job, &mut opened.bench, Arc::clone(&night.run), clock, verbs, events).await.map_err(storage)
}

/// Holds a run for this process; the system lets it go when the process ends, however it ends.
///
/// # Errors
/// Another process works on the run, as a failed command; a folder that cannot be opened.
pub fn hold(path: &Path) -> Result<File, Failure> {
    let failed = |e: std::io::Error| Failure::new(Exit::Storage, format!("{}: {e}", path.display()));
    let folder = File::open(path).map_err(failed)?;
    match rustix::fs::flock(&folder, rustix::fs::FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => Ok(folder),
        Err(rustix::io::Errno::WOULDBLOCK) => {
            let message = format!("{}: another process works on this run; wait for it, or stop it", path.display());
            Err(Failure::new(Exit::Failed, message))
        }
        Err(e) => Err(failed(e.into())),
    }
}

/// The exit code of an outcome.
pub fn exit_of(outcome: &Outcome) -> Exit {
    match outcome.ending {
        Ending::Completed if outcome.summary.missing > 0 => Exit::Incomplete,
        Ending::Completed if outcome.is_safe() => Exit::Done,
        Ending::Stopped | Ending::Aborted | Ending::MadeSafe => Exit::Stopped,
        Ending::DiskFull | Ending::ArchiveFailed => Exit::Storage,
        Ending::Crashed => Exit::Failed,
        _ => Exit::Device,
    }
}

/// An archive error as a failure of a command.
pub fn storage(e: ArchiveError) -> Failure {
    let exit = if matches!(e, ArchiveError::Damaged { .. }) { Exit::Damaged } else { Exit::Storage };
    Failure::new(exit, e.to_string())
}

/// A stamp as a calendar time; what lies beyond the calendar is its first or last moment.
pub fn stamp(utc: UtcMicros) -> jiff::Timestamp {
    let beyond = if utc.0 < 0 { jiff::Timestamp::MIN } else { jiff::Timestamp::MAX };
    jiff::Timestamp::from_microsecond(utc.0).unwrap_or(beyond)
}

/// `20260101T180000Z-venetian-blind-1a2b3c4d`: when, what, which plan.
fn run_id(name: &str, utc: UtcMicros, hash: &str) -> String {
    let words = name.to_lowercase();
    let parts = words.split(|c: char| !c.is_ascii_alphanumeric()).filter(|w| !w.is_empty());
    let mut slug = parts.collect::<Vec<_>>().join("-");
    slug.truncate(40);
    let when = stamp(utc).strftime("%Y%m%dT%H%M%SZ").to_string();
    format!("{when}-{}-{}", slug.trim_end_matches('-'), hash.get(..8).unwrap_or(hash))
}
