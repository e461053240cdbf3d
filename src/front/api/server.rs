//! The listeners: a Unix socket for everything, a loopback port to look at, and how both end.

use super::guarded::{Guarded, GuardedIo};
use super::routes::{Shared, router};
use crate::front::daemon::error::DaemonError;
use crate::front::daemon::hub::Phase;
use axum::serve::Listener;
use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::TokioIo;
use hyper_util::service::TowerToHyperService;
use std::net::SocketAddr;
use std::os::fd::AsFd;
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, UnixListener};
use tokio::sync::watch;
use tokio::task::{JoinHandle, JoinSet};

/// Who may talk to the daemon: its user and its group.
const MODE: u32 = 0o660;
/// How long clients may take to go when they are sent away.
const FAREWELL: Duration = Duration::from_secs(3);

/// The servers of one daemon.
pub struct Servers {
    socket: PathBuf,
    tasks: Vec<JoinHandle<()>>,
}

// === impl Servers ===

impl Servers {
    /// Opens the socket and, where asked for, the loopback port.
    ///
    /// # Errors
    /// [`DaemonError::Socket`]: a socket that answers already, a folder that is not ours, a port that is taken.
    pub async fn start(hub: &Shared, socket: &Path, listen: Option<SocketAddr>) -> Result<Servers, DaemonError> {
        let unix = bind(hub, socket).await?;
        let mut tasks = Vec::new();
        if let Some(address) = listen {
            let failed = |e: std::io::Error| DaemonError::Socket {
                path: PathBuf::from(address.to_string()),
                why: format!("{e}; name another port in [daemon] listen"),
            };
            let tcp = TcpListener::bind(address).await.map_err(failed)?;
            tracing::info!(address = %tcp.local_addr().map_err(failed)?, "the live page");
            tasks.push(serve(hub, tcp, true));
        }
        tasks.push(serve(hub, unix, false));
        Ok(Servers { socket: socket.to_owned(), tasks })
    }

    /// Waits until the clients are gone, but not long, and removes the socket.
    pub async fn end(self, hub: &Shared) {
        for mut task in self.tasks {
            if hub.clock.timeout(FAREWELL, &mut task).await.is_err() {
                task.abort();
            }
        }
        // The next start removes what is left.
        let _ = std::fs::remove_file(&self.socket);
    }
}

fn serve<L>(hub: &Shared, listener: L, read_only: bool) -> JoinHandle<()>
where
    L: Listener,
    L::Io: AsFd,
    L::Addr: std::fmt::Debug,
{
    let router = router(Shared::clone(hub), read_only);
    let phase = hub.phase();
    let mut guarded = Guarded::new(listener, hub.clock);
    tokio::spawn(async move {
        let mut closing = std::pin::pin!(until_closing(phase.clone()));
        // Those that are under way end with this task, at the latest.
        let mut connections = JoinSet::new();
        loop {
            // Nothing but the end may interrupt this: a connection that waits for its place would be lost.
            let (io, _) = tokio::select! {
                () = &mut closing => break,
                accepted = guarded.accept() => accepted,
            };
            while connections.try_join_next().is_some() {}
            connections.spawn(answer(io, router.clone(), phase.clone()));
        }
        drop(guarded);
        while connections.join_next().await.is_some() {}
    })
}

/// Answers the requests of one connection. A client that sends no more may still wait for its answer: half a connection
/// is enough (`nc -N`, `socat`).
async fn answer<I>(io: GuardedIo<I>, router: Router, phase: watch::Receiver<Phase>)
where
    I: AsyncRead + AsyncWrite + AsFd + Unpin + Send + 'static,
{
    let service = TowerToHyperService::new(router.layer(Extension(Arc::new(io.watch()))));
    let connection = http1::Builder::new().half_close(true).serve_connection(TokioIo::new(io), service);
    let mut connection = std::pin::pin!(connection);
    // A connection's error is its client's: nobody is left to tell.
    tokio::select! {
        _ = connection.as_mut() => return,
        () = until_closing(phase) => connection.as_mut().graceful_shutdown(),
    }
    let _ = connection.await;
}

/// Until clients are sent away.
async fn until_closing(mut phase: watch::Receiver<Phase>) {
    // The sender lives in the hub, which the router holds.
    let _ = phase.wait_for(|p| *p == Phase::Closing).await;
}

