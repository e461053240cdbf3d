//! Where the run stands: its state, told to whoever watches, and the recorder that keeps each change.

use super::recorder::Recorder;
use super::state::{Input, State};
use crate::control::events::Event;
use goniod_drivers::clock::Clock;
use tokio::sync::watch;

/// State and record of a run under way.
pub struct Stage {
    state: watch::Sender<State>,
    recorder: Recorder,
    clock: Clock,
}

// === impl Stage ===

impl Stage {
    /// A run about to begin.
    pub fn new(recorder: Recorder, clock: Clock) -> Stage {
        Stage { state: watch::Sender::new(State::Idle), recorder, clock }
    }

    /// The state now.
    pub fn state(&self) -> State {
        self.state.borrow().clone()
    }

    /// The recorder.
    pub fn recorder(&self) -> &Recorder {
        &self.recorder
    }

    /// The run's time.
    pub fn clock(&self) -> Clock {
        self.clock
    }

    /// Enters the state that follows from `input`, without recording it; the change, where there is one.
    pub fn enter(&self, input: &Input) -> Option<Event> {
        let from = self.state();
        let to = from.next(input);
        if from == to {
            return None;
        }
        self.state.send_replace(to.clone());
        Some(Event::StateChanged { from, to })
    }

    /// Enters the state that follows from `input` and records the change.
    pub async fn go(&self, input: Input) {
        if let Some(changed) = self.enter(&input) {
            self.recorder.event(changed).await;
        }
    }

    /// The recorder, to end recording.
    pub fn into_recorder(self) -> Recorder {
        self.recorder
    }
}
