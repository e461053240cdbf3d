//! What is going on now, for everybody who asks: the run under way, the stream of events, who waits for what.

use super::error::DaemonError;
use super::queue::Queue;
use crate::control::events::{Event, Stamped};
use crate::control::sequencer::state::State;
use crate::control::sequencer::verbs::Verb;
use crate::front::lamp::LampWait;
use crate::front::remaining::left_s;
use goniod_drivers::clock::{Clock, UtcMicros};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::{Notify, broadcast, mpsc, watch};

/// Events a slow client may fall behind before it loses the oldest.
const CLIENT_BACKLOG: usize = 1024;
/// Events that a newcomer is shown.
const LAST_EVENTS: usize = 20;

/// The daemon's shared middle: worker on one side, clients on the other. Nobody waits for a client here.
pub struct Hub {
    /// What does not change while the daemon runs.
    pub facts: Facts,
    /// Time.
    pub clock: Clock,
    /// Wakes the worker: an entry came, the hold is gone.
    pub wake: Notify,
    /// Wakes the maker of products.
    pub products: Notify,
    /// Events that clients lost because they were too slow.
    pub lost: AtomicU64,
    /// Held by whoever has the devices open.
    pub bench: tokio::sync::Mutex<()>,
    queue: Mutex<Queue>,
    current: Mutex<Option<Current>>,
    last: Mutex<VecDeque<Told>>,
    feed: broadcast::Sender<Told>,
    phase: watch::Sender<Phase>,
}

/// What does not change while the daemon runs.
#[derive(Debug, Clone)]
pub struct Facts {
    /// Name of the instrument.
    pub name: String,
    /// The instrument file, absolute.
    pub instrument: PathBuf,
    /// Folder of the run directories.
    pub runs_dir: PathBuf,
    /// A run that the daemon's end cut short is gone on with by itself.
    pub auto_resume: bool,
}

/// How far the daemon is on its way out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Phase {
    /// At work.
    Working,
    /// Asked to end: the run under way is stopped well.
    Stopping,
    /// Asked again: the run under way is ended now.
    Aborting,
    /// The bench is safe; clients are sent away.
    Closing,
}

/// The run under way.
#[derive(Debug, Clone)]
pub struct Current {
    /// Entry of the queue.
    pub entry: u32,
    /// The run.
    pub run: String,
    /// Name of the scan.
    pub scan: String,
    /// Exposures of the plan.
    pub steps: u32,
    /// Exposures to do when it began or went on.
    pub to_do: u32,
    /// Stored by now.
    pub stored: u32,
    /// Missing by now.
    pub missing: u32,
    /// What the sequencer is doing.
    pub state: State,
    /// When it began or went on.
    pub begun: UtcMicros,
    /// What a lamp that went out takes besides the forecast.
    pub lamp: LampWait,
    /// Forecast of the whole plan, seconds.
    pub forecast_s: f64,
    /// Longest time without an event that a sound sequencer can need, seconds.
    pub silence_s: f64,
    /// When the last event came, seconds of the daemon's clock.
    pub heard_s: f64,
    /// The sequencer's signs of life.
    pub beats: Arc<AtomicU64>,
    /// An operator asked for its end.
    pub end_asked: bool,
    /// Where requests go.
    pub verbs: mpsc::Sender<Verb>,
}

/// An event as clients are told it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Told {
    /// The run it belongs to.
    pub run: Option<String>,
    /// Its number in the run's journal; absent for what no journal keeps.
    pub seq: Option<u64>,
    /// When.
    pub utc: UtcMicros,
    /// What.
    pub event: What,
}

/// An event of a run or of the daemon itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum What {
    /// Of the run.
    Run(Event),
    /// Of the daemon.
    Daemon(DaemonEvent),
}

