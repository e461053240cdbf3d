//! The night: checks the bench, takes the exposures of a plan in order, ends safe.

use super::interlocks::Reason;
use super::light::LightRules;
use super::memory::Memory;
use super::recorder::{Recorder, Standing};
use super::recovery::Policies;
use super::stage::Stage;
use super::state::{Ending, Input, State};
use super::step::{Hands, StepEnd};
use super::verbs::{Listener, Verb};
use super::watch::Watch;
use crate::archive::rows::{StepState, Summary};
use crate::archive::{ArchiveError, RunDir};
use crate::config::instrument::SafeState;
use crate::config::night::Interlocks;
use crate::control::devices::bench::{Bench, DeviceId};
use crate::control::devices::safe::{SafeReport, SafeResult};
use crate::control::events::{Event, EventBus};
use crate::control::plan::{Plan, Step, Subject, View};
use futures_util::FutureExt;
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::ShutterState;
use std::collections::{BTreeMap, BTreeSet};
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::Instant;

/// How often a suspended run looks whether its reasons are gone, where the instrument says no other period.
const LOOK: Duration = Duration::from_secs(5);

/// How often a bracket is taken again because the lamp drifted; after that it is kept, its drift on record.
const MOST_RETAKES: u32 = 2;

/// Verbs that may wait for the sequencer.
const VERBS: usize = 16;

/// What to carry out and how carefully.
#[derive(Debug, Clone)]
pub struct Job<'a> {
    /// The plan.
    pub plan: &'a Plan,
    /// Fixed gain of each camera, in the driver's units.
    pub gains: BTreeMap<String, f64>,
    /// Rows at the top of each camera's frames that are not picture.
    pub reserved_rows: BTreeMap<String, usize>,
    /// The ordered list of the safe state.
    pub safe_state: SafeState,
    /// Attempts a frame gets from the guard.
    pub attempts: u32,
    /// What is done about failing devices.
    pub recovery: Policies,
    /// Conditions under which exposures wait; absent = nothing is watched.
    pub interlocks: Option<Interlocks>,
    /// What the readings of the light monitor mean; heeded where there are interlocks.
    pub light: LightRules,
    /// Serial numbers that devices must have, by name: those of the run that is gone on with.
    pub serials: BTreeMap<String, String>,
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outcome {
    /// Why it ended.
    pub ending: Ending,
    /// Steps by state.
    pub summary: Summary,
    /// How each device became safe.
    pub safe: Vec<SafeReport>,
    /// What the operator must know, where there is something.
    pub message: Option<String>,
    /// Frames that had to wait until the disk had taken the frames before them.
    pub disk_waits: u64,
}

/// Why the run is over, and what the operator must know.
type Ended = (Ending, Option<String>);

/// One run under way.
struct Night<'a> {
    job: &'a Job<'a>,
    bench: &'a mut Bench,
    stage: &'a Stage,
    listener: Listener,
    memory: Memory,
    watch: Watch,
    events: &'a EventBus,
    lost: Option<Lost>,
}

/// A device that is waited for.
#[derive(Debug, Clone)]
struct Lost {
    id: DeviceId,
    /// When it is tried again; `None`: when somebody asks.
    again: Option<Instant>,
    view: u32,
}

// === impl Job ===

impl Job<'_> {
    /// Attempts of the guard when nothing else is said.
    pub const ATTEMPTS: u32 = 4;
}

// === impl Outcome ===

impl Outcome {
    /// True when every device of the safe state proved it.
    pub fn is_safe(&self) -> bool {
        self.safe.iter().all(|report| report.outcome == SafeResult::Confirmed)
    }
}

