//! Makes the products of runs that are done, one after another, beside the run under way.

use super::entry::{Entry, EntryState, Products};
use super::hub::{DaemonEvent, Hub, Phase};
use crate::products::make::{Made, make_all};
use crate::products::reduce::Run;
use std::path::PathBuf;
use std::sync::Arc;

/// Works until clients are sent away; what is not made by then is made after the next start.
pub async fn work(hub: Arc<Hub>) {
    let mut phase = hub.phase();
    while *phase.borrow_and_update() < Phase::Stopping {
        let due = |e: &&Entry| e.products == Products::Pending && matches!(e.state, EntryState::Done { .. });
        match hub.queue(|queue| queue.entries().find(due).cloned()) {
            Some(entry) => make(&hub, &entry).await,
            None => tokio::select! {
                () = hub.products.notified() => {}
                _ = phase.changed() => {}
            },
        }
    }
}

async fn make(hub: &Hub, entry: &Entry) {
    let EntryState::Done { run, .. } = &entry.state else { return };
    let path = hub.facts.runs_dir.join(run);
    let made = tokio::task::spawn_blocking(move || products(path)).await;
    let made = made.unwrap_or_else(|e| Err(format!("a fault of the program itself: {e}")));
    let (products, event) = match made {
        Ok(Made { files, headline, not_made }) => {
            let event = DaemonEvent::ProductsMade { headline: headline.clone() };
            (Products::Made { headline, files, not_made }, event)
        }
        Err(why) => {
            let reason = format!("{why}; `goniod reduce` makes them again");
            (Products::Failed { reason: reason.clone() }, DaemonEvent::ProductsFailed { reason })
        }
    };
    if let Err(e) = hub.queue(|queue| queue.set(entry.id, |e| e.products = products)) {
        tracing::error!("{e}");
    }
    hub.tell(Some(run), event);
}

fn products(path: PathBuf) -> Result<Made, String> {
    let run = Run::open(&path).map_err(|e| e.to_string())?;
    make_all(&run).map_err(|e| e.to_string())
}
