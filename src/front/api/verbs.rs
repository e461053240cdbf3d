//! `POST /v1/verbs/{verb}`: what an operator asks of the run under way, or, with none, of the queue.

use super::answers::Accepted;
use super::error::ApiError;
use super::routes::Shared;
use crate::control::sequencer::state::State as RunState;
use crate::control::sequencer::verbs::Verb;
use crate::front::daemon::hub::{Current, Hub};
use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use tokio::sync::mpsc::error::TrySendError;

/// The verbs by the names of their paths.
pub const VERBS: [(&str, Verb); 4] =
    [("pause", Verb::Pause), ("resume", Verb::Resume), ("stop", Verb::Stop), ("abort", Verb::Abort)];

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
            give(&hub, &current, *verb)?;
            (Some(current.run), format!("{name} is with the run"))
        }
        None => (None, without_run(&hub, name, *verb).await?),
    };
    Ok(Json(Accepted { verb: (*name).to_owned(), run, message }))
}

fn give(hub: &Hub, current: &Current, verb: Verb) -> Result<(), ApiError> {
    if let Some(why) = refusal(&current.state, verb) {
        return Err(ApiError::new(StatusCode::CONFLICT, format!("{}: {why}", current.run)));
    }
    current.verbs.try_send(verb).map_err(|e| match e {
        TrySendError::Full(_) => ApiError::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "the sequencer has not taken the requests before this one yet; ask again",
        ),
        TrySendError::Closed(_) => ApiError::new(StatusCode::CONFLICT, "the run has just ended"),
    })?;
    if matches!(verb, Verb::Stop | Verb::Abort) {
        hub.end_asked(&current.run);
    }
    Ok(())
}

/// Why a state does not carry a verb out.
fn refusal(state: &RunState, verb: Verb) -> Option<&'static str> {
    match (state, verb) {
        (RunState::MakingSafe(_), _) => Some("the run is ending; the bench is being made safe"),
        (RunState::Ended(_) | RunState::Faulted(_), _) => Some("the run is over"),
        (RunState::Paused | RunState::Pausing, Verb::Pause) => Some("a pause is asked for already"),
        (RunState::Idle | RunState::Checking | RunState::Running, Verb::Resume) => Some("the run is under way"),
        _ => None,
    }
}

/// Between runs the queue is meant: `resume` lets it go on, `pause` and `stop` hold it.
async fn without_run(hub: &Shared, name: &str, verb: Verb) -> Result<String, ApiError> {
    let held = hub.queue(|queue| queue.held().map(str::to_owned));
    let (why, message) = match (verb, held) {
        (Verb::Resume, Some(_)) => (None, "the queue goes on"),
        (Verb::Resume, None) => return Err(nothing(name, "and nothing holds the queue")),
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
