//! Carries the queue out: one run at a time, in order, for as long as the daemon lives.

use super::entry::{Ended, Entry, EntryState, Products};
use super::error::DaemonError;
use super::hub::{Current, Hub, Phase};
use super::lock::Locks;
use super::queue::Queue;
use super::settle::settle;
use super::start::{Begun, NotBegun, begin};
use crate::archive::rows::Summary;
use crate::config::night::Recovery;
use crate::control::events::{EventBus, Stamped};
use crate::control::sequencer::run::Outcome;
use crate::control::sequencer::state::{Ending, State};
use crate::control::sequencer::verbs::Verb;
use crate::front::lamp::LampWait;
use crate::front::night;
use goniod_drivers::clock::Clock;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;
use tokio::sync::{broadcast, mpsc};

/// Requests that may wait for the sequencer.
const VERBS: usize = 8;
/// How long a run may take to stop well when the daemon is to end; the unit's TimeoutStopSec is longer.
pub const STOP_LIMIT: Duration = Duration::from_secs(120);
/// Longest silence of a sound sequencer besides its exposures, seconds: homing and the slowest moves.
const SILENCE_S: f64 = 600.0;
/// Exposures that may pass without an event.
const SILENT_EXPOSURES: f64 = 10.0;

/// Settles what the last daemon left, then works until the daemon is to end; a run under way is then ended well and gone
/// on with at the next start.
pub async fn work(hub: &Arc<Hub>, locks: &Locks) {
    let mut phase = hub.phase();
    let left = settle(hub);
    if left.bench {
        let _bench = hub.bench.lock().await;
        match super::safety::make_safe(hub).await {
            Ok(words) => tracing::info!(words, "the bench was made safe after a run that was cut short"),
            // The run waits for what is away, and holds the queue where its end is not safe.
            Err(why) if left.goes_on && left.hold.is_none() => {
                tracing::warn!(why, "a run was cut short, and the bench could not be made safe")
            }
            Err(why) => hold(hub, format!("a run was cut short, and the bench could not be made safe: {why}")),
        }
    }
    if let Some(why) = left.hold.filter(|_| hub.queue(|queue| queue.held().is_none())) {
        hold(hub, why);
    }
    while *phase.borrow_and_update() == Phase::Working {
        match hub.queue(Queue::claim) {
            Some(entry) => {
                carry_out(hub, locks, &entry).await;
                hub.queue(Queue::let_go);
            }
            None => tokio::select! {
                () = hub.wake.notified() => {}
                _ = phase.changed() => {}
            },
        }
    }
}

/// Carries one entry out and writes what became of it; as long as nothing is sent to a device the bench is free for the
/// safe state.
async fn carry_out(hub: &Arc<Hub>, locks: &Locks, entry: &Entry) {
    let (shared, own) = (Arc::clone(hub), entry.clone());
    let begun = tokio::task::spawn_blocking(move || begin(&shared, &own, Clock::system())).await;
    let begun = begun.unwrap_or_else(|e| Err(NotBegun::Failed(format!("a fault of the program itself: {e}"))));
    let _bench = hub.bench.lock().await;
    let mut begun = match begun {
        Ok(begun) => begun,
        Err(NotBegun::Held) => return,
        Err(NotBegun::Failed(reason)) => {
            failed(hub, entry, reason.clone());
            if let EntryState::Running { run } = &entry.state {
                left_behind(hub, run, &reason).await;
            }
            return;
        }
    };
    let run = begun.run.clone();
    locks.tell(Some(&run));
    tracing::info!(entry = entry.id, run, "begins");
    let ended = measure(hub, entry, &mut begun).await;
    locks.tell(None);
    hub.set_current(None);
    match ended {
        // Held before it could be asked: it is gone on with when the queue is.
        Ok(None) => tracing::info!(run, "does not begin: the queue is held"),
        Ok(Some((outcome, by_us))) => close(hub, entry, &run, &outcome, by_us),
        Err(reason) => {
            failed_run(hub, entry, &run, reason.clone());
            hold(hub, format!("the run {run} broke off: {reason}"));
        }
    }
}

/// A run that was cut short and cannot be gone on with: the bench is made safe, and somebody must look before the next.
async fn left_behind(hub: &Arc<Hub>, run: &str, reason: &str) {
    let safe = match super::safety::make_safe(hub).await {
        Ok(words) => words,
        Err(why) => format!("the bench could not be made safe: {why}"),
    };
    hold(hub, format!("the run {run} was cut short and cannot be gone on with: {reason} ({safe})"));
}

