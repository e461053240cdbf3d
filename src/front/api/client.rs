//! How the command line asks the daemon: one request a connection, over the Unix socket.

use super::error::Refusal;
use goniod_drivers::clock::Clock;
use http_body_util::{BodyExt, Full};
use hyper::body::{Bytes, Incoming};
use hyper::{Method, Request, Response};
use hyper_util::rt::TokioIo;
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};
use std::time::Duration;
use thiserror::Error;
use tokio::net::UnixStream;

/// How long the daemon may take to take a connection.
const CONNECT: Duration = Duration::from_secs(5);
/// How long it may take to answer what it knows.
const ANSWER: Duration = Duration::from_secs(10);
/// How long it may take to do what it is asked: checking a scan reads files, the safe state moves axes.
const DONE: Duration = Duration::from_secs(60);
/// Largest answer that is read, bytes.
const LARGEST: usize = 64 << 20;

/// Why there is no answer.
#[derive(Debug, Error)]
pub enum ClientError {
    /// Nobody listens.
    #[error("the daemon does not run (nobody answers at {socket}); start it with `systemctl start goniod` or `goniod serve`, or name its socket with --socket", socket = .socket.display())]
    NotRunning {
        /// Where it was looked for.
        socket: PathBuf,
    },
    /// The socket is not for this user.
    #[error("{socket}: this user may not talk to the daemon; join its group (usually `goniod`), or use sudo", socket = .socket.display())]
    NotAllowed {
        /// The socket.
        socket: PathBuf,
    },
    /// The daemon said no.
    #[error("{}", .refusal.error)]
    Refused {
        /// HTTP status.
        status: u16,
        /// What it said.
        refusal: Refusal,
    },
    /// The daemon is there and says nothing.
    #[error("{socket}: the daemon does not answer within {seconds} s, it is stopped or stuck; `systemctl restart goniod` begins it again and goes on with its run, or end its process and make the bench safe with `goniod safe --direct`", socket = .socket.display())]
    Silent {
        /// The socket.
        socket: PathBuf,
        /// How long it was waited for.
        seconds: u64,
    },
    /// The daemon is there but does not answer as it should.
    #[error("{socket}: the daemon's answer cannot be used: {why}; is it the same version?", socket = .socket.display())]
    Garbled {
        /// The socket.
        socket: PathBuf,
        /// What is wrong.
        why: String,
    },
}

/// A way to one daemon.
#[derive(Debug, Clone)]
pub struct Client {
    socket: PathBuf,
    clock: Clock,
    /// Instead of the usual limit for an answer.
    limit: Option<Duration>,
}

/// Server-sent events as they arrive.
pub struct Events {
    body: Incoming,
    text: Vec<u8>,
}

// === impl Client ===

impl Client {
    /// A client of the daemon at this socket.
    pub fn new(socket: PathBuf) -> Client {
        Client { socket, clock: Clock::system(), limit: None }
    }

    /// The same client, which waits for an answer so long and no longer.
    pub fn within(self, limit: Duration) -> Client {
        Client { limit: Some(limit), ..self }
    }

    /// The socket.
    pub fn socket(&self) -> &Path {
        &self.socket
    }

    /// Asks and reads the document of the answer.
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn ask<T: DeserializeOwned>(
        &self,
        method: Method,
        path: &str,
        body: Option<&impl serde::Serialize>,
    ) -> Result<T, ClientError> {
        let body = body.map(serde_json::to_vec).transpose().map_err(|e| self.garbled(e))?;
        let limit = self.limit.unwrap_or(if method == Method::GET { ANSWER } else { DONE });
        let work = async {
            let response = self.send(method, path, body.unwrap_or_default()).await?;
            let status = response.status();
            let limited = http_body_util::Limited::new(response.into_body(), LARGEST);
            let bytes = limited.collect().await.map_err(|e| self.garbled(e))?.to_bytes();
            if status.is_success() {
                return serde_json::from_slice(&bytes).map_err(|e| self.garbled(e));
            }
            Err(self.refused(status.as_u16(), &bytes))
        };
        self.clock.timeout(limit, work).await.unwrap_or_else(|_| Err(self.silent(limit)))
    }

    /// Listens to events.
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn events(&self, since: Option<&str>) -> Result<Events, ClientError> {
        let query = since.map_or_else(String::new, |since| format!("?since={since}"));
        let path = format!("/v1/events{query}");
        let head = self.clock.timeout(ANSWER, self.send(Method::GET, &path, Vec::new())).await;
        let response = head.map_err(|_| self.silent(ANSWER))??;
        let status = response.status();
        if status.is_success() {
            return Ok(Events { body: response.into_body(), text: Vec::new() });
        }
        let bytes = response.into_body().collect().await.map_err(|e| self.garbled(e))?.to_bytes();
        Err(self.refused(status.as_u16(), &bytes))
    }

    /// Sends a request and waits for the head of its answer; the caller sets the limit.
    async fn send(&self, method: Method, path: &str, body: Vec<u8>) -> Result<Response<Incoming>, ClientError> {
        let stream = self.clock.timeout(CONNECT, UnixStream::connect(&self.socket)).await;
        let stream = stream.map_err(|_| self.silent(CONNECT))?;
        let stream = stream.map_err(|e| match e.kind() {
            std::io::ErrorKind::PermissionDenied => ClientError::NotAllowed { socket: self.socket.clone() },
            _ => ClientError::NotRunning { socket: self.socket.clone() },
        })?;
        let handshake = hyper::client::conn::http1::handshake(TokioIo::new(stream)).await;
        let (mut sender, connection) = handshake.map_err(|e| self.garbled(e))?;
        // It ends with the answer's body or with the runtime.
        tokio::spawn(connection);
        let request = Request::builder()
            .method(method)
            .uri(path)
            .header("host", "goniod")
            .header("content-type", "application/json")
            .body(Full::new(Bytes::from(body)))
            .map_err(|e| self.garbled(e))?;
        sender.send_request(request).await.map_err(|e| self.garbled(e))
    }

    fn refused(&self, status: u16, bytes: &[u8]) -> ClientError {
        match serde_json::from_slice(bytes) {
            Ok(refusal) => ClientError::Refused { status, refusal },
            Err(_) => self.garbled(format!("status {status} without a sentence")),
        }
    }

    fn silent(&self, limit: Duration) -> ClientError {
        ClientError::Silent { socket: self.socket.clone(), seconds: limit.as_secs() }
    }

    fn garbled(&self, why: impl ToString) -> ClientError {
        ClientError::Garbled { socket: self.socket.clone(), why: why.to_string() }
    }
}

// === impl Events ===

impl Events {
    /// Data of the next event; `None` at the end of the stream. The daemon sends a comment at least every 10 s.
    pub async fn next(&mut self) -> Option<String> {
        loop {
            if let Some(data) = self.take() {
                return Some(data);
            }
            let frame = self.body.frame().await?.ok()?;
            if let Some(bytes) = frame.data_ref() {
                self.text.extend_from_slice(bytes);
            }
            if self.text.len() > LARGEST {
                return None;
            }
        }
    }

    /// The next whole event that has data.
    fn take(&mut self) -> Option<String> {
        loop {
            let end = self.text.windows(2).position(|w| w == b"\n\n")?;
            let block: Vec<u8> = self.text.drain(..end + 2).collect();
            let block = String::from_utf8_lossy(&block).into_owned();
            let data: Vec<&str> = block.lines().filter_map(|l| l.strip_prefix("data:")).map(str::trim_start).collect();
            if !data.is_empty() {
                return Some(data.join("\n"));
            }
        }
    }
}