/// Carries the plan's exposures out that the run's journal has as planned, and closes the run. Whatever happens in
/// between, the bench is then in its safe state, as far as its devices can be reached.
///
/// # Errors
/// [`ArchiveError`] when the journal cannot even be read at the start; everything later is in the outcome.
pub async fn run(
    job: &Job<'_>,
    bench: &mut Bench,
    archive: Arc<RunDir>,
    clock: Clock,
    verbs: mpsc::Receiver<Verb>,
    events: &EventBus,
) -> Result<Outcome, ArchiveError> {
    let (rows, summary, seq) = archive.with(|j| Ok((j.steps()?, j.summary()?, j.next_seq()?)))?;
    let planned = |state: &StepState| *state == StepState::Planned;
    let to_do: BTreeSet<u32> = rows.iter().filter(|r| planned(&r.state)).map(|r| r.layout.number).collect();
    let recorder = Recorder::start(Arc::clone(&archive), summary, seq, events.clone(), clock);
    let stage = Stage::new(recorder, clock);
    let steps = job.plan.steps.len() as u32;
    stage.recorder().event(Event::RunStarted { steps, to_do: to_do.len() as u32 }).await;
    let watch = Watch::new(job.interlocks.clone(), job.light.clone(), Arc::clone(&archive), clock.now());
    let (urgent, verbs) = past_the_sequencer(verbs);
    let (listener, memory) = (Listener::new(verbs), Memory::default());
    let mut night = Night { job, bench: &mut *bench, stage: &stage, listener, memory, watch, events, lost: None };
    // A panic is an end like any other: the bench becomes safe, and what is on the disk stays good.
    let exposures = AssertUnwindSafe(night.exposures(&to_do)).catch_unwind();
    let ended = tokio::select! {
        biased;
        () = urgent => (Ending::MadeSafe, None),
        ended = exposures => ended.unwrap_or_else(|panic| {
            let why = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
            let why = why.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
            (Ending::Crashed, Some(format!("the program failed: {why}; please report this")))
        }),
    };
    let Night { memory, watch, .. } = night;
    end(job, bench, (stage, archive), (memory, watch), ended).await
}

/// A way for the verb `safe` that no sequencer stands in, and the verbs for the sequencer.
fn past_the_sequencer(mut verbs: mpsc::Receiver<Verb>) -> (impl Future<Output = ()>, mpsc::Receiver<Verb>) {
    let (forward, forwarded) = mpsc::channel(VERBS);
    let urgent = async move {
        while let Some(verb) = verbs.recv().await {
            if verb == Verb::Safe {
                return;
            }
            // A sequencer that takes no verbs any more is told no more; `safe` still comes through.
            let _ = forward.try_send(verb);
        }
        drop(forward);
        std::future::pending().await
    };
    (urgent, forwarded)
}

// === impl Night ===