/// Takes the exposures; gives the outcome and whether the daemon's own end cut the run short. `None` where the queue was
/// held before the run could be asked.
async fn measure(hub: &Arc<Hub>, entry: &Entry, begun: &mut Begun) -> Result<Option<(Outcome, bool)>, String> {
    let (sender, verbs) = mpsc::channel(VERBS);
    let events = EventBus::default();
    hub.set_current(Some(current(hub, entry, begun, (sender, events.beats()))));
    // From here on requests go to the run; what came before them held the queue.
    if hub.queue(|queue| queue.held().is_some()) {
        return Ok(None);
    }
    let follower = tokio::spawn(follow(Arc::clone(hub), begun.run.clone(), events.subscribe()));
    let clock = begun.clock;
    let by_us;
    let outcome = {
        let running = night::measure(&begun.checked, &begun.night, &mut begun.opened, clock, verbs, &events);
        let mut running = std::pin::pin!(running);
        tokio::select! {
            outcome = &mut running => { by_us = false; outcome }
            asked = stop_when_asked(hub) => { by_us = asked; running.await }
        }
    };
    drop(events);
    // The follower ends with the bus; it has only bounded work left.
    let _ = hub.clock.timeout(Duration::from_secs(5), follower).await;
    outcome.map(|outcome| Some((outcome, by_us))).map_err(|failure| failure.messages.join("; "))
}

/// Never ends while the daemon is at work; then stops the run, and aborts it when asked again or when it takes too
/// long. Gives whether the daemon was the first to ask for the end; it may have been the operator.
async fn stop_when_asked(hub: &Hub) -> bool {
    let mut phase = hub.phase();
    // The sender lives in the hub.
    let _ = phase.wait_for(|p| *p >= Phase::Stopping).await;
    let Some(current) = hub.current() else { return false };
    ask(&current.verbs, Verb::Stop).await;
    let verbs = current.verbs.clone();
    let clock = hub.clock;
    tokio::spawn(async move {
        // Asked again, or too slow: both mean now.
        let _ = clock.timeout(STOP_LIMIT, phase.wait_for(|p| *p >= Phase::Aborting)).await;
        ask(&verbs, Verb::Abort).await;
    });
    !current.end_asked
}

/// How long a lost device may be waited for.
fn longest_outage_s(recovery: &Recovery) -> f64 {
    let own = recovery.device.values().filter_map(|device| device.longest_outage_s);
    own.fold(recovery.longest_outage_s, f64::max)
}

async fn ask(verbs: &mpsc::Sender<Verb>, verb: Verb) {
    // A run that has ended meanwhile needs no request.
    let _ = verbs.send(verb).await;
}

fn current(hub: &Hub, entry: &Entry, begun: &Begun, (verbs, beats): (mpsc::Sender<Verb>, Arc<AtomicU64>)) -> Current {
    let plan = &begun.night.plan;
    let longest_s = plan.steps.iter().map(|s| s.exposure.0).max().unwrap_or(0) as f64 / 1e6;
    // A run that is gone on with has frames already; a journal that cannot be read ends the run in a moment.
    let Summary { stored, missing, .. } = begun.night.run.with(|journal| journal.summary()).unwrap_or_default();
    let steps = plan.steps.len() as u32;
    Current {
        entry: entry.id,
        run: begun.run.clone(),
        scan: begun.checked.scan.name.clone(),
        steps,
        to_do: steps.saturating_sub(stored + missing),
        stored,
        missing,
        state: State::Idle,
        begun: begun.clock.utc(),
        lamp: LampWait::default(),
        forecast_s: plan.forecast.total_s(),
        silence_s: SILENCE_S + SILENT_EXPOSURES * longest_s + longest_outage_s(&begun.checked.instrument.recovery),
        heard_s: hub.clock.elapsed().as_secs_f64(),
        beats,
        end_asked: false,
        verbs,
    }
}

/// Takes the run's events to the hub until the run's bus is gone.
async fn follow(hub: Arc<Hub>, run: String, mut events: broadcast::Receiver<Stamped>) {
    loop {
        match events.recv().await {
            Ok(stamped) => hub.tell_run(&run, &stamped),
            Err(broadcast::error::RecvError::Lagged(lost)) => {
                hub.tell(Some(&run), super::hub::DaemonEvent::Lagged { lost });
            }
            Err(broadcast::error::RecvError::Closed) => return,
        }
    }
}

/// Writes how a run ended and decides whether the next may begin.
fn close(hub: &Hub, entry: &Entry, run: &str, outcome: &Outcome, by_us: bool) {
    let ending = words(outcome.ending);
    let cut_short = by_us && matches!(outcome.ending, Ending::Stopped | Ending::Aborted);
    if cut_short {
        tracing::info!(run, "cut short by the daemon's end; the next start goes on");
        return;
    }
    let s = &outcome.summary;
    let ended = Ended {
        ending: ending.clone(),
        stored: s.stored,
        missing: s.missing,
        planned: s.planned,
        safe: outcome.is_safe(),
        message: outcome.message.clone(),
    };
    let products = if outcome.ending == Ending::Completed && s.stored > 0 { Products::Pending } else { Products::None };
    change(hub, entry.id, |e| {
        e.state = EntryState::Done { run: run.to_owned(), outcome: ended };
        e.products = products;
    });
    hub.products.notify_one();
    if let Some(why) = holds(run, &ending, outcome) {
        hold(hub, why);
    }
}

