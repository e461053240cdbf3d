//! What happens in a run, as typed events: the journal keeps them, progress displays and the report are made from them.

use super::devices::safe::SafeResult;
use super::frames::guard::Rejection;
use super::lamp_hours::LampAge;
use super::sequencer::interlocks::Trip;
use super::sequencer::state::{Ending, State};
use super::sequencer::verbs::Verb;
use goniod_drivers::clock::UtcMicros;
use goniod_drivers::contract::Identity;
use goniod_drivers::error::ErrorKind;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tokio::sync::broadcast;

/// Events a slow listener may fall behind before it loses the oldest.
const LISTENER_BACKLOG: usize = 1024;

/// One thing that happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Event {
    /// A run begins or goes on.
    RunStarted {
        /// Exposures of the plan.
        steps: u32,
        /// Exposures still to do.
        to_do: u32,
    },
    /// The sequencer is in another state.
    StateChanged {
        /// Before.
        from: State,
        /// Now.
        to: State,
    },
    /// A device was opened and told who it is.
    DeviceOpened {
        /// Name of the instrument file.
        device: String,
        /// What it said.
        identity: Identity,
    },
    /// An exposure begins (not journalled).
    StepStarted {
        /// Step of the plan.
        step: u32,
        /// View of the plan.
        view: u32,
        /// Camera.
        camera: String,
        /// Integration time, microseconds.
        exposure_us: u64,
    },
    /// A frame did not fit its label and was thrown away.
    FrameRejected {
        /// Step it was taken for.
        step: u32,
        /// Why.
        reason: Rejection,
    },
    /// A frame is on the disk and in the journal.
    FrameStored {
        /// Step it was taken for.
        step: u32,
        /// Size of the chunk file.
        bytes: u64,
        /// Attempts it took.
        attempts: u32,
        /// Frames rejected on the way.
        rejected: u32,
    },
    /// An exposure cannot be had and is listed as missing.
    StepMissing {
        /// Step of the plan.
        step: u32,
        /// View of the plan.
        view: u32,
        /// Why, one sentence.
        reason: String,
    },
    /// A device gave an error.
    DeviceError {
        /// Name of the instrument file.
        device: String,
        /// Kind of the error.
        error: ErrorKind,
        /// The device's sentence.
        message: String,
        /// What is done about it.
        decision: String,
    },
    /// Something was asked of the run.
    Asked {
        /// What.
        verb: Verb,
        /// Why it was not carried out; absent when it was.
        refused: Option<String>,
    },
    /// The interlocks stand otherwise than before.
    Interlocks {
        /// Conditions that suspend.
        warnings: Vec<Trip>,
        /// Conditions that end the run.
        alarms: Vec<Trip>,
    },
    /// The light monitor was read.
    LightRead {
        /// View whose bracket begins or ends; absent between brackets.
        view: Option<u32>,
        /// Optical power, watts.
        power_w: f64,
        /// Its standard uncertainty from the scatter of the readings that it is the mean of, watts.
        u_w: f64,
    },
    /// The lamp is in another state, by the light monitor.
    Lamp {
        /// Which.
        lamp: LampNow,
    },
    /// The hours of the lamp, at the beginning and the end of a run.
    LampHours {
        /// How old it is.
        age: LampAge,
    },
    /// The lamp drifted within a bracket: its frames are thrown away and the bracket is taken again.
    ViewRetaken {
        /// View of the plan.
        view: u32,
        /// Largest relative change of the light monitor within it; absent where it is not known.
        change: Option<f64>,
    },
    /// The archive gave an error.
    ArchiveError {
        /// One sentence.
        message: String,
    },
    /// How far the run is (not journalled).
    Progress {
        /// Exposures stored.
        stored: u32,
        /// Exposures missing.
        missing: u32,
        /// Exposures of the plan.
        steps: u32,
    },
    /// One device was asked to make itself safe.
    SafeState {
        /// Name of the instrument file.
        device: String,
        /// How it went.
        outcome: SafeResult,
        /// First command after the reason was known, milliseconds.
        #[serde(default)]
        began_ms: u64,
        /// Proof or last answer after the reason was known, milliseconds.
        #[serde(default)]
        ended_ms: u64,
    },
    /// The run ended.
    RunEnded {
        /// How.
        ending: Ending,
        /// Exposures stored.
        stored: u32,
        /// Exposures missing.
        missing: u32,
        /// Exposures left as planned.
        planned: u32,
        /// What the operator must know, where there is something.
        message: Option<String>,
    },
}