impl Night<'_> {
    /// Checks the bench and takes the exposures that are to do; gives why it is over.
    async fn exposures(&mut self, to_do: &BTreeSet<u32>) -> Ended {
        self.stage.go(Input::Start).await;
        let plan = self.job.plan;
        let goes_on = to_do.len() < plan.steps.len();
        let (mut hands, listener) = self.hands();
        let checked = tokio::select! {
            biased;
            () = listener.until_interrupted(hands.stage) => Err((Ending::Aborted, None)),
            checked = hands.check(goes_on) => checked.map_err(|(e, why)| (e, Some(why))),
        };
        if let Err(ended) = checked {
            return self.asked_or_failed().unwrap_or(ended);
        }
        self.stage.go(Input::Ready).await;
        let views: BTreeMap<u32, &View> = plan.views.iter().map(|view| (view.id, view)).collect();
        for bracket in plan.steps.chunk_by(|a, b| a.view == b.view) {
            let todo: Vec<&Step> = bracket.iter().filter(|step| to_do.contains(&step.number)).collect();
            let Some(first) = todo.first() else { continue };
            let ended = match views.get(&first.view) {
                Some(view) => self.bracket(view, bracket, todo).await,
                None => {
                    let reason = "the plan has no such view";
                    for step in todo {
                        self.stage.recorder().missing(step, None, reason.to_owned()).await;
                    }
                    None
                }
            };
            if let Some(ended) = ended {
                return ended;
            }
        }
        (Ending::Completed, None)
    }

    /// The steps `todo` of a bracket; where the lamp drifts too far or goes out meanwhile, the whole bracket again, a
    /// bounded number of times. `Some` when the run must end.
    async fn bracket(&mut self, view: &View, all: &[Step], mut todo: Vec<&Step>) -> Option<Ended> {
        let limit = self.watch.drift_per_view();
        let lit = self.bench.devices.light_monitor.is_some() && view.subject != Subject::Dark;
        let limit = limit.filter(|_| lit);
        if limit.is_some() && todo.len() < all.len() {
            // Begun by another process: what the lamp did since then is not known.
            self.stage.recorder().retake(view.id, None).await;
            todo = all.iter().collect();
        }
        for retakes in 0.. {
            let before = match self.level_before(view).await {
                Ok(before) => before,
                Err(ended) => return Some(ended),
            };
            let losses = self.watch.lamp_losses();
            self.watch.forget_levels();
            for step in &todo {
                if let Some(ended) = self.until_done(view, step).await {
                    return Some(ended);
                }
            }
            if limit.is_none() && !(lit && self.watch.judges_lamp()) {
                break;
            }
            let after = self.watch.level(self.bench, self.stage, Some(view.id)).await;
            // A level that cannot be had proves nothing.
            let before = before.filter(|w| *w > 0.0).filter(|_| after.is_some());
            let change = before.and_then(|before| self.watch.largest_change(before));
            let steady = limit.is_none_or(|limit| change.is_some_and(|change| change.abs() <= limit));
            let out = self.watch.lamp_losses() != losses;
            if !out && (steady || retakes == MOST_RETAKES) {
                break;
            }
            self.memory.forget_bracket();
            self.stage.recorder().retake(view.id, change).await;
            todo = all.iter().collect();
            if retakes == MOST_RETAKES {
                for step in todo {
                    let reason = format!("the lamp went out while the view was taken, {} times", retakes + 1);
                    self.stage.recorder().missing(step, Some(view), reason).await;
                }
                break;
            }
        }
        None
    }

    /// The level at the beginning of a bracket, of a lamp that is steady where it is judged; `Err` when the run must end.
    async fn level_before(&mut self, view: &View) -> Result<Option<f64>, Ended> {
        loop {
            if let Some(ended) = self.between().await {
                return Err(ended);
            }
            let level = self.watch.level(self.bench, self.stage, Some(view.id)).await;
            if level.is_none() || self.watch.lamp_is_steady(self.stage.clock().now()) {
                return Ok(level);
            }
        }
    }

    /// One step, again after each interruption, until it is stored or missing; `Some` when the run must end.
    async fn until_done(&mut self, view: &View, step: &Step) -> Option<Ended> {
        loop {
            if let Some(ended) = self.between().await {
                return Some(ended);
            }
            let (camera, exposure_us) = (view.camera.clone(), step.exposure.0);
            let (number, view_id) = (step.number, view.id);
            let begins = Event::StepStarted { step: number, view: view_id, camera, exposure_us };
            self.stage.recorder().event(begins).await;
            let (mut hands, listener) = self.hands();
            let end = tokio::select! {
                biased;
                () = listener.until_interrupted(hands.stage) => None,
                () = hands.stage.recorder().until_trouble() => None,
                end = hands.take(view, step) => Some(end),
            };
            match end {
                // What was under way is unknown on every device; each is opened anew before it is used again.
                None => self.memory.doubt_all(self.bench),
                Some(StepEnd::Taken) => return None,
                Some(StepEnd::Missing(reason)) => {
                    self.stage.recorder().missing(step, Some(view), reason).await;
                    return None;
                }
                Some(StepEnd::Lost(id, after)) => {
                    if let Some(ended) = self.lose(id, after, view_id) {
                        return Some(ended);
                    }
                }
                Some(StepEnd::End(ending, why)) => return Some((ending, Some(why))),
            }
        }
    }

    /// Between two exposures: everything that may forbid the next is looked at until nothing does; `Some` when the run
    /// must end.
    async fn between(&mut self) -> Option<Ended> {
        let mut suspended: Option<Instant> = None;
        loop {
            self.events.beat();
            self.listener.catch_up(self.stage).await;
            if let Some(ended) = self.asked_or_failed() {
                return Some(ended);
            }
            let trips = self.watch.look(self.bench, self.stage).await;
            if let Some(alarm) = trips.alarm() {
                return Some((Ending::Alarm, Some(alarm)));
            }
            let mut reasons = trips.reasons();
            reasons.extend(self.stage.recorder().standing().full.then_some(Reason::Disk));
            if let Some(ended) = self.wait_for_lost(&mut reasons).await {
                return Some(ended);
            }
            match self.stage.state() {
                State::Pausing => {
                    self.rest().await;
                    self.stage.go(Input::Rested).await;
                }
                State::Paused if self.listener.is_closed() => self.stage.go(Input::Resume).await,
                State::Paused => self.wait(None).await,
                state => {
                    let was_suspended = matches!(state, State::Suspended(_));
                    if reasons.is_empty() && !was_suspended {
                        return None;
                    }
                    if let Some(ended) = self.too_long(&mut suspended, &reasons) {
                        return Some(ended);
                    }
                    if !was_suspended && !reasons.contains(&Reason::DeviceLost) {
                        self.rest().await;
                    }
                    let (from, clear) = (state, reasons.is_empty());
                    self.stage.go(Input::Hold(reasons)).await;
                    if !clear && self.stage.state() == from {
                        let until = self.lost.as_ref().map(|lost| lost.again);
                        self.wait(until.flatten()).await;
                    }
                }
            }
        }
    }

    /// Tries a lost device again when its time has come; while it stays lost it is a reason to wait.
    async fn wait_for_lost(&mut self, reasons: &mut BTreeSet<Reason>) -> Option<Ended> {
        let asked = self.listener.take_try_again();
        let lost = self.lost.clone()?;
        if asked
            && lost.id == DeviceId::Changer
            && let Some(desk) = &self.bench.devices.operator
        {
            desk.confirm();
        }
        let (now, state) = (self.stage.clock().now(), self.stage.state());
        if !matches!(state, State::Suspended(ref s) if s.contains(&Reason::DeviceLost)) {
            // First the bench is made safe, as far as it can be reached.
            if state != State::Paused && state != State::Pausing {
                let reports = self.bench.make_safe(&self.job.safe_state, self.stage.clock()).await;
                record_safe(self.stage, &reports).await;
            }
            reasons.insert(Reason::DeviceLost);
            return None;
        }
        if !asked && lost.again.is_none_or(|again| now < again) {
            reasons.insert(Reason::DeviceLost);
            return None;
        }
        let (mut hands, listener) = self.hands();
        let tried = tokio::select! {
            biased;
            () = listener.until_interrupted(hands.stage) => return None,
            tried = hands.try_lost(&lost.id, lost.view) => tried,
        };
        self.lost = None;
        match tried? {
            StepEnd::Lost(id, after) => {
                reasons.insert(Reason::DeviceLost);
                self.lose(id, after, lost.view)
            }
            StepEnd::End(ending, why) => Some((ending, Some(why))),
            StepEnd::Taken | StepEnd::Missing(_) => None,
        }
    }

    /// A device is waited for; `Some` when it waits for somebody and nobody is there.
    fn lose(&mut self, id: DeviceId, after: Option<Duration>, view: u32) -> Option<Ended> {
        if after.is_none() && self.listener.is_closed() {
            return Some((Ending::DeviceLost, Some(format!("{id} stayed lost, and nobody can resume the run"))));
        }
        let again = after.map(|after| self.stage.clock().now() + after);
        self.lost = Some(Lost { id, again, view });
        None
    }

    /// Ends a run that waits too long. A lost device has its own longest outage.
    fn too_long(&self, since: &mut Option<Instant>, reasons: &BTreeSet<Reason>) -> Option<Ended> {
        if reasons.iter().all(|r| *r == Reason::DeviceLost) {
            *since = None;
            return None;
        }
        let now = self.stage.clock().now();
        let longest = self.watch.longest_suspension(now);
        if now - *since.get_or_insert(now) < longest {
            return None;
        }
        let names: Vec<&str> = reasons.iter().map(|r| r.name()).collect();
        let why = format!("suspended for {} s: {}", longest.as_secs(), names.join(", "));
        let full = self.stage.recorder().standing().full;
        let disk = "the disk is full; free space on it and go on with the run";
        Some(if full { (Ending::DiskFull, Some(disk.to_owned())) } else { (Ending::SuspendedTooLong, Some(why)) })
    }

    /// The archive's failure, or what was asked for.
    fn asked_or_failed(&self) -> Option<Ended> {
        failure(&self.stage.recorder().standing()).or_else(|| self.listener.ending().map(|ending| (ending, None)))
    }

    /// Closes the shutter. One that does not close now shows itself at the next exposure, or at the end.
    async fn rest(&mut self) {
        let clock = self.stage.clock();
        if self.bench.set_shutter(ShutterState::Closed, clock).await.is_err() {
            let _ = self.bench.open(&DeviceId::Shutter, clock).await;
        }
    }

    /// Waits for a verb, the next look at the gauges, or `until`.
    async fn wait(&mut self, until: Option<Instant>) {
        let clock = self.stage.clock();
        let look = clock.now() + self.watch.period().unwrap_or(LOOK);
        tokio::select! {
            biased;
            () = self.listener.answer_next(self.stage) => {}
            () = clock.sleep_until(until.map_or(look, |until| until.min(look))) => {}
        }
    }

    fn hands(&mut self) -> (Hands<'_>, &mut Listener) {
        let hands = Hands { job: self.job, bench: self.bench, memory: &mut self.memory, stage: self.stage };
        (hands, &mut self.listener)
    }
}

