//! Signs of life to the service manager. They come from the worker's own task, so a sequencer that blocks its thread
//! or goes silent past all its deadlines stops them, and the manager starts the daemon again.

use super::hub::{Current, Hub};
use crate::control::sequencer::state::State;
use sd_notify::NotifyState;
use std::time::Duration;

/// How often the state is looked at, unless the manager wants signs of life more often.
const RHYTHM: Duration = Duration::from_secs(5);
/// Most signs of life in a second.
const SHORTEST: Duration = Duration::from_millis(100);

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
    let mut said = String::new();
    loop {
        let current = hub.current();
        let stuck = current.as_ref().is_some_and(|c| is_stuck(c, hub.clock.elapsed().as_secs_f64()));
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

/// True when a run that should be moving has not given an event for longer than any of its steps can take.
fn is_stuck(current: &Current, now_s: f64) -> bool {
    let moving = !matches!(current.state, State::Paused | State::Suspended(_));
    moving && now_s - current.heard_s > current.silence_s
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
