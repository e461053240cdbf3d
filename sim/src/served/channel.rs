//! The side channel of a served bench: a Unix socket that takes a line and gives one JSON document a line.

use super::board::Board;
use goniod_drivers::clock::Clock;
use serde_json::{Value, json};
use std::io;
use std::os::unix::net::UnixStream as Probe;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

/// Longest line, in bytes.
const LONGEST_LINE: usize = 1024;
/// Clients at once; one more waits.
const MOST_CLIENTS: usize = 16;
/// How long a client may be silent.
const SILENCE: Duration = Duration::from_secs(600);
/// Limit for a client that does not read.
const HAND_OVER: Duration = Duration::from_secs(5);

/// Takes the socket `path`; one that nobody serves any more is replaced.
///
/// # Errors
/// `AddrInUse` when another process serves it; whatever the system says.
pub fn listen(path: &Path) -> io::Result<UnixListener> {
    if Probe::connect(path).is_ok() {
        return Err(io::ErrorKind::AddrInUse.into());
    }
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => UnixListener::bind(path),
    }
}

/// Serves clients until the task is aborted.
pub async fn serve(listener: UnixListener, board: Arc<Board>) {
    let places = Arc::new(Semaphore::new(MOST_CLIENTS));
    let mut clients = JoinSet::new();
    while let Ok(place) = Arc::clone(&places).acquire_owned().await {
        while clients.try_join_next().is_some() {}
        match listener.accept().await {
            Ok((stream, _)) => {
                let board = Arc::clone(&board);
                clients.spawn(async move {
                    client(stream, board).await;
                    drop(place);
                });
            }
            Err(error) => {
                tracing::warn!(%error, "a client of the side channel was lost");
                board.clock.sleep(Duration::from_millis(100)).await;
            }
        }
    }
}

/// Answers one client until it leaves, is silent too long or says a line that never ends.
async fn client(mut stream: UnixStream, board: Arc<Board>) {
    let clock = board.clock;
    let (mut heard, mut chunk) = (Vec::new(), [0_u8; 256]);
    loop {
        while let Some(end) = heard.iter().position(|b| *b == b'\n') {
            let line: Vec<u8> = heard.drain(..=end).collect();
            let reply = match std::str::from_utf8(&line) {
                Ok(line) => board.carry_out(line.trim()),
                Err(_) => Err("the line is not UTF-8 text; write plain words".to_owned()),
            };
            if !say(&mut stream, &document(reply), clock).await {
                return;
            }
        }
        if heard.len() > LONGEST_LINE {
            let reply = Err(format!("the line is longer than {LONGEST_LINE} bytes; write `PART FAULT [NUMBER]`"));
            say(&mut stream, &document(reply), clock).await;
            return;
        }
        match clock.timeout(SILENCE, stream.read(&mut chunk)).await {
            Ok(Ok(n)) if n > 0 => heard.extend_from_slice(chunk.get(..n).unwrap_or_default()),
            _ => return,
        }
    }
}

fn document(reply: Result<Value, String>) -> Value {
    match reply {
        Ok(value) => json!({ "ok": value }),
        Err(sentence) => json!({ "error": sentence }),
    }
}

async fn say(stream: &mut UnixStream, document: &Value, clock: Clock) -> bool {
    let line = format!("{document}\n");
    matches!(clock.timeout(HAND_OVER, stream.write_all(line.as_bytes())).await, Ok(Ok(())))
}
