//! Target: what a client sends to the daemon's socket, byte by byte.

use super::harness::Target;
use goniod::front::api::server::Servers;
use goniod::front::daemon::hub::{Facts, Hub};
use goniod::front::daemon::queue::Queue;
use goniod_drivers::clock::Clock;
use std::io::{Read, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// All of them.
pub const TARGETS: &[Target] = &[Target { name: "api-request", run: request, mutations: 60 }];

/// Bytes of an answer that are looked at.
const MOST: usize = 1 << 20;
/// The stream of events has no end: what came until then is looked at.
const PATIENCE: Duration = Duration::from_millis(500);

/// The socket of a daemon without worker, in this process, which lives as long as the process.
fn socket() -> &'static PathBuf {
    static SOCKET: OnceLock<PathBuf> = OnceLock::new();
    SOCKET.get_or_init(|| {
        let folder = std::env::temp_dir().join(format!("goniod-fuzz-api-{}", std::process::id()));
        let (path, state) = (folder.join("socket"), folder.join("state"));
        let (ready, begun) = std::sync::mpsc::channel();
        let served = path.clone();
        std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
            runtime.block_on(async {
                let facts = Facts {
                    name: "nothing".to_owned(),
                    instrument: state.join("instrument.toml"),
                    runs_dir: state.join("runs"),
                    auto_resume: false,
                };
                let queue = Queue::open(&state).expect("a queue");
                let hub = Arc::new(Hub::new(facts, queue, Clock::system()));
                let _servers = Servers::start(&hub, &served, None).await.expect("a socket");
                ready.send(()).expect("somebody waits");
                std::future::pending::<()>().await;
            });
        });
        begun.recv().expect("the daemon begins");
        path
    })
}

/// Removes the daemon's folder.
pub fn tidy_up() {
    if let Some(folder) = socket().parent() {
        let _ = std::fs::remove_dir_all(folder);
    }
}

/// What comes back until the daemon closes, or nothing more comes.
fn answer(bytes: &[u8], patience: Duration, end: bool) -> Result<Vec<u8>, String> {
    let mut stream = UnixStream::connect(socket()).map_err(|e| format!("the daemon does not listen: {e}"))?;
    stream.set_read_timeout(Some(patience)).map_err(|e| e.to_string())?;
    // A daemon that has refused already may have closed.
    let _ = stream.write_all(bytes);
    if end {
        let _ = stream.shutdown(Shutdown::Write);
    }
    let (mut all, mut chunk) = (Vec::new(), [0; 4096]);
    while let Ok(n @ 1..) = stream.read(&mut chunk) {
        all.extend(chunk.get(..n).unwrap_or_default());
        if all.len() > MOST {
            return Err("an answer without end".to_owned());
        }
    }
    Ok(all)
}

/// It is answered or refused, never with a fault of the daemon's own, and the daemon goes on.
fn request(bytes: &[u8]) -> Result<(), String> {
    let said = answer(bytes, PATIENCE, true)?;
    let head = String::from_utf8_lossy(said.get(..12.min(said.len())).unwrap_or_default()).into_owned();
    let status: Option<u16> =
        head.strip_prefix("HTTP/1.1 ").or(head.strip_prefix("HTTP/1.0 ")).and_then(|s| s.parse().ok());
    match status {
        // 503 is a safe state that is asked for and cannot be had here: there is no instrument.
        Some(500 | 502 | 504 | 505..) => return Err(format!("it answers {head:?}")),
        None if !said.is_empty() => return Err(format!("it answers {head:?}, which is no HTTP")),
        _ => {}
    }
    // This one is answered, however busy the machine is: a client that has ended its side may be gone, so it does not.
    let status = b"GET /v1/status HTTP/1.1\r\nHost: goniod\r\nConnection: close\r\n\r\n";
    let after = answer(status, 60 * PATIENCE, false)?;
    if after.starts_with(b"HTTP/1.1 200") { Ok(()) } else { Err("the daemon does not answer any more".to_owned()) }
}