/// Safe state, last words, closed archive. The bench comes first: the disk may be slow, full or gone.
async fn end(
    job: &Job<'_>,
    bench: &mut Bench,
    (stage, archive): (Stage, Arc<RunDir>),
    (mut memory, mut watch): (Memory, Watch),
    (mut ending, mut message): Ended,
) -> Result<Outcome, ArchiveError> {
    let changed = stage.enter(&Input::End(ending));
    stage.recorder().lose_patience();
    let told = async {
        memory.release(stage.recorder()).await;
        if let Some(changed) = changed {
            stage.recorder().event(changed).await;
        }
    };
    let (safe, ()) = tokio::join!(bench.make_safe(&job.safe_state, stage.clock()), told);
    record_safe(&stage, &safe).await;
    watch.end(bench, &stage).await;
    stage.recorder().flush().await;
    if let Some((failed, why)) = failure(&stage.recorder().standing()) {
        (ending, message) = (failed, why);
    }
    stage.go(Input::Safe(safe.iter().all(|r| r.outcome == SafeResult::Confirmed))).await;
    let Summary { planned, stored, missing, .. } = stage.recorder().standing().summary;
    let last = Event::RunEnded { ending, stored, missing, planned, message: message.clone() };
    stage.recorder().event(last).await;
    let disk_waits = stage.recorder().waits();
    let standing = stage.into_recorder().finish().await;
    let closed = tokio::task::spawn_blocking(move || archive.close()).await;
    if let Ok(Err(e)) = closed
        && standing.failure.is_none()
    {
        ending = if e.is_full() { Ending::DiskFull } else { Ending::ArchiveFailed };
        message = Some(e.to_string());
    }
    Ok(Outcome { ending, summary: standing.summary, safe, message, disk_waits })
}

async fn record_safe(stage: &Stage, reports: &[SafeReport]) {
    for SafeReport { device, outcome, began_ms, ended_ms, .. } in reports {
        let (device, outcome, began_ms, ended_ms) = (device.clone(), *outcome, *began_ms, *ended_ms);
        stage.recorder().event(Event::SafeState { device, outcome, began_ms, ended_ms }).await;
    }
}

fn failure(standing: &Standing) -> Option<Ended> {
    let (full, why) = standing.failure.clone()?;
    Some((if full { Ending::DiskFull } else { Ending::ArchiveFailed }, Some(why)))
}