/// Why the next entry may not begin after this ending; a scan that failed by itself and left the bench safe is no
/// reason.
fn holds(run: &str, ending: &str, outcome: &Outcome) -> Option<String> {
    let message = outcome.message.as_ref().map_or_else(String::new, |m| format!(" ({m})"));
    match outcome.ending {
        _ if !outcome.is_safe() => {
            Some(format!("after {run} ({ending}) a device did not prove that it is safe: look at the bench"))
        }
        Ending::Completed | Ending::DeviceRefused | Ending::NotReady | Ending::DeviceLost => None,
        Ending::SuspendedTooLong | Ending::Crashed => None,
        Ending::Alarm => Some(format!("an interlock gave the alarm in {run}{message}")),
        Ending::DiskFull | Ending::ArchiveFailed => Some(format!("the archive failed in {run}{message}")),
        Ending::Stopped | Ending::Aborted | Ending::MadeSafe => Some(format!("the operator ended {run} ({ending})")),
    }
}

/// The ending as JSON names it.
pub fn words(ending: Ending) -> String {
    serde_json::to_value(ending).ok().and_then(|v| v.as_str().map(str::to_owned)).unwrap_or_default()
}

fn hold(hub: &Hub, why: String) {
    tracing::warn!(why, "the queue is held");
    if let Err(e) = hub.hold(Some(format!("{why}; `goniod resume` lets the queue go on"))) {
        tracing::error!("{e}");
    }
}

fn failed(hub: &Hub, entry: &Entry, reason: String) {
    tracing::error!(entry = entry.id, reason, "cannot be carried out");
    fail(hub, entry, entry.run(), reason);
}

fn failed_run(hub: &Hub, entry: &Entry, run: &str, reason: String) {
    tracing::error!(run, reason, "broke off");
    fail(hub, entry, Some(run), reason);
}

/// Writes an entry as failed, with its run where there is one.
pub(super) fn fail(hub: &Hub, entry: &Entry, run: Option<&str>, reason: String) {
    let run = run.map(str::to_owned);
    change(hub, entry.id, |e| e.state = EntryState::Failed { run, reason });
}

/// Changes an entry on the disk and tells everybody; false where it is not on the disk. When the state folder cannot be
/// written, nothing more is begun.
pub(super) fn change(hub: &Hub, id: u32, change: impl FnOnce(&mut Entry)) -> bool {
    let changed = hub.queue(|queue| queue.set(id, change));
    let written = changed.is_ok();
    match changed {
        Ok(entry) => hub.tell_entry(&entry),
        Err(e @ DaemonError::NoEntry(_)) => tracing::error!("{e}"),
        Err(e) => {
            if let Some(entry) = hub.queue(|queue| queue.get(id).cloned()) {
                hub.tell_entry(&entry);
            }
            hold(hub, format!("the state folder cannot be written: {e}"));
        }
    }
    written
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::control::events::Event;
    use crate::front::daemon::hub::{DaemonEvent, Facts, What};
    use goniod_drivers::clock::UtcMicros;

    /// The way from a run to the clients may fall behind too: what was lost on it is told, and the rest follows.
    #[tokio::test(start_paused = true)]
    async fn events_that_the_daemon_itself_was_too_slow_for_are_told_as_lost() {
        const TOLD: u64 = 3000;
        let state = tempfile::tempdir().unwrap();
        let (instrument, runs_dir) = (state.path().join("instrument.toml"), state.path().join("runs"));
        let facts = Facts { name: "n".to_owned(), instrument, runs_dir, auto_resume: false };
        let clock = Clock::starting_at(UtcMicros(0));
        let hub = Arc::new(Hub::new(facts, Queue::open(state.path()).unwrap(), clock));
        let events = EventBus::default();
        let receiver = events.subscribe();
        for seq in 0..TOLD {
            let event = Event::FrameStored { step: 0, bytes: 1, attempts: 1, rejected: 0 };
            events.tell(Stamped { seq, utc: UtcMicros(0), event });
        }
        drop(events);
        follow(Arc::clone(&hub), "r".to_owned(), receiver).await;
        let told = hub.last();
        let lost = told.iter().find_map(|t| match t.event {
            What::Daemon(DaemonEvent::Lagged { lost }) => Some(lost),
            _ => None,
        });
        assert!(lost.is_some_and(|lost| (1..TOLD).contains(&lost)), "{told:?}");
    }
}
