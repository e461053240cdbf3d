//! The night: checks the bench, takes the exposures of a plan in order, ends safe.

use super::recorder::Recorder;
use super::state::{Ending, Input, State};
use super::step::{Hands, Memory, StepEnd};
use super::verbs::{Listener, Verb};
use crate::archive::rows::{StepState, Summary};
use crate::archive::{ArchiveError, RunDir};
use crate::config::instrument::SafeState;
use crate::control::devices::bench::Bench;
use crate::control::devices::safe::{SafeReport, SafeResult};
use crate::control::events::{Event, EventBus};
use crate::control::plan::{Plan, Step, View};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::ShutterState;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use tokio::sync::mpsc;

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
    /// Retries an exposure gets after errors of devices.
    pub retries: u32,
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
}

struct Night {
    state: State,
    recorder: Recorder,
    clock: Clock,
}

// === impl Job ===

impl Job<'_> {
    /// Attempts of the guard when nothing else is said.
    pub const ATTEMPTS: u32 = 4;
    /// Retries after errors of devices when nothing else is said.
    pub const RETRIES: u32 = 3;
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
    let mut night = Night { state: State::Idle, recorder, clock };
    let mut listener = Listener::new(verbs);
    let steps = job.plan.steps.len() as u32;
    night.recorder.event(Event::RunStarted { steps, to_do: to_do.len() as u32 }).await;
    let message = night.work(job, bench, &mut listener, &to_do).await;
    night.end(job, bench, archive, message).await
}

// === impl Night ===

impl Night {
    /// Checks and takes everything; ends in the state `MakingSafe`. Gives what the operator must know.
    async fn work(
        &mut self,
        job: &Job<'_>,
        bench: &mut Bench,
        listener: &mut Listener,
        to_do: &BTreeSet<u32>,
    ) -> Option<String> {
        let mut memory = Memory::default();
        self.go(Input::Start).await;
        let mut hands = self.hands(job, bench, &mut memory);
        let checked = tokio::select! {
            biased;
            () = listener.until_abort() => Err((Ending::Aborted, None)),
            checked = hands.check() => checked.map_err(|(e, why)| (e, Some(why))),
        };
        if let Err((ending, why)) = checked {
            self.go(Input::End(ending)).await;
            return why;
        }
        self.go(Input::Ready).await;
        let views: BTreeMap<u32, &View> = job.plan.views.iter().map(|view| (view.id, view)).collect();
        for step in job.plan.steps.iter().filter(|step| to_do.contains(&step.number)) {
            listener.catch_up();
            if let Some((ending, why)) = self.asked_to_end(bench, listener).await {
                self.go(Input::End(ending)).await;
                return why;
            }
            let Some(view) = views.get(&step.view) else {
                self.recorder.missing(step.number, step.view, "the plan has no such view".to_owned()).await;
                continue;
            };
            if let Some((ending, why)) = self.step(job, bench, (&mut memory, listener), (view, step)).await {
                self.go(Input::End(ending)).await;
                return why;
            }
        }
        self.recorder.flush().await;
        let (ending, why) = failure(&self.recorder).unwrap_or((Ending::Completed, None));
        self.go(Input::End(ending)).await;
        why
    }

    /// One step; `Some` when the run must end.
    async fn step(
        &mut self,
        job: &Job<'_>,
        bench: &mut Bench,
        (memory, listener): (&mut Memory, &mut Listener),
        (view, step): (&View, &Step),
    ) -> Option<(Ending, Option<String>)> {
        let (camera, exposure_us) = (view.camera.clone(), step.exposure.0);
        self.recorder.event(Event::StepStarted { step: step.number, view: view.id, camera, exposure_us }).await;
        let mut hands = self.hands(job, bench, memory);
        let end = tokio::select! {
            biased;
            () = listener.until_abort() => return Some((Ending::Aborted, None)),
            end = hands.take(view, step) => end,
        };
        match end {
            StepEnd::Taken => None,
            StepEnd::Missing(reason) => {
                self.recorder.missing(step.number, view.id, reason).await;
                None
            }
            StepEnd::End(ending, why) => Some((ending, Some(why))),
        }
    }

    /// Between two exposures: the archive's failure, stop, abort; a pause is spent here.
    async fn asked_to_end(&mut self, bench: &mut Bench, listener: &mut Listener) -> Option<(Ending, Option<String>)> {
        if listener.paused && !listener.stopped && !listener.aborted {
            self.go(Input::Pause).await;
            // A shutter that does not close now shows itself at the next exposure; the lamp harms nothing meanwhile.
            let _ = bench.set_shutter(ShutterState::Closed, self.clock).await;
            self.go(Input::Rested).await;
            listener.until_resumed().await;
            if !listener.stopped && !listener.aborted {
                self.go(Input::Resume).await;
            }
        }
        if let Some(failed) = failure(&self.recorder) {
            return Some(failed);
        }
        match (listener.aborted, listener.stopped) {
            (true, _) => Some((Ending::Aborted, None)),
            (false, true) => Some((Ending::Stopped, None)),
            (false, false) => None,
        }
    }

    /// Safe state, last words, closed archive.
    async fn end(
        mut self,
        job: &Job<'_>,
        bench: &mut Bench,
        archive: Arc<RunDir>,
        mut message: Option<String>,
    ) -> Result<Outcome, ArchiveError> {
        let mut ending = match self.state {
            State::MakingSafe(why) | State::Ended(why) | State::Faulted(why) => why,
            _ => Ending::Aborted,
        };
        let safe = bench.make_safe(&job.safe_state, self.clock).await;
        for SafeReport { device, outcome, .. } in &safe {
            self.recorder.event(Event::SafeState { device: device.clone(), outcome: *outcome }).await;
        }
        self.recorder.flush().await;
        if let Some((failed, why)) = failure(&self.recorder) {
            (ending, message) = (failed, why);
        }
        self.go(Input::Safe(safe.iter().all(|r| r.outcome == SafeResult::Confirmed))).await;
        let Summary { planned, stored, missing, .. } = self.recorder.standing().summary;
        let last = Event::RunEnded { ending, stored, missing, planned, message: message.clone() };
        self.recorder.event(last).await;
        let standing = self.recorder.finish().await;
        let closed = tokio::task::spawn_blocking(move || archive.close()).await;
        if let Ok(Err(e)) = closed
            && standing.failure.is_none()
        {
            ending = if e.is_full() { Ending::DiskFull } else { Ending::ArchiveFailed };
            message = Some(e.to_string());
        }
        Ok(Outcome { ending, summary: standing.summary, safe, message })
    }

    fn hands<'a>(&'a self, job: &'a Job<'a>, bench: &'a mut Bench, memory: &'a mut Memory) -> Hands<'a> {
        Hands { job, bench, memory, recorder: &self.recorder, clock: self.clock }
    }

    async fn go(&mut self, input: Input) {
        let (from, to) = (self.state, self.state.next(input));
        self.state = to;
        if from != to {
            self.recorder.event(Event::StateChanged { from, to }).await;
        }
    }
}

fn failure(recorder: &Recorder) -> Option<(Ending, Option<String>)> {
    let (full, why) = recorder.standing().failure?;
    Some((if full { Ending::DiskFull } else { Ending::ArchiveFailed }, Some(why)))
}
