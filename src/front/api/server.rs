//! The listeners: a Unix socket for everything, a loopback port to look at, and how both end.

use super::guarded::Guarded;
use super::routes::{Shared, router};
use crate::front::daemon::error::DaemonError;
use crate::front::daemon::hub::Phase;
use axum::serve::Listener;
use std::net::SocketAddr;
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::net::{TcpListener, UnixListener};
use tokio::task::JoinHandle;

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
    L::Addr: std::fmt::Debug,
{
    let router = router(Shared::clone(hub), read_only);
    let mut phase = hub.phase();
    let guarded = Guarded::new(listener, hub.clock);
    tokio::spawn(async move {
        let closing = async move {
            // The sender lives in the hub, which the router holds.
            let _ = phase.wait_for(|p| *p == Phase::Closing).await;
        };
        // Its only error is that of a listener that never ends.
        let _ = axum::serve(guarded, router).with_graceful_shutdown(closing).await;
    })
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
