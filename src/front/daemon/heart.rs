//! Signs of life to the service manager. They come from the worker's own task, so a sequencer that blocks its thread
//! or comes round no more past all its deadlines stops them, and the manager starts the daemon again.

use super::hub::{Current, Hub};
use sd_notify::NotifyState;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// How often the state is looked at, unless the manager wants signs of life more often.
pub const RHYTHM: Duration = Duration::from_secs(5);
/// Most signs of life in a second.
const SHORTEST: Duration = Duration::from_millis(100);

/// What the sequencer's last sign of life was, and when it was seen.
#[derive(Debug, Default)]
struct Pulse {
    run: String,
    beats: u64,
    at_s: f64,
}

/// Tells the service manager that the daemon is ready.
pub fn ready() {
    tell(&[NotifyState::Ready]);
}

/// Tells the service manager that the daemon is on its way out.
pub fn stopping() {
    tell(&[NotifyState::Stopping]);
}

/// Gives signs of life for as long as it is polled; never ends.
pub async fn beat(hub: &Hub) {
    let rhythm = sd_notify::watchdog_enabled().map_or(RHYTHM, |limit| (limit / 3).clamp(SHORTEST, RHYTHM));
    let (mut said, mut pulse) = (String::new(), Pulse::default());
    loop {
        let current = hub.current();
        let stuck = current.as_ref().is_some_and(|c| pulse.is_gone(c, hub.clock.elapsed().as_secs_f64()));
        let words = status(hub, current.as_ref(), stuck);
        if words != said {
            tell(&[NotifyState::Status(&words)]);
            said = words;
        }
        if stuck {
            tracing::error!("the sequencer is silent past all its deadlines");
        } else {
            tell(&[NotifyState::Watchdog]);
        }
        hub.clock.sleep(rhythm).await;
    }
}

// === impl Pulse ===

impl Pulse {
    /// True when a run has neither come round nor given an event for longer than any of its steps can take. One that is
    /// paused or suspended comes round all the same: it looks at its gauges.
    fn is_gone(&mut self, current: &Current, now_s: f64) -> bool {
        let beats = current.beats.load(Ordering::Relaxed);
        if beats != self.beats || current.run != self.run {
            *self = Pulse { run: current.run.clone(), beats, at_s: now_s };
        }
        now_s - current.heard_s.max(self.at_s) > current.silence_s
    }
}

fn status(hub: &Hub, current: Option<&Current>, stuck: bool) -> String {
    let held = hub.queue(|queue| (queue.held().is_some(), queue.waiting()));
    match (current, held) {
        (Some(c), _) if stuck => format!("{}: the sequencer is silent", c.run),
        (Some(c), (_, waiting)) => {
            format!("{}: {} of {} exposures, {} missing; {waiting} waiting", c.run, c.stored, c.steps, c.missing)
        }
        (None, (true, waiting)) => format!("the queue is held; {waiting} waiting"),
        (None, (false, _)) => "idle".to_owned(),
    }
}

fn tell(state: &[NotifyState<'_>]) {
    // Without a manager there is nobody to tell.
    let _ = sd_notify::notify(state);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::events::EventBus;
    use crate::control::sequencer::interlocks::Reason;
    use crate::control::sequencer::state::State;
    use goniod_drivers::clock::UtcMicros;

    fn current(events: &EventBus, state: State) -> Current {
        let (verbs, _) = tokio::sync::mpsc::channel(1);
        Current {
            entry: 1,
            run: "r".to_owned(),
            scan: "s".to_owned(),
            steps: 9,
            to_do: 9,
            stored: 0,
            missing: 0,
            state,
            begun: UtcMicros(0),
            lamp: Default::default(),
            forecast_s: 10.0,
            silence_s: 600.0,
            heard_s: 0.0,
            beats: events.beats(),
            end_asked: false,
            verbs,
        }
    }

    #[test]
    fn signs_of_life_end_when_the_sequencer_comes_round_no_more_whatever_its_state() {
        for state in [State::Running, State::Paused, State::Suspended([Reason::Disk].into())] {
            let (events, mut pulse) = (EventBus::default(), Pulse::default());
            let mut current = current(&events, state.clone());
            assert!(!pulse.is_gone(&current, 0.0));
            for hour in 1..9 {
                events.beat();
                assert!(!pulse.is_gone(&current, f64::from(hour) * 3600.0), "{state:?}: it comes round");
            }
            assert!(!pulse.is_gone(&current, 29_300.0), "{state:?}: within its deadlines");
            assert!(pulse.is_gone(&current, 29_401.0), "{state:?}: stuck");
            current.heard_s = 29_402.0;
            assert!(!pulse.is_gone(&current, 29_403.0), "{state:?}: an event is a sign of life");
        }
    }
}
