//! `POST /v1/verbs/{verb}`: what an operator asks of the run under way, or, with none, of the queue.

use super::answers::Accepted;
use super::error::ApiError;
use super::routes::Shared;
use crate::control::sequencer::verbs::{Answer, Verb};
use crate::front::daemon::hub::{Current, Hub};
use crate::front::daemon::safety;
use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use std::time::Duration;
use tokio::sync::mpsc::error::TrySendError;

/// The verbs by the names of their paths.
pub const VERBS: [(&str, Verb); 6] = [
    ("pause", Verb::Pause),
    ("pause-now", Verb::PauseNow),
    ("resume", Verb::Resume),
    ("stop", Verb::Stop),
    ("abort", Verb::Abort),
    ("safe", Verb::Safe),
];

/// How long a run that begins or ends may keep the bench from who wants it safe.
const BENCH: Duration = Duration::from_secs(3);

pub(super) async fn ask(
    State(hub): State<Shared>,
    name: Result<Path<String>, PathRejection>,
) -> Result<Json<Accepted>, ApiError> {
    let Path(name) = name?;
    let Some((name, verb)) = VERBS.iter().find(|(n, _)| *n == name) else {
        let known: Vec<&str> = VERBS.iter().map(|(n, _)| *n).collect();
        let why = format!("there is no verb \"{name}\"; there are {}", known.join(", "));
        return Err(ApiError::new(StatusCode::NOT_FOUND, why));
    };
    let (run, message) = match hub.current() {
        Some(current) => {
            let when = give(&hub, &current, *verb)?;
            (Some(current.run), format!("{name}, {when}"))
        }
        None if *verb == Verb::Safe => {
            // A task of its own: a client that goes away does not leave the bench half safe.
            let made = tokio::spawn(async move { make_safe(&hub).await });
            (None, made.await.map_err(|e| ApiError::broken(&e))??)
        }
        None => (None, without_run(&hub, name, *verb).await?),
    };
    Ok(Json(Accepted { verb: (*name).to_owned(), run, message }))
}

/// Gives the verb to the run; says when it is carried out. The run's own answer, which may differ where its state
/// changes in between, is in its journal.
fn give(hub: &Hub, current: &Current, verb: Verb) -> Result<&'static str, ApiError> {
    let when = match current.state.answer(verb) {
        Answer::Now(_) => "now",
        Answer::AfterStep(_) => "after the exposure under way",
        Answer::Refused(why) => return Err(ApiError::new(StatusCode::CONFLICT, format!("{}: {why}", current.run))),
    };
    current.verbs.try_send(verb).map_err(|e| match e {
        TrySendError::Full(_) => ApiError::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "the sequencer has not taken the requests before this one yet; ask again",
        ),
        TrySendError::Closed(_) => ApiError::new(StatusCode::CONFLICT, "the run has just ended"),
    })?;
    if matches!(verb, Verb::Stop | Verb::Abort | Verb::Safe) {
        hub.end_asked(&current.run);
    }
    Ok(when)
}

/// Without a run: opens what the safe state lists and makes it safe; the queue is held first.
async fn make_safe(hub: &Shared) -> Result<String, ApiError> {
    let why = "the operator asked for the safe state; `goniod resume` lets the queue go on";
    let holder = Shared::clone(hub);
    let saved = tokio::task::spawn_blocking(move || holder.hold(Some(why.to_owned())));
    let saved = saved.await.map_err(|e| ApiError::broken(&e))?;
    let Ok(_bench) = hub.clock.timeout(BENCH, hub.bench.lock()).await else {
        let why = "a run is about to end; ask again in a moment";
        return Err(ApiError::new(StatusCode::SERVICE_UNAVAILABLE, why));
    };
    let made = safety::make_safe(hub).await;
    let words = made.map_err(|why| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, why))?;
    // Whether the hold is on the disk too matters less than the bench, and is told after it.
    saved?;
    Ok(format!("the bench is safe: {words}; the queue is held"))
}

/// Between runs the queue is meant: `resume` lets it go on, `pause` and `stop` hold it.
async fn without_run(hub: &Shared, name: &str, verb: Verb) -> Result<String, ApiError> {
    let held = hub.queue(|queue| queue.held().map(str::to_owned));
    let (why, message) = match (verb, held) {
        (Verb::Resume, Some(_)) => (None, "the queue goes on"),
        (Verb::Resume, None) => {
            return Err(nothing(name, "and nothing holds the queue; `goniod resume RUN` goes on with a run"));
        }
        (Verb::Abort, _) => return Err(nothing(name, "so there is nothing to give up")),
        (_, Some(_)) => return Err(nothing(name, "and the queue is held already")),
        (_, None) => (
            Some("the operator holds the queue; `goniod resume` lets it go on".to_owned()),
            "the queue is held; `goniod resume` lets it go on",
        ),
    };
    let hub = Shared::clone(hub);
    let saved = tokio::task::spawn_blocking(move || hub.hold(why)).await.map_err(|e| ApiError::broken(&e))?;
    saved?;
    Ok(message.to_owned())
}

fn nothing(name: &str, rest: &str) -> ApiError {
    ApiError::new(StatusCode::CONFLICT, format!("{name}: no run is under way, {rest}"))
}
