//! `GET /v1/events`: what happens, as server-sent events. A client that is too slow loses the oldest and is told how
//! many; nobody waits for it.

use super::error::ApiError;
use super::guarded::Watch;
use super::routes::Shared;
use crate::archive::RunDir;
use crate::archive::rows::EventRow;
use crate::control::events::Event as RunEvent;
use crate::front::daemon::hub::{DaemonEvent, Hub, Phase, Told, What};
use axum::Extension;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Query, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::Sse;
use axum::response::sse::{Event, KeepAlive};
use futures_util::stream::{self, Stream, StreamExt};
use goniod_drivers::clock::UtcMicros;
use serde::Deserialize;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{broadcast, watch};

/// Events of journals that one answer replays at most; a client that lacks more is told so.
const MOST_REPLAYED: usize = 20_000;
/// Silence after which a comment is sent, so that dead clients are noticed.
const KEEP_ALIVE: Duration = Duration::from_secs(10);

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Since {
    since: Option<String>,
}

/// Where a client's knowledge ends.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Known {
    run: String,
    seq: u64,
}

struct Listener {
    hub: Shared,
    replay: VecDeque<Told>,
    /// Events of the journal up to here were replayed.
    replayed: Option<Known>,
    live: broadcast::Receiver<Told>,
    phase: watch::Receiver<Phase>,
}

pub(super) async fn events(
    State(hub): State<Shared>,
    Extension(watch): Extension<Arc<Watch>>,
    headers: HeaderMap,
    query: Result<Query<Since>, QueryRejection>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, ApiError> {
    let Query(Since { since }) = query?;
    let last_id = headers.get("last-event-id").and_then(|v| v.to_str().ok()).map(str::to_owned);
    let since = since.or(last_id).map(|text| parse(&text)).transpose()?;
    // First listen, then read the journal: nothing falls between the two.
    let live = hub.listen();
    let phase = hub.phase();
    let reader = Shared::clone(&hub);
    let replay = tokio::task::spawn_blocking(move || since.map_or_else(Vec::new, |known| replay(&reader, &known)));
    let replay: VecDeque<Told> = replay.await.map_err(|e| ApiError::broken(&e))?.into();
    let newest = replay.iter().rev().find_map(|t| Some(Known { run: t.run.clone()?, seq: t.seq? }));
    let listener = Listener { hub, replay, replayed: newest, live, phase };
    let stream = stream::unfold(listener, |mut listener| async move {
        let told = listener.next().await?;
        Some((Ok(sse(&told)), listener))
    });
    let stream = stream.take_until(async move { watch.over().await });
    Ok(Sse::new(stream).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)))
}

// === impl Listener ===

impl Listener {
    /// The next event; `None` when the daemon sends its clients away.
    async fn next(&mut self) -> Option<Told> {
        if let Some(told) = self.replay.pop_front() {
            return Some(told);
        }
        loop {
            let received = tokio::select! {
                biased;
                received = self.live.recv() => received,
                _ = self.phase.wait_for(|p| *p == Phase::Closing) => return None,
            };
            match received {
                Ok(told) if self.knows(&told) => {}
                Ok(told) => return Some(told),
                Err(broadcast::error::RecvError::Lagged(lost)) => {
                    self.hub.count_lost(lost);
                    let event = What::Daemon(DaemonEvent::Lagged { lost });
                    return Some(Told { run: None, seq: None, utc: self.hub.clock.utc(), event });
                }
                Err(broadcast::error::RecvError::Closed) => return None,
            }
        }
    }

    fn knows(&self, told: &Told) -> bool {
        let (Some(known), Some(run), Some(seq)) = (&self.replayed, &told.run, told.seq) else { return false };
        known.run == *run && seq <= known.seq
    }
}

/// `RUN/NUMBER`, as the events' own ids are written.
fn parse(text: &str) -> Result<Known, ApiError> {
    let parts = text.rsplit_once('/').and_then(|(run, seq)| Some((run, seq.parse::<i64>().ok()?)));
    let plain = |run: &str| run.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-'));
    match parts {
        Some((run, seq)) if seq >= -1 && !run.is_empty() && !run.starts_with('.') && plain(run) => {
            // -1 is before the first.
            Ok(Known { run: run.to_owned(), seq: (seq + 1) as u64 })
        }
        _ => {
            let why = format!(
                "`since={text}` is no place in a run; write RUN/NUMBER as the ids of events are, RUN/-1 for all"
            );
            Err(ApiError::new(StatusCode::BAD_REQUEST, why))
        }
    }
}