/// A socket that appears with its rights: made under another name, then renamed.
async fn bind(hub: &Shared, path: &Path) -> Result<UnixListener, DaemonError> {
    let failed = |why: String| DaemonError::Socket { path: path.to_owned(), why };
    let hint = "give another path with --socket or [daemon] socket";
    match std::fs::symlink_metadata(path) {
        Ok(meta) if !meta.file_type().is_socket() => {
            return Err(failed(format!("a file that is no socket is there; {hint}")));
        }
        Ok(_) => {
            let answers = hub.clock.timeout(Duration::from_secs(2), tokio::net::UnixStream::connect(path)).await;
            if matches!(answers, Ok(Ok(_)) | Err(_)) {
                return Err(failed(format!("another daemon answers there; {hint}")));
            }
        }
        Err(_) => {}
    }
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|e| failed(format!("its folder cannot be made ({e}); {hint}")))?;
    }
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".new");
    let building = path.with_file_name(name);
    // Left over from a start that was cut short.
    let _ = std::fs::remove_file(&building);
    let listener =
        UnixListener::bind(&building).map_err(|e| failed(format!("{e}; {hint} (at most 103 bytes long)")))?;
    std::fs::set_permissions(&building, std::fs::Permissions::from_mode(MODE))
        .and_then(|()| std::fs::rename(&building, path))
        .map_err(|e| failed(format!("{e}; {hint}")))?;
    Ok(listener)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::front::api::guarded::MOST_CONNECTIONS;
    use crate::front::daemon::hub::{Facts, Hub};
    use crate::front::daemon::queue::Queue;
    use goniod_drivers::clock::Clock;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::UnixStream;

    fn hub(state: &Path) -> Shared {
        let (instrument, runs_dir) = (state.join("instrument.toml"), state.join("runs"));
        let facts = Facts { name: "n".to_owned(), instrument, runs_dir, auto_resume: false };
        Arc::new(Hub::new(facts, Queue::open(state).unwrap(), Clock::system()))
    }

    /// What a client hears that sends all it has to say and then no more, as `nc -N` does.
    async fn said_and_done(socket: &Path, request: &str) -> String {
        let mut client = UnixStream::connect(socket).await.unwrap();
        client.write_all(request.as_bytes()).await.unwrap();
        client.shutdown().await.unwrap();
        let mut answer = String::new();
        client.read_to_string(&mut answer).await.unwrap();
        answer
    }

    #[tokio::test]
    async fn a_client_that_sends_no_more_after_its_request_gets_its_answer() {
        let state = tempfile::tempdir().unwrap();
        let (hub, socket) = (hub(state.path()), state.path().join("goniod.sock"));
        let servers = Servers::start(&hub, &socket, None).await.unwrap();
        for request in ["GET /v1/status HTTP/1.1\r\nHost: goniod\r\n\r\n", "GET /v1/queue HTTP/1.0\r\n\r\n"] {
            // Whether its end comes with the request or later is a matter of chance.
            for _ in 0..20 {
                let answer = said_and_done(&socket, request).await;
                assert!(answer.contains(" 200 OK\r\n") && answer.contains("\"held\":null"), "{answer}");
            }
        }
        let body = r#"{"resume":"no-such-run"}"#;
        let head = "POST /v1/queue HTTP/1.1\r\nHost: goniod\r\nContent-Type: application/json\r\nContent-Length";
        let answer = said_and_done(&socket, &format!("{head}: {}\r\n\r\n{body}", body.len())).await;
        assert!(answer.contains(" 409 Conflict\r\n") && answer.contains("no-such-run"), "{answer}");
        hub.go(Phase::Closing);
        servers.end(&hub).await;
        assert!(UnixStream::connect(&socket).await.is_err());
    }

    #[tokio::test]
    async fn half_a_request_and_no_more_gets_no_answer_and_disturbs_nobody() {
        let state = tempfile::tempdir().unwrap();
        let (hub, socket) = (hub(state.path()), state.path().join("goniod.sock"));
        let _servers = Servers::start(&hub, &socket, None).await.unwrap();
        for request in ["", "GET", "GET /v1/status HTTP/1.1\r\nHost: go", "\0\0\r\n\r\n"] {
            let answer = said_and_done(&socket, request).await;
            assert!(!answer.contains("200 OK"), "{request}: {answer}");
        }
        let whole = "GET /v1/status HTTP/1.1\r\nHost: goniod\r\nConnection: close\r\n\r\n";
        assert!(said_and_done(&socket, whole).await.contains("200 OK"));
    }

    /// A client that has asked for events and got the head of the answer.
    async fn listener(socket: &Path) -> UnixStream {
        let mut client = UnixStream::connect(socket).await.unwrap();
        client.write_all(b"GET /v1/events HTTP/1.1\r\nHost: goniod\r\n\r\n").await.unwrap();
        let mut head = [0; 15];
        client.read_exact(&mut head).await.unwrap();
        assert_eq!(&head, b"HTTP/1.1 200 OK");
        client
    }

    /// Long before the next comment of a stream would tell.
    #[tokio::test]
    async fn a_stream_ends_when_its_client_is_gone_or_its_place_is_wanted_and_not_before() {
        const SOON: Duration = Duration::from_secs(3);
        let state = tempfile::tempdir().unwrap();
        let (hub, socket) = (hub(state.path()), state.path().join("goniod.sock"));
        let _servers = Servers::start(&hub, &socket, None).await.unwrap();
        let (mut sends_no_more, goes) = (listener(&socket).await, listener(&socket).await);
        sends_no_more.shutdown().await.unwrap();
        drop(goes);
        let one_is_left = async {
            while hub.listeners() > 1 {
                hub.clock.sleep(Duration::from_millis(5)).await;
            }
        };
        hub.clock.timeout(SOON, one_is_left).await.unwrap();
        hub.clock.sleep(Duration::from_millis(100)).await;
        assert_eq!(hub.listeners(), 1, "who sends no more still listens");
        let mut others = Vec::new();
        for _ in 1..MOST_CONNECTIONS {
            others.push(listener(&socket).await);
        }
        let request = "GET /v1/status HTTP/1.1\r\nHost: goniod\r\n\r\n";
        let answer = hub.clock.timeout(SOON, said_and_done(&socket, request)).await.unwrap();
        assert!(answer.contains("200 OK"), "{answer}");
        let mut rest = Vec::new();
        let told = hub.clock.timeout(SOON, sends_no_more.read_to_end(&mut rest)).await;
        assert!(told.is_ok(), "the one that was silent longest was sent away");
    }
}