/// What happens outside of runs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum DaemonEvent {
    /// An entry of the queue is in another state.
    EntryChanged {
        /// The entry.
        entry: u32,
        /// `waiting`, `running`, `done`, `failed`, `cancelled`.
        state: String,
        /// Why, where it failed.
        reason: Option<String>,
    },
    /// The queue is held, or goes on.
    QueueHeld {
        /// Why; absent when it goes on.
        reason: Option<String>,
    },
    /// Products of a run were made.
    ProductsMade {
        /// T and R in a few lines.
        headline: Vec<String>,
    },
    /// Products of a run could not be made.
    ProductsFailed {
        /// Why, and what to do.
        reason: String,
    },
    /// This listener was too slow and lost events; those of a run are in its journal.
    Lagged {
        /// How many.
        lost: u64,
    },
    /// The daemon ends.
    Stopping,
}

// === impl What ===

impl What {
    /// The event's kind as its JSON names it.
    pub fn kind(&self) -> &'static str {
        match self {
            What::Run(event) => event.kind(),
            What::Daemon(DaemonEvent::EntryChanged { .. }) => "entry-changed",
            What::Daemon(DaemonEvent::QueueHeld { .. }) => "queue-held",
            What::Daemon(DaemonEvent::ProductsMade { .. }) => "products-made",
            What::Daemon(DaemonEvent::ProductsFailed { .. }) => "products-failed",
            What::Daemon(DaemonEvent::Lagged { .. }) => "lagged",
            What::Daemon(DaemonEvent::Stopping) => "stopping",
        }
    }
}

// === impl Current ===

impl Current {
    /// Seconds that the run will still take.
    pub fn left_s(&self, now: UtcMicros) -> f64 {
        let done = (self.stored + self.missing).saturating_sub(self.steps.saturating_sub(self.to_do));
        let share = f64::from(self.to_do) / f64::from(self.steps.max(1));
        let elapsed_s = (now.0 - self.begun.0) as f64 / 1e6 - self.lamp.taken_s(now);
        left_s(self.forecast_s * share, elapsed_s, done, self.to_do) + self.lamp.ahead_s(now)
    }

    fn note(&mut self, stamped: &Stamped, now_s: f64) {
        self.heard_s = now_s;
        self.lamp.note(stamped);
        match &stamped.event {
            Event::RunStarted { steps, to_do } => (self.steps, self.to_do) = (*steps, *to_do),
            Event::StateChanged { to, .. } => self.state = to.clone(),
            Event::Progress { stored, missing, .. } => (self.stored, self.missing) = (*stored, *missing),
            _ => {}
        }
    }
}

// === impl Hub ===

impl Hub {
    /// A hub without a run.
    pub fn new(facts: Facts, queue: Queue, clock: Clock) -> Hub {
        Hub {
            facts,
            clock,
            wake: Notify::new(),
            products: Notify::new(),
            lost: AtomicU64::new(0),
            bench: tokio::sync::Mutex::new(()),
            queue: Mutex::new(queue),
            current: Mutex::new(None),
            last: Mutex::new(VecDeque::new()),
            feed: broadcast::Sender::new(CLIENT_BACKLOG),
            phase: watch::Sender::new(Phase::Working),
        }
    }

    /// Works on the queue; short, and never across an await.
    pub fn queue<T>(&self, work: impl FnOnce(&mut Queue) -> T) -> T {
        work(&mut held(&self.queue))
    }

    /// The run under way.
    pub fn current(&self) -> Option<Current> {
        held(&self.current).clone()
    }

    /// Puts a run under way, or none.
    pub fn set_current(&self, current: Option<Current>) {
        *held(&self.current) = current;
    }

    /// Notes that an operator asked for the end of this run.
    pub fn end_asked(&self, run: &str) {
        if let Some(current) = held(&self.current).as_mut().filter(|c| c.run == run) {
            current.end_asked = true;
        }
    }

    /// Listens to everything that happens from now on.
    pub fn listen(&self) -> broadcast::Receiver<Told> {
        self.feed.subscribe()
    }