/// The lamp as the light monitor sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "state", rename_all = "kebab-case")]
pub enum LampNow {
    /// Out and hot.
    Cooling {
        /// From then on an operator may strike it.
        strike_from: UtcMicros,
        /// Shortest time from ignition to steady light, seconds.
        warm_up_s: f64,
    },
    /// Out and cool: an operator must strike it.
    Off {
        /// Shortest time from ignition to steady light, seconds.
        warm_up_s: f64,
    },
    /// Burns.
    Warming {
        /// Not steady before then.
        steady_from: UtcMicros,
    },
    /// Burns steadily: light measured now counts.
    Steady,
    /// Was steady; its light changes faster than allowed.
    Drifting,
}

/// An event with its place in the run's history.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stamped {
    /// Rising number.
    pub seq: u64,
    /// When.
    pub utc: UtcMicros,
    /// What.
    pub event: Event,
}

/// Where displays listen. Sending never waits: a listener that falls behind loses the oldest events and is told so.
#[derive(Debug, Clone)]
pub struct EventBus {
    sender: broadcast::Sender<Stamped>,
    beats: Arc<AtomicU64>,
}

// === impl Event ===

impl Event {
    /// False for what only a display needs.
    pub fn journalled(&self) -> bool {
        !matches!(self, Event::StepStarted { .. } | Event::Progress { .. })
    }

    /// The event's kind as its JSON names it.
    pub fn kind(&self) -> &'static str {
        match self {
            Event::RunStarted { .. } => "run-started",
            Event::StateChanged { .. } => "state-changed",
            Event::DeviceOpened { .. } => "device-opened",
            Event::StepStarted { .. } => "step-started",
            Event::FrameRejected { .. } => "frame-rejected",
            Event::FrameStored { .. } => "frame-stored",
            Event::StepMissing { .. } => "step-missing",
            Event::DeviceError { .. } => "device-error",
            Event::Asked { .. } => "asked",
            Event::Interlocks { .. } => "interlocks",
            Event::LightRead { .. } => "light-read",
            Event::Lamp { .. } => "lamp",
            Event::LampHours { .. } => "lamp-hours",
            Event::ViewRetaken { .. } => "view-retaken",
            Event::ArchiveError { .. } => "archive-error",
            Event::Progress { .. } => "progress",
            Event::SafeState { .. } => "safe-state",
            Event::RunEnded { .. } => "run-ended",
        }
    }
}

// === impl EventBus ===

impl Default for EventBus {
    fn default() -> EventBus {
        EventBus { sender: broadcast::Sender::new(LISTENER_BACKLOG), beats: Arc::default() }
    }
}

impl EventBus {
    /// Listens from now on.
    pub fn subscribe(&self) -> broadcast::Receiver<Stamped> {
        self.sender.subscribe()
    }

    /// Tells all listeners; nobody listening is fine.
    pub fn tell(&self, event: Stamped) {
        // The only error is that nobody listens.
        let _ = self.sender.send(event);
    }

    /// A sign of life: the sequencer has come round once more, also where nothing is told because everything waits.
    pub fn beat(&self) {
        self.beats.fetch_add(1, Ordering::Relaxed);
    }

    /// The count of the signs of life, for whoever watches over the sequencer.
    pub fn beats(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.beats)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::super::sequencer::interlocks::Reason;
    use super::*;

    #[test]
    fn the_kind_of_an_event_is_the_one_in_its_json_and_it_reads_back() {
        let events = [
            Event::RunStarted { steps: 3, to_do: 2 },
            Event::StateChanged { from: State::Idle, to: State::Safe(Ending::Completed) },
            Event::StateChanged { from: State::Running, to: State::Suspended([Reason::Disk].into()) },
            Event::Asked { verb: Verb::PauseNow, refused: None },
            Event::FrameRejected { step: 1, reason: Rejection::Damaged },
            Event::SafeState { device: "shutter".to_owned(), outcome: SafeResult::Confirmed, began_ms: 0, ended_ms: 7 },
            Event::Progress { stored: 1, missing: 0, steps: 3 },
            Event::Lamp { lamp: LampNow::Cooling { strike_from: UtcMicros(7), warm_up_s: 300.0 } },
        ];
        for event in events {
            let json = serde_json::to_value(&event).unwrap();
            assert_eq!(json["kind"], event.kind());
            assert_eq!(serde_json::from_value::<Event>(json).unwrap(), event);
        }
    }
}
