//! The whole daemon: locks, queue, socket, worker; until it is asked to end.

use super::error::DaemonError;
use super::hub::{DaemonEvent, Facts, Hub, Phase};
use super::lock::Locks;
use super::queue::Queue;
use super::{heart, products, snapshot, worker};
use crate::config::instrument::Instrument;
use crate::control::sequencer::verbs::ending_signals;
use crate::front::api::server::Servers;
use goniod_drivers::clock::Clock;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::signal::unix::Signal;

/// The socket where nothing else is said.
pub const USUAL_SOCKET: &str = "/run/goniod/goniod.sock";

/// Where the daemon lives.
#[derive(Debug, Clone)]
pub struct Place {
    /// The instrument file.
    pub instrument: PathBuf,
    /// Folder of queue and locks.
    pub state: PathBuf,
    /// The socket.
    pub socket: PathBuf,
    /// The loopback port of the live page.
    pub listen: Option<SocketAddr>,
}

/// Serves until one of the signals that ask for an end; the second one ends the run under way at once. `ready` is called
/// when requests are taken.
///
/// # Errors
/// [`DaemonError`]: the instrument or the state folder is in use, the socket cannot be made.
pub async fn serve(place: &Place, instrument: &Instrument, ready: impl FnOnce()) -> Result<(), DaemonError> {
    let signals =
        ending_signals().map_err(|source| DaemonError::Io { path: Path::new("SIGTERM").to_owned(), source })?;
    let locks = Locks::of_instrument(&place.instrument, instrument, "goniod serve")?.and_state(&place.state)?;
    let facts = Facts {
        name: instrument.name.clone(),
        instrument: snapshot::plain(&place.instrument),
        runs_dir: snapshot::plain(&instrument.runs_dir),
        auto_resume: instrument.auto_resume,
    };
    let hub = Arc::new(Hub::new(facts, Queue::open(&place.state)?, Clock::system()));
    let servers = Servers::start(&hub, &place.socket, place.listen).await?;
    for signal in signals {
        tokio::spawn(end_when_asked(Arc::clone(&hub), signal));
    }
    tokio::spawn(products::work(Arc::clone(&hub)));
    heart::ready();
    ready();
    tokio::select! {
        () = worker::work(&hub, &locks) => {}
        () = heart::beat(&hub) => {}
    }
    hub.go(Phase::Closing);
    servers.end(&hub).await;
    Ok(())
}

async fn end_when_asked(hub: Arc<Hub>, mut signal: Signal) {
    while signal.recv().await.is_some() {
        let first = *hub.phase().borrow() == Phase::Working;
        if first {
            heart::stopping();
            hub.tell(None, DaemonEvent::Stopping);
        }
        hub.go(if first { Phase::Stopping } else { Phase::Aborting });
    }
}