    /// Listens to the daemon's way out.
    pub fn phase(&self) -> watch::Receiver<Phase> {
        self.phase.subscribe()
    }

    /// Goes on to a later phase; never back.
    pub fn go(&self, phase: Phase) {
        self.phase.send_if_modified(|now| {
            let later = phase > *now;
            if later {
                *now = phase;
            }
            later
        });
    }

    /// The last events that journals keep.
    pub fn last(&self) -> Vec<Told> {
        held(&self.last).iter().cloned().collect()
    }

    /// Clients that listen now.
    pub fn listeners(&self) -> usize {
        self.feed.receiver_count()
    }

    /// Tells an event of a run and takes note of it.
    pub fn tell_run(&self, run: &str, stamped: &Stamped) {
        if let Some(current) = held(&self.current).as_mut() {
            current.note(stamped, self.clock.elapsed().as_secs_f64());
        }
        let seq = stamped.event.journalled().then_some(stamped.seq);
        let event = What::Run(stamped.event.clone());
        self.publish(Told { run: Some(run.to_owned()), seq, utc: stamped.utc, event });
    }

    /// Tells an event of the daemon.
    pub fn tell(&self, run: Option<&str>, event: DaemonEvent) {
        let run = run.map(str::to_owned);
        self.publish(Told { run, seq: None, utc: self.clock.utc(), event: What::Daemon(event) });
    }

    /// Tells that an entry is in another state.
    pub fn tell_entry(&self, entry: &super::entry::Entry) {
        let reason = match &entry.state {
            super::entry::EntryState::Failed { reason, .. } => Some(reason.clone()),
            _ => None,
        };
        let state = entry.state.name().to_owned();
        self.tell(entry.run(), DaemonEvent::EntryChanged { entry: entry.id, state, reason });
    }

    /// Holds the queue, or lets it go on.
    ///
    /// # Errors
    /// Storage failures; the hold is then in memory only.
    pub fn hold(&self, why: Option<String>) -> Result<(), DaemonError> {
        let saved = self.queue(|queue| queue.hold(why.clone()));
        self.tell(None, DaemonEvent::QueueHeld { reason: why });
        self.wake.notify_one();
        saved
    }

    /// Counts events that a client lost.
    pub fn count_lost(&self, lost: u64) {
        self.lost.fetch_add(lost, Ordering::Relaxed);
    }

    fn publish(&self, told: Told) {
        let kept = match &told.event {
            What::Run(event) => event.journalled() && !matches!(event, Event::FrameStored { .. }),
            What::Daemon(_) => true,
        };
        if kept {
            let mut last = held(&self.last);
            last.push_back(told.clone());
            if last.len() > LAST_EVENTS {
                last.pop_front();
            }
        }
        // The only error is that nobody listens.
        let _ = self.feed.send(told);
    }
}

/// A lock's value also after a panic elsewhere: every change under these locks is one assignment.
fn held<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn told_events_read_back_and_name_their_kind() {
        let events = [
            What::Run(Event::Progress { stored: 1, missing: 0, steps: 3 }),
            What::Daemon(DaemonEvent::EntryChanged { entry: 1, state: "done".to_owned(), reason: None }),
            What::Daemon(DaemonEvent::QueueHeld { reason: None }),
            What::Daemon(DaemonEvent::ProductsMade { headline: vec![] }),
            What::Daemon(DaemonEvent::ProductsFailed { reason: "r".to_owned() }),
            What::Daemon(DaemonEvent::Lagged { lost: 3 }),
            What::Daemon(DaemonEvent::Stopping),
        ];
        for event in events {
            let told = Told { run: None, seq: Some(4), utc: UtcMicros(5), event };
            let json = serde_json::to_value(&told).unwrap();
            assert_eq!(json["event"]["kind"], told.event.kind());
            assert_eq!(serde_json::from_value::<Told>(json).unwrap(), told);
        }
    }
}
