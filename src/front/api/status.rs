//! `GET /v1/status`: everything at a glance.

use super::answers::{Headline, RunNow, Status};
use super::routes::Shared;
use crate::front::daemon::entry::Products;
use crate::front::daemon::hub::{Current, Hub, Phase};
use crate::front::night::stamp;
use crate::front::remaining::after;
use axum::Json;
use axum::extract::State;
use goniod_drivers::clock::UtcMicros;
use std::sync::atomic::Ordering;

pub(super) async fn status(State(hub): State<Shared>) -> Json<Status> {
    Json(now(&hub))
}

fn now(hub: &Hub) -> Status {
    let now = hub.clock.utc();
    let (held, waiting, bad_entries, headline) = hub.queue(|queue| {
        let headline = queue.entries().rev().find_map(|e| match (&e.products, e.run()) {
            (Products::Made { headline, .. }, Some(run)) => {
                Some(Headline { run: run.to_owned(), lines: headline.clone() })
            }
            _ => None,
        });
        (queue.held().map(str::to_owned), queue.waiting(), queue.bad().len(), headline)
    });
    Status {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        pid: std::process::id(),
        instrument: hub.facts.name.clone(),
        runs_dir: hub.facts.runs_dir.clone(),
        now: stamp(now).to_string(),
        held,
        stopping: *hub.phase().borrow() > Phase::Working,
        run: hub.current().map(|current| run_now(&current, now)),
        waiting,
        bad_entries,
        headline,
        last_events: hub.last(),
        listeners: hub.listeners(),
        lost_events: hub.lost.load(Ordering::Relaxed),
    }
}

fn run_now(current: &Current, now: UtcMicros) -> RunNow {
    let left_s = current.left_s(now);
    // A state is plain data: JSON always holds it.
    let detail = serde_json::to_value(&current.state).unwrap_or_default();
    RunNow {
        entry: current.entry,
        run: current.run.clone(),
        scan: current.scan.clone(),
        state: word(&detail),
        detail,
        exposures: current.steps,
        stored: current.stored,
        missing: current.missing,
        begun: stamp(current.begun).to_string(),
        left_s,
        lamp: current.lamp.told(),
        done_at: stamp(after(now, left_s)).to_string(),
    }
}

/// The state's name: the text itself, or the key of a state with particulars.
fn word(state: &serde_json::Value) -> String {
    let key = || state.as_object().and_then(|o| o.keys().next().cloned());
    state.as_str().map(str::to_owned).or_else(key).unwrap_or_default()
}
