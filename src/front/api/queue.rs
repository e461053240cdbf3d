//! `/v1/queue`: what waits, what was done, a scan put in, an entry taken out.

use super::answers::{Added, Bad, EntryNow, NewEntry, QueueList};
use super::error::ApiError;
use super::routes::Shared;
use crate::front::daemon::entry::{Entry, Work};
use crate::front::daemon::error::DaemonError;
use crate::front::daemon::hub::Hub;
use crate::front::daemon::queue::Queue;
use crate::front::daemon::start::{check_for_queue, check_resumable};
use crate::front::night::stamp;
use axum::Json;
use axum::extract::rejection::{JsonRejection, PathRejection};
use axum::extract::{Path, State};
use axum::http::StatusCode;
use goniod_drivers::clock::Clock;

pub(super) async fn list(State(hub): State<Shared>) -> Json<QueueList> {
    Json(hub.queue(|queue| QueueList {
        held: queue.held().map(str::to_owned),
        entries: queue.entries().map(EntryNow::of).collect(),
        bad: queue.bad().iter().map(|b| Bad { path: b.path.clone(), reason: b.reason.clone() }).collect(),
    }))
}

pub(super) async fn add(
    State(hub): State<Shared>,
    body: Result<Json<NewEntry>, JsonRejection>,
) -> Result<(StatusCode, Json<Added>), ApiError> {
    let Json(new) = body?;
    // Checking reads files and adding waits for the disk: neither belongs on an async thread.
    let added = tokio::task::spawn_blocking(move || add_blocking(&hub, new));
    let added = added.await.map_err(|e| ApiError::broken(&e))??;
    Ok((StatusCode::CREATED, Json(added)))
}

pub(super) async fn remove(
    State(hub): State<Shared>,
    id: Result<Path<u32>, PathRejection>,
) -> Result<Json<EntryNow>, ApiError> {
    let Path(id) = id?;
    let cancel = move || -> Result<Entry, DaemonError> {
        let entry = hub.queue(|queue| queue.cancel(id))?;
        hub.tell_entry(&entry);
        Ok(entry)
    };
    let entry = tokio::task::spawn_blocking(cancel).await.map_err(|e| ApiError::broken(&e))??;
    Ok(Json(EntryNow::of(&entry)))
}

fn add_blocking(hub: &Hub, new: NewEntry) -> Result<Added, ApiError> {
    let clock = Clock::system();
    let added = stamp(clock.utc()).to_string();
    let (entry, warnings) = match (new.scan, new.resume) {
        (Some(scan), None) => {
            if !scan.is_absolute() {
                let why = format!(
                    "{}: the daemon works in another folder; name the scan by its absolute path",
                    scan.display()
                );
                return Err(ApiError::new(StatusCode::UNPROCESSABLE_ENTITY, why));
            }
            let (queued, checked, warnings) = check_for_queue(hub, &scan, clock)?;
            let work = Work::Scan(Box::new(queued));
            let staged = hub.queue(Queue::stage)?;
            staged.copy(&checked)?;
            (hub.queue(|queue| queue.add(staged, work, added))?, warnings)
        }
        (None, Some(run)) => {
            check_resumable(hub, &run).map_err(|why| ApiError::new(StatusCode::CONFLICT, why))?;
            let staged = hub.queue(Queue::stage)?;
            (hub.queue(|queue| queue.add(staged, Work::Resume { run }, added))?, Vec::new())
        }
        _ => {
            let why = "the body names either `scan` (an absolute path) or `resume` (a run), one of the two";
            return Err(ApiError::new(StatusCode::UNPROCESSABLE_ENTITY, why));
        }
    };
    hub.tell_entry(&entry);
    hub.wake.notify_one();
    let (before, held) = hub.queue(|queue| {
        let before = queue.entries().filter(|e| !e.is_over() && e.id < entry.id).count();
        (before, queue.held().map(str::to_owned))
    });
    Ok(Added { entry: EntryNow::of(&entry), before, held, warnings })
}