/// What the journals have after `from`: the rest of that run, then the run under way where that is another one.
/// `from.seq` is the first number that is not known.
fn replay(hub: &Hub, from: &Known) -> Vec<Told> {
    let mut told = journal(hub, &from.run, from.seq);
    if let Some(current) = hub.current().filter(|c| c.run != from.run) {
        told.extend(journal(hub, &current.run, 0));
    }
    let lost = told.len().saturating_sub(MOST_REPLAYED);
    if lost > 0 {
        told.drain(..lost);
        let event = What::Daemon(DaemonEvent::Lagged { lost: lost as u64 });
        told.insert(0, Told { run: None, seq: None, utc: hub.clock.utc(), event });
    }
    told
}

fn journal(hub: &Hub, run: &str, from: u64) -> Vec<Told> {
    let read = RunDir::open(&hub.facts.runs_dir.join(run)).and_then(|dir| dir.with(|journal| journal.events()));
    // A run that cannot be read has nothing to replay.
    let rows = read.unwrap_or_default();
    let tell = |row: EventRow| {
        let event = serde_json::from_str::<RunEvent>(&row.json).ok()?;
        Some(Told {
            run: Some(run.to_owned()),
            seq: Some(row.seq),
            utc: UtcMicros(row.utc_us),
            event: What::Run(event),
        })
    };
    rows.into_iter().filter(|row| row.seq >= from).filter_map(tell).collect()
}

fn sse(told: &Told) -> Event {
    let data = serde_json::to_string(told).unwrap_or_default();
    let event = Event::default().event(told.event.kind()).data(data);
    match (&told.run, told.seq) {
        (Some(run), Some(seq)) => event.id(format!("{run}/{seq}")),
        _ => event,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn places_are_read_as_ids_are_written_and_nothing_else_is() {
        assert_eq!(parse("20260101T180000Z-a-1/7").unwrap(), Known { run: "20260101T180000Z-a-1".to_owned(), seq: 8 });
        assert_eq!(parse("r/-1").unwrap().seq, 0);
        for wrong in ["", "7", "r/", "/7", "r/x", "../etc/7", "a/b/7", ".hidden/1", "r/-2", "r/99999999999999999999"] {
            assert!(parse(wrong).is_err(), "{wrong}");
        }
    }

    fn hub(state: &std::path::Path) -> Shared {
        let facts = crate::front::daemon::hub::Facts {
            name: "n".to_owned(),
            instrument: state.join("instrument.toml"),
            runs_dir: state.join("runs"),
            auto_resume: false,
        };
        let queue = crate::front::daemon::queue::Queue::open(state).unwrap();
        std::sync::Arc::new(Hub::new(facts, queue, goniod_drivers::clock::Clock::starting_at(UtcMicros(0))))
    }

    /// A client that does not read: the oldest are gone, their number is told and counted, and the rest comes in order.
    #[tokio::test(start_paused = true)]
    async fn a_client_that_falls_behind_is_told_how_many_events_it_lost() {
        const TOLD: u64 = 3000;
        let state = tempfile::tempdir().unwrap();
        let hub = hub(state.path());
        let (live, phase) = (hub.listen(), hub.phase());
        let mut listener = Listener { hub: Shared::clone(&hub), replay: VecDeque::new(), replayed: None, live, phase };
        for seq in 0..TOLD {
            let event = RunEvent::FrameStored { step: seq as u32, bytes: 1, attempts: 1, rejected: 0 };
            hub.tell_run("r", &crate::control::events::Stamped { seq, utc: UtcMicros(0), event });
        }
        let first = listener.next().await.unwrap();
        let What::Daemon(DaemonEvent::Lagged { lost }) = first.event else { panic!("{first:?}") };
        assert!(lost > 0 && hub.lost.load(std::sync::atomic::Ordering::Relaxed) == lost);
        for seq in lost..TOLD {
            assert_eq!(listener.next().await.unwrap().seq, Some(seq), "in order, none twice");
        }
        hub.go(Phase::Closing);
        assert_eq!(listener.next().await, None);
    }
}
